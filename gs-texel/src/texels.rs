//! The texel table: face and barycentric coordinates of every texel of a texture map.
//!
//! Texture coordinates do not depend on the pose, so a table is built once per template and size. Posing then costs three
//! gathers per texel ([`TexelTable::interp`]). Row `k` of every column belongs to the `k`-th **valid** texel, one whose centre
//! lies in a UV triangle; there are `K` of them, in the row-major order of the map.

mod charts;
mod reader;
mod resize;

pub use reader::{MapReader, SeamRead};
pub use resize::resize;

use crate::coverage::{MAX_COORDINATE, Window, spans, to_fixed};
use crate::surface::{CHUNK, MeshError, NONE, check_faces};
use glam::{DVec2, Vec2, Vec3};
use gs_core::Image;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Largest side of a map, texels.
const MAX_SIZE: usize = 1 << 14;
/// Share of valid texels that may lie in more than one triangle.
const MAX_OVERLAP: f64 = 1e-3;

/// Texture coordinates or sizes that [`TexelTable::build`] refuses.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TexelError {
    /// Faces name rows that do not exist, or the numbers of faces differ.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A coordinate is not finite, or far outside the texture.
    #[error("texture coordinate {row} is ({u}, {v}); coordinates must be finite and of magnitude below 16")]
    Coordinate {
        /// Row among the texture coordinates.
        row: usize,
        /// Its horizontal coordinate `u`, in textures.
        u: f32,
        /// Its vertical coordinate `v`, in textures.
        v: f32,
    },
    /// The side of the map is out of range.
    #[error("texture size {size} is out of range: 1 to {MAX_SIZE} texels")]
    Size {
        /// The side asked for, texels.
        size: usize,
    },
    /// Too many texels lie in more than one triangle.
    #[error(
        "{overlaps} of {valid} texels belong to more than one triangle (the first is texel {texel}, of faces {first} and {second}); \
         unwrap the mesh without overlap, or allow it and the lower face wins"
    )]
    Overlap {
        /// Number of texels in more than one triangle.
        overlaps: usize,
        /// Number of texels that lie in a triangle.
        valid: usize,
        /// The first such texel, `y·S + x`.
        texel: u32,
        /// The lowest face that covers it.
        first: u32,
        /// The next face it lies in.
        second: u32,
    },
    /// No texel centre lies in a UV triangle.
    #[error("no texel of a {size}x{size} texture has its centre in a UV triangle; use a larger texture or unwrap anew")]
    Empty {
        /// Side of the map, texels.
        size: usize,
    },
}

/// Rules of [`TexelTable::build`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TexelOptions {
    /// Accept any number of overlapping texels (mirrored halves that share texels on purpose). Default: no; above 0.1 % is an
    /// error.
    pub allow_overlap: bool,
}

/// Counts made while a table was built.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TexelReport {
    /// Texels in more than one triangle; the lowest face gets them.
    pub overlaps: usize,
    /// Faces without area in the texture.
    pub degenerate: usize,
    /// Faces with area in the texture that get no texel.
    pub unseen_faces: usize,
    /// Share of these faces in the area of all, in the texture.
    pub unseen_area: f64,
    /// Number of charts (islands of the texture).
    pub charts: usize,
}

/// Face and barycentric coordinates of the `K` valid texels of an `S × S` map.
///
/// ```
/// use glam::Vec2;
/// use gs_texel::texels::{TexelOptions, TexelTable};
///
/// // The unit square as two triangles: every texel is valid.
/// let uvs = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vec2::from_array);
/// let faces = [[0, 1, 2], [0, 2, 3]];
/// let table = TexelTable::build(&faces, &uvs, &faces, 4, &TexelOptions::default())?;
/// assert_eq!((table.len(), table.report.charts), (16, 1));
/// // Interpolating the coordinates themselves gives the texel centres.
/// assert_eq!(table.interp(&faces, &uvs.map(|p| p.to_array()))[5], [0.375, 0.375]);
/// # Ok::<(), gs_texel::texels::TexelError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct TexelTable {
    /// Side of the map `S`, texels.
    pub size: usize,
    /// Index of each valid texel in the map, `y·S + x`; `K` rows, ascending.
    pub valid: Vec<u32>,
    /// Face of each valid texel; `K` rows.
    pub tri: Vec<u32>,
    /// Barycentric weights `b₀, b₁` of the first and second corner; `K` rows.
    pub bary: Vec<[f32; 2]>,
    /// Chart of each valid texel; `K` rows.
    pub chart: Vec<u16>,
    /// Row of each texel of the map, [`NONE`] for invalid ones; `S²` values.
    pub row: Vec<u32>,
    /// Overlaps, degenerate faces and other counts.
    pub report: TexelReport,
}

impl TexelTable {
    /// Builds the table of a `size × size` map. `faces` are rows of vertices, `face_uvs` the same triangles as rows of `uvs`.
    ///
    /// # Errors
    /// If rows do not exist, a coordinate is not finite, more texels overlap than allowed, or no texel is valid.
    pub fn build(
        faces: &[[u32; 3]],
        uvs: &[Vec2],
        face_uvs: &[[u32; 3]],
        size: usize,
        options: &TexelOptions,
    ) -> Result<Self, TexelError> {
        check(faces, uvs, face_uvs, size)?;
        let mut fill = Fill::new(size);
        face_uvs.iter().enumerate().for_each(|(f, uv)| fill.face(f as u32, uv.map(|k| uvs[k as usize])));
        let valid: Vec<u32> = (0..fill.owner.len() as u32).filter(|&t| fill.owner[t as usize] != NONE).collect();
        if valid.is_empty() {
            return Err(TexelError::Empty { size });
        }
        let (overlaps, share) = (fill.report.overlaps, MAX_OVERLAP * valid.len() as f64);
        if let (Some((texel, first, second)), false) = (fill.first_overlap, options.allow_overlap)
            && overlaps as f64 > share
        {
            return Err(TexelError::Overlap { overlaps, valid: valid.len(), texel, first, second });
        }
        let tri: Vec<u32> = valid.iter().map(|&t| fill.owner[t as usize]).collect();
        let bary = valid.iter().map(|&t| fill.bary[t as usize]).collect();
        let of_face = charts::of_faces(faces, uvs, face_uvs);
        let mut report = fill.report;
        report.unseen_area /= fill.area.max(f64::MIN_POSITIVE);
        report.charts = of_face.iter().max().map_or(0, |&c| usize::from(c) + 1);
        let chart = tri.iter().map(|&f| of_face[f as usize]).collect();
        let mut row = vec![NONE; size * size];
        valid.iter().enumerate().for_each(|(k, &t)| row[t as usize] = k as u32);
        Ok(Self { size, valid, tri, bary, chart, row, report })
    }

    /// `K`, the number of valid texels.
    pub fn len(&self) -> usize {
        self.valid.len()
    }

    /// Whether there is no valid texel; never true for a table from [`TexelTable::build`].
    pub fn is_empty(&self) -> bool {
        self.valid.is_empty()
    }

    /// Texture coordinate of the centre of the texel of row `k`.
    pub fn uv(&self, k: usize) -> Vec2 {
        let (t, s) = (self.valid[k] as usize, self.size as f32);
        Vec2::new((t % self.size) as f32 + 0.5, (t / self.size) as f32 + 0.5) / s
    }

    /// Interpolates a vertex attribute: `a(t) = b₀ a₀ + b₁ a₁ + (1 − b₀ − b₁) a₂` at every valid texel, `K` rows. `faces` are
    /// those of the table; `attribute` has a row of `C` values per vertex.
    pub fn interp<const C: usize>(&self, faces: &[[u32; 3]], attribute: &[[f32; C]]) -> Vec<[f32; C]> {
        let mut out = vec![[0.0; C]; self.len()];
        self.each(&mut out, |k| {
            let w = self.weights(k);
            let [a, b, c] = faces[self.tri[k] as usize].map(|v| &attribute[v as usize]);
            std::array::from_fn(|i| w[0] * a[i] + w[1] * b[i] + w[2] * c[i])
        });
        out
    }

    /// [`TexelTable::interp`] for vectors. Interpolated normals are not normalised.
    pub fn interp_vec3(&self, faces: &[[u32; 3]], attribute: &[Vec3]) -> Vec<Vec3> {
        let mut out = vec![Vec3::ZERO; self.len()];
        self.each(&mut out, |k| self.at(faces, attribute, k));
        out
    }

    /// A vertex attribute interpolated at the texel of row `k`.
    #[inline]
    pub fn at(&self, faces: &[[u32; 3]], attribute: &[Vec3], k: usize) -> Vec3 {
        let w = self.weights(k);
        let [a, b, c] = faces[self.tri[k] as usize].map(|v| attribute[v as usize]);
        w[0] * a + w[1] * b + w[2] * c
    }

    /// Barycentric weights of the three corners at row `k`; they sum to 1.
    #[inline]
    pub fn weights(&self, k: usize) -> [f32; 3] {
        let [a, b] = self.bary[k];
        [a, b, 1.0 - a - b]
    }

    fn each<T: Send>(&self, out: &mut [T], value: impl Fn(usize) -> T + Sync) {
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            out.iter_mut().enumerate().for_each(|(i, o)| *o = value(chunk * CHUNK + i));
        });
    }

    /// An `S × S × C` map of `K` rows, `fill` at invalid texels.
    pub fn to_map<const C: usize>(&self, rows: &[[f32; C]], fill: f32) -> Image {
        let mut map = Image { width: self.size, height: self.size, channels: C, data: vec![fill; self.row.len() * C] };
        for (&t, row) in self.valid.iter().zip(rows) {
            map.data[t as usize * C..(t as usize + 1) * C].copy_from_slice(row);
        }
        map
    }

    /// The `K` rows of valid texels of an `S × S × C` map.
    pub fn from_map<const C: usize>(&self, map: &Image) -> Vec<[f32; C]> {
        let row = |&t: &u32| std::array::from_fn(|i| map.data[t as usize * C + i]);
        self.valid.iter().map(row).collect()
    }

    /// Mask of the map: 1 at valid texels, 0 elsewhere; `S²` values.
    pub fn mask(&self) -> Vec<f32> {
        self.row.iter().map(|&r| if r == NONE { 0.0 } else { 1.0 }).collect()
    }

    /// Copies the nearest valid texel into each invalid one of an `S × S` map within `width` texels of it, so that filters do not
    /// mix in the background.
    pub fn fill_gutter(&self, map: &mut Image, width: usize) {
        let c = map.channels;
        for [texel, row] in gutter(&self.row, self.size, width) {
            let from = self.valid[row as usize] as usize * c;
            map.data.copy_within(from..from + c, texel as usize * c);
        }
    }
}

fn check(faces: &[[u32; 3]], uvs: &[Vec2], face_uvs: &[[u32; 3]], size: usize) -> Result<(), TexelError> {
    if !(1..=MAX_SIZE).contains(&size) {
        return Err(TexelError::Size { size });
    }
    if faces.len() != face_uvs.len() {
        return Err(MeshError::Rows { what: "face_uvs", got: face_uvs.len(), want: faces.len() }.into());
    }
    check_faces(face_uvs, uvs.len())?;
    // Magnitude 16 at the largest size stays within fixed-point range.
    let limit = (MAX_COORDINATE / (4 * MAX_SIZE) as f64) as f32;
    match uvs.iter().position(|uv| !(uv.is_finite() && uv.abs().max_element() < limit)) {
        Some(row) => Err(TexelError::Coordinate { row, u: uvs[row].x, v: uvs[row].y }),
        None => Ok(()),
    }
}

/// The map being filled face by face.
struct Fill {
    size: usize,
    owner: Vec<u32>,
    bary: Vec<[f32; 2]>,
    area: f64,
    first_overlap: Option<(u32, u32, u32)>,
    /// Whether a texel lies in more than one triangle.
    shared: Vec<bool>,
    report: TexelReport,
}

impl Fill {
    fn new(size: usize) -> Self {
        let (owner, bary) = (vec![NONE; size * size], vec![[0.0; 2]; size * size]);
        let shared = vec![false; size * size];
        Self { size, owner, bary, area: 0.0, first_overlap: None, shared, report: TexelReport::default() }
    }

    /// Assigns the texels of a face, of either orientation.
    fn face(&mut self, face: u32, uv: [Vec2; 3]) {
        let [a, b, c] = uv.map(|p| p.as_dvec2() * self.size as f64);
        let area = (b - a).perp_dot(c - a);
        if area.abs() < 1e-9 * (self.size * self.size) as f64 {
            self.report.degenerate += 1;
            return;
        }
        self.area += area.abs();
        let window = Window { x0: 0, y0: 0, x1: self.size, y1: self.size };
        let mut met = false;
        spans([a, b, c].map(to_fixed), window, |y, x0, x1| {
            met = true;
            for x in x0..x1 {
                let q = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let weights = [(b - q).perp_dot(c - q) / area, (c - q).perp_dot(a - q) / area];
                self.assign(face, y * self.size + x, weights);
            }
        });
        if !met {
            self.report.unseen_faces += 1;
            self.report.unseen_area += area.abs();
        }
    }

    fn assign(&mut self, face: u32, texel: usize, [b0, b1]: [f64; 2]) {
        let owner = self.owner[texel];
        if owner != NONE {
            self.report.overlaps += usize::from(!std::mem::replace(&mut self.shared[texel], true));
            self.first_overlap.get_or_insert((texel as u32, owner, face));
            return;
        }
        self.owner[texel] = face;
        // Rounded corners may cover centres slightly outside; the point stays on the triangle.
        let (b0, b1) = (b0.clamp(0.0, 1.0), b1.clamp(0.0, 1.0));
        let over = (b0 + b1).max(1.0);
        self.bary[texel] = [(b0 / over) as f32, (b1 / over) as f32];
    }
}

/// Invalid texels within `rings` texels of a valid one, each with the row of the nearest (the lowest of equals).
fn gutter(row: &[u32], size: usize, rings: usize) -> Vec<[u32; 2]> {
    let reach = rings as i64;
    let offsets = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx * dx + dy * dy, dy, dx)));
    let mut offsets: Vec<(i64, i64, i64)> = offsets.filter(|o| o.0 <= reach * reach + reach).collect();
    offsets.sort_unstable();
    let nearest = |t: usize| {
        let (x, y) = ((t % size) as i64, (t / size) as i64);
        let inside = |v: i64| (0..size as i64).contains(&v);
        let at = |&(_, dy, dx): &(i64, i64, i64)| {
            let good = inside(x + dx) && inside(y + dy);
            good.then(|| row[(y + dy) as usize * size + (x + dx) as usize]).filter(|&r| r != NONE)
        };
        offsets.iter().find_map(at)
    };
    let texel = |t: usize| if row[t] == NONE { nearest(t).map(|r| [t as u32, r]) } else { None };
    if rings == 0 { Vec::new() } else { (0..row.len()).into_par_iter().filter_map(texel).collect() }
}
