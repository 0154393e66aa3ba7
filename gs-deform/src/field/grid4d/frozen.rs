//! The same splats at many timestamps: the time-independent part is computed once, and splats that hardly move may be
//! left at their canonical rows.
//!
//! A [`FrozenField`] borrows the field and the splats, so neither can change while it exists.
//!
//! ```
//! use gs_core::{Geometry, Time};
//! use gs_deform::{Field, Grid4dConfig, Grid4dField};
//!
//! let mut config = Grid4dConfig::default();
//! config.canonical.log2_table = 10;
//! let field = Grid4dField::new(&config, 1)?;
//! let canonical = Geometry { means: vec![glam::Vec3::ONE], quats: vec![[1.0, 0.0, 0.0, 0.0]], scales: vec![glam::Vec3::ONE] };
//! let mut frozen = field.freeze(canonical.view());
//! let (mut frozen_out, mut out) = (Geometry::default(), Geometry::default());
//! for t in [0.1, 0.9] {
//!     frozen.forward(Time::new(t)?, &mut frozen_out);
//!     field.forward(canonical.view(), Time::new(t)?, &mut Default::default(), &mut out);
//!     assert_eq!(frozen_out, out);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Static splats** (an approximation, used only after [`FrozenField::keep_static`]). With `ψ = |ρ_xyz| / |q_d|` the
//! sine of half the angle, a splat's mean moves by at most
//!
//! ```text
//! δ = r 2ψ|μ| + η|τ|       and its extent in any direction changes by at most       η (|Δs|_max + 2 |s|_max |Δr|)
//! pixels ≤ f / (t_z − δ) · (1 + tan(fov/2)) · (δ + change of extent)
//! ```
//! (`r` is the gate or 1, by mode). A splat whose bound is within the tolerance at every probe time and in every camera
//! keeps its canonical row. The bound holds at the probe times, not between them.

use super::config::{GateConfig, GateMode};
use super::{Grid4dField, StaticState, TimeState, gate};
use glam::Vec3;
use gs_core::{Camera, Geometry, GeometryRef, Time};
use rayon::prelude::*;

/// A field and splats, prepared for evaluation at many timestamps; see the [module](self).
#[derive(Debug)]
pub struct FrozenField<'a> {
    field: &'a Grid4dField,
    canonical: GeometryRef<'a>,
    static_state: StaticState,
    time_state: TimeState,
    moving: Option<DynamicRows>,
}

/// The splats that are not kept static.
#[derive(Debug)]
struct DynamicRows {
    rows: Vec<u32>,
    /// These rows, canonical and moved.
    canonical: Geometry,
    moved: Geometry,
}

/// Tolerance under which splats are kept static.
#[derive(Clone, Copy, Debug)]
pub struct StaticTolerance<'a> {
    /// Largest error on screen, pixels; 0 keeps only splats static that do not move at all.
    pub pixels: f32,
    /// Number of probe times, evenly spaced over 0 … 1; 0 counts as 1.
    pub probes: usize,
    /// The cameras that will be rendered; without any, only splats that do not move at all are kept static.
    pub cameras: &'a [Camera],
}

/// Number of splats kept static, and the bound of their error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StaticReport {
    /// Number of all splats.
    pub splats: usize,
    /// Number of splats kept at their canonical rows.
    pub still: usize,
    /// Largest error bound among the static splats, pixels.
    pub bound_pixels: f32,
    /// Number of probe times checked.
    pub probes: usize,
}

impl Grid4dField {
    /// Computes the time-independent part for `canonical`, for evaluation at many timestamps.
    pub fn freeze<'a>(&'a self, canonical: GeometryRef<'a>) -> FrozenField<'a> {
        let mut static_state = StaticState::default();
        self.encode_static(canonical, &mut static_state);
        FrozenField { field: self, canonical, static_state, time_state: TimeState::default(), moving: None }
    }
}

impl FrozenField<'_> {
    /// Writes the splats at timestamp `t` to `out`, as [`Field::forward`](crate::Field::forward) does.
    pub fn forward(&mut self, t: Time, out: &mut Geometry) {
        let Self { field, canonical, static_state, time_state, moving } = self;
        let Some(DynamicRows { rows, canonical: from, moved }) = moving else {
            if !field.config.exact.cached_attention {
                field.encode_static(*canonical, static_state);
            }
            field.forward_at(*canonical, static_state, t, time_state, out);
            return;
        };
        if !field.config.exact.cached_attention {
            field.encode_static(from.view(), static_state);
        }
        field.forward_at(from.view(), static_state, t, time_state, moved);
        out.resize(canonical.len());
        out.view_mut().copy_from(*canonical);
        out.scatter(moved, rows);
    }

    /// Keeps splats static in later calls of [`FrozenField::forward`] whose error on screen is at most
    /// `options.pixels`.
    pub fn keep_static(&mut self, options: &StaticTolerance<'_>) -> StaticReport {
        let Self { field, canonical, static_state, time_state, moving } = self;
        if moving.take().is_some() {
            field.encode_static(*canonical, static_state);
        }
        let probes = options.probes.max(1);
        let (mut displacements, mut out) = (vec![[0.0f32; 2]; canonical.len()], Geometry::default());
        for probe in 0..probes {
            let normalised = if probes > 1 { probe as f32 / (probes - 1) as f32 } else { 0.5 };
            let t = Time { normalised, seconds: f64::from(normalised) };
            field.forward_at(*canonical, static_state, t, time_state, &mut out);
            let heads = time_state.blocks.iter().flat_map(|b| b.head.chunks_exact(field.config.head_width()));
            for (i, (displacement, head)) in displacements.iter_mut().zip(heads).enumerate() {
                if field.moves(&static_state.points[i]) {
                    let row = gate::Row::read(head, field.config.gate);
                    let here = row_bounds(&row, field.config.gate, canonical.means[i], canonical.scales[i]);
                    *displacement = [displacement[0].max(here[0]), displacement[1].max(here[1])];
                }
            }
        }
        let pixels = |(displacement, mean): (&[f32; 2], &Vec3)| screen_bound(*displacement, *mean, options.cameras);
        let bounds: Vec<f32> = displacements.par_iter().zip(canonical.means).map(pixels).collect();
        let is_static = |bound: f32| bound <= options.pixels;
        let rows: Vec<u32> = (0..canonical.len()).filter(|&i| !is_static(bounds[i])).map(|i| i as u32).collect();
        let bound_pixels = bounds.iter().filter(|b| is_static(**b)).fold(0.0f32, |m, b| m.max(*b));
        let (splats, still) = (canonical.len(), canonical.len() - rows.len());
        if still > 0 {
            let from = canonical.pick(&rows);
            field.encode_static(from.view(), static_state);
            *moving = Some(DynamicRows { rows, canonical: from, moved: Geometry::default() });
        }
        StaticReport { splats, still, bound_pixels, probes }
    }
}

/// Bounds on the displacement of the mean and on the change of extent, world units.
fn row_bounds(row: &gate::Row, gate: GateConfig, mean: Vec3, scale: Vec3) -> [f32; 2] {
    let eta = row.gate;
    let norm = |v: &[f32]| v.iter().map(|v| v * v).sum::<f32>().sqrt();
    let raw = row.raw_rotation(gate.mode);
    let rotated = 2.0 * (norm(&raw[1..]) / norm(&raw).max(f32::MIN_POSITIVE)).min(1.0) * mean.length();
    let moved = match gate.mode {
        GateMode::ScaleParam | GateMode::TranslationOnly => rotated + eta * row.tau.length(),
        GateMode::LerpPosition => eta * (rotated + row.tau.length()),
        GateMode::Literal => (1.0 - eta) * mean.length() + eta * (rotated + row.tau.length()),
    };
    let (rotation, scale_change) = row.largest_shape_offsets();
    let largest = scale.abs().max_element() + eta * scale_change;
    [moved, eta * scale_change + 2.0 * largest * (eta * rotation).min(1.0)]
}

/// Bound on the screen displacement, pixels, of a splat at `mean` whose mean moves by at most `moved` and whose extent
/// changes by at most `changed` (world units): the largest over all cameras. 0 if both are 0; infinite without cameras
/// or if the splat may cross a camera's plane `z = 0`. Cameras that it stays behind do not count.
pub fn screen_bound([moved, changed]: [f32; 2], mean: Vec3, cameras: &[Camera]) -> f32 {
    if moved == 0.0 && changed == 0.0 {
        return 0.0;
    }
    if cameras.is_empty() {
        return f32::INFINITY;
    }
    cameras.iter().fold(0.0f32, |largest, c| {
        let depth = (c.rotation * mean.as_dvec3() + c.translation).z;
        let moved = f64::from(moved);
        if depth + moved <= 0.0 {
            return largest; // behind the camera at every displacement
        }
        if depth - moved <= 0.0 {
            return f32::INFINITY;
        }
        let (width, height) = (f64::from(c.width), f64::from(c.height));
        let tan = (c.cx.max(width - c.cx) / c.fx).max(c.cy.max(height - c.cy) / c.fy);
        let per_unit = c.fx.max(c.fy) / (depth - moved) * (1.0 + tan);
        largest.max((per_unit * (moved + f64::from(changed))) as f32)
    })
}
