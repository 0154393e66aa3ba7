//! A trained scene as one web page that plays it: `gs4d export -o NAME.html`.

use super::loss::Loss;
use super::motion::Motion;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::progress::Progress;
use glam::DVec3;
use gs_data::View;
use gs4d_eval::export::{Baker, ExportError, mean_up};
use gs4d_player::{Clip, Page, PlayerError, Start, Tolerance};
use serde_json::json;

/// Writes the page and reads it back; its answer, and what it lost in PSNR.
pub(super) fn run(motion: &Motion, tolerance: Tolerance, global: &Global) -> Result<(Answer, Option<Loss>), Failure> {
    let source = motion.open(global)?;
    let mut progress = Progress::new(source.times.len() as u64, "times", global.quiet);
    let baker = Baker::new(&source.run.loaded.model, &source.views, motion.sh_degree);
    let made = baker
        .clip(&source.times, source.observed(), tolerance, &mut |k| progress.at(k as u64, || "baked".to_owned()))?;
    progress.finish();
    let title = motion.out.file_stem().map_or_else(|| "scene".to_owned(), |s| s.to_string_lossy().into_owned());
    let (kept, views) = (&source.kept, &source.views);
    let start = kept.held_out.first().or(views.first()).map_or_else(Start::default, |v| first_view(v, &made, views));
    let page = Page { title, start, background: source.run.background(), clock: kept.seconds() };
    let html = page.html(&made).map_err(ExportError::from)?;
    let bytes = motion.write(&source, |out| out.write_all(html.as_bytes()), global)?;
    let clip = gs4d_player::read(&String::from_utf8_lossy(&bytes)).map_err(ExportError::from)?;
    let loss = motion.loss(&source, None, &|time| Ok(clip.splats(time)))?;
    let (splats, frames, moving) = (clip.len(), clip.times().len(), clip.moving());
    let holds = format!(
        "{splats} splats at {frames} times, {moving} of them move\nno coordinate of a splat is off by more than {} of its standard deviation in \
         the image of the nearest camera\nopen it in any browser",
        tolerance.0
    );
    let json = json!({
        "splats": splats, "frames": frames, "moving": moving, "keys": clip.keys(), "tolerance": tolerance.0,
    });
    Ok((motion.answer(&holds, loss.as_ref(), bytes.len(), json), loss))
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
