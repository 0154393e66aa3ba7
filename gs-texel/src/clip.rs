//! Animation clips: keyframes over time, with the semantics of glTF 2.0.
//!
//! ```text
//! STEP     the last key's value
//! LINEAR   (1 − s) a + s b,  rotations slerp(a, b; s) on the shorter arc,   s = (t − t₀)/(t₁ − t₀)
//! CUBIC    (2s³−3s²+1) a + (s³−2s²+s) Δt m_a + (−2s³+3s²) b + (s³−s²) Δt m_b,  rotations normalised afterwards
//! ```
//! The value is constant before the first key and after the last.

use crate::skeleton::{Pose, Skeleton};
use gs_core::rot;

/// Above this cosine of half the angle between them, rotations are interpolated linearly.
const LERP_COSINE: f64 = 1.0 - 1e-10;

/// How values between keys are interpolated (equations in [`crate::clip`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// The value of the last key at or before the time.
    Step,
    /// Linear; spherical linear for rotations.
    Linear,
    /// Cubic Hermite spline. Each key holds in-tangent, value and out-tangent.
    Cubic,
}

/// What a channel animates, by row of [`Skeleton::nodes`] or of the template's morphs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A node's translation, 3 values a key.
    Translation(u32),
    /// A node's rotation, 4 values a key, `(w, x, y, z)`.
    Rotation(u32),
    /// A node's scale, 3 values a key.
    Scale(u32),
    /// Weights of some morphs, `count` values a key.
    Morphs {
        /// Row of the first morph.
        first: u32,
        /// Number of morphs that follow one another.
        count: u32,
    },
}

impl Target {
    /// Values per key; a cubic key holds three times as many.
    pub fn width(self) -> usize {
        match self {
            Target::Translation(_) | Target::Scale(_) => 3,
            Target::Rotation(_) => 4,
            Target::Morphs { count, .. } => count as usize,
        }
    }
}

/// The keys of one animated [`Target`].
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Node or morphs that the keys apply to.
    pub target: Target,
    /// Interpolation of the values between keys.
    pub interpolation: Interpolation,
    /// Times of the keys in seconds: finite, not decreasing, at least one.
    pub times: Vec<f64>,
    /// [`Target::width`] finite values per key; three times as many (in-tangent, value, out-tangent) for
    /// [`Interpolation::Cubic`].
    pub values: Vec<f64>,
}

/// An animation: channels that are sampled together.
///
/// ```
/// use gs_texel::figure::{Cylinder, cylinder};
/// use std::f64::consts::FRAC_PI_4;
///
/// // The clip rotates joint 1 from 0 to 90 degrees about y in one second.
/// let character = cylinder(&Cylinder::default());
/// let pose = character.clip("twist").unwrap().pose(&character.skeleton, 0.5);
/// let [w, x, y, z] = pose.locals[1].rotation;
/// assert!((w - (0.5 * FRAC_PI_4).cos()).abs() < 1e-12 && (y - (0.5 * FRAC_PI_4).sin()).abs() < 1e-12);
/// assert_eq!((x, z), (0.0, 0.0));
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clip {
    /// Name from the file; empty if it has none.
    pub name: String,
    /// Channels in the file's order. Of two with the same target the later wins.
    pub channels: Vec<Channel>,
}

impl Clip {
    /// Time of the last key of any channel, seconds; 0 without channels.
    pub fn duration(&self) -> f64 {
        self.channels.iter().filter_map(|c| c.times.last()).fold(0.0, |a, &b| f64::max(a, b))
    }

    /// The pose at `t` seconds. What no channel animates keeps its rest pose.
    pub fn pose(&self, skeleton: &Skeleton, t: f64) -> Pose {
        let mut pose = skeleton.rest_pose();
        let mut out = Vec::new();
        for channel in &self.channels {
            channel.sample(t, &mut out);
            match channel.target {
                Target::Translation(n) => pose.locals[n as usize].translation = glam::DVec3::from_slice(&out),
                Target::Scale(n) => pose.locals[n as usize].scale = glam::DVec3::from_slice(&out),
                Target::Rotation(n) => pose.locals[n as usize].rotation = [out[0], out[1], out[2], out[3]],
                Target::Morphs { first, .. } => {
                    let morphs = &mut pose.morphs[first as usize..];
                    morphs.iter_mut().zip(&out).for_each(|(m, &v)| *m = v as f32);
                }
            }
        }
        pose
    }
}

impl Channel {
    /// Writes the value at `t` seconds to `out`.
    fn sample(&self, t: f64, out: &mut Vec<f64>) {
        let width = self.target.width();
        let next = self.times.partition_point(|&k| k <= t);
        out.clear();
        if next == 0 || next == self.times.len() || self.interpolation == Interpolation::Step {
            out.extend_from_slice(self.key(next.saturating_sub(1), width));
        } else {
            let span = self.times[next] - self.times[next - 1];
            let s = (t - self.times[next - 1]) / span;
            let (a, b) = (self.key(next - 1, width), self.key(next, width));
            match (self.interpolation, self.target) {
                (Interpolation::Cubic, _) => self.hermite(next, (s, span), width, out),
                (_, Target::Rotation(_)) => out.extend(slerp(quat(a), quat(b), s)),
                _ => out.extend(a.iter().zip(b).map(|(&a, &b)| (1.0 - s) * a + s * b)),
            }
        }
        if matches!(self.target, Target::Rotation(_)) {
            let unit = rot::normalise(quat(out)).wxyz;
            out.copy_from_slice(&unit);
        }
    }

    /// The value of key `k`, without the tangents of a cubic key.
    fn key(&self, k: usize, width: usize) -> &[f64] {
        match self.interpolation {
            Interpolation::Cubic => &self.values[(3 * k + 1) * width..][..width],
            _ => &self.values[k * width..][..width],
        }
    }

    fn hermite(&self, next: usize, (s, span): (f64, f64), width: usize, out: &mut Vec<f64>) {
        let (a, b) = (self.key(next - 1, width), self.key(next, width));
        let leaving = &self.values[(3 * next - 1) * width..][..width];
        let arriving = &self.values[3 * next * width..][..width];
        let (s2, s3) = (s * s, s * s * s);
        let basis = [2.0 * s3 - 3.0 * s2 + 1.0, (s3 - 2.0 * s2 + s) * span, 3.0 * s2 - 2.0 * s3, (s3 - s2) * span];
        let value = |i: usize| basis[0] * a[i] + basis[1] * leaving[i] + basis[2] * b[i] + basis[3] * arriving[i];
        out.extend((0..width).map(value));
    }
}

fn quat(v: &[f64]) -> [f64; 4] {
    [v[0], v[1], v[2], v[3]]
}

/// Spherical linear interpolation on the shorter arc.
fn slerp(a: [f64; 4], b: [f64; 4], s: f64) -> [f64; 4] {
    let (a, mut b) = (rot::normalise(a).wxyz, rot::normalise(b).wxyz);
    let mut cosine: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    if cosine < 0.0 {
        b = b.map(|v| -v);
        cosine = -cosine;
    }
    let (wa, wb) = if cosine > LERP_COSINE {
        (1.0 - s, s)
    } else {
        let angle = cosine.acos();
        (((1.0 - s) * angle).sin() / angle.sin(), (s * angle).sin() / angle.sin())
    };
    std::array::from_fn(|i| wa * a[i] + wb * b[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::{Node, Trs, axis_angle};
    use glam::DVec3;

    fn one_node() -> Skeleton {
        let nodes = vec![Node { name: String::new(), parent: None, rest: Trs::at(DVec3::X) }];
        Skeleton { nodes, rest_morphs: vec![0.25, 0.5, 0.75], ..Skeleton::default() }
    }

    fn posed(target: Target, interpolation: Interpolation, times: &[f64], values: Vec<f64>, t: f64) -> Pose {
        let channels = vec![Channel { target, interpolation, times: times.to_vec(), values }];
        Clip { name: String::new(), channels }.pose(&one_node(), t)
    }

    #[test]
    fn step_holds_and_linear_joins() {
        let keys = || vec![0.0, 0.0, 0.0, 4.0, 8.0, -2.0];
        let at = |i, t| posed(Target::Translation(0), i, &[1.0, 3.0], keys(), t).locals[0].translation;
        for (t, share) in [(-1.0, 0.0), (1.0, 0.0), (2.0, 0.5), (2.5, 0.75), (3.0, 1.0), (9.0, 1.0), (f64::NAN, 0.0)] {
            let end = DVec3::new(4.0, 8.0, -2.0);
            assert!(at(Interpolation::Linear, t).abs_diff_eq(end * share, 1e-12), "{t}");
            assert_eq!(at(Interpolation::Step, t), if share == 1.0 { end } else { DVec3::ZERO });
        }
    }

    #[test]
    fn rotations_take_the_shorter_arc_evenly() {
        let axis = DVec3::new(0.3, -0.5, 0.8);
        let far = axis_angle(axis, 2.0).map(|v| -3.0 * v);
        let keys = [axis_angle(axis, 0.0), far].concat();
        for s in [0.0, 0.1, 0.5, 0.9, 1.0] {
            let pose = posed(Target::Rotation(0), Interpolation::Linear, &[0.0, 1.0], keys.clone(), s);
            let (got, want) = (pose.locals[0].rotation, axis_angle(axis, 2.0 * s));
            let dot: f64 = got.iter().zip(want).map(|(a, b)| a * b).sum();
            assert!((dot.abs() - 1.0).abs() < 1e-12, "{s}: {got:?} {want:?}");
        }
        let same = [axis_angle(axis, 1.0), axis_angle(axis, 1.0)].concat();
        let pose = posed(Target::Rotation(0), Interpolation::Linear, &[0.0, 1.0], same, 0.3);
        assert!(pose.locals[0].rotation.iter().zip(axis_angle(axis, 1.0)).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn a_cubic_spline_reproduces_a_cubic() {
        // f(t) = t³ − 2t + 1 with its slopes at 1 and 3.
        let (f, slope) = (|t: f64| t * t * t - 2.0 * t + 1.0, |t: f64| 3.0 * t * t - 2.0);
        let key = |t: f64| [slope(t), f(t), slope(t)].map(|v| vec![v, -v, 2.0 * v]).concat();
        let keys = [key(1.0), key(3.0)].concat();
        for t in [1.0, 1.3, 2.0, 2.9, 3.0] {
            let scale = posed(Target::Scale(0), Interpolation::Cubic, &[1.0, 3.0], keys.clone(), t).locals[0].scale;
            assert!(scale.abs_diff_eq(DVec3::new(f(t), -f(t), 2.0 * f(t)), 1e-12), "{t}: {scale}");
        }
        assert_eq!(posed(Target::Scale(0), Interpolation::Cubic, &[1.0, 3.0], keys, 0.0).locals[0].scale.x, f(1.0));
    }

    #[test]
    fn morphs_and_what_is_not_moved() {
        let target = Target::Morphs { first: 1, count: 2 };
        let pose = posed(target, Interpolation::Linear, &[0.0, 2.0, 2.0], vec![0.0, 1.0, 1.0, 0.0, 7.0, 7.0], 1.0);
        assert_eq!(pose.morphs, [0.25, 0.5, 0.5]);
        assert_eq!(pose.locals, [Trs::at(DVec3::X)]);
        let single = posed(target, Interpolation::Linear, &[5.0], vec![0.1, 0.2], 1.0);
        assert_eq!(single.morphs, [0.25, 0.1, 0.2]);
    }
}
