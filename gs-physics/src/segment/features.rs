//! Feature rows that twists are clustered by.
//!
//! ```text
//! polar (published)   (‖v‖, v̂ ‖v‖/(‖v‖+κ_v),  ‖w‖, ŵ ‖w‖/(‖w‖+κ_w))                              8 numbers
//! plain               (v, w)                                                                     6 numbers
//! ```
//! both with lengths over a scale `s_v`, `s_w`: the 95th percentile of the particles' own lengths (1 without
//! normalisation), at least a twentieth of the velocity that the other kind of motion causes at the scene's radius, so that
//! noise about no motion is not amplified. Lengths are clamped at twice the scale: an outlier is no cluster of its own.
//! Directions fade out below `κ = ` 5 % of the scale, where they are noise.

use crate::twist::Motion;
use glam::Vec3;
use gs_core::cast;

/// `κ`: directions of motions shorter than this fraction of the scale fade out.
const DIRECTION_FADE: f32 = 0.05;
/// Smallest scale of one kind of motion, as a fraction of the other at the scene's radius.
const MIN_SCALE_RATIO: f32 = 0.05;
/// Largest length, over the scale.
const MAX_LENGTH: f32 = 2.0;

/// Layout of a feature row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Feature {
    /// Lengths and directions of `v` and `w`, 8 numbers.
    #[default]
    Polar,
    /// The twist `(v, w)` itself, 6 numbers.
    Plain,
}

/// How feature rows are computed from motions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOptions<'a> {
    /// Layout of the rows, 6 or 8 numbers of motion.
    pub feature: Feature,
    /// Whether lengths are divided by their 95th percentile.
    pub normalise: bool,
    /// Per particle, whether it is static: its motion counts as zero.
    pub resting: Option<&'a [bool]>,
    /// Weight `β` and positions, appended as `β x` (FreeGave: 0.1 to 0.8, world units); 3 numbers more.
    pub positions: Option<(f32, &'a [Vec3])>,
    /// Radius of the scene about the twists' origin, world units: relates angular to linear velocity.
    pub radius: f32,
}

impl Default for FeatureOptions<'_> {
    fn default() -> Self {
        Self { feature: Feature::Polar, normalise: true, resting: None, positions: None, radius: 1.0 }
    }
}

/// Feature rows `[n, width]`, and their width. Slices in the options must be as long as `motions`; a twist that is not
/// finite counts as zero.
pub fn features(motions: &[Motion<f32>], options: &FeatureOptions<'_>) -> (Vec<f32>, usize) {
    let rests = |i: usize| options.resting.is_some_and(|r| r[i]);
    let parts = |i: usize| {
        let twist = &motions[i].twist;
        let (v, w) = (Vec3::from_array(twist.v), Vec3::from_array(twist.w));
        if rests(i) || !(v.is_finite() && w.is_finite()) { (Vec3::ZERO, Vec3::ZERO) } else { (v, w) }
    };
    let twists: Vec<(Vec3, Vec3)> = (0..motions.len()).map(parts).collect();
    let (sv, sw) = scales(&twists, options);
    let width = if options.feature == Feature::Polar { 8 } else { 6 } + if options.positions.is_some() { 3 } else { 0 };
    let mut rows = Vec::with_capacity(width * motions.len());
    for (i, (v, w)) in twists.iter().enumerate() {
        for a in [*v / sv, *w / sw] {
            let length = a.length();
            let clamped = length.min(if options.normalise { MAX_LENGTH } else { f32::INFINITY });
            match options.feature {
                Feature::Polar => {
                    rows.push(clamped);
                    rows.extend((a / (length + DIRECTION_FADE)).to_array());
                }
                Feature::Plain => rows.extend((a * (clamped / length.max(f32::MIN_POSITIVE))).to_array()),
            }
        }
        if let Some((beta, positions)) = options.positions {
            rows.extend((positions[i] * beta).to_array());
        }
    }
    (rows, width)
}

/// Root mean square distance of particles from the origin of twists, weighted by `weights` (opacities) if there are any, in the unit of
/// `means`: [`FeatureOptions::radius`]. 1 where that is 0 or not finite.
pub fn radius(means: &[Vec3], origin: Vec3, weights: Option<&[f32]>) -> f32 {
    let weight = |i: usize| weights.map_or(1.0, |w| f64::from(w[i]));
    let (mut square, mut total) = (0.0, 0.0);
    for (i, x) in means.iter().enumerate() {
        square += f64::from(x.distance_squared(origin)) * weight(i);
        total += weight(i);
    }
    let radius = cast::to_f32((square / total.max(f64::MIN_POSITIVE)).sqrt());
    if radius > 0.0 && radius.is_finite() { radius } else { 1.0 }
}

/// The scales `s_v` and `s_w` that lengths are divided by; without normalisation the fade is in absolute units.
fn scales(twists: &[(Vec3, Vec3)], options: &FeatureOptions<'_>) -> (f32, f32) {
    if !options.normalise {
        return (1.0, 1.0);
    }
    let moving = |i: &usize| options.resting.is_none_or(|r| !r[*i]);
    let of = |pick: fn(&(Vec3, Vec3)) -> Vec3| {
        let mut lengths: Vec<f32> = (0..twists.len()).filter(moving).map(|i| pick(&twists[i]).length()).collect();
        lengths.sort_unstable_by(f32::total_cmp);
        lengths.get(lengths.len() * 95 / 100).copied().unwrap_or(0.0)
    };
    let (v, w, radius) = (of(|t| t.0), of(|t| t.1), options.radius.max(f32::MIN_POSITIVE));
    let one = |scale: f32| if scale > 0.0 && scale.is_finite() { scale } else { 1.0 };
    (one(v.max(MIN_SCALE_RATIO * w * radius)), one(w.max(MIN_SCALE_RATIO * v / radius)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Twist;

    fn motion(v: [f32; 3], w: [f32; 3]) -> Motion<f32> {
        Motion { twist: Twist { v, w }, ..Motion::default() }
    }

    #[test]
    fn the_published_row() {
        let motions = [motion([0.0, 3.0, 4.0], [0.0, 0.0, -2.0])];
        let raw = FeatureOptions { normalise: false, ..FeatureOptions::default() };
        let (row, width) = features(&motions, &raw);
        assert_eq!(width, 8);
        let want = [5.0, 0.0, 3.0 / 5.05, 4.0 / 5.05, 2.0, 0.0, 0.0, -2.0 / 2.05];
        assert!(row.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6), "{row:?}");
        let scaled = features(&motions, &FeatureOptions::default()).0;
        let want = [1.0, 0.0, 0.6 / 1.05, 0.8 / 1.05, 1.0, 0.0, 0.0, -1.0 / 1.05];
        assert!(scaled.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6), "{scaled:?}");
        let plain = features(&motions, &FeatureOptions { feature: Feature::Plain, ..FeatureOptions::default() });
        assert!(plain.1 == 6 && plain.0.iter().zip([0.0, 0.6, 0.8, 0.0, 0.0, -1.0]).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    /// Noise of angular velocity about zero stays small, an outlier is clamped, a static particle has a zero row.
    #[test]
    fn noise_outliers_and_rest() {
        let mut motions = vec![motion([1.0, 0.0, 0.0], [1e-4, 0.0, 0.0]); 40];
        motions[3] = motion([900.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0]);
        motions[4] = motion([900.0, 0.0, 0.0], [0.0; 3]);
        let mut resting = vec![false; 40];
        resting[7] = true;
        let positions = vec![Vec3::new(1.0, -2.0, 3.0); 40];
        let options =
            FeatureOptions { resting: Some(&resting), positions: Some((0.5, &positions)), ..Default::default() };
        let (rows, width) = features(&motions, &options);
        let row = |i: usize| &rows[i * width..][..width];
        assert_eq!((width, rows.len()), (11, 440));
        assert!(row(0)[4] < 0.01 && row(0)[5] < 0.05);
        assert!(row(3)[..8].iter().all(|x| *x == 0.0) && row(7)[..8].iter().all(|x| *x == 0.0));
        assert_eq!((row(4)[0], &row(7)[8..]), (2.0, &[0.5, -1.0, 1.5][..]));
        assert_eq!(features(&[], &FeatureOptions::default()).0.len(), 0);
    }
}
