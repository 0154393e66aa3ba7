//! A trained scene as a `.4dgs` file: `gs4d export -o NAME.4dgs`.

use super::loss::Loss;
use super::motion::Motion;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::progress::Progress;
use gs4d_eval::export::{Baker, ExportError};
use gs4d_player::{Spans, Tolerance};
use serde_json::json;

/// Writes a `.4dgs` file and reads it back; its answer, and what it lost in PSNR.
pub(super) fn run(motion: &Motion, tolerance: Tolerance, global: &Global) -> Result<(Answer, Option<Loss>), Failure> {
    let source = motion.open(global)?;
    let frames = source.times.len();
    let mut progress = Progress::new(frames as u64, "times", global.quiet);
    let baker = Baker::new(&source.run.loaded.model, &source.views, motion.sh_degree);
    if baker.antialiased() {
        global.say(
            "note: .4dgs files cannot say that splats are to be drawn anti-aliased: viewers draw small ones too opaque",
        );
    }
    let tick = &mut |k| progress.at(k as u64, || "baked".to_owned());
    let (made, splats) = baker.spans(&source.times, source.seconds(), tolerance, tick)?;
    progress.finish();
    let made = made.bytes().map_err(ExportError::from)?;
    let bytes = motion.write(&source, |out| out.write_all(&made), global)?;
    let read = Spans::read(&bytes).map_err(ExportError::from)?;
    let loss = motion.loss(&source, Some(false), &|time| Ok(read.splats(time)))?;
    let (gaussians, seconds) = (read.len(), read.duration());
    let holds = format!(
        "{splats} splats at {frames} times as {gaussians} Gaussians, each for a span of time, {seconds:.2} s in all"
    );
    let json = json!({
        "splats": splats, "frames": frames, "gaussians": gaussians, "seconds": seconds, "tolerance": tolerance.0,
    });
    Ok((motion.answer(&holds, loss.as_ref(), bytes.len(), json), loss))
}
