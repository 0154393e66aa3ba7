//! How the centres of splats move: temporal spectra and second differences (see [`gs_metrics::trajectory`]).

use super::AnalysisError;
use super::histogram::Histogram;
use super::row;
use crate::Need;
use crate::needs::neutral_camera;
use gs_core::{Camera, Color, Splats};
use gs_metrics::trajectory::{ENERGY_FLOOR, Spread, Window, default_cutoff, high_energies, second_differences};
use gs_train::capabilities::Overlay;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use serde::Serialize;

/// Fewest and most moments taken for a scene of so many training times.
const MOMENTS: [usize; 2] = [8, 200];
/// Share of the largest second difference from which on a map is white.
const REFERENCE: f64 = 1e-12;

/// How the splats of a scene move.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Paths {
    /// Moments sampled, evenly over the training span.
    pub moments: usize,
    /// First frequency that counts as high, cycles over the training span.
    pub cutoff: usize,
    /// High-frequency energy of the paths as they are.
    pub raw: Energy,
    /// The same with straight lines removed and a Hann window.
    pub hann: Energy,
    /// Squared second differences between neighbouring moments, world units squared.
    pub jerk: Jerk,
}

/// Energy of paths at high frequencies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Energy {
    /// Mean over splats of `log10(E + 1e-12)`.
    pub mean_log10: f64,
    /// Mean over splats of `ln(E + 1e-12)`.
    pub mean_ln: f64,
    /// Of `log10(E + 1e-12)`.
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

/// How second differences are spread over splats and moments.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Jerk {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 90 %.
    pub p90: f64,
    /// 99 %.
    pub p99: f64,
    /// Gini coefficient: towards 1 if few splats at few moments do all the jerking.
    pub gini: f64,
}

/// The moments to sample for a scene with so many training times.
pub fn moments_for(training_times: usize) -> usize {
    training_times.clamp(MOMENTS[0], MOMENTS[1])
}

impl Paths {
    /// Of a method at `moments` evenly spaced times; the cut-off is `⌈moments/4⌉` if none is given.
    ///
    /// # Errors
    /// If the splats are not the same ones at every moment, there are fewer than 4 moments, or the cut-off is out of range.
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

    /// As rows of a table.
    pub fn rows(&self) -> Vec<Need> {
        let meaning = format!(
            "mean log10 (ln) of path energy at {} or more cycles over {} moments; 1e-12 is rest",
            self.cutoff, self.moments
        );
        let energy = |e: &Energy| format!("{:.2} ({:.2})", e.mean_log10, e.mean_ln);
        let j = self.jerk;
        let spread = format!("{:.2e} / {:.2e} / {:.2e} / {:.2e}", j.mean, j.p50, j.p90, j.p99);
        vec![
            row("fast motion", energy(&self.raw), &meaning),
            row("fast motion, windowed", energy(&self.hann), "without straight lines, Hann window: no leaking drift"),
            row("second differences", spread, "squared, world units squared: mean, median, 90 %, 99 %"),
            row("their contrast", format!("{:.3}", j.gini), "Gini coefficient: towards 1 if few splats do all of it"),
        ]
    }
}

/// Centres of all splats at evenly spaced times.
fn centres(method: &Model, camera: &Camera, moments: usize) -> Result<Vec<Vec<[f32; 3]>>, MethodError> {
    let time = |k: usize| k as f32 / (moments.max(2) - 1) as f32;
    (0..moments).map(|k| means_at(method, time(k), camera)).collect()
}

fn means_at(method: &Model, time: f32, camera: &Camera) -> Result<Vec<[f32; 3]>, MethodError> {
    let splats = method.all_splats(&Timestamp::normalised(time), camera)?;
    Ok(splats.means.iter().map(|m| m.to_array()).collect())
}

/// Second differences at a time against the times `interval` before and after it, as colours: black at rest, through red
/// and yellow to white at the largest, by `log(1 + A / A_ref)` with the median of those that are not at rest as `A_ref`.
///
/// # Errors
/// If the splats are not the same ones at the three times.
pub fn jerk_overlay(method: &Model, time: f32, interval: f32, camera: &Camera) -> Result<Overlay, AnalysisError> {
    let at = |t: f32| means_at(method, t, camera);
    let frames = [at(time - interval)?, at(time)?, at(time + interval)?];
    let values = second_differences(&frames)?.swap_remove(0);
    let reference = Spread::of(values.iter().copied().filter(|a| *a > REFERENCE)).p50.max(REFERENCE);
    let largest = values.iter().map(|a| (1.0 + a / reference).ln()).fold(f64::MIN_POSITIVE, f64::max);
    let color = |a: &f64| {
        let x = 3.0 * ((1.0 + a / reference).ln() / largest) as f32;
        [0.0, 1.0, 2.0].map(|from: f32| (x - from).clamp(0.0, 1.0))
    };
    let colors = values.iter().map(color).collect();
    Ok(Overlay { name: "second differences", colors, meaning: "black at rest, white at the largest" })
}

/// Splats in the colours of an overlay.
pub fn painted(splats: Splats, overlay: Overlay) -> Splats {
    Splats { color: Color::Rgb(overlay.colors), ..splats }
}
