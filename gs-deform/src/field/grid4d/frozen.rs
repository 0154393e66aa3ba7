//! One cloud drawn at many times: what does not depend on time is worked out once, and splats that hardly move may be
//! left where they are.
//!
//! The view borrows field and cloud, so neither can change while it exists and nothing in it can be out of date.
//!
//! **Still splats** (an approximation, used only where [`FrozenField::leave_still`] is called). With `ψ = |ρ_xyz| / |q_d|`
//! the sine of half the angle, a splat's centre moves by at most
//!
//! ```text
//! δ = r 2ψ|μ| + η|τ|       and its extent in any direction changes by at most       η (|Δs|_max + 2 |s|_max |Δr|)
//! pixels ≤ f / (t_z − δ) · (1 + tan(fov/2)) · (δ + change of extent)
//! ```
//! (`r` is the gate or 1, by mode). A splat whose bound is below the tolerance at every probe time and in every camera
//! keeps its canonical row. The bound holds at the probe times; between them it is as good as the probes are dense.

use super::config::{GateConfig, GateMode};
use super::{Grid4dField, Playing, Standing, gate};
use crate::apply;
use glam::Vec3;
use gs_core::{Camera, Splats, Time};
use rayon::prelude::*;

/// A field and a cloud, ready to be drawn at many times; see the [module](self).
#[derive(Debug)]
pub struct FrozenField<'a> {
    field: &'a Grid4dField,
    canonical: &'a Splats,
    standing: Standing,
    playing: Playing,
    moving: Option<MovingRows>,
}

/// The splats that are not left still.
#[derive(Debug)]
struct MovingRows {
    rows: Vec<u32>,
    /// Their means, rotations and scales, canonical and moved.
    canonical: Splats,
    moved: Splats,
}

/// Which splats may be left still.
#[derive(Clone, Copy, Debug)]
pub struct StillOptions<'a> {
    /// Largest error on screen, pixels.
    pub pixels: f32,
    /// Probe times, spread evenly over 0 … 1; at least 1.
    pub probes: usize,
    /// The cameras that will be drawn from.
    pub cameras: &'a [Camera],
}

/// What was left still, and what it may cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillReport {
    /// All splats.
    pub splats: usize,
    /// Those left at their canonical row.
    pub still: usize,
    /// Largest bound among them, pixels.
    pub bound_pixels: f32,
    /// Probe times looked at.
    pub probes: usize,
}

impl Grid4dField {
    /// Prepares to draw one cloud at many times.
    pub fn freeze<'a>(&'a self, canonical: &'a Splats) -> FrozenField<'a> {
        let mut standing = Standing::default();
        self.stand(canonical, &mut standing);
        FrozenField { field: self, canonical, standing, playing: Playing::default(), moving: None }
    }
}

impl FrozenField<'_> {
    /// Writes the splats at time `t` to `out`, as [`Field::forward`](crate::Field::forward) does.
    pub fn forward(&mut self, t: Time, out: &mut Splats) {
        let Self { field, canonical, standing, playing, moving } = self;
        let Some(MovingRows { rows, canonical: from, moved }) = moving else {
            if !field.config.exact.cached_attention {
                field.stand(canonical, standing);
            }
            field.play(canonical, standing, t, playing, out);
            return;
        };
        if !field.config.exact.cached_attention {
            field.stand(from, standing);
        }
        field.play(from, standing, t, playing, moved);
        apply::pass_through(canonical, out);
        out.means.copy_from_slice(&canonical.means);
        out.quats.copy_from_slice(&canonical.quats);
        out.scales.copy_from_slice(&canonical.scales);
        apply::put_back(moved, rows, out);
    }

    /// From now on leaves splats still whose error on screen is bounded by `options.pixels`; says which share that is.
    /// Without cameras, or with a tolerance of 0, only splats that do not move at all are left still.
    pub fn leave_still(&mut self, options: &StillOptions<'_>) -> StillReport {
        let Self { field, canonical, standing, playing, moving } = self;
        if moving.take().is_some() {
            field.stand(canonical, standing);
        }
        let probes = options.probes.max(1);
        let (mut reach, mut out) = (vec![[0.0f32; 2]; canonical.len()], Splats::default());
        for probe in 0..probes {
            let normalised = if probes > 1 { probe as f32 / (probes - 1) as f32 } else { 0.5 };
            let t = Time { normalised, seconds: f64::from(normalised) };
            field.play(canonical, standing, t, playing, &mut out);
            let heads = playing.blocks.iter().flat_map(|b| b.head.chunks_exact(field.config.head_width()));
            for (i, (reach, head)) in reach.iter_mut().zip(heads).enumerate() {
                if field.moves(&standing.points[i]) {
                    let row = gate::Row::read(head, field.config.gate);
                    let here = row_reach(&row, field.config.gate, canonical.means[i], canonical.scales[i]);
                    *reach = [reach[0].max(here[0]), reach[1].max(here[1])];
                }
            }
        }
        let pixels = |(reach, mean): (&[f32; 2], &Vec3)| screen_bound(*reach, *mean, options.cameras);
        let bounds: Vec<f32> = reach.par_iter().zip(&canonical.means).map(pixels).collect();
        let is_still = |bound: f32| bound <= options.pixels;
        let rows: Vec<u32> = (0..canonical.len()).filter(|&i| !is_still(bounds[i])).map(|i| i as u32).collect();
        let bound_pixels = bounds.iter().filter(|b| is_still(**b)).fold(0.0f32, |m, b| m.max(*b));
        let (splats, still) = (canonical.len(), canonical.len() - rows.len());
        if still > 0 {
            let from = apply::pick(canonical, &rows);
            field.stand(&from, standing);
            *moving = Some(MovingRows { rows, canonical: from, moved: Splats::default() });
        }
        StillReport { splats, still, bound_pixels, probes }
    }
}

/// Bounds on the way of the centre and on the change of extent, world units.
fn row_reach(row: &gate::Row, gate: GateConfig, mean: Vec3, scale: Vec3) -> [f32; 2] {
    let eta = row.gate;
    let norm = |v: &[f32]| v.iter().map(|v| v * v).sum::<f32>().sqrt();
    let raw = row.turn_raw(gate.mode);
    let turned = 2.0 * (norm(&raw[1..]) / norm(&raw).max(f32::MIN_POSITIVE)).min(1.0) * mean.length();
    let moved = match gate.mode {
        GateMode::ScaleParam | GateMode::TranslationOnly => turned + eta * row.tau.length(),
        GateMode::LerpPosition => eta * (turned + row.tau.length()),
        GateMode::Literal => (1.0 - eta) * mean.length() + eta * (turned + row.tau.length()),
    };
    let (turn, stretch) = row.shape_change();
    let largest = scale.abs().max_element() + eta * stretch;
    [moved, eta * stretch + 2.0 * largest * (eta * turn).min(1.0)]
}

/// Largest error on screen of a splat at `mean` whose centre is moved and whose extent is changed by so much (world
/// units), pixels, over the cameras; 0 for what does not move, infinite if it may reach a camera's plane or there is none.
pub fn screen_bound([moved, changed]: [f32; 2], mean: Vec3, cameras: &[Camera]) -> f32 {
    if moved == 0.0 && changed == 0.0 {
        return 0.0;
    }
    if cameras.is_empty() {
        return f32::INFINITY;
    }
    cameras.iter().fold(0.0f32, |most, c| {
        let depth = (c.rotation * mean.as_dvec3() + c.translation).z;
        let moved = f64::from(moved);
        if depth + moved <= 0.0 {
            return most; // behind the camera wherever it goes
        }
        if depth - moved <= 0.0 {
            return f32::INFINITY;
        }
        let (width, height) = (f64::from(c.width), f64::from(c.height));
        let tan = (c.cx.max(width - c.cx) / c.fx).max(c.cy.max(height - c.cy) / c.fy);
        let per_unit = c.fx.max(c.fy) / (depth - moved) * (1.0 + tan);
        most.max((per_unit * (moved + f64::from(changed))) as f32)
    })
}
