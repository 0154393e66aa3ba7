//! Still parts of a moving scene, for rendering: an approximation, off unless asked for.
//!
//! Where a Gaussian goes does not depend on who looks. Its centre `μ(t) = x' + O' ⊙ l' + Δx`, moved by GAD and LGD
//! together, and LGD's `Δs` and `Δr` belong to its row `anchor · k + j`. Rows that hardly change are **baked**, and LGD is
//! not asked about them:
//!
//! ```text
//! μ̄, Δ̄s, Δ̄r = half-way between the smallest and the largest value over the probe times
//! μ = μ̄     s = s' ∘ Δ̄s     q = q' + Δ̄r          s', q' as decoded now, with all that GAD does to them
//! ```
//! A row is baked if its centre stays within `pixels` on every camera's screen (where it comes nearest), and its shape
//! within a share ε, `max |s − s̄| ≤ ε max |s|` and `2 ‖q − q̄‖ ≤ ε ‖q‖`, at the probe times and half-way between them,
//! each seen from one of the cameras. A row that none of these views decodes is never baked.
//!
//! LGD on hash grids has no offsets to bake: none of its rows rest.
//!
//! Anchors with `M = 0` and a local factor below `weight` are not asked about by GAD either.

use super::Anchored;
use glam::Vec3;
use gs_anchor::Lgd;
use gs_core::nn::BLOCK;
use gs_core::{Camera, Geometry, GeometryRef, Time, cast};
use gs_deform::HexPlaneField;
use gs_deform::apply::{Apply, Offsets};
use gs_train::capabilities::{FreezeOptions, FreezeReport};
use gs_train::still::{Worst, judge, probe_times};
use rayon::prelude::*;

/// Where rows are, and how LGD changes their shape.
#[derive(Clone, Debug, Default)]
struct Poses {
    /// `μ`, 3 values a row.
    centers: Vec<f32>,
    /// `Δs`, 3 values a row; empty if scales do not change.
    scales: Vec<f32>,
    /// `Δr`, 4 values a row; empty if rotations do not change.
    quats: Vec<f32>,
}

/// The baked rows of a scene.
#[derive(Clone, Debug)]
pub(super) struct Rest {
    poses: Poses,
    still: Vec<bool>,
    below: f32,
}

impl Poses {
    fn columns(&mut self) -> [&mut Vec<f32>; 3] {
        [&mut self.centers, &mut self.scales, &mut self.quats]
    }

    /// Combines two, value by value.
    fn with(mut self, mut other: Self, f: fn(f32, f32) -> f32) -> Self {
        for (a, b) in self.columns().into_iter().zip(other.columns()) {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = f(*a, *b));
        }
        self
    }

    fn center(&self, row: usize) -> Vec3 {
        Vec3::from_slice(&self.centers[3 * row..])
    }

    /// How the shape of a row changes.
    fn change(&self, row: usize) -> Offsets<'_> {
        let scales = self.scales.get(3 * row..3 * row + 3).unwrap_or_default();
        let quats = self.quats.get(4 * row..4 * row + 4).unwrap_or_default();
        Offsets { means: &[], scales, quats }
    }

    /// Writes decoded Gaussians of these rows in their poses.
    fn put(&self, rule: Apply, neural: GeometryRef<'_>, rows: &[u32], out: &mut Geometry) {
        out.resize(neural.len());
        let columns = neural.chunks(BLOCK).zip(out.view_mut().chunks(BLOCK));
        columns.zip(rows.par_chunks(BLOCK)).for_each(|((from, mut to), rows)| {
            for (i, row) in rows.iter().map(|r| *r as usize).enumerate() {
                let mut to = to.rows(i..i + 1);
                rule.forward(from.rows(i..i + 1), self.change(row), &mut to);
                to.means[0] = self.center(row);
            }
        });
    }
}

impl Rest {
    /// Local factors below this count as zero.
    pub(super) fn below(&self) -> f32 {
        self.below
    }

    /// Moves decoded Gaussians of these rows: those that rest to their baked pose, the others as the field says.
    pub(super) fn forward(
        &self,
        lgd: &HexPlaneField,
        places: &[Vec3],
        neural: GeometryRef<'_>,
        rows: &[u32],
        t: Time,
        out: &mut Geometry,
    ) {
        self.poses.put(lgd.rule(), neural, rows, out);
        let moves = |i: &u32| !self.still[rows[*i as usize] as usize];
        let moving: Vec<u32> = (0..cast::to_u32(rows.len())).filter(moves).collect();
        let mut moved = Geometry::default();
        let places: Vec<Vec3> = moving.iter().map(|i| places[*i as usize]).collect();
        lgd.forward_at(&places, neural.pick(&moving).view(), t, &mut Default::default(), &mut moved);
        out.scatter(&moved, &moving);
    }
}

impl Anchored {
    /// Finds what rests; `None` without LGD on planes or where nothing moves.
    pub(super) fn rest(&self, options: &FreezeOptions<'_>) -> Option<(Rest, FreezeReport)> {
        let Some(Lgd::Planes(lgd)) = self.motion.lgd.as_ref().filter(|_| self.dynamic()) else { return None };
        let poses = probe_times(options.probes).map(|t| self.poses(lgd, t));
        let span =
            poses.map(|p| (p.clone(), p)).reduce(|(low, high), (a, b)| (low.with(a, f32::min), high.with(b, f32::max)));
        let poses = span.map(|(low, high)| low.with(high, |a, b| 0.5 * (a + b)))?;
        let look = |t: Time, camera: Option<&Camera>, worst: &mut [Worst]| self.compare(lgd, &poses, t, camera, worst);
        let (still, report) = judge(poses.centers.len() / 3, options, |row| poses.center(row), look);
        let below = options.weight;
        let idle = self.motion.gad.iter().flat_map(|gad| gad.is_active(&self.anchors, below)).filter(|p| !p).count();
        Some((Rest { poses, still, below }, FreezeReport { anchors: idle, ..report }))
    }

    /// The poses of all rows at a time.
    fn poses(&self, lgd: &HexPlaneField, t: Time) -> Poses {
        let local = self.local(t);
        let rows: Vec<u32> = (0..cast::to_u32(local.len() * self.config.offsets)).collect();
        let centers: Vec<Vec3> = rows.par_iter().map(|row| self.center(&local, *row)).collect();
        let mut said = Default::default();
        lgd.offsets_at(&self.places(&centers, &rows), t, &mut Default::default(), &mut said);
        let mut centers: Vec<f32> = centers.iter().flat_map(|c| c.to_array()).collect();
        centers.iter_mut().zip(&said.means).for_each(|(c, d)| *c += d);
        Poses { centers, scales: said.scales, quats: said.quats }
    }

    /// Enters how far rows are from their baked poses at a time; their shapes as a camera sees them.
    fn compare(&self, lgd: &HexPlaneField, baked: &Poses, t: Time, camera: Option<&Camera>, worst: &mut [Worst]) {
        let exact = self.poses(lgd, t);
        for (row, worst) in worst.iter_mut().enumerate() {
            worst.see_mean(exact.center(row), baked.center(row));
        }
        let Some(camera) = camera else { return };
        let (neural, tape) = self.decoded(&self.local(t), camera, None);
        let [exact, baked] = [&exact, baked].map(|poses| {
            let mut posed = Geometry::default();
            poses.put(lgd.rule(), neural.geometry(), &tape.rows, &mut posed);
            posed
        });
        for (i, &row) in tape.rows.iter().enumerate() {
            worst[row as usize].see_shape((exact.scales[i], exact.quats[i]), (baked.scales[i], baked.quats[i]));
        }
    }
}
