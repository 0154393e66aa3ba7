//! `gs4d eval`: scores a run on a split of its data, or a folder of images against a folder of truths.

use super::train::scores_text;
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::images::{self, Pictures};
use crate::{Global, parse};
use gs_train::compare::{Comparer, Metric, SetScores};
use gs_train::data::Split;
use gs_train::run::OpenRun;
use gs_train::run::folder::METRICS;
use gs_train::run::opened::metrics_json;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Score a run on its test views, or a folder of images against a folder of truths
#[derive(clap::Args)]
pub struct Eval {
    /// Folder of the run.
    #[arg(value_name = "RUN", required_unless_present = "pred", conflicts_with_all = ["pred", "gt", "mask", "metrics"])]
    run: Option<PathBuf>,
    /// Which views of the run's data.
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    split: SplitName,
    /// Colour behind drawing and truth: black, white, one grey or r,g,b in 0..1 [default: the recipe's; folders: black].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::color)]
    background: Option<[f32; 3]>,
    /// Folder of images to score.
    #[arg(long, value_name = "DIR", requires = "gt")]
    pred: Option<PathBuf>,
    /// Folder of their truths; files belong together by name, whatever their extensions.
    #[arg(long, value_name = "DIR", requires = "pred")]
    gt: Option<PathBuf>,
    /// Folder of masks: only bright pixels count.
    #[arg(long, value_name = "DIR", requires = "pred")]
    mask: Option<PathBuf>,
    /// Metrics, separated by commas: psnr, ssim, ms_ssim, perceptual_proxy [default: all].
    #[arg(long, value_delimiter = ',', requires = "pred", value_parser = |s: &str| s.parse::<Metric>())]
    metrics: Option<Vec<Metric>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum SplitName {
    Train,
    Val,
    Test,
}

impl From<SplitName> for Split {
    fn from(name: SplitName) -> Self {
        match name {
            SplitName::Train => Split::Train,
            SplitName::Val => Split::Val,
            SplitName::Test => Split::Test,
        }
    }
}

impl Eval {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        match (&self.run, &self.pred, &self.gt) {
            (Some(run), _, _) => self.of_run(run, global),
            (None, Some(pred), Some(gt)) => self.of_folders(pred, gt),
            _ => Err(Failure::usage("give a run, or two folders with --pred and --gt")),
        }
    }

    fn of_run(&self, root: &Path, global: &Global) -> Result<Answer, Failure> {
        let run = OpenRun::open(root)?;
        for skipped in &run.skipped {
            global.say(format!("skipped {}", skipped.why));
        }
        let dataset = run.resolved.open_data()?;
        let background = self.background.unwrap_or_else(|| run.background());
        let scores = run.score(&dataset, self.split.into(), background)?;
        let mut text = scores_text(&scores, run.loaded.step);
        let json = metrics_json(&scores, run.loaded.step);
        if self.split == SplitName::Test && self.background.is_none() {
            run.folder.write(METRICS, &format!("{json:#}\n"))?;
            text.push_str(&format!("-> {}\n", root.join(METRICS).display()));
        }
        Ok(Answer::new(text, json))
    }

    fn of_folders(&self, pred: &Path, gt: &Path) -> Result<Answer, Failure> {
        let background = self.background.unwrap_or_default();
        let (images, truths) = (Pictures::of(pred)?, Pictures::of(gt)?);
        let masks = self.mask.as_deref().map(Pictures::of).transpose()?;
        images.same_names(&truths)?;
        if let Some(masks) = &masks {
            images.have_partners(masks)?;
        }
        let chosen = self.metrics.clone().unwrap_or_else(|| Metric::ALL.map(|m| m.1).to_vec());
        let mut comparer = Comparer::new(&chosen);
        for (name, path) in images.iter() {
            let image = images::over(path, background)?;
            let truth = images::over(truths.path(name)?, background)?;
            let mask = masks.as_ref().map(|m| images::mask(m.path(name)?)).transpose()?;
            let added = comparer.add(name, &image, &truth, mask.as_ref());
            added.map_err(|e| Failure::new(Class::Data, "data.metric", e.to_string()).place(path.display()))?;
        }
        let scores = comparer.finish();
        let mut json = json!(scores);
        json["pred"] = json!(pred.display().to_string());
        json["gt"] = json!(gt.display().to_string());
        json["background"] = json!(background);
        json["protocol"] = json!("data range 1; SSIM 11x11 with zero padding; perceptual_proxy is not LPIPS");
        Ok(Answer::new(table(&scores), json))
    }
}

fn table(scores: &SetScores) -> String {
    let cell = |v: Option<f64>, perfect: bool, digits: usize| match v {
        Some(v) => format!("{v:>10.digits$}"),
        None => format!("{:>10}", if perfect { "inf" } else { "-" }),
    };
    let mut out = format!("{:24}{:>10}{:>10}{:>10}{:>10}\n", "", "psnr", "ssim", "ms-ssim", "proxy");
    for v in &scores.views {
        let row = [cell(v.psnr, v.mse_is_zero(), 3), cell(v.ssim, false, 4), cell(v.ms_ssim, false, 4)].concat();
        out.push_str(&format!("{:24}{row}{}\n", v.name, cell(v.perceptual_proxy, false, 4)));
    }
    let m = &scores.mean;
    let row = [cell(m.psnr, scores.perfect_views > 0, 3), cell(m.ssim, false, 4), cell(m.ms_ssim, false, 4)].concat();
    out.push_str(&format!("{:24}{row}{}\n", "mean", cell(m.perceptual_proxy, false, 4)));
    let from_mean = scores.psnr_of_mean_mse.map_or(String::new(), |p| format!("psnr of the mean error {p:.3} dB; "));
    out.push_str(&format!("{from_mean}{} views, {} without error\n", scores.views.len(), scores.perfect_views));
    out
}
