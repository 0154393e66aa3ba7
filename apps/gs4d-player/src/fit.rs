//! Key frames: the fewest found by going from key to key as far as the tolerance allows.

use crate::frames::Size;
use crate::track::{Track, apart, step};

/// Bounds of exponents: steps from 10⁻⁹ to 10³.
const EXPONENTS: [f32; 2] = [-30.0, 10.0];
/// Largest multiple of a step.
const MOST: f32 = 1e9;

/// What a component of a quaternion loses in the 16 bits of [`crate::words`].
const QUAT_WORD: f32 = 0.5 / 32767.0;
/// What the logarithm of a scale between 10⁻⁶ and 10⁶ loses there.
const LOG_WORD: f32 = 1.0 / 256.0;

/// How far each component of a splat's attributes may be from the scene, so that what is drawn keeps to the tolerance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// World units.
    pub(crate) mean: f32,
    /// Of a unit quaternion, root mean square of its components. Where that is `b`, the four together are off by `2 b`; the sine of half the
    /// angle that they turn by is no more, and what is at a distance `r` is moved by `2 r` times that sine: `4 r b` at most.
    pub(crate) quat: f32,
    /// Of the natural logarithm.
    pub(crate) log_scale: f32,
    /// 0 to 1.
    pub(crate) opacity: f32,
    /// 0 to 1.
    pub(crate) color: f32,
}

impl Bounds {
    /// For a splat of that size and largest opacity. What hardly shows may be less exact.
    pub(crate) fn new(tolerance: f32, size: Size, opacity: f32) -> Self {
        let seen = opacity.clamp(0.05, 1.0);
        Self {
            mean: tolerance * size.least,
            quat: (0.25 * tolerance * size.least / size.most - QUAT_WORD).clamp(QUAT_WORD, 0.1),
            log_scale: (tolerance.ln_1p() - LOG_WORD).max(LOG_WORD),
            opacity: (0.1 * tolerance).max(0.002),
            color: (0.1 * tolerance / seen).clamp(0.002, 0.1),
        }
    }
}

/// How far a value of so many components is off: of a quaternion the root mean square, else the largest.
fn off(errors: impl Iterator<Item = f32>, width: usize) -> f32 {
    if width == 4 { 0.5 * errors.map(|e| e * e).sum::<f32>().sqrt() } else { errors.fold(0.0, |m, e| m.max(e.abs())) }
}

/// Adds a splat to a track, from its values `[frames, width]`.
pub(crate) fn add(track: &mut Track, values: &[f32], tolerance: f32) {
    let width = track.width;
    let largest = values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    // Rounding to steps of half the tolerance costs a quarter of it.
    let exponent = (0.5 * tolerance).max(largest / MOST).log2().floor().clamp(EXPONENTS[0], EXPONENTS[1]) as i8;
    let step = step(exponent);
    let rounded: Vec<i32> = values.iter().map(|v| (v / step).round() as i32).collect();
    let row = |frame: usize| &rounded[frame * width..][..width];
    if let Some(middle) = still(values, width, tolerance) {
        let one: Vec<i32> = middle.iter().map(|v| (v / step).round() as i32).collect();
        return track.push(exponent, &[0], &one);
    }
    let (count, mut keys) = (values.len() / width, vec![0usize]);
    while let Some(&from) = keys.last().filter(|&&k| k + 1 < count) {
        let fits = |to: usize| {
            (from + 1..to).all(|m| {
                let share = (m - from) as f32 / (to - from) as f32;
                let line = row(from).iter().zip(row(to)).map(|(&a, &b)| step * (a as f32 + share * apart(a, b)));
                off(line.zip(&values[m * width..]).map(|(a, b)| a - b), width) <= tolerance
            })
        };
        let next = (from + 2..count).take_while(|&to| fits(to)).last().unwrap_or(from + 1);
        keys.push(next);
    }
    let frames: Vec<u16> = keys.iter().map(|&k| k as u16).collect();
    let kept: Vec<i32> = keys.iter().flat_map(|&k| row(k).iter().copied()).collect();
    track.push(exponent, &frames, &kept);
}

/// The middle of the range of each component, if no value is farther from it than three quarters of the tolerance.
fn still(values: &[f32], width: usize, tolerance: f32) -> Option<Vec<f32>> {
    let range = |c: usize| {
        let column = values.iter().skip(c).step_by(width);
        column.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], &v| [a.min(v), b.max(v)])
    };
    let ranges: Vec<[f32; 2]> = (0..width).map(range).collect();
    let near = off(ranges.iter().map(|[low, high]| 0.5 * (high - low)), width) <= 0.75 * tolerance;
    near.then(|| ranges.iter().map(|[low, high]| 0.5 * (low + high)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::rng::Rng;

    fn fitted(values: &[f32], width: usize, tolerance: f32) -> Track {
        let mut track = Track::new(width);
        add(&mut track, values, tolerance);
        track
    }

    fn worst(track: &Track, values: &[f32]) -> f32 {
        let mut out = vec![0.0; track.width];
        let mut worst = 0.0f32;
        for (frame, row) in values.chunks_exact(track.width).enumerate() {
            track.at(0, frame as f32, &mut out);
            worst = worst.max(off(out.iter().zip(row).map(|(a, b)| a - b), track.width));
        }
        worst
    }

    #[test]
    fn every_frame_stays_within_the_tolerance() {
        for seed in 0..200 {
            let mut r = Rng::new(seed, "keys", 0, 0);
            let (width, tolerance, speed) =
                (1 + seed as usize % 4, 0.003 * 1.1f32.powi((seed % 40) as i32), r.range(0.0, 9.0));
            let values: Vec<f32> = (0..60 * width)
                .map(|k| (0.1 * speed * (k / width) as f32 + k as f32).sin() + 0.002 * r.normal())
                .collect();
            let track = fitted(&values, width, tolerance);
            assert!(worst(&track, &values) <= tolerance * 1.001, "{seed}: {} {tolerance}", worst(&track, &values));
        }
    }

    #[test]
    fn what_does_not_move_has_one_key_and_a_line_two() {
        assert_eq!(fitted(&[1.0; 60], 1, 0.01).frames, [0]);
        let line: Vec<f32> = (0..60).map(|k| 0.1 * k as f32).collect();
        assert_eq!(fitted(&line, 1, 0.01).frames, [0, 59]);
        // A corner costs one more, or two.
        let corner: Vec<f32> = (0..60).map(|k| 0.1 * (k as f32 - 30.0).abs()).collect();
        assert!((3..=4).contains(&fitted(&corner, 1, 0.01).frames.len()));
        assert_eq!(fitted(&[3.0], 1, 0.01).frames, [0]);
    }
}
