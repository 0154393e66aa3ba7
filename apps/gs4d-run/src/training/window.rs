//! Sums over the steps between two lines of the log.

use crate::provenance::peak_memory_mib;
use gs_train::trainer::{Phases, StepReport};
use serde_json::{Value, json};

/// Sums since the last line of the log.
#[derive(Debug, Default)]
pub(super) struct Window {
    steps: u32,
    pub(super) loss: f64,
    l1: f64,
    fre: f64,
    mrf: f64,
    exposure: f64,
    mse: f64,
    ms: Phases,
    pub(super) quarantined: u64,
    cloned: u64,
    split: u64,
    pruned: u64,
    /// The last of them.
    last: Option<StepReport>,
}

impl Window {
    pub(super) fn add(&mut self, report: StepReport) {
        self.steps += 1;
        self.loss += report.loss.total;
        self.l1 += report.loss.l1;
        self.fre += report.loss.term("fre").unwrap_or(0.0);
        self.mrf += report.loss.term("mrf").unwrap_or(0.0);
        self.exposure += report.loss.term("exposure").unwrap_or(0.0);
        self.mse += report.loss.mse;
        self.ms += report.ms;
        self.quarantined += u64::from(report.quarantined);
        self.cloned += u64::from(report.adapted.cloned);
        self.split += u64::from(report.adapted.split);
        self.pruned += u64::from(report.adapted.pruned);
        self.last = Some(report);
    }

    pub(super) fn mean(&self, sum: f64) -> f64 {
        sum / f64::from(self.steps.max(1))
    }

    pub(super) fn psnr(&self) -> f64 {
        gs_metrics::psnr_from_mse(self.mean(self.mse))
    }

    /// The line of the log after the last step, `seconds` into the training; none without a step.
    pub(super) fn line(&self, seconds: f64) -> Option<Value> {
        let report = self.last.as_ref()?;
        let ms = self.ms / f64::from(self.steps);
        Some(json!({
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
            "steps": self.steps,
            "ms_per_step": ms.total,
            "ms": ms,
            "ms_last": report.ms,
            "sent_last": report.sent_bytes,
            "memory_mib": peak_memory_mib(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nine steps of 5 ms in the field, and one that ends with 100 ms of densification.
    #[test]
    fn phases_are_means_over_all_steps_of_a_line() {
        let mut window = Window::default();
        assert_eq!(window.line(0.0), None);
        for step in 1..=10 {
            let mut report = StepReport { step, ..StepReport::default() };
            (report.ms.field, report.ms.adapt) = (5.0, if step == 10 { 100.0 } else { 0.0 });
            window.add(report);
        }
        let line = window.line(1.0).unwrap();
        assert_eq!((&line["step"], &line["steps"]), (&json!(10), &json!(10)));
        assert_eq!(line["ms"]["adapt"], 10.0);
        assert_eq!(crate::work::step_phases(&[line])[..2], [("adapt".to_owned(), 10.0), ("field".to_owned(), 5.0)]);
    }
}
