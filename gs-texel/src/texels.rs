//! The texels of a surface: which point of which triangle each one is.
//!
//! Texture coordinates never move, so this is found once per template and size; what a pose changes is then three gathers
//! per texel ([`TexelTable::interp`]). Row `k` of every column belongs to the `k`-th **valid** texel, one whose centre a
//! UV triangle owns; `K` of them, in the order of the map.

mod charts;
mod reader;
mod resize;

pub use reader::{MapReader, SeamRead};
pub use resize::resize;

use crate::coverage::{REACH, Window, snap, spans};
use crate::surface::{CHUNK, MeshError, NONE, check_faces};
use glam::{DVec2, Vec2, Vec3};
use gs_core::Image;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Largest texture side.
pub const MAX_SIZE: usize = 1 << 14;
/// Share of texels that may be claimed twice.
pub const MAX_OVERLAP: f64 = 1e-3;

/// Texture coordinates no table can be made of.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TexelError {
    /// Faces do not fit.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A coordinate is not finite, or far outside the texture.
    #[error("texture coordinate {row} is ({u}, {v}); coordinates must be finite and of magnitude below 16")]
    Coordinate {
        /// Row of the coordinate.
        row: usize,
        /// Its u.
        u: f32,
        /// Its v.
        v: f32,
    },
    /// Sides out of range.
    #[error("texture size {size} is out of range: 1 to {MAX_SIZE} texels")]
    Size {
        /// The size asked for.
        size: usize,
    },
    /// Too many texels are claimed by more than one triangle.
    #[error(
        "{overlaps} of {valid} texels belong to more than one triangle (the first is texel {texel}, of faces {first} and {second}); \
         unwrap the mesh without overlap, or allow it and the lower face wins"
    )]
    Overlap {
        /// Texels claimed again.
        overlaps: usize,
        /// Valid texels.
        valid: usize,
        /// The first of them.
        texel: u32,
        /// Its owner.
        first: u32,
        /// Who else claims it.
        second: u32,
    },
    /// Fewer texels than a map of this size could number, or none at all.
    #[error("no texel of a {size}x{size} texture has its centre in a UV triangle; use a larger texture or unwrap anew")]
    Empty {
        /// The texture's side.
        size: usize,
    },
}

/// How a table is made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TexelOptions {
    /// Accept any number of overlapping texels (mirrored halves that share texels on purpose).
    pub allow_overlap: bool,
    /// Rings of texels around the charts that copy their nearest valid texel where maps are convolved or filtered.
    pub gutter: usize,
}

impl Default for TexelOptions {
    fn default() -> Self {
        Self { allow_overlap: false, gutter: 2 }
    }
}

/// What was met while a table was made.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TexelReport {
    /// Texels claimed by more than one triangle; the lowest face has them.
    pub overlaps: usize,
    /// Faces without area in the texture.
    pub degenerate: usize,
    /// Faces with area that own no texel.
    pub unseen_faces: usize,
    /// Their share of the area in the texture.
    pub unseen_area: f64,
    /// Islands of the texture.
    pub charts: usize,
}

/// Where the valid texels of an `S × S` map lie on a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct TexelTable {
    /// `S`.
    pub size: usize,
    /// Number of each valid texel in the map, `y·S + x`; `K` rows, ascending.
    pub valid: Vec<u32>,
    /// Face of each; `K` rows.
    pub tri: Vec<u32>,
    /// Weights of the first and second corner, the third has the rest; `K` rows.
    pub bary: Vec<[f32; 2]>,
    /// Chart of each; `K` rows.
    pub chart: Vec<u16>,
    /// Row of each texel of the map, [`NONE`] if not valid; `S²` rows.
    pub row: Vec<u32>,
    /// Texels of the gutter, each with the row it copies.
    pub gutter: Vec<[u32; 2]>,
    /// What was met.
    pub report: TexelReport,
}

impl TexelTable {
    /// The table of a mesh: `faces` number vertices, `face_uvs` the same triangles' `uvs`.
    ///
    /// # Errors
    /// Numbers that do not fit, coordinates that are not finite, more overlap than allowed, no texel at all.
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
        let gutter = gutter(&row, size, options.gutter);
        Ok(Self { size, valid, tri, bary, chart, row, gutter, report })
    }

    /// `K`, the number of valid texels.
    pub fn len(&self) -> usize {
        self.valid.len()
    }

    /// Whether there is no valid texel (never, for a table that was built).
    pub fn is_empty(&self) -> bool {
        self.valid.is_empty()
    }

    /// Centre of the texel of row `k`, in texture coordinates.
    pub fn uv(&self, k: usize) -> Vec2 {
        let (t, s) = (self.valid[k] as usize, self.size as f32);
        Vec2::new((t % self.size) as f32 + 0.5, (t / self.size) as f32 + 0.5) / s
    }

    /// `a(t) = b₀ a₀ + b₁ a₁ + (1 − b₀ − b₁) a₂` at every valid texel, for a vertex attribute of `C` values. `faces` are
    /// those of the table; `attribute` has a row per vertex.
    pub fn interp<const C: usize>(&self, faces: &[[u32; 3]], attribute: &[[f32; C]]) -> Vec<[f32; C]> {
        let mut out = vec![[0.0; C]; self.len()];
        self.each(&mut out, |k| {
            let w = self.weights(k);
            let [a, b, c] = faces[self.tri[k] as usize].map(|v| &attribute[v as usize]);
            std::array::from_fn(|i| w[0] * a[i] + w[1] * b[i] + w[2] * c[i])
        });
        out
    }

    /// As [`TexelTable::interp`], for points and normals (which are not made unit again).
    pub fn interp_vec3(&self, faces: &[[u32; 3]], attribute: &[Vec3]) -> Vec<Vec3> {
        let mut out = vec![Vec3::ZERO; self.len()];
        self.each(&mut out, |k| self.at(faces, attribute, k));
        out
    }

    /// A vertex attribute at the texel of row `k`.
    #[inline]
    pub fn at(&self, faces: &[[u32; 3]], attribute: &[Vec3], k: usize) -> Vec3 {
        let w = self.weights(k);
        let [a, b, c] = faces[self.tri[k] as usize].map(|v| attribute[v as usize]);
        w[0] * a + w[1] * b + w[2] * c
    }

    /// The weights of the three corners at row `k`.
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

    /// Rows as an `S × S × C` map, `fill` elsewhere.
    pub fn to_map<const C: usize>(&self, rows: &[[f32; C]], fill: f32) -> Image {
        let mut map = Image { width: self.size, height: self.size, channels: C, data: vec![fill; self.row.len() * C] };
        for (&t, row) in self.valid.iter().zip(rows) {
            map.data[t as usize * C..(t as usize + 1) * C].copy_from_slice(row);
        }
        map
    }

    /// The valid rows of an `S × S × C` map.
    pub fn from_map<const C: usize>(&self, map: &Image) -> Vec<[f32; C]> {
        let row = |&t: &u32| std::array::from_fn(|i| map.data[t as usize * C + i]);
        self.valid.iter().map(row).collect()
    }

    /// 1 at valid texels, 0 elsewhere; `S²` values.
    pub fn mask(&self) -> Vec<f32> {
        self.row.iter().map(|&r| if r == NONE { 0.0 } else { 1.0 }).collect()
    }

    /// Copies the border of the charts of an `S × S` map into the gutter.
    pub fn fill_gutter(&self, map: &mut Image) {
        let c = map.channels;
        for &[texel, row] in &self.gutter {
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
    // Magnitude 16 at the largest size stays within reach of fixed point.
    let limit = (REACH / (4 * MAX_SIZE) as f64) as f32;
    match uvs.iter().position(|uv| !(uv.is_finite() && uv.abs().max_element() < limit)) {
        Some(row) => Err(TexelError::Coordinate { row, u: uvs[row].x, v: uvs[row].y }),
        None => Ok(()),
    }
}

/// A map being claimed face by face.
struct Fill {
    size: usize,
    owner: Vec<u32>,
    bary: Vec<[f32; 2]>,
    area: f64,
    first_overlap: Option<(u32, u32, u32)>,
    report: TexelReport,
}

impl Fill {
    fn new(size: usize) -> Self {
        let (owner, bary) = (vec![NONE; size * size], vec![[0.0; 2]; size * size]);
        Self { size, owner, bary, area: 0.0, first_overlap: None, report: TexelReport::default() }
    }

    /// Claims the texels of a face; mirrored faces are as good as others.
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
        spans([a, b, c].map(snap), window, |y, x0, x1| {
            met = true;
            for x in x0..x1 {
                let q = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let weights = [(b - q).perp_dot(c - q) / area, (c - q).perp_dot(a - q) / area];
                self.claim(face, y * self.size + x, weights);
            }
        });
        if !met {
            self.report.unseen_faces += 1;
            self.report.unseen_area += area.abs();
        }
    }

    fn claim(&mut self, face: u32, texel: usize, [b0, b1]: [f64; 2]) {
        let owner = self.owner[texel];
        if owner != NONE {
            self.report.overlaps += 1;
            self.first_overlap.get_or_insert((texel as u32, owner, face));
            return;
        }
        self.owner[texel] = face;
        // Rounded corners may claim centres a hair outside; the point stays on the triangle.
        let (b0, b1) = (b0.clamp(0.0, 1.0), b1.clamp(0.0, 1.0));
        let over = (b0 + b1).max(1.0);
        self.bary[texel] = [(b0 / over) as f32, (b1 / over) as f32];
    }
}

/// Invalid texels within `rings` steps of a valid one, each with the row of the nearest (the lowest of equals).
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
