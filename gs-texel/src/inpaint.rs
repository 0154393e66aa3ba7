//! In-painting of unseen texels within each chart, and interpolation weights of views by direction. Delaunay triangulations
//! are those of `spade`.
//!
//! In-painting is for display, evaluation and mean colours: the networks get black at unseen texels.
//!
//! ```
//! use gs_texel::inpaint::{Inpainted, InpaintMethod, inpaint};
//! use gs_texel::{figure::plate, texels::TexelTable};
//!
//! let t = plate(1.0, 1).template;
//! let table = TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, 16, &Default::default())?;
//! let mut rows: Vec<[f32; 1]> = (0..table.len()).map(|k| [table.uv(k).x]).collect();
//! let mut known = vec![true; rows.len()];
//! (rows[50], known[50]) = ([-1.0], false);
//! let done = inpaint(&table, &mut rows, &known, InpaintMethod::Harmonic)?;
//! assert_eq!(done, Inpainted { filled: 1, left: 0 });
//! assert!((rows[50][0] - table.uv(50).x).abs() < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod diffuse;

use crate::texels::TexelTable;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, FloatTriangulation, HasPosition, InsertionError, Point2, Triangulation};

/// Known texels within this many rows and columns of an unknown one take part.
const SITE_RADIUS: i64 = 2;

/// How unseen texels are filled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InpaintMethod {
    /// Not at all: the value stays.
    #[default]
    Black,
    /// The nearest seen texel of the chart.
    Nearest,
    /// Linear over Delaunay triangles of the seen texels nearby; the nearest outside their hull.
    Delaunay,
    /// Natural neighbour interpolation of the seen texels nearby: smooth, slower; the nearest outside their hull.
    Natural,
    /// Push-pull: means over a pyramid of the chart; smooth, fast.
    PushPull,
    /// The harmonic function through the seen texels: `Δ = 0` in the chart.
    Harmonic,
}

/// Inputs that [`inpaint`] and [`ViewWeights::new`] refuse.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InpaintError {
    /// A column does not have one row per valid texel.
    #[error("{got} {what} for {want} valid texels")]
    Rows {
        /// Name of the column concerned.
        what: &'static str,
        /// Number of rows it has.
        got: usize,
        /// Number of valid texels of the map.
        want: usize,
    },
    /// A point cannot be triangulated.
    #[error("point {row} cannot be triangulated ({error}); directions must be finite and not opposite to `up`")]
    Point {
        /// Row of the point among the points.
        row: usize,
        /// Why `spade` refuses the point.
        error: InsertionError,
    },
}

/// Counts of texels that [`inpaint`] returns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Inpainted {
    /// Number of texels that got a value.
    pub filled: usize,
    /// Number of unknown texels left as they were, since their chart has no known texel.
    pub left: usize,
}

/// A point and the row of its value.
#[derive(Clone, Copy)]
struct Site {
    at: Point2<f64>,
    row: u32,
}

impl HasPosition for Site {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.at
    }
}

type Mesh2 = DelaunayTriangulation<Site>;
type Weights = Vec<(FixedVertexHandle, f64)>;

/// Fills the texels that are not `known` from known ones of the same chart. `rows` and `known` have one row per valid
/// texel.
///
/// # Errors
/// If a column has another number of rows.
pub fn inpaint<const C: usize>(
    table: &TexelTable,
    rows: &mut [[f32; C]],
    known: &[bool],
    how: InpaintMethod,
) -> Result<Inpainted, InpaintError> {
    for (what, got) in [("rows", rows.len()), ("flags", known.len())] {
        if got != table.len() {
            return Err(InpaintError::Rows { what, got, want: table.len() });
        }
    }
    let unknown = known.iter().filter(|k| !**k).count();
    if how == InpaintMethod::Black {
        return Ok(Inpainted { filled: 0, left: unknown });
    }
    let charts = table.chart.iter().max().map_or(0, |&c| usize::from(c) + 1);
    let mut holes = vec![Vec::new(); charts];
    (0..table.len()).filter(|&k| !known[k]).for_each(|k| holes[usize::from(table.chart[k])].push(k as u32));
    let from: &[[f32; C]] = rows;
    let diffuse = matches!(how, InpaintMethod::PushPull | InpaintMethod::Harmonic);
    let boxes = if diffuse { diffuse::boxes(table) } else { Vec::new() };
    let fill = |(chart, rows): (usize, &Vec<u32>)| {
        let Some(&window) = boxes.get(chart) else { return fill_chart(table, from, known, rows, how) };
        let holes = diffuse::Holes { rows, window };
        let fill = if how == InpaintMethod::Harmonic { diffuse::harmonic } else { diffuse::push_pull };
        Ok(fill(table, from, known, holes))
    };
    let filled: Vec<Result<Vec<_>, InpaintError>> = holes.par_iter().enumerate().map(fill).collect();
    let mut report = Inpainted { filled: 0, left: unknown };
    for chart in filled {
        let chart = chart?;
        report.filled += chart.len();
        report.left -= chart.len();
        chart.into_iter().for_each(|(k, value)| rows[k as usize] = value);
    }
    Ok(report)
}

/// Values for the unknown texels of one chart.
fn fill_chart<const C: usize>(
    table: &TexelTable,
    rows: &[[f32; C]],
    known: &[bool],
    holes: &[u32],
    how: InpaintMethod,
) -> Result<Vec<(u32, [f32; C])>, InpaintError> {
    let sites = sites(table, known, holes);
    let mesh = triangulate(sites)?;
    let natural = mesh.natural_neighbor();
    let linear = mesh.barycentric();
    let mut weights: Weights = Vec::new();
    let mut out = Vec::with_capacity(holes.len());
    for &k in holes {
        let at = position(table, k);
        weights.clear();
        match how {
            InpaintMethod::Delaunay => linear.get_weights(at, &mut weights),
            InpaintMethod::Natural => natural.get_weights(at, &mut weights),
            _ => {}
        }
        if weights.is_empty() {
            weights.extend(mesh.nearest_neighbor(at).map(|v| (v.fix(), 1.0)));
        }
        if !weights.is_empty() {
            out.push((k, blend(&mesh, rows, &weights)));
        }
    }
    Ok(out)
}

fn blend<const C: usize>(mesh: &Mesh2, rows: &[[f32; C]], weights: &Weights) -> [f32; C] {
    let mut sum = [0.0f64; C];
    for &(vertex, weight) in weights {
        let value = &rows[mesh.vertex(vertex).data().row as usize];
        sum.iter_mut().zip(value).for_each(|(s, v)| *s += weight * f64::from(*v));
    }
    sum.map(|s| s as f32)
}

/// Column and row in the map; whole numbers are in the domain of the triangulation.
fn position(table: &TexelTable, k: u32) -> Point2<f64> {
    let t = table.valid[k as usize] as usize;
    Point2::new((t % table.size) as f64, (t / table.size) as f64)
}

/// The known texels around the holes of a chart, ascending.
fn sites(table: &TexelTable, known: &[bool], holes: &[u32]) -> Vec<Site> {
    let size = table.size as i64;
    let mut near = Vec::new();
    for &k in holes {
        let t = i64::from(table.valid[k as usize]);
        let (x, y) = (t % size, t / size);
        for v in (y - SITE_RADIUS).max(0)..=(y + SITE_RADIUS).min(size - 1) {
            for u in (x - SITE_RADIUS).max(0)..=(x + SITE_RADIUS).min(size - 1) {
                let row = table.row[(v * size + u) as usize] as usize;
                // Off the charts there is no row.
                if known.get(row) == Some(&true) && table.chart[row] == table.chart[k as usize] {
                    near.push(row as u32);
                }
            }
        }
    }
    near.sort_unstable();
    near.dedup();
    near.into_iter().map(|row| Site { at: position(table, row), row }).collect()
}

fn triangulate(sites: Vec<Site>) -> Result<Mesh2, InpaintError> {
    Mesh2::bulk_load_stable(sites).map_err(|error| InpaintError::Point { row: 0, error })
}

/// Interpolation weights of views by direction: barycentric over the Delaunay triangulation of their directions, in place of
/// a plain mean over all views.
///
/// ```
/// use glam::Vec3;
/// use gs_texel::inpaint::ViewWeights;
///
/// let views = ViewWeights::new(&[Vec3::X, Vec3::Z], Vec3::Y)?;
/// let weights = views.weights(Vec3::new(1.0, 0.0, 1.0));
/// assert!(weights.len() == 2 && weights.iter().all(|w| (w.1 - 0.5).abs() < 1e-6));
/// # Ok::<(), gs_texel::inpaint::InpaintError>(())
/// ```
pub struct ViewWeights {
    mesh: Mesh2,
    basis: [Vec3; 3],
}

impl ViewWeights {
    /// Triangulates directions from the subject to the cameras (any length but 0), in stereographic projection from `−up`. Of
    /// equal directions the first is kept.
    ///
    /// # Errors
    /// If a direction is not finite or is opposite to `up`.
    pub fn new(directions: &[Vec3], up: Vec3) -> Result<Self, InpaintError> {
        let up = up.normalize_or(Vec3::Y);
        let (right, ahead) = up.any_orthonormal_pair();
        let basis = [right, ahead, up];
        let site = |(row, d): (usize, &Vec3)| Site { at: stereographic(&basis, *d), row: row as u32 };
        let sites: Vec<Site> = directions.iter().enumerate().map(site).collect();
        for site in &sites {
            let checked = [site.at.x, site.at.y].into_iter().try_for_each(spade::validate_coordinate);
            checked.map_err(|error| InpaintError::Point { row: site.row as usize, error })?;
        }
        Ok(Self { mesh: triangulate(sites)?, basis })
    }

    /// `(view, weight)` of up to three views for `direction`: weights are at least 0 and sum to 1. Outside the hull of the
    /// directions the nearest point of the hull is used. Empty without views, or if `direction` is not finite.
    pub fn weights(&self, direction: Vec3) -> Vec<(u32, f64)> {
        let at = stereographic(&self.basis, direction);
        let row = |v: FixedVertexHandle| self.mesh.vertex(v).data().row;
        if !(at.x.is_finite() && at.y.is_finite()) {
            return Vec::new();
        }
        let mut weights: Weights = Vec::new();
        self.mesh.barycentric().get_weights(at, &mut weights);
        if !weights.is_empty() {
            return weights.into_iter().map(|(v, w)| (row(v), w)).collect();
        }
        let hull = self.mesh.convex_hull().map(|e| {
            let share = e.project_point(at).relative_position().clamp(0.0, 1.0);
            (e.distance_2(at), share, e.from().fix(), e.to().fix())
        });
        match hull.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, share, a, b)) => vec![(row(a), 1.0 - share), (row(b), share)],
            None => self.mesh.nearest_neighbor(at).map(|v| (v.data().row, 1.0)).into_iter().collect(),
        }
    }
}

/// Stereographic projection: conformal, defined on the whole sphere but one point.
fn stereographic(basis: &[Vec3; 3], direction: Vec3) -> Point2<f64> {
    let d = direction.as_dvec3().normalize();
    let [x, y, z] = basis.map(|b| b.as_dvec3().dot(d));
    // The library refuses numbers that are almost 0.
    let tidy = |v: f64| if v.abs() < 1e-12 { 0.0 } else { v };
    Point2::new(tidy(x / (1.0 + z)), tidy(y / (1.0 + z)))
}
