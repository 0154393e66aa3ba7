//! Which faces are near one another along the surface.

use crate::surface::{MeshError, NONE, Rows, Topology};
use rayon::prelude::*;

/// Most edges that are walked from vertex to vertex.
const MOST_EDGES: usize = 8;

/// Faces that lie within a few edges of one another on a welded mesh.
pub(crate) struct Neighbours<'a> {
    faces: &'a [[u32; 3]],
    /// For each vertex those within so many edges, itself first; none where only a vertex in common counts.
    around: Option<Rows>,
}

impl<'a> Neighbours<'a> {
    /// Faces whose nearest vertices lie within `edges` edges of one another, at most [`MOST_EDGES`]; 0: which have a vertex in
    /// common.
    ///
    /// # Errors
    /// If a face names a vertex beyond `vertices`.
    pub(crate) fn within(edges: usize, faces: &'a [[u32; 3]], vertices: usize) -> Result<Self, MeshError> {
        let around = (edges > 0).then(|| {
            let topology = Topology::new(faces, vertices)?;
            let near: Vec<Vec<u32>> =
                (0..vertices).into_par_iter().map(|v| walked(v, edges.min(MOST_EDGES), &topology)).collect();
            let pairs = near.iter().enumerate().flat_map(|(v, near)| near.iter().map(move |&w| (v as u32, w)));
            Ok(Rows::from_pairs(vertices, pairs))
        });
        Ok(Self { faces, around: around.transpose()? })
    }

    /// Whether two faces are near; [`NONE`] is near nothing.
    #[inline]
    pub(crate) fn are_near(&self, a: u32, b: u32) -> bool {
        if a == b || a == NONE || b == NONE {
            return a == b && a != NONE;
        }
        let (a, b) = (self.faces[a as usize], self.faces[b as usize]);
        let meet = a.iter().any(|v| b.contains(v));
        meet || self
            .around
            .as_ref()
            .is_some_and(|around| a.iter().any(|&v| around.row(v as usize).iter().any(|w| b.contains(w))))
    }
}

/// Vertices within `edges` edges of `v`, nearest first.
fn walked(v: usize, edges: usize, topology: &Topology) -> Vec<u32> {
    let mut found = vec![v as u32];
    let mut from = 0;
    for _ in 0..edges {
        let last = found.len();
        for i in from..last {
            for &w in topology.ring.row(found[i] as usize) {
                if !found.contains(&w) {
                    found.push(w);
                }
            }
        }
        from = last;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of triangles along the vertices 0, 1, 2, …: face `i` is `[i, i + 1, i + 2]`.
    fn strip(faces: u32) -> Vec<[u32; 3]> {
        (0..faces).map(|i| [i, i + 1, i + 2]).collect()
    }

    #[test]
    fn faces_of_a_strip_are_near_as_far_as_edges_reach() {
        let faces = strip(20);
        for edges in 0..4 {
            let near = Neighbours::within(edges, &faces, 22).unwrap();
            // A vertex in common up to two faces on; an edge of a strip reaches two vertices on.
            let reach = 2 + 2 * edges as u32;
            for b in 0..20 {
                assert_eq!(near.are_near(3, b), b.abs_diff(3) <= reach, "{edges} {b}");
                assert_eq!(near.are_near(b, 3), near.are_near(3, b), "both ways");
            }
        }
    }

    #[test]
    fn parts_that_share_no_vertex_are_never_near() {
        let mut faces = strip(4);
        faces.extend(strip(4).into_iter().map(|f| f.map(|v| v + 6)));
        let near = Neighbours::within(MOST_EDGES, &faces, 12).unwrap();
        assert!((0..4).all(|a| (4..8).all(|b| !near.are_near(a, b))) && near.are_near(4, 7));
        assert!(!near.are_near(NONE, 0) && !near.are_near(0, NONE) && !near.are_near(NONE, NONE));
    }
}
