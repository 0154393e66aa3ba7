//! Values for texels no camera sees, within each chart; and weights of cameras by direction. Triangulations are `spade`'s.
//!
//! In-painting is for showing and measuring: the networks see unseen texels as black.

mod diffuse;

use crate::texels::TexelTable;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, FloatTriangulation, HasPosition, InsertionError, Point2, Triangulation};

/// Known texels this close to an unknown one take part.
const RING: i64 = 2;

/// What stands where no camera looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Unseen {
    /// Nothing: the value stays.
    #[default]
    Black,
    /// The nearest seen texel of the chart.
    Nearest,
    /// Linear over the Delaunay triangles of the seen texels around; the nearest beyond their hull.
    Delaunay,
    /// Natural neighbours of the seen texels around: smooth, slower; the nearest beyond their hull.
    Natural,
    /// Means of ever larger neighbourhoods in the chart: smooth, fast.
    PushPull,
    /// The smoothest function that meets the seen texels: `Δ = 0` in the chart.
    Harmonic,
}

/// What in-painting cannot do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InpaintError {
    /// Columns that do not fit the table.
    #[error("{got} {what} for {want} valid texels")]
    Rows {
        /// The column.
        what: &'static str,
        /// Its rows.
        got: usize,
        /// Rows needed.
        want: usize,
    },
    /// A point the triangulation refuses.
    #[error("point {row} cannot be triangulated ({error}); directions must be finite and not opposite to `up`")]
    Point {
        /// Row of the point.
        row: usize,
        /// What it says.
        error: InsertionError,
    },
}

/// What in-painting did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Inpainted {
    /// Texels that got a value.
    pub filled: usize,
    /// Texels left as they were: their chart has no known texel.
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

/// Gives the texels that are not `known` a value from those of their chart that are. `rows` and `known` have a row per
/// valid texel.
///
/// # Errors
/// Rows that do not fit.
pub fn inpaint<const C: usize>(
    table: &TexelTable,
    rows: &mut [[f32; C]],
    known: &[bool],
    how: Unseen,
) -> Result<Inpainted, InpaintError> {
    for (what, got) in [("rows", rows.len()), ("flags", known.len())] {
        if got != table.len() {
            return Err(InpaintError::Rows { what, got, want: table.len() });
        }
    }
    let unknown = known.iter().filter(|k| !**k).count();
    if how == Unseen::Black {
        return Ok(Inpainted { filled: 0, left: unknown });
    }
    let charts = table.chart.iter().max().map_or(0, |&c| usize::from(c) + 1);
    let mut holes = vec![Vec::new(); charts];
    (0..table.len()).filter(|&k| !known[k]).for_each(|k| holes[usize::from(table.chart[k])].push(k as u32));
    let from: &[[f32; C]] = rows;
    let diffuse = matches!(how, Unseen::PushPull | Unseen::Harmonic);
    let boxes = if diffuse { diffuse::boxes(table) } else { Vec::new() };
    let fill = |(chart, rows): (usize, &Vec<u32>)| {
        let Some(&window) = boxes.get(chart) else { return fill_chart(table, from, known, rows, how) };
        let holes = diffuse::Holes { rows, window };
        let fill = if how == Unseen::Harmonic { diffuse::harmonic } else { diffuse::push_pull };
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
    how: Unseen,
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
            Unseen::Delaunay => linear.get_weights(at, &mut weights),
            Unseen::Natural => natural.get_weights(at, &mut weights),
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

/// Whole numbers, so that no triangulation can be out of its domain.
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
        for v in (y - RING).max(0)..=(y + RING).min(size - 1) {
            for u in (x - RING).max(0)..=(x + RING).min(size - 1) {
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

/// Cameras by direction: smooth weights of the two or three nearest, in place of a plain mean over all.
pub struct ViewFan {
    mesh: Mesh2,
    basis: [Vec3; 3],
}

impl ViewFan {
    /// A fan of directions from the subject to the cameras (any length), flattened stereographically from opposite to
    /// `up`. Of equal directions the first is kept.
    ///
    /// # Errors
    /// Directions that are not finite or opposite to `up`.
    pub fn new(directions: &[Vec3], up: Vec3) -> Result<Self, InpaintError> {
        let up = up.normalize_or(Vec3::Y);
        let (right, ahead) = up.any_orthonormal_pair();
        let basis = [right, ahead, up];
        let site = |(row, d): (usize, &Vec3)| Site { at: flatten(&basis, *d), row: row as u32 };
        let sites: Vec<Site> = directions.iter().enumerate().map(site).collect();
        for site in &sites {
            let checked = [site.at.x, site.at.y].into_iter().try_for_each(spade::validate_coordinate);
            checked.map_err(|error| InpaintError::Point { row: site.row as usize, error })?;
        }
        Ok(Self { mesh: triangulate(sites)?, basis })
    }

    /// Rows and weights of the cameras to use towards `direction`: at least 0, of sum 1. Beyond the hull of the cameras
    /// the nearest point of the hull decides.
    pub fn weights(&self, direction: Vec3) -> Vec<(u32, f64)> {
        let at = flatten(&self.basis, direction);
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

/// Stereographic projection: angles are kept, and the whole sphere but one point fits.
fn flatten(basis: &[Vec3; 3], direction: Vec3) -> Point2<f64> {
    let d = direction.as_dvec3().normalize();
    let [x, y, z] = basis.map(|b| b.as_dvec3().dot(d));
    // The library refuses numbers that are almost 0.
    let tidy = |v: f64| if v.abs() < 1e-12 { 0.0 } else { v };
    Point2::new(tidy(x / (1.0 + z)), tidy(y / (1.0 + z)))
}
