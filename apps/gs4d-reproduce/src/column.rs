//! Columns of the papers' tables.

use gs_train::evaluate::{EvalReport, MaskedScores};
use serde::Deserialize;

/// A score that a paper prints, and how ours is measured.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Name in the files of tables.
    pub name: &'static str,
    /// Decimal digits in tables.
    pub digits: usize,
    /// How it is measured.
    pub measure: Measure,
    /// The difference of two trials view by view, where one score is left out of means over views; else that of the scores.
    pub less: Option<Less>,
}

/// A score of the first report less that of the second; `None` where they have none in common.
pub type Less = fn(&EvalReport, &EvalReport) -> Option<f64>;

/// How a column is measured.
#[derive(Clone, Copy, Debug)]
pub enum Measure {
    /// From the scores that a run has.
    Scores(Score),
    /// From scores that are made with LPIPS of the column's network.
    Lpips(Score),
    /// tOF of the videos of test cameras, their mean ([`gs4d_eval::temporal::tof_by_camera`]).
    Tof,
}

/// A score of a report; `None` where it has none.
pub type Score = fn(&EvalReport) -> Option<f64>;

/// Which mean over images a PSNR is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PsnrMean {
    /// The mean of the images' PSNR.
    #[default]
    Images,
    /// The PSNR of the images' mean squared error.
    MeanError,
}

impl PsnrMean {
    /// In words, for pages.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::Images => "the mean of the images' PSNR",
            Self::MeanError => "the PSNR of the images' mean squared error",
        }
    }
}

fn masked(r: &EvalReport) -> Option<MaskedScores> {
    r.mean.masked
}

const fn scores(name: &'static str, digits: usize, of: Score) -> Column {
    Column { name, digits, measure: Measure::Scores(of), less: None }
}

/// A PSNR: of a view without error it is infinite, and not in the mean.
const fn psnr(name: &'static str, of: Score, less: Less) -> Column {
    Column { name, digits: 2, measure: Measure::Scores(of), less: Some(less) }
}

const LESS: Less = |a, b| a.less(b, |view| view.psnr);

const fn lpips(name: &'static str, of: Score) -> Column {
    Column { name, digits: 3, measure: Measure::Lpips(of), less: None }
}

/// The columns of tables that are run.
const COLUMNS: [Column; 12] = [
    psnr("psnr", |r| r.mean.psnr, LESS),
    scores("ssim", 4, |r| r.mean.ssim),
    scores("ms_ssim", 4, |r| r.mean.ms_ssim),
    lpips("lpips", |r| r.mean.lpips),
    psnr("masked_psnr", |r| masked(r)?.psnr, |a, b| a.less(b, |view| view.masked?.psnr)),
    scores("masked_ssim", 4, |r| masked(r)?.ssim),
    lpips("masked_lpips", |r| masked(r)?.lpips),
    psnr("future_psnr", EvalReport::extrapolated_psnr, |a, b| LESS(a.extrapolate.as_ref()?, b.extrapolate.as_ref()?)),
    scores("future_ssim", 4, |r| r.extrapolate.as_ref()?.mean.ssim),
    lpips("future_lpips", |r| r.extrapolate.as_ref()?.mean.lpips),
    Column { name: "tof", digits: 3, measure: Measure::Tof, less: None },
    scores("megabytes", 2, |r| Some(r.parameter_bytes as f64 * 1e-6)),
];

impl Column {
    /// The column of this name; `None` for one that no contest knows.
    pub fn named(name: &str) -> Option<Self> {
        COLUMNS.into_iter().find(|c| c.name == name)
    }

    /// The same on generated scenes, which have no masks: masked scores are those of all pixels.
    pub(crate) fn on_generated(self) -> Self {
        match self.name {
            "masked_psnr" => psnr(self.name, |r| r.mean.psnr, LESS),
            "masked_ssim" => Self { measure: Measure::Scores(|r| r.mean.ssim), ..self },
            "masked_lpips" => Self { measure: Measure::Lpips(|r| r.mean.lpips), ..self },
            _ => self,
        }
    }

    /// The same with this mean over images, where it is a PSNR of all pixels.
    pub(crate) fn with_mean(self, mean: PsnrMean) -> Self {
        match (mean, self.name) {
            (PsnrMean::MeanError, "psnr") => scores(self.name, self.digits, |r| r.psnr_of_mean_mse),
            (PsnrMean::MeanError, "future_psnr") => {
                scores(self.name, self.digits, |r| r.extrapolate.as_ref()?.psnr_of_mean_mse)
            }
            _ => self,
        }
    }

    /// Whether it counts under masks.
    pub(crate) fn is_masked(&self) -> bool {
        self.name.starts_with("masked_")
    }

    /// Whether it is measured beside the scores of training.
    pub(crate) fn is_beside(&self) -> bool {
        !matches!(self.measure, Measure::Scores(_))
    }

    /// Whether it is LPIPS.
    pub(crate) fn is_lpips(&self) -> bool {
        matches!(self.measure, Measure::Lpips(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    /// A report with these means of PSNR, and those beyond the training time.
    fn report([psnr, of_mean]: [f64; 2], future: Option<[f64; 2]>) -> Value {
        json!({
            "method": "m", "split": "test", "background": [0.0, 0.0, 0.0], "scale": 1.0, "protocol": "",
            "psnr_of_mean_mse": of_mean, "perfect_views": 0, "gaussians": 1, "parameter_bytes": 4, "train_seconds": null,
            "views": [], "mean": {"psnr": psnr, "ssim": 0.5, "ms_ssim": null, "perceptual_proxy": 0.2, "lpips": 0.1},
            "extrapolate": future.map(|means| report(means, None)),
        })
    }

    fn value(column: Column, report: &EvalReport) -> Option<f64> {
        match column.measure {
            Measure::Scores(of) | Measure::Lpips(of) => of(report),
            Measure::Tof => None,
        }
    }

    #[test]
    fn without_masks_all_pixels_count_on_generated_scenes_alone() {
        let report: EvalReport = serde_json::from_value(report([24.0, 23.0], None)).unwrap();
        for (name, plain, generated) in [
            ("masked_psnr", None, Some(24.0)),
            ("masked_ssim", None, Some(0.5)),
            ("masked_lpips", None, Some(0.1)),
            ("ssim", Some(0.5), Some(0.5)),
        ] {
            let column = Column::named(name).unwrap();
            assert_eq!((value(column, &report), value(column.on_generated(), &report)), (plain, generated), "{name}");
            assert_eq!(column.is_masked(), plain.is_none());
        }
    }

    #[test]
    fn psnr_has_two_means() {
        let report: EvalReport = serde_json::from_value(report([24.0, 23.0], Some([20.0, 19.0]))).unwrap();
        for (name, images, error) in [("psnr", 24.0, 23.0), ("future_psnr", 20.0, 19.0), ("ssim", 0.5, 0.5)] {
            let column = Column::named(name).unwrap();
            assert_eq!(value(column.with_mean(PsnrMean::Images), &report), Some(images), "{name}");
            assert_eq!(value(column.with_mean(PsnrMean::MeanError), &report), Some(error), "{name}");
        }
    }
}
