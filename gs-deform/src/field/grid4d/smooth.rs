//! The smoothness regulariser of Grid4D: the features of a point and of a point nearby should agree.
//!
//! ```text
//! L_s = mean_i |H_xyz(x_i + δ_i) − H_xyz(x_i)|²        L_t = mean_i |H_t(x_i + δ_i, t + δt_i) − H_t(x_i, t)|²
//! value = λ_s L_s + λ_t L_t        backward: ±2 Δ λ / n to both points        δ ~ U(−ε, ε) along each axis
//! ```
//! A step samples one splat from each of `n` equal ranges of rows (`n` is the share of all splats), separately for
//! space and time.

use super::config::SmoothConfig;
use super::grids::{Grids, TimedTape, Times, inside};
use glam::Vec3;
use gs_core::Rng;
use gs_core::nn::BLOCK;
use rayon::prelude::*;

/// Two points in the unit cube and the shift in time of the second.
type Pair = ([[f32; 3]; 2], f32);

/// Scratch of the regulariser, reused between steps.
#[derive(Clone, Debug, Default)]
pub(super) struct Smooth {
    pairs: Vec<Option<Pair>>,
    /// All first points, then all second points.
    points: Vec<[f32; 3]>,
    times: Vec<f32>,
    timed: TimedTape,
    features: Vec<f32>,
    d_features: Vec<f32>,
    sums: Vec<f64>,
}

/// Key of a step's random numbers.
#[derive(Clone, Copy)]
pub(super) struct StepSeed {
    pub seed: u64,
    pub step: u32,
}

impl Smooth {
    /// Adds the gradient of `λ_s L_s` to the canonical grid, returns the value.
    pub(super) fn space(&mut self, grids: &mut Grids, config: &SmoothConfig, means: &[Vec3], seed: StepSeed) -> f64 {
        if config.lambda_s == 0.0 {
            return 0.0;
        }
        self.sample(grids, config, means, ("field.smooth.space", seed), 0.0);
        grids.space(&self.points, &mut self.features);
        let value = self.compare(grids.widths()[0], config.lambda_s);
        grids.space_backward(&self.points, &self.d_features);
        value
    }

    /// Adds the gradient of `λ_t L_t` to the temporal grids, returns the value. `t`: normalised to the cube.
    pub(super) fn time(
        &mut self,
        grids: &mut Grids,
        config: &SmoothConfig,
        means: &[Vec3],
        t: f32,
        seed: StepSeed,
    ) -> f64 {
        if config.lambda_t == 0.0 {
            return 0.0;
        }
        self.sample(grids, config, means, ("field.smooth.time", seed), t);
        let times = if config.eps_t == 0.0 { Times::Common(t) } else { Times::Each(&self.times) };
        grids.time(&self.points, times, &mut self.timed, &mut self.features);
        let value = self.compare(grids.widths()[1], config.lambda_t);
        grids.time_backward(&mut self.timed, &self.d_features);
        value
    }

    /// Samples the pairs of a step.
    fn sample(&mut self, grids: &Grids, config: &SmoothConfig, means: &[Vec3], (name, key): (&str, StepSeed), t: f32) {
        let n = means.len();
        let count = ((f64::from(config.share) * n as f64).round() as usize).clamp(n.min(1), n);
        let unit = 1.0 / grids.side();
        let pair = |j: usize| {
            let mut rng = Rng::new(key.seed, name, key.step, j as u64);
            let rows = stratum(j, count, n);
            let row = rows.start + rng.below(rows.len() as u32) as usize;
            let first = grids.normalise(means[row]);
            let second = std::array::from_fn(|d| first[d] + unit * rng.range(-config.eps[d], config.eps[d]));
            let shift = unit * rng.range(-config.eps_t, config.eps_t);
            let within = inside(&first) && inside(&second) && (0.0..=1.0).contains(&(t + shift));
            (within || !config.drop_leaving).then_some(([first, second], shift))
        };
        (0..count).into_par_iter().map(pair).collect_into_vec(&mut self.pairs);
        self.points.clear();
        self.times.clear();
        for second in [false, true] {
            for (pair, shift) in self.pairs.iter().flatten() {
                self.points.push(pair[usize::from(second)]);
                self.times.push(if second { t + shift } else { t });
            }
        }
    }

    /// `λ/n Σ |second − first|²` of the features, and its gradient.
    fn compare(&mut self, width: usize, weight: f32) -> f64 {
        let Self { points, features, d_features, sums, .. } = self;
        let pairs = points.len() / 2;
        if pairs == 0 {
            d_features.clear();
            return 0.0;
        }
        d_features.resize(features.len(), 0.0);
        let scale = 2.0 * weight / pairs as f32;
        let (first, second) = features.split_at(pairs * width);
        let (d_first, d_second) = d_features.split_at_mut(pairs * width);
        let piece = BLOCK * width;
        let values = first.par_chunks(piece).zip(second.par_chunks(piece));
        let cotangents = d_first.par_chunks_mut(piece).zip(d_second.par_chunks_mut(piece));
        values
            .zip(cotangents)
            .map(|((first, second), (d_first, d_second))| difference(first, second, d_first, d_second, scale))
            .collect_into_vec(sums);
        f64::from(weight) * sums.iter().sum::<f64>() / pairs as f64
    }
}

/// `Σ (second − first)²`; sets the cotangents to `±scale (second − first)`.
fn difference(first: &[f32], second: &[f32], d_first: &mut [f32], d_second: &mut [f32], scale: f32) -> f64 {
    let mut sum = 0.0;
    for ((a, b), (d_a, d_b)) in first.iter().zip(second).zip(d_first.iter_mut().zip(d_second)) {
        let difference = b - a;
        sum += f64::from(difference) * f64::from(difference);
        (*d_a, *d_b) = (-scale * difference, scale * difference);
    }
    sum
}

/// Range `j` of `count` equal ranges of `0..n`.
fn stratum(j: usize, count: usize, n: usize) -> std::ops::Range<usize> {
    j * n / count..(j + 1) * n / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::HashGridConfig;
    use crate::field::grid4d::Grid4dConfig;
    use crate::reference::HashGridRef;
    use gs_core::Params;

    const SEED: StepSeed = StepSeed { seed: 3, step: 7 };

    fn means(n: usize) -> Vec<Vec3> {
        let mut rng = Rng::new(1, "means", 0, 0);
        (0..n).map(|_| Vec3::new(rng.range(-1.1, 1.1), rng.range(-1.1, 1.1), rng.range(-1.1, 1.1))).collect()
    }

    fn grids(smooth: SmoothConfig, time_slicing: bool) -> (Grids, SmoothConfig) {
        let mut config = Grid4dConfig {
            bound: 1.0,
            canonical: HashGridConfig { base: [3.0; 3], end: [5.0, 6.0, 7.0], levels: 2, log2_table: 6 },
            temporal: HashGridConfig { base: [2.0; 3], end: [4.0; 3], levels: 2, log2_table: 10 },
            smooth,
            ..Grid4dConfig::default()
        };
        config.exact.time_slicing = time_slicing;
        let mut grids = Grids::new(&config, 1).unwrap();
        grids.visit_mut(&mut |p| {
            let mut rng = Rng::new(2, &p.name, 0, 0);
            p.value.iter_mut().for_each(|v| *v = rng.normal());
        });
        (grids, config.smooth)
    }

    fn wide(drop_leaving: bool, eps_t: f32) -> SmoothConfig {
        SmoothConfig { lambda_s: 0.7, lambda_t: 0.3, eps: [0.3, 0.2, 0.4], eps_t, share: 0.6, drop_leaving }
    }

    #[test]
    fn strata_cover_every_row_once() {
        for (count, n) in [(1, 1), (1, 7), (3, 7), (7, 7), (100, 999)] {
            let all: Vec<usize> = (0..count).flat_map(|j| stratum(j, count, n)).collect();
            assert_eq!(all, (0..n).collect::<Vec<_>>());
            assert!((0..count).all(|j| !stratum(j, count, n).is_empty()));
        }
    }

    #[test]
    fn values_agree_with_the_f64_grids() {
        let (mut grids, config) = grids(wide(false, 0.1), false);
        let (mut smooth, means) = (Smooth::default(), means(40));
        let space = smooth.space(&mut grids, &config, &means, SEED);
        let references = grids.all().map(HashGridRef::new);
        let distance = |reference: &HashGridRef, a: [f32; 3], b: [f32; 3]| -> f64 {
            let (a, b) = (reference.features(a.map(f64::from)), reference.features(b.map(f64::from)));
            a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
        };
        let n = smooth.points.len() / 2;
        assert_eq!(n, 24, "pairs that leave the cube were to be kept");
        let want: f64 = (0..n).map(|i| distance(&references[0], smooth.points[i], smooth.points[n + i])).sum();
        assert!((space - 0.7 * want / n as f64).abs() < 1e-5 * space, "{space} {want}");

        let time = smooth.time(&mut grids, &config, &means, 0.4, SEED);
        let point = |i: usize, (a, b): (usize, usize)| [smooth.points[i][a], smooth.points[i][b], smooth.times[i]];
        let pairs = [(0, 1), (1, 2), (0, 2)].into_iter().zip(&references[1..]);
        let want: f64 = pairs
            .map(|(axes, reference)| {
                (0..n).map(|i| distance(reference, point(i, axes), point(n + i, axes))).sum::<f64>()
            })
            .sum();
        assert!((time - 0.3 * want / n as f64).abs() < 1e-5 * time, "{time} {want}");
    }

    #[test]
    fn pairs_that_leave_the_cube_are_dropped_and_steps_differ() {
        let (mut grids, config) = grids(wide(true, 0.0), true);
        let (mut smooth, means) = (Smooth::default(), means(200));
        let first = smooth.space(&mut grids, &config, &means, SEED);
        assert!(smooth.points.iter().all(inside) && smooth.points.len() < 240);
        assert_eq!(first, smooth.space(&mut grids, &config, &means, SEED));
        assert_ne!(first, smooth.space(&mut grids, &config, &means, StepSeed { step: 8, ..SEED }));
        for none in [&means[..0], &[Vec3::splat(9.0)]] {
            assert_eq!(smooth.space(&mut grids, &config, none, SEED), 0.0);
            assert_eq!(smooth.time(&mut grids, &config, none, 0.4, SEED), 0.0);
        }
    }

    /// Both terms are squares of sums of table values, so a central difference with a large step is exact up to the
    /// rounding of the features (tolerance: 2e-5 of the largest gradient).
    #[test]
    fn gradients_match_finite_differences() {
        for (config, slicing) in [(wide(true, 0.1), true), (wide(false, 0.0), true), (wide(true, 0.0), false)] {
            let (mut grids, config) = grids(config, slicing);
            let (mut smooth, means) = (Smooth::default(), means(40));
            let mut value = |grids: &mut Grids| {
                smooth.space(grids, &config, &means, SEED) + smooth.time(grids, &config, &means, 0.4, SEED)
            };
            value(&mut grids);
            let mut names = Vec::new();
            grids.visit(&mut |p| names.push((p.name.clone(), p.grad.clone())));
            for (name, grad) in names {
                let largest = grad.iter().fold(0.0f32, |m, g| m.max(g.abs()));
                assert!(largest > 0.0, "{name} has no gradient");
                for i in (0..grad.len()).step_by(7) {
                    let mut at = |step: f32| {
                        let mut moved = grids.clone();
                        moved.visit_mut(&mut |p| {
                            if p.name == name {
                                p.value[i] += step
                            }
                        });
                        value(&mut moved)
                    };
                    let want = (at(0.5) - at(-0.5)) as f32;
                    assert!((grad[i] - want).abs() <= 2e-5 * largest, "{name}[{i}]: {} {want}", grad[i]);
                }
            }
        }
    }
}
