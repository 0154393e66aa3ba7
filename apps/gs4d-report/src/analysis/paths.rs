//! Motion of the splats' means: temporal spectra and second differences (see [`gs_metrics::trajectory`]).

use super::AnalysisError;
use super::histogram::Histogram;
use crate::ReportRow;
use crate::needs::neutral_camera;
use gs_core::{Camera, Color, Splats};
use gs_metrics::trajectory::{ENERGY_FLOOR, Spread, Window, default_cutoff, high_energies, second_differences};
use gs_train::capabilities::Overlay;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use serde::Serialize;

/// Fewest and most times at which paths are sampled.
const SAMPLE_TIMES: [usize; 2] = [8, 200];
/// Second differences up to this are rest, squared world units.
const MIN_SECOND_DIFFERENCE: f64 = 1e-12;

/// Statistics of the paths of all splats.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Paths {
    /// Number of sampled times, evenly over the training span.
    pub moments: usize,
    /// First frequency that counts as high, cycles over the training span.
    pub cutoff: usize,
    /// High-frequency energy of the paths.
    pub raw: Energy,
    /// The same with straight lines removed and a Hann window.
    pub hann: Energy,
    /// Squared second differences between neighbouring times, world units squared.
    pub jerk: Jerk,
}

/// Distribution over splats of the energy `E` of their paths at high frequencies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Energy {
    /// Mean over splats of `log10(E + 1e-12)`.
    pub mean_log10: f64,
    /// Mean over splats of `ln(E + 1e-12)`.
    pub mean_ln: f64,
    /// Histogram of `log10(E + 1e-12)` over −12..4.
    pub histogram: Histogram,
}

impl Energy {
    fn of(name: &str, energies: &[f64]) -> Self {
        let logs: Vec<f32> = energies.iter().map(|e| (e + ENERGY_FLOOR).log10() as f32).collect();
        let mean = |log: fn(f64) -> f64| {
            energies.iter().map(|e| log(e + ENERGY_FLOOR)).sum::<f64>() / energies.len().max(1) as f64
        };
        let histogram = Histogram::of(name, None, [-12.0, 4.0], &logs);
        Self { mean_log10: mean(f64::log10), mean_ln: mean(f64::ln), histogram }
    }
}

/// Distribution of squared second differences over splats and times, world units squared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Jerk {
    /// Mean over all splats and times.
    pub mean: f64,
    /// Median, nearest rank.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Gini coefficient: towards 1 if few splats at few times have all of it.
    pub gini: f64,
}

/// The number of times to sample for a scene with this many training times: clamped to 8..200.
pub fn sample_count(training_times: usize) -> usize {
    training_times.clamp(SAMPLE_TIMES[0], SAMPLE_TIMES[1])
}

impl Paths {
    /// Samples the means of a model at `moments` evenly spaced times; `cutoff` is the first high frequency, `⌈moments/4⌉` by
    /// default.
    ///
    /// # Errors
    /// If the number of splats changes over time, there are fewer than 4 times, or the cutoff is out of range.
    pub fn of(method: &Model, moments: usize, cutoff: Option<usize>) -> Result<Self, AnalysisError> {
        let frames = centres(method, &neutral_camera(), moments)?;
        let cutoff = cutoff.unwrap_or(default_cutoff(moments));
        let energy = |name, window| high_energies(&frames, cutoff, window).map(|e| Energy::of(name, &e));
        let raw = energy("log10 energy", Window::Raw)?;
        let hann = energy("log10 energy, windowed", Window::Hann)?;
        let s = Spread::of(second_differences(&frames)?.into_iter().flatten());
        let jerk = Jerk { mean: s.mean, p50: s.p50, p90: s.p90, p99: s.p99, gini: s.gini };
        Ok(Self { moments, cutoff, raw, hann, jerk })
    }

    /// Rows for the report.
    pub fn rows(&self) -> Vec<ReportRow> {
        let meaning = format!(
            "mean log10 (ln) of path energy at {} or more cycles over {} moments; 1e-12 is rest",
            self.cutoff, self.moments
        );
        let energy = |e: &Energy| format!("{:.2} ({:.2})", e.mean_log10, e.mean_ln);
        let j = self.jerk;
        let spread = format!("{:.2e} / {:.2e} / {:.2e} / {:.2e}", j.mean, j.p50, j.p90, j.p99);
        vec![
            ReportRow::new("fast motion", energy(&self.raw), &meaning),
            ReportRow::new(
                "fast motion, windowed",
                energy(&self.hann),
                "without straight lines, Hann window: no leaking drift",
            ),
            ReportRow::new("second differences", spread, "squared, world units squared: mean, median, 90 %, 99 %"),
            ReportRow::new(
                "their contrast",
                format!("{:.3}", j.gini),
                "Gini coefficient: towards 1 if few splats do all of it",
            ),
        ]
    }
}

/// Means of all splats at evenly spaced times.
fn centres(method: &Model, camera: &Camera, moments: usize) -> Result<Vec<Vec<[f32; 3]>>, MethodError> {
    let time = |k: usize| k as f32 / (moments.max(2) - 1) as f32;
    (0..moments).map(|k| means_at(method, time(k), camera)).collect()
}

fn means_at(method: &Model, time: f32, camera: &Camera) -> Result<Vec<[f32; 3]>, MethodError> {
    let splats = method.all_splats(&Timestamp::normalised(time), camera)?;
    Ok(splats.means.iter().map(|m| m.to_array()).collect())
}

/// Colours by the second difference `A` of each mean between `time − interval`, `time` and `time + interval`: black at rest,
/// through red and yellow to white at the largest, by `log(1 + A / A_ref)`, `A_ref` the median of those not at rest.
///
/// # Errors
/// If the number of splats differs between the three times.
pub fn second_difference_overlay(
    method: &Model,
    time: f32,
    interval: f32,
    camera: &Camera,
) -> Result<Overlay, AnalysisError> {
    let at = |t: f32| means_at(method, t, camera);
    let frames = [at(time - interval)?, at(time)?, at(time + interval)?];
    let values = second_differences(&frames)?.swap_remove(0);
    let reference =
        Spread::of(values.iter().copied().filter(|a| *a > MIN_SECOND_DIFFERENCE)).p50.max(MIN_SECOND_DIFFERENCE);
    let largest = values.iter().map(|a| (1.0 + a / reference).ln()).fold(f64::MIN_POSITIVE, f64::max);
    let color = |a: &f64| {
        let x = 3.0 * ((1.0 + a / reference).ln() / largest) as f32;
        [0.0, 1.0, 2.0].map(|from: f32| (x - from).clamp(0.0, 1.0))
    };
    let colors = values.iter().map(color).collect();
    Ok(Overlay { name: "second differences", colors, meaning: "black at rest, white at the largest" })
}

/// The splats with the colours of an overlay.
pub fn painted(splats: Splats, overlay: Overlay) -> Splats {
    Splats { color: Color::Rgb(overlay.colors), ..splats }
}
