//! A trained scene as a clip that plays in a page: its frames, its layers, its score.

use super::{Baker, ExportError};
use crate::layers;
use gs_core::{Camera, Splats};
use gs_data::{Dataset, Split};
use gs_raster::RasterOptions;
use gs_train::evaluate::{EvalError, EvalReport, Scoring, evaluate_splats};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::palette::color_scale;
use gs_train::timestamp::Timestamp;
use gs4d_player::{Clip, Frames, Layer, RenderSettings, Spans, Tolerance, words};

/// Most frames of a clip, unless more are asked for.
const MAX_FRAMES: usize = 60;

/// The times of the frames of a clip: those of the training images, ascending, or 60 evenly spaced where they are more.
pub fn frame_times(training: &[f32]) -> Vec<f32> {
    match training {
        [] => vec![0.0],
        [first, .., last] if training.len() > MAX_FRAMES => {
            let share = |k: usize| first + (last - first) * k as f32 / (MAX_FRAMES - 1) as f32;
            (0..MAX_FRAMES).map(share).collect()
        }
        all => all.to_vec(),
    }
}

impl Baker<'_> {
    /// The scene at ascending times as a clip that is rendered as the model is, with the layers of the method. Parts are those of the motion up
    /// to `observed`, the last training time.
    ///
    /// # Errors
    /// If the splats of a time are not valid, differ in number, or none is visible.
    pub fn clip(
        &self,
        times: &[f32],
        observed: f32,
        tolerance: Tolerance,
        tick: &mut dyn FnMut(usize),
    ) -> Result<Clip, ExportError> {
        let frames = self.frames(times, &|splats| splats, tick)?;
        let layers = clip_layers(self.method, &frames, times[times.len() / 2], observed)?;
        let RasterOptions { near, dilation, antialias, .. } = self.method.raster_options([0.0; 3]);
        let settings = RenderSettings { near, dilation, antialias };
        Ok(Clip::fit(&frames, &self.poses, tolerance).with_layers(layers).with_render_settings(settings))
    }

    /// The scene at ascending times as Gaussians that each last for a span, a unit of normalised time for `seconds`; and the number of
    /// its splats.
    ///
    /// # Errors
    /// As [`Self::clip`].
    pub fn spans(
        &self,
        times: &[f32],
        seconds: f64,
        tolerance: Tolerance,
        tick: &mut dyn FnMut(usize),
    ) -> Result<(Spans, usize), ExportError> {
        let frames = self.frames(times, &Splats::with_plain_kernel, tick)?;
        Ok((Spans::fit(&frames, &self.poses, tolerance, seconds), frames.len()))
    }

    /// The scene at ascending times, its splats as `kept`.
    fn frames(
        &self,
        times: &[f32],
        kept: &dyn Fn(Splats) -> Splats,
        tick: &mut dyn FnMut(usize),
    ) -> Result<Frames, ExportError> {
        let mut splats = Vec::with_capacity(times.len());
        for (k, &time) in times.iter().enumerate() {
            splats.push(kept(self.truncated(self.averaged(&Timestamp::normalised(time))?)));
            tick(k + 1);
        }
        Ok(Frames::new(times.to_vec(), splats)?)
    }
}

/// Lengths of paths, rigid parts where there are any, and what the method offers at a time in the middle.
fn clip_layers(method: &Model, frames: &Frames, time: f32, observed: f32) -> Result<Vec<Layer>, ExportError> {
    let at = Timestamp::normalised(time);
    let layer = |name: &str, meaning: String, colors: &[[f32; 3]]| {
        let row = |&i: &usize| colors.get(i).copied().unwrap_or_default().map(words::unit);
        Layer { name: name.to_owned(), meaning, colors: frames.rows().iter().map(row).collect() }
    };
    let mut out = Vec::new();
    if frames.times().len() > 1 {
        let (colors, most) = paths(frames);
        let meaning = format!("length of the path: dark blue rests, pale yellow {most:.3} world units or more");
        out.push(Layer { name: "path".to_owned(), meaning, colors });
        if let Ok(labels) = layers::parts(method, observed) {
            let meaning = format!("rigid parts: {}", labels.k);
            out.push(layer("parts", meaning, &layers::part_colors(&labels)));
        }
    }
    for layers::Layer { overlay, .. } in layers::all(method, &at)? {
        out.push(layer(overlay.name, overlay.meaning.to_owned(), &overlay.colors));
    }
    Ok(out)
}

/// The length of the path of each splat as a colour, and that of the brightest: 98 of 100 splats move less.
fn paths(frames: &Frames) -> (Vec<[u8; 3]>, f32) {
    let steps = frames.splats().windows(2);
    let mut lengths = vec![0.0f32; frames.len()];
    for pair in steps {
        for (sum, (a, b)) in lengths.iter_mut().zip(pair[0].means.iter().zip(&pair[1].means)) {
            *sum += a.distance(*b);
        }
    }
    let mut sorted = lengths.clone();
    sorted.sort_by(f32::total_cmp);
    let most = sorted[sorted.len() * 98 / 100].max(f32::MIN_POSITIVE);
    let color = |length: &f32| color_scale((length / most).min(1.0)).map(words::unit);
    (lengths.iter().map(color).collect(), most)
}

/// Scores on a split of what a file plays at a normalised time, as the method itself is scored. `scoring.plain` says how the file is
/// drawn: a page as the model is, other files as programs draw that know splats alone.
///
/// # Errors
/// Those of the evaluation.
pub fn evaluate_played(
    played: &dyn Fn(f32) -> Result<Splats, MethodError>,
    method: &Model,
    (dataset, split): (&Dataset, Split),
    scoring: &Scoring<'_>,
) -> Result<EvalReport, EvalError> {
    evaluate_splats(method, &|at: &Timestamp, _: &Camera| played(at.t.normalised), dataset, split, scoring)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_the_training_times_or_sixty() {
        assert_eq!(frame_times(&[]), [0.0]);
        assert_eq!(frame_times(&[0.25]), [0.25]);
        assert_eq!(frame_times(&[0.0, 0.5, 1.0]), [0.0, 0.5, 1.0]);
        let many: Vec<f32> = (0..100).map(|k| 0.01 * k as f32).collect();
        let times = frame_times(&many);
        assert_eq!((times.len(), times[0]), (60, 0.0));
        assert!((times[59] - 0.99).abs() < 1e-6 && times.is_sorted());
    }
}
