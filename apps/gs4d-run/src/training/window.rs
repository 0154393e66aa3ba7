//! Sums over the steps between two lines of the log.

use crate::provenance::peak_memory_mib;
use gs_train::trainer::StepReport;
use serde_json::{Value, json};

/// Sums since the last line of the log.
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    steps: u32,
    pub(super) loss: f64,
    l1: f64,
    fre: f64,
    mrf: f64,
    exposure: f64,
    mse: f64,
    ms: f64,
    pub(super) quarantined: u64,
    cloned: u64,
    split: u64,
    pruned: u64,
}

impl Window {
    pub(super) fn add(&mut self, report: &StepReport) {
        self.steps += 1;
        self.loss += report.loss.total;
        self.l1 += report.loss.l1;
        self.fre += report.loss.term("fre").unwrap_or(0.0);
        self.mrf += report.loss.term("mrf").unwrap_or(0.0);
        self.exposure += report.loss.term("exposure").unwrap_or(0.0);
        self.mse += report.loss.mse;
        self.ms += report.ms.total;
        self.quarantined += u64::from(report.quarantined);
        self.cloned += u64::from(report.adapted.cloned);
        self.split += u64::from(report.adapted.split);
        self.pruned += u64::from(report.adapted.pruned);
    }

    pub(super) fn mean(&self, sum: f64) -> f64 {
        sum / f64::from(self.steps.max(1))
    }

    pub(super) fn psnr(&self) -> f64 {
        gs_metrics::psnr_from_mse(self.mean(self.mse))
    }

    /// The line of the log after this step, `seconds` into the training.
    pub(super) fn line(&self, report: &StepReport, seconds: f64) -> Value {
        json!({
            "step": report.step,
            "seconds": seconds,
            "stage": report.stage,
            "loss": self.mean(self.loss),
            "l1": self.mean(self.l1),
            "fre": report.loss.term("fre").map(|_| self.mean(self.fre)),
            "mrf": report.loss.term("mrf").map(|_| self.mean(self.mrf)),
            "exposure": report.loss.term("exposure").map(|_| self.mean(self.exposure)),
            "psnr": self.psnr(),
            "penalties": report.penalties.iter().map(|(n, v)| (n.to_string(), json!(v))).collect::<serde_json::Map<_, _>>(),
            "splats": report.splats,
            "cloned": self.cloned,
            "split": self.split,
            "pruned": self.pruned,
            "quarantined": self.quarantined,
            "ms_per_step": self.mean(self.ms),
            "ms_last": report.ms,
            "sent_last": report.sent_bytes,
            "memory_mib": peak_memory_mib(),
        })
    }
}
