//! A trained scene as a `.4dgs` file: `gs4d export -o NAME.4dgs`.

use super::export::Loss;
use super::export_rigid::played_seconds;
use super::player::{Player, ascending_times};
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::progress::Progress;
use gs_core::io::{read_file, write_file};
use gs4d_eval::export::{Baker, ExportError};
use gs4d_player::Spans;
use serde_json::json;

impl Player {
    /// Writes a `.4dgs` file and reads it back; its answer, and what it lost in PSNR.
    pub fn run_spans(self, global: &Global) -> Result<(Answer, Option<Loss>), Failure> {
        let run = self.place.open(&self.run, global)?;
        // Opened first, so that nothing is written if the data are missing.
        let dataset = if self.no_eval { None } else { Some(run.open_data()?) };
        let (views, kept) = (run.training_views()?, run.kept().unwrap_or_default());
        let (times, seconds) = (ascending_times(self.times.as_deref(), &kept), played_seconds(&kept));
        let mut progress = Progress::new(times.len() as u64, "times", global.quiet);
        let baker = Baker::new(&run.loaded.model, &views, self.sh_degree);
        let tick = &mut |k| progress.at(k as u64, || "baked".to_owned());
        let (made, splats) = baker.spans(&times, seconds, self.tolerance, tick)?;
        progress.finish();
        let bytes = made.bytes().map_err(ExportError::from)?;
        // One rank writes; the others read what it wrote.
        run.share.barrier()?;
        if run.share.leads() {
            write_file(&self.out, self.force, |out| out.write_all(&bytes))?;
        }
        run.share.barrier()?;
        let read = Spans::read(&read_file(&self.out, &global.limits())?).map_err(ExportError::from)?;
        let loss = dataset.map(|data| self.measure(&run, &data, &|time| read.splats(time))).transpose()?;
        let mut text = format!(
            "{splats} splats at {} times as {} Gaussians, each for a span of time, {:.2} s in all, {:.2} MB, read back whole\n",
            times.len(),
            read.len(),
            read.duration(),
            bytes.len() as f64 / 1e6
        );
        text.push_str(&loss.as_ref().map_or(String::new(), |l| l.line("from the file, read back")));
        text.push_str(&format!("-> {}\n", self.out.display()));
        let json = json!({
            "file": self.out.display().to_string(), "bytes": bytes.len(), "splats": splats, "frames": times.len(),
            "gaussians": read.len(), "seconds": read.duration(), "tolerance": self.tolerance.0,
            "psnr": loss.as_ref().map(Loss::to_json),
        });
        Ok((Answer::new(text, json), loss))
    }
}
