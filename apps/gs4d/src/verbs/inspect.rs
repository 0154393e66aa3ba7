//! `gs4d inspect`: what a splat file, a checkpoint or a run consists of.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use gs_core::io::{Limits, RawSplats, load_splats};
use gs_train::checkpoint::Checkpoint;
use gs_train::inspect::{BlockSummary, SplatSummary, bytes_text};
use gs_train::run::OpenRun;
use gs_train::run::needs::{needs, neutral_camera};
use gs_train::run::picture::moment;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Counts, ranges, needles and non-finite rows of a splat file or checkpoint; for a run, what its scene needed
#[derive(clap::Args)]
pub struct Inspect {
    /// A .ply, .splat, .spz or .gs4d file, or a run folder.
    #[arg(value_name = "FILE|RUN")]
    path: PathBuf,
}

impl Inspect {
    pub fn run(self) -> Result<Answer, Failure> {
        let path = &self.path;
        if path.is_dir() {
            run_folder(path)
        } else if path.extension().is_some_and(|e| e == "gs4d") {
            checkpoint_file(path)
        } else {
            splat_file(path)
        }
    }
}

fn splat_file(path: &Path) -> Result<Answer, Failure> {
    let limits = Limits { allow_non_finite: true, ..Limits::default() };
    let raw = load_splats(path, &limits)?;
    let bytes = file_bytes(path)?;
    let summary = SplatSummary::of(&raw);
    let text = format!("{}  {} on disk\n{}", path.display(), bytes_text(bytes), summary.to_text());
    Ok(Answer::new(text, json!({"file": path.display().to_string(), "file_bytes": bytes, "summary": summary})))
}

fn checkpoint_file(path: &Path) -> Result<Answer, Failure> {
    let checkpoint = Checkpoint::load(path)?;
    let bytes = file_bytes(path)?;
    let blocks: Vec<BlockSummary> = checkpoint.tensors.iter().map(|(n, v)| BlockSummary::of(n, v)).collect();
    let field = |name: &str| checkpoint.meta.get(name).map_or(String::new(), Value::to_string);
    let mut text = format!(
        "{}  {}, verified; method {}, step {}\n{}",
        path.display(),
        bytes_text(bytes),
        field("method"),
        field("step"),
        BlockSummary::table_head()
    );
    blocks.iter().for_each(|b| text.push_str(&b.to_text()));
    let json =
        json!({"file": path.display().to_string(), "file_bytes": bytes, "meta": checkpoint.meta, "tensors": blocks});
    Ok(Answer::new(text, json))
}

fn run_folder(root: &Path) -> Result<Answer, Failure> {
    let run = OpenRun::open(root)?;
    let method = run.loaded.method.as_ref();
    let camera = neutral_camera();
    let needs = needs(method, &camera, run.loaded.scene.extent);
    let raw = RawSplats::from_splats(&method.splats(&moment(0.0), &camera));
    let raw = raw.map_err(|e| Failure::new(Class::Data, "data.splats", e.to_string()).place(run.path.display()))?;
    let summary = SplatSummary::of(&raw);
    let mut text = format!("{}  {} at step {}\n", run.path.display(), method.name(), run.loaded.step);
    for n in &needs {
        text.push_str(&format!("{:26}{:>22}  {}\n", n.name, n.value, n.meaning));
    }
    text.push_str("\nat time 0: ");
    text.push_str(&summary.to_text());
    let json = json!({
        "run": root.display().to_string(),
        "checkpoint": run.path.display().to_string(),
        "method": method.name(),
        "step": run.loaded.step,
        "train_seconds": run.loaded.train_seconds,
        "needs": needs,
        "summary": summary,
        "skipped": run.skipped.iter().map(|s| s.why.clone()).collect::<Vec<_>>(),
    });
    Ok(Answer::new(text, json))
}

fn file_bytes(path: &Path) -> Result<usize, Failure> {
    let meta = std::fs::metadata(path).map_err(|e| Failure::io("read", path, &e))?;
    Ok(usize::try_from(meta.len()).unwrap_or(usize::MAX))
}
