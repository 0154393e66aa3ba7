//! A trained scene as one small file: `gs4d export -o NAME.gs4d`, and the older name `gs4d compact`.

use super::eval::SplitName;
use super::export::to_score;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::opening::RunData;
use crate::output::prepare_file;
use gs_data::Dataset;
use gs_train::evaluate::EvalReport;
use gs4d_run::OpenRun;
use gs4d_run::compact::{Bits, CompactReport, CompactScene, Packing};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Write a trained scene as one small file that renders, and report the loss in PSNR
#[derive(clap::Args)]
pub struct Compact {
    /// Folder of the run, or one of its checkpoints.
    #[arg(value_name = "RUN|FILE")]
    pub(super) run: PathBuf,
    /// The file to write, NAME.gs4d; gs4d eval, render and inspect read it.
    #[arg(short, long, value_name = "FILE")]
    pub(super) out: PathBuf,
    /// Bits per value: 32 exact, 16 half precision, 8 quantised; positions keep 16.
    #[arg(long, value_enum, default_value_t = BitsName::Eight)]
    pub(super) bits: BitsName,
    /// Do not deflate.
    #[arg(long)]
    pub(super) no_deflate: bool,
    /// Views to score before and after.
    #[arg(long, value_enum, default_value_t = SplitName::Test, conflicts_with = "no_eval")]
    pub(super) split: SplitName,
    /// Do not score.
    #[arg(long)]
    pub(super) no_eval: bool,
    /// Overwrite an existing file.
    #[arg(short, long)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) place: RunData,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum BitsName {
    #[value(name = "32")]
    ThirtyTwo,
    #[value(name = "16")]
    Sixteen,
    #[value(name = "8")]
    Eight,
}

impl From<BitsName> for Bits {
    fn from(name: BitsName) -> Self {
        match name {
            BitsName::ThirtyTwo => Bits::Full,
            BitsName::Sixteen => Bits::Half,
            BitsName::Eight => Bits::Byte,
        }
    }
}

impl Compact {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        self.check_out()?;
        let run = self.place.open(&self.run, global)?;
        let dataset = if self.no_eval { None } else { to_score(&run, self.split, None, global)? };
        let before = self.score(&run, dataset.as_ref())?;
        let report = self.write(&run, global)?;
        let data = Path::new(&run.resolved.run.data);
        let mut again = OpenRun::open_with(gs_methods::registry(), &self.out, Some(data))?;
        again.share = run.share.clone();
        let after = self.score(&again, dataset.as_ref())?;
        // The first rank answers.
        Ok(report.map_or_else(|| Answer::new(String::new(), json!(null)), |r| self.answer(&r, before, after)))
    }

    /// Writes the file on one rank, which gets its sizes.
    fn write(&self, run: &OpenRun, global: &Global) -> Result<Option<CompactReport>, Failure> {
        // Every rank finds its output free before one writes.
        run.share.barrier()?;
        let mut report = None;
        if run.share.leads() {
            let scene = CompactScene::of(&run.loaded.model, &run.loaded.config);
            let packing = Packing { bits: self.bits.into(), deflate: !self.no_deflate };
            let (settings, kept) = (run.resolved.config.table(), run.kept().unwrap_or_default());
            report = Some(scene.write(&self.out, &run.loaded, &settings, &kept, packing)?);
            global.detail(format!("wrote {}", self.out.display()));
        }
        run.share.barrier()?;
        Ok(report)
    }

    /// What the file holds, and what it lost.
    fn answer(&self, report: &CompactReport, before: Option<EvalReport>, after: Option<EvalReport>) -> Answer {
        let change = before.as_ref().zip(after.as_ref()).and_then(|(b, a)| a.less(b, |view| view.psnr));
        let [before, after] = [before, after].map(|report| report.and_then(|r| r.mean.psnr));
        let mut text = report.to_text();
        if let (Some(before), Some(after), Some(change)) = (before, after, change) {
            text.push_str(&format!("psnr {before:.3} dB before, {after:.3} dB after ({change:+.3} dB)\n"));
        }
        text.push_str(&format!("-> {}\n", self.out.display()));
        let mut json = json!(report);
        json["file"] = json!(self.out.display().to_string());
        json["psnr"] = json!({"before": before, "after": after, "change": change});
        Answer::new(text, json)
    }

    fn check_out(&self) -> Result<(), Failure> {
        if self.out.extension().is_none_or(|e| e != "gs4d") {
            return Err(Failure::usage("the file to write must be named NAME.gs4d, so that the other verbs know it"));
        }
        prepare_file(self.force, &self.out)
    }

    /// Scores of the split; `None` without data.
    fn score(&self, run: &OpenRun, dataset: Option<&Dataset>) -> Result<Option<EvalReport>, Failure> {
        let Some(dataset) = dataset else { return Ok(None) };
        Ok(Some(run.score(dataset, self.split.into(), run.background())?))
    }
}
