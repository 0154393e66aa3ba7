//! Trajectories of points: their energy at high temporal frequencies, and their second differences.
//!
//! The path `x_k`, `k = 0 … T − 1`, of a point at evenly spaced timestamps, less its mean `x̃_k`, has the spectrum
//! ```text
//! X_f = Σ_k x̃_k e^{−2πi f k / T}        E = Σ_{f ≥ f_c} |X_f|²,   f = 0 … ⌊T/2⌋,   f_c = ⌈T/4⌉ by default
//! ```
//! summed over the three coordinates (FAGS, temporal power spectrum; the cut-off is ours, the upper half of the spectrum).
//! A path that does not close leaks `1/f²` into every bin, so even a slow drift has energy there. [`Window::Hann`] first
//! subtracts the least-squares line, then multiplies by `w_k = ½ − ½ cos(2πk/T)`, divided by `√mean w²` so that the energy of
//! white noise is kept.
//!
//! Jerkiness: `A(k) = |x_{k+1} − 2 x_k + x_{k−1}|²` per point and inner timestamp.
//!
//! Everything is computed in `f64`, path by path.
//!
//! ```
//! use gs_metrics::trajectory::{Window, default_cutoff, high_energies, second_differences};
//! // One point on a parabola: its second difference is 2 · 0.25 everywhere.
//! let path: Vec<Vec<[f32; 3]>> = (0..8).map(|k| vec![[0.25 * (k * k) as f32, 0.0, 0.0]]).collect();
//! assert!(second_differences(&path)?.iter().all(|points| points == &[0.25]));
//! // A point that alternates between ±1 has all its energy at the highest frequency: 8².
//! let shake: Vec<Vec<[f32; 3]>> = (0..8).map(|k| vec![[(1 - 2 * (k % 2)) as f32, 0.0, 0.0]]).collect();
//! assert!((high_energies(&shake, default_cutoff(8), Window::Raw)?[0] - 64.0).abs() < 1e-9);
//! # Ok::<(), gs_metrics::trajectory::TrajectoryError>(())
//! ```

use gs_core::cast;
use gs_fft::RealToComplex;
use gs_fft::num_complex::Complex64;
use rayon::prelude::*;

/// Added to energies before logarithms are taken, squared units of length.
pub const ENERGY_FLOOR: f64 = 1e-12;
/// Paths of one parallel task.
const BLOCK: usize = 256;

/// Preparation of a path before its transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Window {
    /// Only the mean is subtracted, coordinate by coordinate.
    Raw,
    /// The least-squares line is subtracted, and the path is multiplied by a Hann window.
    Hann,
}

/// Why trajectories cannot be analysed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TrajectoryError {
    /// There are too few timestamps.
    #[error("{got} timestamps are too few, {need} are needed; sample the motion more often")]
    TooFew {
        /// Fewest timestamps the function accepts.
        need: usize,
        /// Number of timestamps of the paths.
        got: usize,
    },
    /// The number of points changes between timestamps.
    #[error("timestamp {index} has {got} points, the first has {want}; paths need the same points at every timestamp")]
    Uneven {
        /// Index of the first such timestamp, from 0.
        index: usize,
        /// Number of points at that timestamp.
        got: usize,
        /// Number of points at the first timestamp.
        want: usize,
    },
    /// The cut-off lies outside the spectrum.
    #[error("cut-off {cutoff} is out of range: {timestamps} timestamps have frequencies 1 to {highest}")]
    Cutoff {
        /// The cut-off given, in periods over the whole path.
        cutoff: usize,
        /// Number of timestamps of the paths.
        timestamps: usize,
        /// The highest frequency there is, `⌊T/2⌋`.
        highest: usize,
    },
}

/// The default cut-off `f_c = ⌈T/4⌉` for `T` timestamps, in periods over the whole path.
pub fn default_cutoff(timestamps: usize) -> usize {
    timestamps.div_ceil(4)
}

/// The energy `E` of every path, `[points]`. `frames[k][i]` is point `i` at timestamp `k`, in any unit of length; energies are in
/// its square.
///
/// # Errors
/// Fewer than 4 timestamps, a changing number of points, a cut-off outside `1 … ⌊T/2⌋`.
pub fn high_energies(frames: &[Vec<[f32; 3]>], cutoff: usize, window: Window) -> Result<Vec<f64>, TrajectoryError> {
    let points = check(frames, 4)?;
    let (timestamps, highest) = (frames.len(), frames.len() / 2);
    if !(1..=highest).contains(&cutoff) {
        return Err(TrajectoryError::Cutoff { cutoff, timestamps, highest });
    }
    let fft = gs_fft::real_forward_f64(timestamps);
    let mut out = vec![0.0; points];
    out.par_chunks_mut(BLOCK).enumerate().for_each_init(
        || Transform::new(&*fft),
        |transform, (block, out)| {
            for (k, energy) in out.iter_mut().enumerate() {
                let path = |axis: usize| frames.iter().map(move |f| f64::from(f[block * BLOCK + k][axis]));
                *energy = (0..3).map(|axis| transform.energy(&*fft, path(axis), cutoff, window)).sum();
            }
        },
    );
    Ok(out)
}

/// Buffers for the transform of one coordinate of a path.
struct Transform {
    path: Vec<f64>,
    spectrum: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

impl Transform {
    fn new(fft: &dyn RealToComplex<f64>) -> Self {
        Self { path: fft.make_input_vec(), spectrum: fft.make_output_vec(), scratch: fft.make_scratch_vec() }
    }

    fn energy(
        &mut self,
        fft: &dyn RealToComplex<f64>,
        path: impl Iterator<Item = f64>,
        cutoff: usize,
        window: Window,
    ) -> f64 {
        self.path.iter_mut().zip(path).for_each(|(p, v)| *p = v);
        match window {
            Window::Raw => remove_line(&mut self.path, false),
            Window::Hann => {
                remove_line(&mut self.path, true);
                let n = self.path.len() as f64;
                // The mean of w² is 3/8 for three samples and more.
                let weight = |k: usize| (0.5 - 0.5 * (std::f64::consts::TAU * k as f64 / n).cos()) / 0.375f64.sqrt();
                self.path.iter_mut().enumerate().for_each(|(k, v)| *v *= weight(k));
            }
        }
        fft.process_with_scratch(&mut self.path, &mut self.spectrum, &mut self.scratch).expect("lengths of the plan");
        self.spectrum[cutoff..].iter().map(Complex64::norm_sqr).sum()
    }
}

/// Subtracts the mean, and with `slope` the least-squares line.
fn remove_line(path: &mut [f64], slope: bool) {
    let n = path.len() as f64;
    let mean = path.iter().sum::<f64>() / n;
    let centred = |k: usize| k as f64 - 0.5 * (n - 1.0);
    let covariance: f64 = path.iter().enumerate().map(|(k, v)| centred(k) * (v - mean)).sum();
    // Σ (k − k̄)² = n (n² − 1) / 12.
    let gradient = if slope { covariance * 12.0 / (n * (n * n - 1.0)) } else { 0.0 };
    path.iter_mut().enumerate().for_each(|(k, v)| *v -= mean + gradient * centred(k));
}

/// `A(k)` of every point at the inner timestamps, `[T − 2][points]`, in squared units of length.
///
/// # Errors
/// Fewer than 3 timestamps, or a changing number of points.
pub fn second_differences(frames: &[Vec<[f32; 3]>]) -> Result<Vec<Vec<f64>>, TrajectoryError> {
    check(frames, 3)?;
    let squared = |i: usize, w: &[Vec<[f32; 3]>]| {
        let along = |axis: usize| {
            let [a, b, c] = [0, 1, 2].map(|k| f64::from(w[k][i][axis]));
            (c - 2.0 * b + a).powi(2)
        };
        (0..3).map(along).sum()
    };
    Ok(frames.windows(3).map(|w| (0..w[0].len()).map(|i| squared(i, w)).collect()).collect())
}

fn check(frames: &[Vec<[f32; 3]>], need: usize) -> Result<usize, TrajectoryError> {
    if frames.len() < need {
        return Err(TrajectoryError::TooFew { need, got: frames.len() });
    }
    let want = frames[0].len();
    match frames.iter().position(|f| f.len() != want) {
        Some(index) => Err(TrajectoryError::Uneven { index, got: frames[index].len(), want }),
        None => Ok(want),
    }
}

/// Statistics of the distribution of values `≥ 0`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Arithmetic mean of the finite values.
    pub mean: f64,
    /// Median: the value of nearest rank, not interpolated.
    pub p50: f64,
    /// 90th percentile, the value of nearest rank.
    pub p90: f64,
    /// 99th percentile, the value of nearest rank.
    pub p99: f64,
    /// Gini coefficient in `[0, 1)`: 0 if all values are equal, near 1 if few values hold the sum.
    pub gini: f64,
}

impl Spread {
    /// Statistics of the finite values; all 0 if there is none.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let sum: f64 = sorted.iter().sum();
        if sorted.is_empty() {
            return Self::default();
        }
        let rank = |share: f64| sorted[cast::to_usize((share * n).ceil()).max(1) - 1];
        let weighted: f64 = sorted.iter().enumerate().map(|(k, v)| (2.0 * k as f64 + 1.0 - n) * v).sum();
        let gini = if sum > 0.0 { weighted / (n * sum) } else { 0.0 };
        Self { mean: sum / n, p50: rank(0.5), p90: rank(0.9), p99: rank(0.99), gini }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    /// One path with the points `(f(k), 0, 0)`.
    fn along_x(timestamps: usize, f: impl Fn(f64) -> f64) -> Vec<Vec<[f32; 3]>> {
        (0..timestamps).map(|k| vec![[f(k as f64) as f32, 0.0, 0.0]]).collect()
    }

    fn energy(frames: &[Vec<[f32; 3]>], cutoff: usize, window: Window) -> f64 {
        high_energies(frames, cutoff, window).unwrap()[0]
    }

    #[test]
    fn a_wave_has_its_energy_at_its_frequency() {
        for (timestamps, m) in [(32, 9), (31, 9), (50, 13)] {
            let frames = along_x(timestamps, |k| 2.0 + 0.5 * (TAU * m as f64 * k / timestamps as f64).cos());
            let want = (0.5 * timestamps as f64 / 2.0).powi(2);
            assert!((energy(&frames, m, Window::Raw) / want - 1.0).abs() < 1e-5);
            assert!((energy(&frames, default_cutoff(timestamps), Window::Raw) / want - 1.0).abs() < 1e-5);
            assert!(energy(&frames, m + 1, Window::Raw) < 1e-8 * want);
            // The window distributes it over three bins: 1 + ¼ + ¼ of w̄² = ¼, over 3/8; the line removes a little of it.
            assert!((energy(&frames, m - 2, Window::Hann) / want - 1.0).abs() < 0.02);
        }
    }

    /// `|X_f| = s T / (2 sin(π f / T))` for `x_k = s k`.
    #[test]
    fn a_drift_leaks_without_a_window_and_not_with_it() {
        let (timestamps, s) = (40, 0.125);
        let frames = along_x(timestamps, |k| s * k);
        let bin = |f: usize| (s * timestamps as f64 / (2.0 * (PI * f as f64 / timestamps as f64).sin())).powi(2);
        let want: f64 = (10..=20).map(bin).sum();
        assert!((energy(&frames, 10, Window::Raw) / want - 1.0).abs() < 1e-9);
        assert!(energy(&frames, 10, Window::Hann) < 1e-20);
    }

    #[test]
    fn coordinates_add_up_and_points_keep_their_places() {
        let wave = |k: usize| (TAU * 3.0 * k as f64 / 8.0).sin() as f32;
        let frames: Vec<_> =
            (0..8).map(|k| (0..600).map(|i| [wave(k), i as f32, wave(k) * (i % 7) as f32]).collect()).collect();
        let energies = high_energies(&frames, 3, Window::Raw).unwrap();
        for (i, e) in energies.iter().enumerate() {
            let want = 16.0 * (1.0 + ((i % 7) as f64).powi(2));
            assert!((e / want - 1.0).abs() < 1e-6, "{i}: {e} {want}");
        }
    }

    #[test]
    fn second_differences_of_a_parabola_are_even() {
        let frames = along_x(9, |k| 3.0 + 0.5 * k + 0.25 * k * k);
        let all = second_differences(&frames).unwrap();
        assert_eq!(all.len(), 7);
        assert!(all.iter().all(|a| a == &[0.25]), "(2 · 0.25)²");
        let s = Spread::of(all.into_iter().flatten());
        assert_eq!(s, Spread { mean: 0.25, p50: 0.25, p90: 0.25, p99: 0.25, gini: 0.0 });
    }

    #[test]
    fn statistics_agree_with_their_definitions() {
        let one_of = |n: usize| Spread::of((0..n).map(|k| if k == 3 { 1.0 } else { 0.0 })).gini;
        assert!((one_of(100) - 0.99).abs() < 1e-12);
        let s = Spread::of((1..=100).map(f64::from).chain([f64::NAN]));
        assert_eq!((s.mean, s.p50, s.p90, s.p99), (50.5, 50.0, 90.0, 99.0));
        assert!((s.gini - 0.33).abs() < 1e-12, "(n − 1) / 3n for 1 … n");
        assert_eq!(Spread::of([]), Spread::default());
        assert_eq!(Spread::of([0.0, 0.0]).gini, 0.0);
    }

    #[test]
    fn bad_paths_are_errors_that_name_the_fault() {
        let frames = along_x(8, |k| k);
        let got = |cutoff| high_energies(&frames, cutoff, Window::Raw).unwrap_err().to_string();
        assert!(got(0).contains("cut-off 0") && got(5).contains("1 to 4"), "{}", got(5));
        assert!(matches!(second_differences(&frames[..2]), Err(TrajectoryError::TooFew { need: 3, got: 2 })));
        let mut uneven = frames.clone();
        uneven[5].push([0.0; 3]);
        let e = high_energies(&uneven, 2, Window::Raw).unwrap_err();
        assert_eq!(e, TrajectoryError::Uneven { index: 5, got: 2, want: 1 });
    }
}
