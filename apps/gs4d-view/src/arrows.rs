//! Velocities of some splats as arrows, by central differences of their means.

use crate::shot::Shot;
use glam::Vec3;
use gs_core::cast;
use serde_json::{Value, json};

/// Most arrows.
const MAX_ARROWS: usize = 300;
/// Splats with a lower opacity have no arrow.
const MIN_OPACITY: f32 = 0.1;
/// Half width of the difference, in mean intervals of training timestamps.
const HALF_STEP: f32 = 0.5;

/// Positions and velocities (world units per second, or per unit of normalised time where the data have no seconds) of splats, spread over
/// those whose centres are in the image ([`gs_data::spread()`]).
///
/// # Errors
/// As [`Shot::all_splats`].
pub(crate) fn arrows(shot: &Shot) -> Result<Value, String> {
    let splats = shot.all_splats()?;
    let camera = &shot.camera;
    let in_image = |&i: &usize| {
        let at = camera.to_camera(splats.means[i].as_dvec3());
        let pixel = camera.to_pixel(at);
        let within =
            (0.0..f64::from(camera.width)).contains(&pixel.x) && (0.0..f64::from(camera.height)).contains(&pixel.y);
        splats.opacities[i] >= MIN_OPACITY && at.z > 0.0 && within
    };
    let all: Vec<usize> = (0..splats.len()).filter(in_image).collect();
    let some: Vec<usize> = gs_data::spread(all.len(), MAX_ARROWS).into_iter().map(|k| all[k]).collect();
    let half = HALF_STEP * shot.show.interval();
    let at = |d: f32| shot.all_splats_at(shot.time + d);
    let (before, after) = (at(-half)?, at(half)?);
    let seconds = 2.0 * half * cast::to_f32(shot.show.seconds());
    let shift = |i: usize| Some(*after.means.get(i)? - *before.means.get(i)?);
    let velocity = |i: usize| shift(i).unwrap_or_default() / seconds.max(f32::MIN_POSITIVE);
    let velocities: Vec<Vec3> = some.iter().map(|&i| velocity(i)).collect();
    let longest = velocities.iter().map(|v| v.length()).fold(0.0, f32::max);
    let line = |(&i, v): (&usize, &Vec3)| [splats.means[i].to_array(), v.to_array()];
    let lines: Vec<_> = some.iter().zip(&velocities).map(line).collect();
    let unit = if shot.show.has_seconds() { "world units/s" } else { "world units per sequence" };
    Ok(json!({"lines": lines, "longest": longest, "unit": unit}))
}
