//! Scores of several runs: which columns a table shows, mean and deviation over seeds.

use gs_train::evaluate::EvalReport;
use serde::Serialize;

/// Mean and standard deviation over seeds (`n − 1` in the denominator; 0 for one seed).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
}

impl Spread {
    /// Of some values; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        (!values.is_empty()).then(|| Self { mean, deviation: (squares / (n - 1.0).max(1.0)).sqrt() })
    }
}

/// A score: its name in tables, its digits, its value.
pub type Score = (&'static str, usize, fn(&EvalReport) -> Option<f64>);

/// Columns of tables that set entries or runs beside each other; those that nobody has a number for are left out there.
pub const SCORES: [Score; 7] = [
    ("psnr", 2, |r| r.mean.psnr),
    ("ext dB", 2, EvalReport::extrapolated_psnr),
    ("ssim", 4, |r| r.mean.ssim),
    ("proxy", 4, |r| r.mean.perceptual_proxy),
    ("splats", 0, |r| Some(r.gaussians as f64)),
    ("MB", 2, |r| Some(r.parameter_bytes as f64 * 1e-6)),
    ("seconds", 0, |r| r.train_seconds),
];
