//! A trained scene as rigid parts in motion, for `.glb` files: the parts that `segment` finds, each under the rigid motion that fits its
//! splats best.

use super::{Baker, ExportError, MIN_OPACITY};
use crate::layers;
use crate::segment::SegmentError;
use glam::{DMat3, DQuat, DVec3};
use gs_core::io::RawSplats;
use gs_core::io::glb::{GlbScene, RigidMotion, RigidPart};
use gs_core::rot::{self, Mat3};
use gs_core::{Splats, cast};
use gs_physics::kabsch::kabsch;
use gs_train::method::MethodError;
use gs_train::timestamp::Timestamp;

/// A motion that takes no splat of its part farther than this share of the extent of the scene is none.
const AT_REST: f64 = 1e-5;

/// Rigid parts of a scene, and how well they describe its motion.
#[derive(Clone, Debug)]
pub struct RigidScene {
    /// The parts; those with most opacity first.
    pub parts: Vec<RigidPart>,
    /// Number of parts that move.
    pub moving: usize,
    /// Root mean square distance of splats from where their part takes them, by opacity, over all times, world units.
    pub residual: f64,
}

impl Baker<'_> {
    /// The scene as rigid parts, with key frames at ascending normalised times, the first of which is second 0; a normalised time of 1
    /// takes `seconds`. Parts are those of the motion up to `observed`, the last training time.
    ///
    /// # Errors
    /// If the splats of a time are not valid or differ in number, none is visible, or no parts can be found.
    pub fn rigid(&self, times: &[f32], seconds: f64, observed: f32) -> Result<RigidScene, ExportError> {
        let labels = layers::parts(self.method, observed).map_err(|e| ExportError::Parts(e.into()))?;
        let middle = times.get(times.len() / 2).copied().unwrap_or(0.0);
        let rest = self.truncated(self.averaged(&Timestamp::normalised(middle))?).with_plain_kernel();
        // Where splats are does not depend on the camera.
        let camera = self.cameras.first().ok_or(ExportError::Empty { time: middle })?;
        let means = |t: &f32| Ok(self.method.all_splats(&Timestamp::normalised(*t), camera)?.means);
        let frames = times.iter().map(means).collect::<Result<Vec<_>, MethodError>>()?;
        if labels.of.len() != rest.len() || frames.iter().any(|f| f.len() != rest.len()) {
            return Err(ExportError::Parts(SegmentError::NoPaths(self.method.name().to_owned()).into()));
        }
        let clock: Vec<f32> =
            times.iter().map(|t| cast::to_f32(f64::from(t - times.first().unwrap_or(t)) * seconds)).collect();
        let extent = extent(&rest);
        let mut scene = RigidScene { parts: Vec::new(), moving: 0, residual: 0.0 };
        let (mut squares, mut weight) = (0.0, 0.0);
        for part in 0..labels.k {
            let visible = |i: &usize| labels.of[*i] as usize == part && rest.opacities[*i] >= MIN_OPACITY;
            let rows: Vec<usize> = (0..rest.len()).filter(visible).collect();
            if rows.is_empty() {
                continue;
            }
            let fitted = fit(&rest, &rows, &frames);
            squares += fitted.squares;
            weight += fitted.weight;
            let raw = RawSplats::from_splats(&rest.rows(&rows));
            let mut raw = raw.map_err(|source| ExportError::Splats { time: middle, source })?;
            raw.antialiased = self.antialiased();
            let moves = fitted.farthest > AT_REST * extent;
            scene.moving += usize::from(moves);
            scene.parts.push(moving_part(self.turn, raw, fitted, if moves { &clock } else { &[] }));
        }
        if scene.parts.is_empty() {
            return Err(ExportError::Empty { time: middle });
        }
        scene.residual = (squares / f64::max(weight, f64::MIN_POSITIVE)).sqrt();
        Ok(scene)
    }

    /// The splats of a file of rigid parts at a normalised time, in the axes of the data; `seconds` and `first`, the time of the first key
    /// frame, are those of [`Self::rigid`].
    ///
    /// # Errors
    /// If a splat of the file is not valid.
    pub fn rigid_splats(&self, scene: &GlbScene, seconds: f64, first: f32, time: f32) -> Result<Splats, MethodError> {
        let raw = scene.at(cast::to_f32(f64::from(time - first) * seconds));
        self.turned_back(raw).to_splats().map_err(|e| MethodError::Render(e.to_string()))
    }
}

/// The motions of a part.
struct Fitted {
    motions: Vec<(DMat3, DVec3)>,
    /// Weighted squares of what the motions leave, and the weight.
    squares: f64,
    weight: f64,
    /// Farthest that a motion takes a splat.
    farthest: f64,
    /// Mean of the splats at rest, by opacity.
    centre: DVec3,
}

/// The rigid motions from `rest` to the means of each frame that fit these rows best, by opacity.
fn fit(rest: &Splats, rows: &[usize], frames: &[Vec<glam::Vec3>]) -> Fitted {
    let weights: Vec<f64> = rows.iter().map(|i| f64::from(rest.opacities[*i])).collect();
    let all: f64 = weights.iter().sum();
    let centre = rows.iter().zip(&weights).map(|(i, w)| *w * rest.means[*i].as_dvec3()).sum::<DVec3>() / all;
    let mut out = Fitted { motions: Vec::new(), squares: 0.0, weight: 0.0, farthest: 0.0, centre };
    for frame in frames {
        let pairs: Vec<_> = rows.iter().map(|i| (rest.means[*i].as_dvec3(), frame[*i].as_dvec3())).collect();
        let rigid = kabsch(&pairs, Some(&weights));
        for ((from, to), w) in pairs.iter().zip(&weights) {
            let moved = rigid.apply(*from);
            out.squares += w * moved.distance_squared(*to);
            out.weight += w;
            out.farthest = out.farthest.max(moved.distance(*from));
        }
        out.motions.push((rigid.rotation, rigid.translation));
    }
    out
}

/// A part of the file, turned if files are; at rest without a clock. One that moves has its own centre as its origin: readers
/// take rotation and translation between key frames apart, and a part that turned about a far origin would leave its path.
fn moving_part(turn: Option<Mat3<f64>>, splats: RawSplats, fitted: Fitted, clock: &[f32]) -> RigidPart {
    let mut splats = match &turn {
        Some(turn) => splats.mapped(turn),
        None => splats,
    };
    let turn = turn.map_or(DMat3::IDENTITY, |rows| DMat3::from_cols_array_2d(&rows).transpose());
    let mut motion = RigidMotion { times: clock.to_vec(), ..RigidMotion::default() };
    let centre = turn * fitted.centre;
    if !clock.is_empty() {
        splats.means.iter_mut().for_each(|m| *m = (m.as_dvec3() - centre).as_vec3());
    }
    for (rotation, translation) in fitted.motions.into_iter().take(clock.len()) {
        let rotation = turn * rotation * turn.transpose();
        let translation = turn * translation + rotation * centre;
        let mut quat = DQuat::from_mat3(&rotation).normalize();
        let before = motion.rotations.last().map(|q| rot::to_glam(*q).as_dquat());
        if before.is_some_and(|b| b.dot(quat) < 0.0) {
            quat = -quat;
        }
        motion.translations.push(translation.as_vec3());
        motion.rotations.push(rot::from_glam(quat.as_quat()));
    }
    RigidPart { splats, motion }
}

/// Diagonal of the box around the splats.
fn extent(splats: &Splats) -> f64 {
    let low = splats.means.iter().copied().reduce(glam::Vec3::min).unwrap_or_default();
    let high = splats.means.iter().copied().reduce(glam::Vec3::max).unwrap_or_default();
    f64::from(low.distance(high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::io::Limits;
    use gs_core::io::glb::{read_scene, write_parts};

    /// Splats on a circle around a far centre, by an angle.
    fn ring(angle: f64) -> Splats {
        let at = |k: usize| {
            let a = angle + std::f64::consts::FRAC_PI_3 * k as f64;
            DVec3::new(4.0 + 0.5 * a.cos(), 0.5 * a.sin(), 1.0).as_vec3()
        };
        Splats {
            means: (0..6).map(at).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 6],
            scales: vec![glam::Vec3::splat(0.1); 6],
            opacities: vec![0.5; 6],
            color: gs_core::Color::Rgb(vec![[0.5; 3]; 6]),
            ..Splats::default()
        }
    }

    #[test]
    fn a_part_that_turns_far_from_the_origin_keeps_its_place_between_key_frames() {
        let (rest, rows) = (ring(0.0), [0, 1, 2, 3, 4, 5]);
        let frames: Vec<_> = [0.0, 0.8, 1.6].map(|angle| ring(angle).means).to_vec();
        // Turned by a quarter about x.
        let quarter = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
        for turn in [None, Some(quarter)] {
            let raw = RawSplats::from_splats(&rest).unwrap();
            let made = moving_part(turn, raw, fit(&rest, &rows, &frames), &[0.0, 1.0, 2.0]);
            let mut bytes = Vec::new();
            write_parts(&[made], &mut bytes).unwrap();
            let scene = read_scene(&bytes, "t.glb", &Limits::default()).unwrap();
            for (seconds, angle) in [(0.0, 0.0), (0.5, 0.4), (1.0, 0.8), (1.75, 1.4)] {
                let truth = RawSplats::from_splats(&ring(angle)).unwrap();
                let truth = turn.map_or(truth.clone(), |turn| truth.mapped(&turn));
                let shown = scene.at(seconds).means;
                let off = shown.iter().zip(&truth.means).map(|(a, b)| a.distance(*b));
                assert!(off.fold(0.0, f32::max) < 1e-4, "{seconds}");
            }
        }
    }
}
