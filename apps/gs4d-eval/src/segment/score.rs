//! Masks of the views of a split against true ones.

use std::collections::BTreeMap;

use gs_core::Image;
use gs_metrics::{Overlap, SegmentScores, Segmentation};
use serde::Serialize;

use super::{Labels, Mask, Masker, SegmentError, TrueLabels, color};
use gs_data::{ImageCache, View};
use gs_train::evaluate::clamped;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;

/// How masks were compared, in words, for the report.
pub const PROTOCOL: &str = "an id of a view is matched at IoU >= 0.5, background is an id; counts over all views; \
     miou: ids present, miou_strict: ids 0 to the largest present (NVFi)";
/// Views by which colours are chosen.
const FEW: usize = 8;

/// Scores over views, as JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Average precision at IoU ½.
    pub ap: f64,
    /// Panoptic quality.
    pub pq: f64,
    /// Harmonic mean of precision and recall.
    pub f1: f64,
    /// Part of the predicted instances that are matched.
    pub precision: f64,
    /// Part of the true instances that are matched.
    pub recall: f64,
    /// Mean IoU of true instances that are present.
    pub miou: f64,
    /// Mean IoU over ids from 0 to the largest present (NVFi).
    pub miou_strict: f64,
    /// Views scored.
    pub views: usize,
}

impl From<SegmentScores> for Scores {
    fn from(s: SegmentScores) -> Self {
        let SegmentScores { ap, pq, f1, precision, recall, miou, miou_strict, images } = s;
        Self { ap, pq, f1, precision, recall, miou, miou_strict, views: images }
    }
}

/// A view with its mask.
#[derive(Clone, Debug)]
pub struct ViewMask<'a> {
    /// The view.
    pub view: &'a View,
    /// What part each pixel shows.
    pub mask: Mask,
    /// Its true labels, where there are any.
    pub truth: Option<Vec<u32>>,
    /// The id of whose colour each part is shown in: a true one where parts are aligned with those.
    pub shown_as: &'a BTreeMap<u32, u32>,
    /// The method's picture, RGB.
    pub picture: Image,
}

impl ViewMask<'_> {
    /// The mask in colours, `[H, W, 3]`.
    pub fn colored(&self) -> Image {
        let shown = |id: &u32| color(self.shown_as.get(id).copied().unwrap_or(*id));
        let data = self.mask.ids.iter().flat_map(shown).collect();
        Image { width: self.mask.width, height: self.mask.height, channels: 3, data }
    }

    /// The picture with the mask over it, half and half; the background keeps its colours.
    pub fn overlaid(&self) -> Image {
        let mut out = self.colored();
        let pixels = out.data.chunks_exact_mut(3).zip(self.picture.data.chunks_exact(3)).zip(&self.mask.ids);
        for ((out, picture), id) in pixels {
            let share = if *id == 0 { 0.0 } else { 0.5 };
            out.iter_mut().zip(picture).for_each(|(o, p)| *o = share * *o + (1.0 - share) * p);
        }
        out
    }
}

/// Draws the mask of every view, in order, scores those that have true labels, and hands each over. No scores without truth.
///
/// # Errors
/// If true labels cannot be read or do not fit; and whatever `each` returns.
pub fn study<'a, E: From<SegmentError>>(
    method: &Model,
    labels: &Labels,
    (split, views): (&str, &'a [View]),
    truth: Option<&TrueLabels>,
    (photographs, background): (&ImageCache, [f32; 3]),
    mut each: impl FnMut(ViewMask<'_>) -> Result<(), E>,
) -> Result<Option<Scores>, E> {
    let options = method.raster_options(background);
    let (mut masker, mut renderer) = (Masker::new(options.clone()), Renderer::new(options));
    let mut look = |view: &'a View| -> Result<_, SegmentError> {
        let camera = photographs.camera(view);
        let splats = method.all_splats(&Timestamp::new(view.time), &camera)?;
        let mask = masker.draw(&splats, &labels.of, labels.k, &camera);
        let truth = truth.map(|t| t.of(view, split, &camera)).transpose()?.flatten();
        Ok((mask, truth, splats, camera))
    };
    let mut overlap = Overlap::default();
    for view in views.iter().step_by(views.len().div_ceil(FEW).max(1)) {
        let (mask, truth, ..) = look(view)?;
        if let Some(truth) = truth {
            overlap.add(&mask.ids, &truth).map_err(SegmentError::from)?;
        }
    }
    let shown_as = shown_as(&overlap, labels.k);
    let mut all = Segmentation::default();
    for view in views {
        let (mask, truth, splats, camera) = look(view)?;
        if let Some(truth) = &truth {
            all.add(&mask.ids, truth, &mask.confidence).map_err(SegmentError::from)?;
        }
        let picture = clamped(renderer.render(&splats, &camera));
        each(ViewMask { view, mask, truth, shown_as: &shown_as, picture })?;
    }
    Ok(all.scores().map(Scores::from))
}

/// The id that each part is coloured as: the true one it is aligned with, else one that no part has.
fn shown_as(overlap: &Overlap, k: usize) -> BTreeMap<u32, u32> {
    let mut shown = overlap.aligned();
    shown.insert(0, 0);
    let mut free = (1..).filter({
        let taken: Vec<u32> = shown.values().copied().collect();
        move |id| !taken.contains(id)
    });
    for id in 1..=k as u32 {
        if shown.get(&id).is_none_or(|to| *to == 0) {
            shown.insert(id, free.next().unwrap_or(id));
        }
    }
    shown
}
