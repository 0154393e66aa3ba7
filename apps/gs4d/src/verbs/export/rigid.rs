//! A trained scene as rigid parts in motion: `gs4d export --rigid -o NAME.glb`.

use super::loss::Loss;
use super::motion::Motion;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use gs_core::io::SplatFormat;
use gs_core::io::glb::{read_scene, write_parts};
use gs_core::rot::Mat3;
use gs_data::View;
use gs4d_eval::export::Baker;
use serde_json::json;

/// Writes the file and reads it back; its answer, and what it lost in PSNR. `turn` gives the rotation of the file from the training
/// views.
pub(super) fn run(
    motion: &Motion,
    turn: impl FnOnce(&[View]) -> Result<Option<Mat3<f64>>, Failure>,
    global: &Global,
) -> Result<(Answer, Option<Loss>), Failure> {
    let source = motion.open(global)?;
    let turn = turn(&source.views)?;
    let (first, seconds) = (source.times.first().copied().unwrap_or(0.0), source.seconds());
    let baker = Baker::new(&source.run.loaded.model, &source.views, motion.sh_degree).turned(turn);
    let made = baker.rigid(&source.times, seconds, source.observed())?;
    if let Some(note) = made.parts.first().and_then(|part| SplatFormat::Glb.note(&part.splats)) {
        global.say(format!("note: {note}"));
    }
    let bytes = motion.write(&source, |out| write_parts(&made.parts, out), global)?;
    let scene = read_scene(&bytes, &motion.out.display().to_string(), &global.limits())?;
    let loss = motion.loss(&source, Some(false), &|time| baker.rigid_splats(&scene, seconds, first, time))?;
    let (parts, moving, residual) = (made.parts.len(), made.moving, made.residual);
    let (splats, frames, duration) = (scene.at(0.0).len(), source.times.len(), scene.duration());
    if moving == 0 {
        global.say("note: no part of the scene moves: a file of one moment holds it, too, without --rigid".to_owned());
    }
    let holds = format!(
        "{splats} splats in {parts} rigid parts, {moving} of them move, {frames} key frames over {duration:.2} s\nsplats are {residual:.4} \
         world units from where their part takes them (root mean square)"
    );
    let json = json!({
        "splats": splats, "parts": parts, "moving": moving, "frames": frames, "seconds": duration, "residual": residual,
        "rotation": turn,
    });
    Ok((motion.answer(&holds, loss.as_ref(), bytes.len(), json), loss))
}
