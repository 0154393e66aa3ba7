//! Scores of several runs: columns of tables, mean and standard deviation.

use gs_train::evaluate::EvalReport;
use serde::Serialize;

/// Mean and sample standard deviation (`n − 1` in the denominator; 0 for one value).
///
/// ```
/// use gs4d_eval::spread::Spread;
///
/// assert_eq!(Spread::of(&[1.0, 3.0, 5.0]), Some(Spread { mean: 3.0, deviation: 2.0 }));
/// assert_eq!(Spread::of(&[]), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Arithmetic mean of the values.
    pub mean: f64,
    /// Sample standard deviation, over n − 1; 0 for one value.
    pub deviation: f64,
}

impl Spread {
    /// Of `values`, summed in order; `None` if there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        (!values.is_empty()).then(|| Self { mean, deviation: (squares / (n - 1.0).max(1.0)).sqrt() })
    }
}

/// A column of a table of runs: header, decimal digits, value of a report.
pub type Score = (&'static str, usize, fn(&EvalReport) -> Option<f64>);

/// The columns of tables of runs; tables leave out those without any value.
pub const SCORES: [Score; 7] = [
    ("psnr", 2, |r| r.mean.psnr),
    ("ext dB", 2, EvalReport::extrapolated_psnr),
    ("ssim", 4, |r| r.mean.ssim),
    ("proxy", 4, |r| r.mean.perceptual_proxy),
    ("splats", 0, |r| Some(r.gaussians as f64)),
    ("MB", 2, |r| Some(r.parameter_bytes as f64 * 1e-6)),
    ("seconds", 0, |r| r.train_seconds),
];
