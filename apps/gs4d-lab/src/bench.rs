//! A short set of measurements across the crates, each with its error: what `gs4d bench` prints.
//!
//! Every row has a median time and an error against the f64 reference or a closed form; some have PyTorch's time for the same
//! operation ([`PYTORCH`]). The crates' own benches are more thorough; these run in seconds and need nothing but the program.
//! Longer ones are [`growth()`], [`frames()`] and [`approximations()`].

mod approximations;
mod dense;
mod field;
mod growth;
mod image;
mod networks;
mod optimiser;
mod physics;
mod raster;
mod stages;

pub use approximations::approximations;
pub use growth::{frames, growth};
pub use raster::{Memory, memory};
pub use stages::{STAGES, Stage, StageOptions, StageTimes, stage_times};

use crate::people::LabError;
use gs_core::Params;
use gs_core::nn::gemm::roof;
use gs_core::speed::{BenchRow, Stopwatch, median_seconds};
use gs_raster::SimdLevel;
use gs_raster::measure::Roofline;
use gs_train::adam::{Adam, Refused};
use gs_train::registry::{MethodEntry, overlay};
use serde::Serialize;

/// Where PyTorch's times are from.
pub const PYTORCH: &str = "PyTorch's times are of November 2026, on two threads of two cores of a Sapphire-Rapids-class Xeon \
with AVX-512 that ran other jobs, too: version 2.15 (MKL, oneDNN), the U-Net the least of 94 to 203 ms; 10 000 splats by gsplat's \
torch code, in a scene of the same statistics. They compare with the times above on such a machine only";

/// Timed rounds of the longer measurements.
const ROUNDS: usize = 9;

/// Kind of error of layers and networks.
const OUTPUT_ERROR: &str = "relative L2 of outputs, f64";

/// A group of measurements: the crate they concern and the function that makes them.
pub struct Group {
    /// Name of the crate, for example `gs-raster`.
    pub name: &'static str,
    /// Runs the measurements in the current rayon pool; one row per case and variant.
    pub measure: fn() -> Vec<Measured>,
}

/// A row of the bench and what it is held against.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Time and error.
    pub row: BenchRow,
    /// Whether the row's `work` counts floating-point operations, two per multiply-add.
    pub flops: bool,
    /// Milliseconds of PyTorch for the same operation ([`PYTORCH`]).
    pub pytorch: Option<f64>,
}

impl From<BenchRow> for Measured {
    fn from(row: BenchRow) -> Self {
        Self { row, flops: false, pytorch: None }
    }
}

impl Measured {
    fn flops(row: BenchRow, pytorch: Option<f64>) -> Self {
        Self { row, flops: true, pytorch }
    }

    /// GFLOP/s, where operations are counted.
    pub fn gflops(&self) -> Option<f64> {
        self.flops.then(|| self.row.rate())
    }
}

/// Rows that nothing is held against.
fn alone(rows: Vec<BenchRow>) -> Vec<Measured> {
    rows.into_iter().map(Measured::from).collect()
}

/// All groups, in the order `gs4d bench` prints them.
pub const GROUPS: &[Group] = &[
    Group { name: "gs-core", measure: dense::rows },
    Group { name: "gs-raster", measure: raster::rows },
    Group { name: "gs-metrics", measure: || alone(image::rows()) },
    Group { name: "gs-deform", measure: field::rows },
    Group { name: "gs-texel", measure: networks::rows },
    Group { name: "gs-physics", measure: || alone(physics::rows()) },
    Group { name: "gs-train", measure: || alone(optimiser::rows()) },
];

/// Peak rates of this machine with the threads of a rayon pool.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Roofs {
    /// Fused multiply-adds, GFLOP/s.
    pub fma_gflops: f64,
    /// Matrix products of 1024³, GFLOP/s.
    pub gemm_gflops: f64,
    /// Exponentials, 10⁹/s.
    pub exp2_giga_per_second: f64,
    /// Number of threads.
    pub threads: usize,
}

impl Roofs {
    /// Measures them in the current rayon pool; takes less than a second.
    pub fn measure() -> Self {
        let Roofline { threads, fma, exp2 } = Roofline::measure(SimdLevel::Auto);
        Self { fma_gflops: fma, gemm_gflops: roof().rate(), exp2_giga_per_second: exp2, threads }
    }
}

/// Updates all parameters with Adam and clears their gradients.
fn train(net: &mut impl Params, adam: &mut Adam) {
    net.visit_mut(&mut |p| adam.update(p, optimiser::UPDATE, &mut Refused::default()));
}

/// Labels of a [`BenchRow`].
struct Case {
    krate: &'static str,
    case: String,
    variant: &'static str,
    error_kind: &'static str,
}

impl Case {
    /// Times `call` (median of `runs` calls). `n` is the size, `work` the units of work per call.
    fn row(self, n: usize, work: f64, error: f64, runs: usize, call: impl FnMut()) -> BenchRow {
        BenchRow {
            krate: self.krate,
            case: self.case,
            variant: self.variant.to_owned(),
            n,
            threads: rayon::current_num_threads(),
            ms: 1e3 * median_seconds(runs, call),
            work,
            error: Some(error),
            error_kind: self.error_kind,
        }
    }
}

/// Median milliseconds of `N` calls that take turns in [`ROUNDS`] rounds, after one round that does not count: what slows the machine for
/// a while slows all of them. `call` gets the number of a call and the stopwatch that it is to be timed with.
fn in_turns<const N: usize>(mut call: impl FnMut(usize, &mut Stopwatch)) -> [f64; N] {
    let mut watches: [Stopwatch; N] = std::array::from_fn(|_| Stopwatch::default());
    (0..N).for_each(|k| call(k, &mut Stopwatch::default()));
    for _ in 0..ROUNDS {
        watches.iter_mut().enumerate().for_each(|(k, watch)| call(k, watch));
    }
    watches.map(|watch| watch.median_ms().unwrap_or(f64::NAN))
}

/// Largest, mean and mean squared difference of the colours of two pictures of one size.
fn differences(a: &[f32], b: &[f32]) -> [f64; 3] {
    let off = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs());
    let (largest, sum, squares) =
        off.fold((0.0f64, 0.0, 0.0), |(largest, sum, squares), d| (largest.max(d), sum + d, squares + d * d));
    let n = a.len().max(1) as f64;
    [largest, sum / n, squares / n]
}

/// A preset of a method with TOML laid over it.
fn settings(entry: &MethodEntry, preset: &str, over: &str) -> Result<toml::Table, LabError> {
    let mut config = entry.config(preset)?;
    overlay(&mut config, over.parse().map_err(|e: toml::de::Error| LabError::Unfit(e.to_string()))?);
    Ok(config)
}

/// `|a − b|₂ / |b|₂`; 0 where both are zero.
fn relative_l2(got: impl Iterator<Item = f64>, want: impl Iterator<Item = f64>) -> f64 {
    let (mut difference, mut norm) = (0.0f64, 0.0f64);
    for (a, b) in got.zip(want) {
        difference += (a - b).powi(2);
        norm += b * b;
    }
    if difference == 0.0 { 0.0 } else { (difference / norm).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn relative_differences() {
        let l2 = |a: &[f64], b: &[f64]| relative_l2(a.iter().copied(), b.iter().copied());
        assert_eq!(l2(&[3.0, 4.0], &[3.0, 4.0]), 0.0);
        assert!((l2(&[3.0, 5.0], &[3.0, 4.0]) - 0.2).abs() < 1e-15);
        assert_eq!(l2(&[0.0], &[0.0]), 0.0);
    }

    #[test]
    fn calls_take_turns_and_the_first_round_does_not_count() {
        let (mut order, mut spent) = (Vec::new(), [Vec::new(), Vec::new()]);
        let ms: [f64; 2] = in_turns(|k, watch| {
            order.push(k);
            // Long in five rounds of ten: with the first one the median would be a long one.
            let rest = Duration::from_millis(if order.len() <= 10 { 2 } else { 0 });
            spent[k].push(1e3 * watch.run(1, || std::thread::sleep(rest)).as_secs_f64());
        });
        assert_eq!(order, [0, 1].repeat(1 + ROUNDS));
        for (ms, spent) in ms.iter().zip(&mut spent) {
            spent[1..].sort_by(f64::total_cmp);
            assert_eq!(*ms, spent[1 + ROUNDS / 2]);
        }
    }

    #[test]
    fn cheap_groups_measure_and_are_accurate() {
        for rows in [image::rows(), optimiser::rows()] {
            for r in rows {
                assert!(r.ms > 0.0 && r.error.is_some_and(|e| e < 1e-4), "{r:?}");
            }
        }
    }
}
