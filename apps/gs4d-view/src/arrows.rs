//! Where splats go: an arrow for some of them, the difference of where they are drawn a little later and a little earlier.

use crate::shot::Shot;
use glam::Vec3;
use serde_json::{Value, json};

/// Arrows, at most.
const MOST: usize = 300;
/// Splats fainter than this have none.
const CLEAR: f32 = 0.1;
/// Half of the time between the two places, in mean distances of training times.
const HALF: f32 = 0.5;

/// Starts and velocities in world units a second, of splats spread evenly over those whose centres are in the picture.
///
/// # Errors
/// As [`Shot::tracked`].
pub fn arrows(shot: &Shot) -> Result<Value, String> {
    let splats = shot.all_splats()?;
    let camera = &shot.camera;
    let seen = |&i: &usize| {
        let at = camera.to_camera(splats.means[i].as_dvec3());
        let pixel = camera.to_pixel(at);
        let within =
            (0.0..f64::from(camera.width)).contains(&pixel.x) && (0.0..f64::from(camera.height)).contains(&pixel.y);
        splats.opacities[i] >= CLEAR && at.z > 0.0 && within
    };
    let all: Vec<usize> = (0..splats.len()).filter(seen).collect();
    let some: Vec<usize> = (0..all.len().min(MOST)).map(|k| all[k * all.len() / all.len().min(MOST)]).collect();
    let half = HALF * shot.show.interval();
    let at = |d: f32| shot.scene.all_splats(shot.time + d, camera);
    let (before, after) = (at(-half)?, at(half)?);
    let seconds = 2.0 * half * shot.show.seconds() as f32;
    let shift = |i: usize| Some(*after.means.get(i)? - *before.means.get(i)?);
    let velocity = |i: usize| shift(i).unwrap_or_default() / seconds.max(f32::MIN_POSITIVE);
    let velocities: Vec<Vec3> = some.iter().map(|&i| velocity(i)).collect();
    let longest = velocities.iter().map(|v| v.length()).fold(0.0, f32::max);
    let line = |(&i, v): (&usize, &Vec3)| [splats.means[i].to_array(), v.to_array()];
    let lines: Vec<_> = some.iter().zip(&velocities).map(line).collect();
    Ok(json!({"lines": lines, "longest": longest, "unit": "world units/s"}))
}
