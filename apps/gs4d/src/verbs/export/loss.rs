//! What an export loses in PSNR.

use crate::failure::{Class, Failure};
use gs_train::evaluate::EvalReport;
use serde_json::{Value, json};
use std::path::Path;

/// PSNR before and after export.
pub(super) struct Loss {
    before: Option<f64>,
    after: Option<f64>,
    /// Mean loss of the views that have an error before and after, dB.
    mean: Option<f64>,
    /// Largest loss of a view, dB, and its time.
    worst: Option<(f64, f32)>,
    /// Number of views without an error before that have one after.
    spoilt: usize,
    split: String,
    views: usize,
    /// Views rendered from the written files; the others were baked at times of their own.
    read: usize,
}

impl Loss {
    pub(super) fn of(before: &EvalReport, after: &EvalReport, read: usize) -> Self {
        let pairs = || before.views.iter().zip(&after.views);
        let losses = pairs().filter_map(|(b, a)| Some((b.psnr? - a.psnr?, b.time)));
        Self {
            before: before.mean.psnr,
            after: after.mean.psnr,
            mean: before.less(after, |view| view.psnr),
            spoilt: pairs().filter(|(b, a)| b.psnr.is_none() && a.psnr.is_some()).count(),
            worst: losses.reduce(|a, b| if b.0 > a.0 { b } else { a }),
            split: before.split.clone(),
            views: before.views.len(),
            read,
        }
    }

    pub(super) fn to_text(&self) -> String {
        self.line(&match self.read {
            n if n == self.views => "each drawn from the file nearest in time".to_owned(),
            0 => "each drawn from splats of its own time in this format, as no file has its time".to_owned(),
            n => format!(
                "{n} drawn from the file nearest in time, {} from splats of their own times in this format, as no file has their times",
                self.views - n
            ),
        })
    }

    /// The line for people, with where the renders came from.
    pub(super) fn line(&self, from: &str) -> String {
        let number = |psnr: Option<f64>| psnr.map_or("no error".to_owned(), |db| format!("{db:.3} dB"));
        let (before, after) = (number(self.before), number(self.after));
        let loss = self.mean.map_or(String::new(), |lost| {
            let worst = self.worst.map_or(String::new(), |(db, t)| format!(", worst {db:.3} dB at t = {t:.3}"));
            format!(" (mean loss {lost:.3} dB{worst})")
        });
        let spoilt = match self.spoilt {
            0 => String::new(),
            n => format!("; {n} views without an error have one now"),
        };
        format!(
            "psnr over {} {} views ({from}): {before} as trained, {after} as written{loss}{spoilt}\n",
            self.views, self.split
        )
    }

    pub(super) fn to_json(&self) -> Value {
        let worst = self.worst.map(|(db, time)| json!({"loss": db, "time": time}));
        json!({
            "before": self.before, "after": self.after, "loss": self.mean, "worst": worst, "spoilt": self.spoilt,
            "split": self.split, "views": self.views, "from_files": self.read,
        })
    }
}

/// Fails if the files lost more than is allowed.
pub(super) fn verdict(max_error: Option<f64>, loss: Option<&Loss>, out: &Path, try_this: &str) -> Result<(), Failure> {
    let (Some(bound), Some(loss)) = (max_error, loss) else { return Ok(()) };
    let what = match loss.mean {
        Some(lost) if lost <= bound => return Ok(()),
        Some(lost) => format!("the files lose {lost:.3} dB"),
        None if loss.spoilt == 0 => return Ok(()),
        None => format!("the files spoil {} views that were without an error", loss.spoilt),
    };
    Err(Failure::new(Class::Verification, "export.loss", format!("{what}, --max-error allows {bound} dB"))
        .place(out.display())
        .why("the files are written and valid, but not as accurate as asked for")
        .remedy(format!("try {try_this}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::from_value;

    /// A report of views of these PSNRs; none: without an error.
    fn report(psnrs: &[Option<f64>]) -> EvalReport {
        let view = |(k, psnr): (usize, &Option<f64>)| json!({"name": format!("v{k}"), "time": 0.0, "psnr": psnr, "ssim": 1.0, "ms_ssim": null, "perceptual_proxy": 0.0});
        let finite: Vec<f64> = psnrs.iter().flatten().copied().collect();
        let mean = (!finite.is_empty()).then(|| finite.iter().sum::<f64>() / finite.len() as f64);
        let all = json!({
            "method": "m", "split": "test", "background": [0.0, 0.0, 0.0], "scale": 1.0, "protocol": "",
            "psnr_of_mean_mse": mean, "perfect_views": psnrs.len() - finite.len(), "gaussians": 1, "parameter_bytes": 4,
            "train_seconds": null, "views": psnrs.iter().enumerate().map(view).collect::<Vec<_>>(),
            "mean": {"psnr": mean, "ssim": 1.0, "ms_ssim": null, "perceptual_proxy": 0.0},
        });
        from_value(all).unwrap()
    }

    fn judged(before: &[Option<f64>], after: &[Option<f64>]) -> (Option<f64>, String, bool) {
        let loss = Loss::of(&report(before), &report(after), 0);
        (loss.mean, loss.to_text(), verdict(Some(0.5), Some(&loss), Path::new("a"), "b").is_ok())
    }

    #[test]
    fn a_view_without_an_error_hides_no_loss_of_others() {
        let (mean, text, stands) = judged(&[Some(30.0), None], &[Some(27.0), Some(60.0)]);
        assert!(
            mean == Some(3.0) && !stands && text.contains("1 views without an error have one now"),
            "{mean:?} {text}"
        );
        let (mean, text, stands) = judged(&[None], &[Some(20.0)]);
        assert!(mean.is_none() && !stands && text.contains("no error as trained, 20.000 dB as written"), "{text}");
        let (mean, text, stands) = judged(&[None], &[None]);
        assert!(mean.is_none() && stands && text.contains("no error as written"), "{text}");
        let (mean, _, stands) = judged(&[Some(30.0), Some(40.0)], &[Some(29.8), Some(39.6)]);
        assert!(stands && (mean.unwrap() - 0.3).abs() < 1e-9);
    }
}
