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
    pub of: fn(&EvalReport) -> Option<f64>,
}

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
}
