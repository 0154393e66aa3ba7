//! A short set of measurements across the crates, each with its error: what `gs4d bench` prints.
//!
//! Every row has a median time and an error against the f64 reference or a closed form. The crates' own criterion benches
//! are more thorough; these run in seconds and need nothing but the program.

mod field;
mod image;
mod optimiser;
mod physics;
mod raster;
mod stages;
mod variants;

pub use raster::{Memory, memory};
pub use stages::{STAGES, Stage, StageOptions, StageTimes, stage_times};

use gs_core::speed::{BenchRow, median_seconds};
use gs_raster::SimdLevel;
use gs_raster::measure::Roofline;

/// A group of measurements: the crate they concern and the function that makes them.
pub struct Group {
    /// Name of the crate, for example `gs-raster`.
    pub name: &'static str,
    /// Runs the measurements in the current rayon pool; one row per case and variant.
    pub measure: fn() -> Vec<BenchRow>,
}

/// All groups, in the order `gs4d bench` prints them.
pub const GROUPS: &[Group] = &[
    Group { name: "gs-raster", measure: raster::rows },
    Group { name: "gs-metrics", measure: image::rows },
    Group { name: "gs-deform", measure: field::rows },
    Group { name: "gs-physics", measure: physics::rows },
    Group { name: "gs-train", measure: optimiser::rows },
];

/// Measured peak rates of the current rayon pool: `(GFLOP/s of fused multiply-adds, 10⁹ exponentials/s)`.
pub fn roofline() -> (f64, f64) {
    let peak = Roofline::measure(SimdLevel::Auto);
    (peak.fma, peak.exp2)
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

    #[test]
    fn relative_differences() {
        let l2 = |a: &[f64], b: &[f64]| relative_l2(a.iter().copied(), b.iter().copied());
        assert_eq!(l2(&[3.0, 4.0], &[3.0, 4.0]), 0.0);
        assert!((l2(&[3.0, 5.0], &[3.0, 4.0]) - 0.2).abs() < 1e-15);
        assert_eq!(l2(&[0.0], &[0.0]), 0.0);
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
