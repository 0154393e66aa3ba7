//! Meshes and their topology: edges, one-rings, and vertex normals of a posed surface.

use glam::Vec3;
use rayon::prelude::*;

/// Marks a missing face, texel or row in columns of `u32`.
pub const NONE: u32 = u32::MAX;

/// Rows handled by one task; fixed, so results do not depend on the number of threads.
pub(crate) const CHUNK: usize = 1024;

/// Faults of a mesh: bad faces, positions or row counts.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// A face names a vertex that is not there.
    #[error("face {face} names vertex {vertex}, but the mesh has {vertices}; read the mesh again")]
    Vertex {
        /// Row of the face among the faces.
        face: usize,
        /// The vertex it names, beyond the mesh.
        vertex: u32,
        /// Number of vertices of the mesh.
        vertices: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} is ({x}, {y}, {z}), which is not finite; check the pose and the offsets", x = .at.x, y = .at.y, z = .at.z)]
    NonFinite {
        /// Row of the vertex among the vertices.
        vertex: usize,
        /// Its position, with a coordinate that is not finite.
        at: Vec3,
    },
    /// A column has the wrong number of rows.
    #[error("{what} has {got} rows, {want} are needed")]
    Rows {
        /// Name of the column concerned.
        what: &'static str,
        /// Number of rows it has.
        got: usize,
        /// Number of rows it must have.
        want: usize,
    },
}

/// A posed triangle mesh: `N` vertices and normals, `F` faces.
#[derive(Clone, Copy, Debug)]
pub struct Mesh<'a> {
    /// Vertex positions in the world, `N` rows.
    pub vertices: &'a [Vec3],
    /// Unit vertex normals, `N` rows.
    pub normals: &'a [Vec3],
    /// Triangles: `F` rows of three vertex rows.
    pub faces: &'a [[u32; 3]],
}

impl Mesh<'_> {
    /// Checks row counts, vertex rows of faces, and that positions are finite.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(&self) -> Result<(), MeshError> {
        let (got, want) = (self.normals.len(), self.vertices.len());
        if got != want {
            return Err(MeshError::Rows { what: "normals", got, want });
        }
        check_faces(self.faces, want)?;
        check_finite(self.vertices)
    }
}

/// Checks that faces name only vertices below `vertices`.
pub(crate) fn check_faces(faces: &[[u32; 3]], vertices: usize) -> Result<(), MeshError> {
    let beyond = |(face, corners): (usize, &[u32; 3])| {
        let vertex = corners.iter().copied().find(|&v| v as usize >= vertices)?;
        Some(MeshError::Vertex { face, vertex, vertices })
    };
    faces.iter().enumerate().find_map(beyond).map_or(Ok(()), Err)
}

/// Checks that positions are finite.
fn check_finite(vertices: &[Vec3]) -> Result<(), MeshError> {
    match vertices.iter().position(|v| !v.is_finite()) {
        Some(vertex) => Err(MeshError::NonFinite { vertex, at: vertices[vertex] }),
        None => Ok(()),
    }
}

/// Rows of different lengths in one buffer (compressed sparse rows).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rows {
    /// Row `i` is `begins[i]..begins[i + 1]` of `values`.
    pub begins: Vec<u32>,
    /// The values of all rows, one row after another.
    pub values: Vec<u32>,
}

impl Rows {
    /// The values of row `i`.
    pub fn row(&self, i: usize) -> &[u32] {
        &self.values[self.begins[i] as usize..self.begins[i + 1] as usize]
    }

    /// `rows` rows from `(row, value)` pairs; values keep the order of the pairs.
    pub(crate) fn from_pairs(rows: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut begins = vec![0u32; rows + 1];
        pairs.clone().for_each(|(row, _)| begins[row as usize + 1] += 1);
        (0..rows).for_each(|i| begins[i + 1] += begins[i]);
        let mut next = begins.clone();
        let mut values = vec![0; begins[rows] as usize];
        for (row, value) in pairs {
            values[next[row as usize] as usize] = value;
            next[row as usize] += 1;
        }
        Self { begins, values }
    }
}

/// Edges, one-rings and incident faces of a welded mesh.
///
/// ```
/// use gs_texel::surface::Topology;
///
/// let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
/// let topology = Topology::new(&tetrahedron, 4)?;
/// assert_eq!(topology.edges, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]);
/// assert_eq!((topology.edge_faces[0], topology.ring.row(3)), ([0, 1], &[0, 1, 2][..]));
/// # Ok::<(), gs_texel::surface::MeshError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Unique undirected edges, lower vertex row first, sorted.
    pub edges: Vec<[u32; 2]>,
    /// The two lowest face rows at each edge, [`NONE`] where there is no second.
    pub edge_faces: Vec<[u32; 2]>,
    /// Number of edges with more than two faces.
    pub non_manifold: usize,
    /// One-ring of each vertex: its neighbours along edges, ascending.
    pub ring: Rows,
    /// Corners of faces at each vertex, as `3·face + corner`, ascending.
    pub corners: Rows,
}

impl Topology {
    /// The topology of `faces` over `vertices` vertices. Edges from a vertex to itself are dropped.
    ///
    /// # Errors
    /// If a face names a vertex that is not there.
    pub fn new(faces: &[[u32; 3]], vertices: usize) -> Result<Self, MeshError> {
        check_faces(faces, vertices)?;
        let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(3 * faces.len());
        for (f, &[a, b, c]) in faces.iter().enumerate() {
            let pairs = [[a, b], [b, c], [c, a]].into_iter().filter(|[p, q]| p != q);
            sides.extend(pairs.map(|[p, q]| ([p.min(q), p.max(q)], f as u32)));
        }
        sides.sort_unstable();
        let mut out = Self::default();
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            out.edges.push(same[0].0);
            out.edge_faces.push([same[0].1, same.get(1).map_or(NONE, |s| s.1)]);
            out.non_manifold += usize::from(same.len() > 2);
        }
        let lower = out.edges.iter().map(|&[a, b]| (b, a));
        let higher = out.edges.iter().map(|&[a, b]| (a, b));
        out.ring = Rows::from_pairs(vertices, lower.chain(higher));
        let corners = faces.iter().flatten().enumerate().map(|(corner, &v)| (v, corner as u32));
        out.corners = Rows::from_pairs(vertices, corners);
        Ok(out)
    }

    /// Unit vertex normals: means of face normals weighted by the angle at the vertex, +z for a vertex without a face of
    /// positive area. `faces` must be those of [`Topology::new`].
    pub fn normals(&self, vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<Vec3> {
        let mut of_corner = vec![[Vec3::ZERO; 3]; faces.len()];
        of_corner.par_chunks_mut(CHUNK).zip(faces.par_chunks(CHUNK)).for_each(|(out, faces)| {
            out.iter_mut().zip(faces).for_each(|(o, f)| *o = corner_normals(f.map(|v| vertices[v as usize])));
        });
        let flat = of_corner.as_flattened();
        let normal = |v: usize| {
            let sum: Vec3 = self.corners.row(v).iter().map(|&c| flat[c as usize]).sum();
            let length = sum.length();
            if length > 1e-12 { sum / length } else { Vec3::Z }
        };
        (0..vertices.len()).into_par_iter().with_min_len(CHUNK).map(normal).collect()
    }
}

/// The unit normal of a triangle times its angle at each corner; zero where it has no area.
fn corner_normals([a, b, c]: [Vec3; 3]) -> [Vec3; 3] {
    // In f64, so that triangles of a micrometre still have a direction.
    let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
    let n = (b - a).cross(c - a);
    let Some(n) = n.try_normalize() else { return [Vec3::ZERO; 3] };
    let angle = |p: glam::DVec3, q: glam::DVec3| p.cross(q).length().atan2(p.dot(q));
    let angles = [angle(b - a, c - a), angle(c - b, a - b), angle(a - c, b - c)];
    angles.map(|t| (n * t).as_vec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    #[test]
    fn a_tetrahedron_has_six_edges_and_rings_of_three() {
        let t = Topology::new(&TETRAHEDRON, 5).unwrap();
        assert_eq!(t.edges.len(), 6);
        assert!(t.edge_faces.iter().all(|f| f[1] != NONE) && t.non_manifold == 0);
        assert_eq!(t.ring.row(3), [0, 1, 2]);
        assert_eq!(t.corners.row(3), [5, 8, 11]);
        assert!(t.ring.row(4).is_empty());
    }

    #[test]
    fn normals_are_angle_weighted_and_never_nan() {
        // A cube's corner: three squares of two triangles each, however they are cut, give (1, 1, 1)/√3.
        let v = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]];
        let v: Vec<Vec3> = v.iter().map(|p| Vec3::from_array(p.map(|c| c as f32))).collect();
        let faces = [[0, 2, 1], [0, 3, 2], [0, 1, 5], [0, 5, 4], [0, 4, 3], [4, 6, 3], [0, 0, 1]];
        let t = Topology::new(&faces, v.len()).unwrap();
        let n = t.normals(&v, &faces);
        assert!((n[0] + Vec3::ONE / 3f32.sqrt()).length() < 1e-6, "{}", n[0]);
        assert!(n.iter().all(|n| (n.length() - 1.0).abs() < 1e-6));
        let flat = Topology::new(&[[0, 1, 2]], 3).unwrap().normals(&[Vec3::ONE; 3], &[[0, 1, 2]]);
        assert_eq!(flat, [Vec3::Z; 3]);
    }

    #[test]
    fn bad_meshes_are_refused_by_name() {
        let error = Topology::new(&[[0, 1, 2], [0, 7, 1]], 3).unwrap_err().to_string();
        assert!(error.starts_with("face 1 names vertex 7, but the mesh has 3"), "{error}");
        let error = check_finite(&[Vec3::ZERO, Vec3::new(0.0, f32::NAN, 1.0)]).unwrap_err().to_string();
        assert!(error.starts_with("vertex 1 is (0, NaN, 1)"), "{error}");
    }
}
