//! A trained scene as one web page that plays it: `gs4d export -o NAME.html`. What a `.4dgs` file is made from is the same.

use super::eval::SplitName;
use super::export::Loss;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::opening::RunData;
use crate::progress::Progress;
use glam::DVec3;
use gs_core::Splats;
use gs_core::io::{read_text, write_file};
use gs_data::{Dataset, View};
use gs_train::evaluate::evaluate_with;
use gs4d_eval::export::{Baker, ExportError, evaluate_played, frame_times, mean_up};
use gs4d_player::{Clip, Page, PlayerError, Start, Tolerance};
use gs4d_run::{Kept, OpenRun};
use serde_json::json;
use std::path::PathBuf;

/// What a page, or a `.4dgs` file, is made from and how.
pub struct Player {
    pub run: PathBuf,
    pub out: PathBuf,
    /// Normalised times of the frames; those of training if there are none.
    pub times: Option<Vec<f32>>,
    pub tolerance: Tolerance,
    pub sh_degree: Option<u8>,
    pub split: SplitName,
    pub no_eval: bool,
    pub force: bool,
    pub place: RunData,
}

impl Player {
    /// Writes the page and reads it back; its answer, and what it lost in PSNR.
    pub fn run(self, global: &Global) -> Result<(Answer, Option<Loss>), Failure> {
        let run = self.place.open(&self.run, global)?;
        // Opened first, so that nothing is written if the data are missing.
        let dataset = if self.no_eval { None } else { Some(run.open_data()?) };
        let (views, kept, share) = (run.training_views()?, run.kept().unwrap_or_default(), &run.share);
        let times = ascending_times(self.times.as_deref(), &kept);
        let mut progress = Progress::new(times.len() as u64, "times", global.quiet);
        let baker = Baker::new(&run.loaded.model, &views, self.sh_degree);
        let made = baker.clip(&times, self.tolerance, &mut |k| progress.at(k as u64, || "baked".to_owned()))?;
        progress.finish();
        let title = self.out.file_stem().map_or_else(|| "scene".to_owned(), |s| s.to_string_lossy().into_owned());
        let start =
            kept.held_out.first().or(views.first()).map_or_else(Start::default, |v| first_view(v, &made, &views));
        let page = Page { title, start, background: run.background(), clock: kept.clock };
        let html = page.html(&made).map_err(ExportError::from)?;
        share.barrier()?;
        if share.leads() {
            write_file(&self.out, self.force, |out| out.write_all(html.as_bytes()))?;
        }
        share.barrier()?;
        let clip = gs4d_player::read(&read_text(&self.out, &global.limits())?).map_err(ExportError::from)?;
        let loss = dataset.map(|data| self.measure(&run, &data, &|time| clip.splats(time))).transpose()?;
        Ok((self.answer(&clip, html.len(), loss.as_ref()), loss))
    }

    /// What is lost in PSNR where a file plays these splats at a normalised time.
    pub(super) fn measure(
        &self,
        run: &OpenRun,
        data: &Dataset,
        played: &dyn Fn(f32) -> Splats,
    ) -> Result<Loss, Failure> {
        let (images, model, background) = (run.images(), &run.loaded.model, run.background());
        let split = self.split.into();
        let scoring = run.scoring(background, &images);
        let before = evaluate_with(model, data, split, &scoring)?;
        let after = evaluate_played(played, model, (data, split), &scoring)?;
        Ok(Loss::of(&before, &after, after.views.len()))
    }

    fn answer(&self, clip: &Clip, bytes: usize, loss: Option<&Loss>) -> Answer {
        let (splats, frames, moving, tolerance) = (clip.len(), clip.times().len(), clip.moving(), self.tolerance.0);
        let mut text = format!(
            "{splats} splats at {frames} times, {moving} of them move, {:.2} MB, read back whole\nno splat is displaced by more than \
             {tolerance} of its standard deviation in the image of the nearest camera\n",
            bytes as f64 / 1e6
        );
        text.push_str(&loss.map_or(String::new(), |l| l.line("from the page, read back")));
        text.push_str(&format!("-> {}: open it in any browser\n", self.out.display()));
        let file = self.out.display().to_string();
        Answer::new(
            text,
            json!({
                "file": file, "bytes": bytes, "splats": splats, "frames": frames, "moving": moving, "keys": clip.keys(),
                "tolerance": tolerance, "psnr": loss.map(Loss::to_json),
            }),
        )
    }
}

/// The times asked for, ascending; without any those of training, at most 60.
pub(super) fn ascending_times(asked: Option<&[f32]>, kept: &Kept) -> Vec<f32> {
    let mut times = asked.map_or_else(|| frame_times(&kept.times), <[f32]>::to_vec);
    times.sort_by(f32::total_cmp);
    times.dedup();
    times
}

/// What a view sees, orbiting around the middle of the splats.
fn first_view(view: &View, clip: &Clip, views: &[View]) -> Start {
    let means = clip.splats(clip.times().first().copied().unwrap_or(0.0)).means;
    let median = |axis: usize| {
        let mut all: Vec<f32> = means.iter().map(|m| m[axis]).collect();
        all.sort_by(f32::total_cmp);
        f64::from(all.get(all.len() / 2).copied().unwrap_or(0.0))
    };
    Start::of(&view.camera, DVec3::new(median(0), median(1), median(2)), mean_up(views))
}

impl From<PlayerError> for Failure {
    fn from(e: PlayerError) -> Self {
        ExportError::from(e).into()
    }
}
