//! What every file of a scene in motion has in common, be it a page, a `.4dgs` file or rigid parts: it is made from a run at some
//! times, written by one rank, read back, and scored as it was read.

use super::super::eval::SplitName;
use super::loss::Loss;
use super::to_score;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::opening::{RunData, note_extrapolated};
use gs_core::Splats;
use gs_core::io::{read_file, write_file};
use gs_data::{Dataset, View};
use gs_train::evaluate::{Scoring, evaluate_with};
use gs_train::method::MethodError;
use gs4d_eval::export::{evaluate_played, frame_times};
use gs4d_run::{Kept, OpenRun};
use serde_json::Value;
use std::io::{self, Write};
use std::path::PathBuf;

/// Data without seconds are played in three, as in the viewer.
const SECONDS: f64 = 3.0;

/// What was asked for.
pub(super) struct Motion {
    pub run: PathBuf,
    pub out: PathBuf,
    /// Normalised times of the key frames; those of training if there are none.
    pub times: Option<Vec<f32>>,
    pub sh_degree: Option<u8>,
    pub split: SplitName,
    pub no_eval: bool,
    pub max_error: Option<f64>,
    pub force: bool,
    pub place: RunData,
}

/// The run, and what is known of its data.
pub(super) struct Source {
    pub run: OpenRun,
    /// To score with.
    dataset: Option<Dataset>,
    pub views: Vec<View>,
    pub kept: Kept,
    /// Normalised times of the key frames, ascending: those asked for, else those of training, at most 60.
    pub times: Vec<f32>,
}

impl Source {
    /// The last training time, normalised.
    pub fn observed(&self) -> f32 {
        self.kept.times.last().copied().unwrap_or(1.0)
    }

    /// How long a unit of normalised time plays.
    pub fn seconds(&self) -> f64 {
        self.kept.seconds().map_or(SECONDS, |[start, end]| end - start)
    }
}

impl Motion {
    /// Opens the run, and its data where they are needed: nothing is written if they are missing.
    pub fn open(&self, global: &Global) -> Result<Source, Failure> {
        let run = self.place.open(&self.run, global)?;
        let dataset = if self.no_eval { None } else { to_score(&run, self.split, self.max_error, global)? };
        let (views, kept) = (run.training_views()?, run.kept().unwrap_or_default());
        let mut times = self.times.clone().unwrap_or_else(|| frame_times(&kept.times));
        times.sort_by(f32::total_cmp);
        times.dedup();
        note_extrapolated(times.iter().copied(), &run, global);
        Ok(Source { run, dataset, views, kept, times })
    }

    /// Writes the file on one rank; what all ranks then read.
    pub fn write(
        &self,
        source: &Source,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
        global: &Global,
    ) -> Result<Vec<u8>, Failure> {
        let share = &source.run.share;
        share.barrier()?;
        if share.leads() {
            write_file(&self.out, self.force, content)?;
        }
        share.barrier()?;
        Ok(read_file(&self.out, &global.limits())?)
    }

    /// What is lost in PSNR where these splats are shown at a normalised time, drawn as [`Scoring::plain`] says; nothing if it is not to be
    /// measured.
    pub fn loss(
        &self,
        source: &Source,
        plain: Option<bool>,
        shown: &dyn Fn(f32) -> Result<Splats, MethodError>,
    ) -> Result<Option<Loss>, Failure> {
        let Source { run, dataset: Some(data), .. } = source else { return Ok(None) };
        let (images, split) = (run.images(), self.split.into());
        let scoring = run.scoring(run.background(), &images);
        let before = evaluate_with(&run.loaded.model, data, split, &scoring)?;
        let after = evaluate_played(shown, &run.loaded.model, (data, split), &Scoring { plain, ..scoring })?;
        Ok(Some(Loss::of(&before, &after, after.views.len())))
    }

    /// The answer: what the file holds, what it lost, where it lies.
    pub fn answer(&self, holds: &str, loss: Option<&Loss>, bytes: usize, mut json: Value) -> Answer {
        let lost = loss.map_or_else(String::new, |l| l.line("from the file, read back"));
        let text = format!("{:.2} MB, read back whole: {holds}\n{lost}-> {}\n", bytes as f64 / 1e6, self.out.display());
        json["file"] = self.out.display().to_string().into();
        json["bytes"] = bytes.into();
        json["psnr"] = loss.map(Loss::to_json).into();
        Answer::new(text, json)
    }
}
