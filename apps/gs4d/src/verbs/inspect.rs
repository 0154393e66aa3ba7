//! `gs4d inspect`: what a splat file or a run consists of.

use crate::answer::Answer;
use crate::failure::Failure;
use gs_core::io::{Limits, load_splats};
use gs_train::inspect::{SplatSummary, bytes_text};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Counts, ranges, quantiles, needles and non-finite rows of a splat file, or what the scene of a run needed
#[derive(clap::Args)]
pub struct Inspect {
    /// A .ply, .splat or .spz file, or a run folder.
    #[arg(value_name = "FILE|RUN")]
    path: PathBuf,
}

impl Inspect {
    pub fn run(self) -> Result<Answer, Failure> {
        splat_file(&self.path)
    }
}

fn splat_file(path: &Path) -> Result<Answer, Failure> {
    let limits = Limits { allow_non_finite: true, ..Limits::default() };
    let raw = load_splats(path, &limits)?;
    let file_bytes = std::fs::metadata(path).map_err(|e| Failure::io("read", path, &e))?.len();
    let summary = SplatSummary::of(&raw);
    let text = format!("{}  {} on disk\n{}", path.display(), bytes_text(file_bytes as usize), summary.to_text());
    Ok(Answer::new(text, json!({"file": path.display().to_string(), "file_bytes": file_bytes, "summary": summary})))
}
