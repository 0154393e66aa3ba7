//! How much of a trained scene moves, rotates, changes size, has view-dependent colour, or is never visible.
//!
//! Splats are sampled at nine evenly spaced times of the training span. A splat *moves* if its mean leaves the mean
//! of its path by more than 0.1 % of the scene's extent; it *rotates* by more than 0.02 radians
//! against the first time; it *changes size* if a scale changes by more than 2 %.

use crate::ReportRow;
use crate::inspect::{INVISIBLE_OPACITY, bytes_text};
use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Color, Splats, rot};
use gs_train::jumps::jumps;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;

/// Number of sampled times.
pub(crate) const SAMPLE_TIMES: usize = 9;
/// Displacement up to which a splat is static, as a share of the extent.
pub(crate) const MIN_DISPLACEMENT: f32 = 1e-3;
/// Rotation up to which an orientation is static, radians.
pub(crate) const MIN_ROTATION: f32 = 0.02;
/// Relative change up to which a scale is static.
pub(crate) const MIN_SCALE_CHANGE: f32 = 0.02;
/// Bound on the view-dependent part of a colour below which SH degree 0 gives the same 8-bit value.
pub(crate) const MAX_SH_REST: f32 = 1.0 / 255.0;

/// Statistics of a model's splats, as rows for the report. `extent` is the length that motion is compared with, world units;
/// `camera` matters only to models whose splats depend on it.
///
/// # Errors
/// If the model cannot produce its splats.
pub fn needs(method: &Model, camera: &Camera, extent: f32) -> Result<Vec<ReportRow>, MethodError> {
    let times: Vec<f32> = (0..SAMPLE_TIMES).map(|k| k as f32 / (SAMPLE_TIMES - 1) as f32).collect();
    let scenes = times.iter().map(|&t| method.all_splats(&Timestamp::normalised(t), camera));
    let scenes = scenes.collect::<Result<Vec<Splats>, _>>()?;
    let Some(first) = scenes.first().filter(|s| !s.is_empty()) else { return Ok(Vec::new()) };
    let n = first.len();
    let mut out = vec![ReportRow::new("splats", n.to_string(), "rendered at every time")];
    if scenes.iter().all(|s| s.len() == n) {
        motion(&scenes, extent, &mut out);
    }
    let jumps = jumps(method, camera)?;
    if let Some(most) = jumps.iter().max_by(|a, b| a.mean.total_cmp(&b.mean)) {
        let text = format!("{:.2} pixels, 99 % within {:.2}, at t = {:.3}", most.mean, most.most, most.t);
        let meaning = format!("the largest of {} where an interval of time begins, mean by opacity", jumps.len());
        out.push(ReportRow::new("jump", text, &meaning));
    }
    let unseen = scenes.iter().fold(vec![true; n], |unseen, s| {
        unseen.iter().zip(&s.opacities).map(|(&u, &o)| u && o < INVISIBLE_OPACITY).collect()
    });
    out.push(ReportRow::new(
        "splats never visible",
        count(&unseen),
        "below opacity 1/255 at every time: can be left out",
    ));
    if let Color::Sh { degree, coeffs } = &first.color {
        let plain: Vec<bool> = coeffs.chunks_exact(first.color.width()).map(is_plain).collect();
        let meaning = format!("their colour hardly depends on the view: degree 0 instead of {degree} would do");
        out.push(ReportRow::new("splats of plain colour", count(&plain), &meaning));
    }
    out.push(ReportRow::new("storage in all", bytes_text(4 * method.param_count()), "parameters as f32"));
    Ok(out)
}

/// A camera of one pixel at the origin, for models whose splats do not depend on the camera.
pub fn neutral_camera() -> Camera {
    Camera {
        width: 1,
        height: 1,
        fx: 1.0,
        fy: 1.0,
        cx: 0.5,
        cy: 0.5,
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
    }
}

fn motion(scenes: &[Splats], extent: f32, out: &mut Vec<ReportRow>) {
    let n = scenes[0].len();
    let displacement = |i: usize| {
        let mean = scenes.iter().map(|s| s.means[i]).sum::<Vec3>() / scenes.len() as f32;
        scenes.iter().map(|s| s.means[i].distance(mean)).fold(0.0, f32::max)
    };
    let displacements: Vec<f32> = (0..n).map(displacement).collect();
    let moves: Vec<bool> = displacements.iter().map(|&s| s > MIN_DISPLACEMENT * extent).collect();
    let rotates: Vec<bool> = (0..n).map(|i| largest_rotation(scenes, i) > MIN_ROTATION).collect();
    let resizes: Vec<bool> = (0..n).map(|i| largest_scale_change(scenes, i) > MIN_SCALE_CHANGE).collect();
    let is_static: Vec<bool> = (0..n).map(|i| !moves[i] && !rotates[i] && !resizes[i]).collect();
    let largest = displacements.iter().copied().fold(0.0, f32::max);
    out.push(ReportRow::new(
        "splats that move",
        count(&moves),
        "leave the mean of their path by more than 0.1 % of the extent",
    ));
    out.push(ReportRow::new("splats that turn", count(&rotates), "by more than 0.02 radians"));
    out.push(ReportRow::new("splats that change size", count(&resizes), "by more than 2 %"));
    out.push(ReportRow::new("splats at rest", count(&is_static), "could be rendered without the field"));
    let text = format!("{largest:.3}");
    out.push(ReportRow::new(
        "largest motion",
        text,
        &format!("from the mean of its path, world units; the extent is {extent:.3}"),
    ));
}

/// Largest rotation of a splat against the first time, radians.
fn largest_rotation(scenes: &[Splats], i: usize) -> f32 {
    let unit = |s: &Splats| rot::normalise(s.quats[i]).wxyz;
    let first = unit(&scenes[0]);
    let angle = |s: &Splats| {
        let cos_half: f32 = first.iter().zip(unit(s)).map(|(a, b)| a * b).sum();
        2.0 * cos_half.abs().min(1.0).acos()
    };
    scenes[1..].iter().map(angle).fold(0.0, f32::max)
}

/// Largest relative change of a scale against the first time.
fn largest_scale_change(scenes: &[Splats], i: usize) -> f32 {
    let first = scenes[0].scales[i].max(Vec3::splat(f32::MIN_POSITIVE));
    scenes[1..].iter().map(|s| (s.scales[i] / first - 1.0).abs().max_element()).fold(0.0, f32::max)
}

/// Whether the SH above degree 0 stay below [`MAX_SH_REST`] in any direction: each basis function is below 1.
fn is_plain(row: &[f32]) -> bool {
    let rest = |c: usize| row.iter().skip(3 + c).step_by(3).map(|v| v.abs()).sum::<f32>();
    (0..3).all(|c| rest(c) < MAX_SH_REST)
}

fn count(which: &[bool]) -> String {
    let k = which.iter().filter(|&&w| w).count();
    format!("{k} of {} ({:.1} %)", which.len(), 100.0 * k as f64 / which.len().max(1) as f64)
}
