//! A trained scene as rigid parts in motion: `gs4d export --rigid -o NAME.glb`.

use super::eval::SplitName;
use super::export::Loss;
use super::player::ascending_times;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::opening::RunData;
use gs_core::io::glb::{read_scene, write_parts};
use gs_core::io::{read_file, write_file};
use gs_core::rot::Mat3;
use gs_data::View;
use gs_train::evaluate::evaluate_with;
use gs4d_eval::export::{Baker, evaluate_rigid};
use gs4d_run::Kept;
use serde_json::json;
use std::path::PathBuf;

/// Data without seconds are played in three, as in the viewer.
const SECONDS: f64 = 3.0;

/// What a file of rigid parts is made from and how.
pub struct Rigid {
    pub run: PathBuf,
    pub out: PathBuf,
    /// Normalised times of the key frames; those of training if there are none.
    pub times: Option<Vec<f32>>,
    pub sh_degree: Option<u8>,
    pub split: SplitName,
    pub no_eval: bool,
    pub force: bool,
    pub place: RunData,
}

/// How long a unit of normalised time plays.
pub fn played_seconds(kept: &Kept) -> f64 {
    kept.clock.filter(|[a, b]| *a < 0.0 || *b > 1.0).map_or(SECONDS, |[a, b]| b - a)
}

impl Rigid {
    /// Writes the file and reads it back; its answer, and what it lost in PSNR. `turn` gives the rotation of the file from the
    /// training views.
    pub fn run(
        self,
        turn: impl FnOnce(&[View]) -> Result<Option<Mat3<f64>>, Failure>,
        global: &Global,
    ) -> Result<(Answer, Option<Loss>), Failure> {
        let run = self.place.open(&self.run, global)?;
        // Opened first, so that nothing is written if the data are missing.
        let dataset = if self.no_eval { None } else { Some(run.open_data()?) };
        let (views, kept) = (run.training_views()?, run.kept().unwrap_or_default());
        let turn = turn(&views)?;
        let times = ascending_times(self.times.as_deref(), &kept);
        let first = times.first().copied().unwrap_or(0.0);
        let seconds = played_seconds(&kept);
        let model = &run.loaded.model;
        let baker = Baker::new(model, &views, self.sh_degree).turned(turn);
        let observed = kept.times.last().copied().unwrap_or(1.0);
        let made = baker.rigid(&times, seconds, observed)?;
        // One rank writes; the others read what it wrote.
        run.share.barrier()?;
        if run.share.leads() {
            write_file(&self.out, self.force, |out| write_parts(&made.parts, out))?;
        }
        run.share.barrier()?;
        let bytes = read_file(&self.out, &global.limits())?;
        let scene = read_scene(&bytes, &self.out.display().to_string(), &global.limits())?;
        let measure = |data: &gs_data::Dataset| {
            let (images, split) = (run.images(), self.split.into());
            let scoring = run.scoring(run.background(), &images);
            let before = evaluate_with(model, data, split, &scoring)?;
            let after = evaluate_rigid((&baker, &scene), (seconds, first), model, (data, split), &scoring)?;
            Ok::<_, Failure>(Loss::of(&before, &after, after.views.len()))
        };
        let loss = dataset.as_ref().map(measure).transpose()?;
        let (parts, moving, residual) = (made.parts.len(), made.moving, made.residual);
        let splats = scene.at(0.0).len();
        if moving == 0 {
            let text = "no part of the scene moves: a file of one moment holds it, too, without --rigid";
            global.say(format!("note: {text}"));
        }
        let mut text = format!(
            "{splats} splats in {parts} rigid parts, {moving} of them move, {} key frames over {:.2} s, {:.2} MB, read back whole\nsplats are {residual:.4} world units from where \
             their part takes them (root mean square)\n",
            times.len(),
            scene.duration(),
            bytes.len() as f64 / 1e6
        );
        text.push_str(&loss.as_ref().map_or(String::new(), |l| l.line("from the file, read back")));
        text.push_str(&format!("-> {}\n", self.out.display()));
        let json = json!({
            "file": self.out.display().to_string(), "bytes": bytes.len(), "splats": splats, "parts": parts, "moving": moving,
            "frames": times.len(), "seconds": scene.duration(), "residual": residual, "rotation": turn,
            "psnr": loss.as_ref().map(Loss::to_json),
        });
        Ok((Answer::new(text, json), loss))
    }
}
