//! What an export loses in PSNR.

use crate::failure::{Class, Failure};
use gs_train::evaluate::EvalReport;
use serde_json::{Value, json};
use std::path::Path;

/// PSNR before and after export.
pub(super) struct Loss {
    before: Option<f64>,
    after: Option<f64>,
    /// Largest loss of a view, dB, and its time.
    worst: Option<(f64, f32)>,
    split: String,
    views: usize,
    /// Views rendered from the written files; the others were baked at times of their own.
    read: usize,
}

impl Loss {
    pub(super) fn of(before: &EvalReport, after: &EvalReport, read: usize) -> Self {
        let pairs = before.views.iter().zip(&after.views);
        let losses = pairs.filter_map(|(b, a)| Some((b.psnr? - a.psnr?, b.time)));
        Self {
            before: before.mean.psnr,
            after: after.mean.psnr,
            worst: losses.reduce(|a, b| if b.0 > a.0 { b } else { a }),
            split: before.split.clone(),
            views: before.views.len(),
            read,
        }
    }

    /// Loss of the mean PSNR, dB; `None` if either is perfect.
    fn mean(&self) -> Option<f64> {
        Some(self.before? - self.after?)
    }

    pub(super) fn to_text(&self) -> String {
        self.line(&match self.read {
            n if n == self.views => "from the files, the nearest in time".to_owned(),
            n => format!("{n} from the files, {} baked at times that no file has", self.views - n),
        })
    }

    /// The line for people, with where the renders came from.
    pub(super) fn line(&self, from: &str) -> String {
        let (Some(before), Some(after), Some(lost)) = (self.before, self.after, self.mean()) else {
            return "psnr: every view is perfect\n".to_owned();
        };
        let worst = self.worst.map_or(String::new(), |(db, t)| format!(", worst {db:.3} dB at t = {t:.3}"));
        format!(
            "psnr over {} {} views ({from}): {before:.3} dB as trained, {after:.3} dB as written (mean loss {lost:.3} dB{worst})\n",
            self.views, self.split
        )
    }

    pub(super) fn to_json(&self) -> Value {
        let worst = self.worst.map(|(db, time)| json!({"loss": db, "time": time}));
        json!({
            "before": self.before, "after": self.after, "loss": self.mean(), "worst": worst,
            "split": self.split, "views": self.views, "from_files": self.read,
        })
    }
}

/// Fails if the files lost more than is allowed.
pub(super) fn verdict(max_error: Option<f64>, loss: Option<&Loss>, out: &Path, try_this: &str) -> Result<(), Failure> {
    let (Some(bound), Some(lost)) = (max_error, loss.and_then(Loss::mean)) else { return Ok(()) };
    if lost <= bound {
        return Ok(());
    }
    Err(Failure::new(
        Class::Verification,
        "export.loss",
        format!("the files lose {lost:.3} dB, --max-error allows {bound}"),
    )
    .place(out.display())
    .why("the files are written and valid, but not as accurate as asked for")
    .remedy(format!("try {try_this}")))
}
