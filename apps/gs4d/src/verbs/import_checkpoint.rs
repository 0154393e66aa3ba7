//! `gs4d import-checkpoint`: a checkpoint of another code as a run.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use gs_core::io::{Limits, read_file};
use gs_data::{Split, shell_quoted};
use gs4d_checkpoints::Scene;
use gs4d_run::training::few_views;
use gs4d_run::{Elsewhere, OpenRun};
use serde_json::json;
use std::path::PathBuf;

/// Training views that are scored.
const VIEWS: usize = 8;
/// A scene that fits its own training views worse than this, dB, is seen from elsewhere.
const LEAST: f64 = 15.0;

/// Take over a scene that 4DGaussians, Deformable-3D-GS, Grid4D, Scaffold-GS or TRACE has trained, as a run
#[derive(clap::Args)]
pub struct ImportCheckpointVerb {
    /// The checkpoint as one safetensors file, written by docs/guide/export_checkpoint.py.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Folder of the data it was trained on.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder of the run; made if missing.
    #[arg(short, long, value_name = "RUN")]
    out: PathBuf,
    /// One setting of data, run or method, for example data.scale=0.5 (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Do not score training views.
    #[arg(long)]
    no_scores: bool,
    /// Overwrite an older run in that folder.
    #[arg(short, long)]
    force: bool,
}

impl ImportCheckpointVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let scene = self.scene()?;
        let Scene { code, iteration, method, rows, settings, tensors, bounds, notes } = scene;
        let file = self.file.file_name().unwrap_or_default().to_string_lossy();
        let origin = json!({ "code": code, "iteration": iteration, "file": file });
        let elsewhere = Elsewhere { method, settings, tensors, bounds, origin };
        let registry = gs_methods::registry();
        let resolved = elsewhere.resolve(registry, &self.data, &self.sets)?;
        elsewhere.write(&self.out, self.force, &resolved)?;
        notes.iter().for_each(|note| global.say(format!("note: {note}")));
        let unit = if method == "scaffold" { "anchors" } else { "splats" };
        let mut text = format!("{code}, iteration {iteration}: {rows} {unit}, method {method}\n");
        let scored = if self.no_scores { None } else { self.score(global)? };
        if let Some((psnr, views)) = scored {
            text.push_str(&format!("psnr of {views} training views {psnr:.2} dB\n"));
            if psnr < LEAST {
                global.say(format!(
                    "warning: {psnr:.1} dB is no fit: the data are not those it was trained on, or their cameras are in other units (docs/guide/checkpoints.md)"
                ));
            }
        }
        let place = shell_quoted(self.out.display().to_string());
        text.push_str(&format!("-> {}\nnext: gs4d eval {place}\n", self.out.display()));
        let json = json!({
            "code": code, "iteration": iteration, "method": method, "rows": rows, "notes": notes, "run": self.out.display().to_string(),
            "psnr": scored.map(|s| s.0), "views": scored.map(|s| s.1),
        });
        Ok(Answer::new(text, json))
    }

    fn scene(&self) -> Result<Scene, Failure> {
        let bytes = read_file(&self.file, &Limits::default())?;
        Scene::read(&bytes).map_err(|e| {
            Failure::new(Class::Data, "data.checkpoint", e.to_string())
                .place(self.file.display())
                .remedy("docs/guide/checkpoints.md says what is read, and how the file is made")
        })
    }

    /// PSNR of a few training views, dB, and their number; nothing where there are none.
    fn score(&self, global: &Global) -> Result<Option<(f64, usize)>, Failure> {
        let mut run = OpenRun::open(gs_methods::registry(), &self.out)?;
        run.share = global.share.clone();
        let few = few_views(&run.open_data()?, Split::Train, VIEWS);
        let report = run.score(&few, Split::Train, run.background())?;
        Ok(report.mean.psnr.map(|psnr| (psnr, report.views.len())))
    }
}
