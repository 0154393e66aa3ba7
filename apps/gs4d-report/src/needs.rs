//! What a scene turned out to need: how much of it moves, turns, changes size, shines from one side only, or is never seen.
//!
//! The method is asked for its splats at [`MOMENTS`] evenly spaced moments of the training span. A splat *moves* if its
//! centre leaves the mean of its own path by more than [`STILL`] of the scene's extent; it *turns* if any axis of its
//! frame turns by more than [`TURN`] radians; it *breathes* if a scale changes by more than [`BREATH`].

use crate::Need;
use crate::inspect::{INVISIBLE_OPACITY, bytes_text};
use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Color, Params, Splats, rot};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;

/// Moments looked at.
pub const MOMENTS: usize = 9;
/// Share of the extent below which a path counts as rest.
pub const STILL: f32 = 1e-3;
/// Radians.
pub const TURN: f32 = 0.02;
/// Relative change of a scale.
pub const BREATH: f32 = 0.02;
/// Change of colour over directions below which degree 0 would look the same in 8 bit.
pub const PLAIN: f32 = 1.0 / 255.0;

/// What the scene of a method needs. `extent` is the length that motion is compared with, world units.
///
/// # Errors
/// If the method cannot be asked for its splats.
pub fn needs(method: &Model, camera: &Camera, extent: f32) -> Result<Vec<Need>, MethodError> {
    let times: Vec<f32> = (0..MOMENTS).map(|k| k as f32 / (MOMENTS - 1) as f32).collect();
    let scenes = times.iter().map(|&t| method.all_splats(&Timestamp::normalised(t), camera));
    let scenes = scenes.collect::<Result<Vec<Splats>, _>>()?;
    let Some(first) = scenes.first().filter(|s| !s.is_empty()) else { return Ok(Vec::new()) };
    let n = first.len();
    let mut out = vec![need("splats", n.to_string(), "drawn at every moment")];
    if scenes.iter().all(|s| s.len() == n) {
        motion(&scenes, extent, &mut out);
    }
    let unseen = scenes.iter().fold(vec![true; n], |unseen, s| {
        unseen.iter().zip(&s.opacities).map(|(&u, &o)| u && o < INVISIBLE_OPACITY).collect()
    });
    out.push(need("splats never visible", count(&unseen), "below opacity 1/255 at every moment: can be left out"));
    if let Color::Sh { degree, coeffs } = &first.color {
        let plain: Vec<bool> = coeffs.chunks_exact(first.color.width()).map(is_plain).collect();
        let meaning = format!("their colour hardly depends on the view: degree 0 instead of {degree} would do");
        out.push(need("splats of plain colour", count(&plain), &meaning));
    }
    out.push(need("storage in all", bytes_text(4 * Params::param_count(method)), "parameters as f32"));
    Ok(out)
}

/// A camera for questions whose answer does not depend on the camera.
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

fn motion(scenes: &[Splats], extent: f32, out: &mut Vec<Need>) {
    let n = scenes[0].len();
    let sway = |i: usize| {
        let mean = scenes.iter().map(|s| s.means[i]).sum::<Vec3>() / scenes.len() as f32;
        scenes.iter().map(|s| s.means[i].distance(mean)).fold(0.0, f32::max)
    };
    let sways: Vec<f32> = (0..n).map(sway).collect();
    let moves: Vec<bool> = sways.iter().map(|&s| s > STILL * extent).collect();
    let turns: Vec<bool> = (0..n).map(|i| turned(scenes, i) > TURN).collect();
    let breathes: Vec<bool> = (0..n).map(|i| breath(scenes, i) > BREATH).collect();
    let still: Vec<bool> = (0..n).map(|i| !moves[i] && !turns[i] && !breathes[i]).collect();
    let largest = sways.iter().copied().fold(0.0, f32::max);
    out.push(need("splats that move", count(&moves), "leave the mean of their path by more than 0.1 % of the extent"));
    out.push(need("splats that turn", count(&turns), "by more than 0.02 radians"));
    out.push(need("splats that change size", count(&breathes), "by more than 2 %"));
    out.push(need("splats at rest", count(&still), "could be drawn without the field"));
    let text = format!("{largest:.3}");
    out.push(need(
        "largest motion",
        text,
        &format!("from the mean of its path, world units; the extent is {extent:.3}"),
    ));
}

/// Largest turn of a splat against its first moment, radians.
fn turned(scenes: &[Splats], i: usize) -> f32 {
    let unit = |s: &Splats| rot::normalise(s.quats[i]).wxyz;
    let first = unit(&scenes[0]);
    let angle = |s: &Splats| {
        let cos_half: f32 = first.iter().zip(unit(s)).map(|(a, b)| a * b).sum();
        2.0 * cos_half.abs().min(1.0).acos()
    };
    scenes[1..].iter().map(angle).fold(0.0, f32::max)
}

/// Largest relative change of a scale against the first moment.
fn breath(scenes: &[Splats], i: usize) -> f32 {
    let first = scenes[0].scales[i].max(Vec3::splat(f32::MIN_POSITIVE));
    scenes[1..].iter().map(|s| (s.scales[i] / first - 1.0).abs().max_element()).fold(0.0, f32::max)
}

/// A bound of what the SH rest can add in any direction: each basis function is below 1.
fn is_plain(row: &[f32]) -> bool {
    let rest = |c: usize| row.iter().skip(3 + c).step_by(3).map(|v| v.abs()).sum::<f32>();
    (0..3).all(|c| rest(c) < PLAIN)
}

fn need(name: &str, value: String, meaning: &str) -> Need {
    Need { name: name.to_owned(), value, meaning: meaning.to_owned() }
}

fn count(which: &[bool]) -> String {
    let k = which.iter().filter(|&&w| w).count();
    format!("{k} of {} ({:.1} %)", which.len(), 100.0 * k as f64 / which.len().max(1) as f64)
}
