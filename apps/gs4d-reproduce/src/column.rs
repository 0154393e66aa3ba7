//! Columns of the papers' tables.

use gs_train::evaluate::{EvalReport, MaskedScores};

/// A score that a paper prints, and how a report of ours has it.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Name in the files of tables.
    pub name: &'static str,
    /// Decimal digits in tables.
    pub digits: usize,
    /// The score of a run; `None` where it has none.
    pub of: Score,
}

/// A score of a report.
type Score = fn(&EvalReport) -> Option<f64>;

fn masked(r: &EvalReport) -> Option<MaskedScores> {
    r.mean.masked
}

/// The columns of tables that are run. `lpips` is there where the user has weights ([`Reproduction::score_lpips`](crate::Reproduction::score_lpips)); `tof` is not measured.
const COLUMNS: [Column; 12] = [
    Column { name: "psnr", digits: 2, of: |r| r.mean.psnr },
    Column { name: "ssim", digits: 4, of: |r| r.mean.ssim },
    Column { name: "ms_ssim", digits: 4, of: |r| r.mean.ms_ssim },
    Column { name: "lpips", digits: 3, of: |r| r.mean.lpips },
    Column { name: "masked_psnr", digits: 2, of: |r| masked(r)?.psnr },
    Column { name: "masked_ssim", digits: 4, of: |r| masked(r)?.ssim },
    Column { name: "masked_lpips", digits: 3, of: |r| masked(r)?.lpips },
    Column { name: "future_psnr", digits: 2, of: EvalReport::extrapolated_psnr },
    Column { name: "future_ssim", digits: 4, of: |r| r.extrapolate.as_ref()?.mean.ssim },
    Column { name: "future_lpips", digits: 3, of: |r| r.extrapolate.as_ref()?.mean.lpips },
    Column { name: "tof", digits: 3, of: |_| None },
    Column { name: "megabytes", digits: 2, of: |r| Some(r.parameter_bytes as f64 * 1e-6) },
];

impl Column {
    /// The column of this name; `None` for one that no contest knows.
    pub fn named(name: &str) -> Option<Self> {
        COLUMNS.into_iter().find(|c| c.name == name)
    }

    /// The same on generated scenes, which have no masks: masked scores are those of all pixels.
    pub(crate) fn on_generated(self) -> Self {
        let of: Score = match self.name {
            "masked_psnr" => |r| r.mean.psnr,
            "masked_ssim" => |r| r.mean.ssim,
            "masked_lpips" => |r| r.mean.lpips,
            _ => self.of,
        };
        Self { of, ..self }
    }

    /// Whether it counts under masks.
    pub(crate) fn is_masked(&self) -> bool {
        self.name.starts_with("masked_")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_masks_all_pixels_count_on_generated_scenes_alone() {
        let scores = serde_json::json!({
            "method": "m", "split": "test", "background": [0.0, 0.0, 0.0], "scale": 1.0, "protocol": "", "psnr_of_mean_mse": null,
            "perfect_views": 0, "gaussians": 1, "parameter_bytes": 4, "train_seconds": null, "views": [],
            "mean": {"psnr": 24.0, "ssim": 0.5, "ms_ssim": null, "perceptual_proxy": 0.2},
        });
        let report: EvalReport = serde_json::from_value(scores).unwrap();
        let column = Column::named("masked_psnr").unwrap();
        assert_eq!(((column.of)(&report), (column.on_generated().of)(&report)), (None, Some(24.0)));
        let plain = Column::named("ssim").unwrap();
        assert_eq!(((plain.of)(&report), (plain.on_generated().of)(&report)), (Some(0.5), Some(0.5)));
        assert!(column.is_masked() && !plain.is_masked());
    }
}
