//! Part masks of the views of a split, scored against ground truth.

use std::collections::BTreeMap;

use gs_core::{Image, cast};
use gs_metrics::{Overlap, SegmentScores, Segmentation};
use serde::Serialize;

use super::{Labels, Mask, Masker, SegmentError, TrueLabels, color};
use crate::Placing;
use gs_data::{ImageCache, View};
use gs_train::evaluate::clamped;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;

/// The conditions of the scores, in words.
pub const PROTOCOL: &str = "an id of a view is matched at IoU >= 0.5, background is an id; counts over all views; \
     miou: ids present, miou_strict: ids 0 to the largest present (NVFi)";
/// Number of views by which parts are aligned with true ids.
const ALIGNMENT_VIEWS: usize = 8;

/// Segmentation scores over all views, each 0..1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Average precision at an IoU of 0.5.
    pub ap: f64,
    /// Panoptic quality at an IoU of 0.5.
    pub pq: f64,
    /// Harmonic mean of precision and recall.
    pub f1: f64,
    /// Share of predicted instances that are matched.
    pub precision: f64,
    /// Share of true instances that are matched.
    pub recall: f64,
    /// Mean IoU over the true instances that are present.
    pub miou: f64,
    /// Mean IoU over ids from 0 to the largest present (NVFi).
    pub miou_strict: f64,
    /// Number of views with labels, those scored.
    pub views: usize,
}

impl From<SegmentScores> for Scores {
    fn from(s: SegmentScores) -> Self {
        let SegmentScores { ap, pq, f1, precision, recall, miou, miou_strict, images } = s;
        Self { ap, pq, f1, precision, recall, miou, miou_strict, views: images }
    }
}

/// A view with its mask and render.
#[derive(Clone, Debug)]
pub struct ViewMask<'a> {
    /// The view of the data set.
    pub view: &'a View,
    /// The mask rendered from the model.
    pub mask: Mask,
    /// Ground-truth labels at the pixels of the mask, where there are any.
    pub truth: Option<Vec<u32>>,
    /// The id whose colour each part gets: the true one it is aligned with, if any.
    pub shown_as: &'a BTreeMap<u32, u32>,
    /// The render, RGB, `[H, W, 3]`.
    pub picture: Image,
}

impl ViewMask<'_> {
    /// The mask in colours, `[H, W, 3]`.
    pub fn colored(&self) -> Image {
        let shown = |id: &u32| color(self.shown_as.get(id).copied().unwrap_or(*id));
        let data = self.mask.ids.iter().flat_map(shown).collect();
        Image { width: self.mask.width, height: self.mask.height, channels: 3, data }
    }

    /// The render blended with the coloured mask, half and half; the background keeps its colours.
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

/// Renders the mask of every view, in order, scores those that have ground truth, and passes each to `each`. `None` without
/// ground truth. `split` is the name of the views' split, for folders of label images. `placed` gives a view as it is rendered:
/// where its camera was refined, at its own time; its truth is that of the data's view.
///
/// # Errors
/// If labels cannot be read or have the wrong shape; and whatever `each` returns.
pub fn study<'a, E: From<SegmentError>>(
    method: &Model,
    labels: &Labels,
    (split, views): (&str, &'a [View]),
    truth: Option<&TrueLabels>,
    (images, background, placed): (&ImageCache, [f32; 3], &Placing<'_>),
    mut each: impl FnMut(ViewMask<'_>) -> Result<(), E>,
) -> Result<Option<Scores>, E> {
    let options = method.raster_options(background);
    let (mut masker, mut renderer) = (Masker::new(options.clone()), Renderer::new(options));
    let mut render_mask = |view: &'a View| -> Result<_, SegmentError> {
        let shown = placed(view);
        let camera = images.camera(&shown);
        let splats = method.all_splats(&Timestamp::new(shown.time), &camera)?;
        let mask = masker.draw(&splats, &labels.of, labels.k, &camera)?;
        let truth = truth.map(|t| t.of(view, split, &images.camera(view))).transpose()?.flatten();
        Ok((mask, truth, splats, camera))
    };
    let mut overlap = Overlap::default();
    for k in gs_data::evenly(views.len(), ALIGNMENT_VIEWS) {
        let (mask, truth, ..) = render_mask(&views[k])?;
        if let Some(truth) = truth {
            overlap.add(&mask.ids, &truth).map_err(SegmentError::from)?;
        }
    }
    let shown_as = shown_as(&overlap, labels.k);
    let mut all = Segmentation::default();
    for view in views {
        let (mask, truth, splats, camera) = render_mask(view)?;
        if let Some(truth) = &truth {
            all.add(&mask.ids, truth, &mask.confidence).map_err(SegmentError::from)?;
        }
        let picture = clamped(renderer.render(&splats, &camera).map_err(SegmentError::from)?);
        each(ViewMask { view, mask, truth, shown_as: &shown_as, picture })?;
    }
    Ok(all.scores().map(Scores::from))
}

/// The id whose colour each part gets: the true one it is aligned with, else an unused one.
fn shown_as(overlap: &Overlap, k: usize) -> BTreeMap<u32, u32> {
    let mut shown = overlap.aligned();
    shown.insert(0, 0);
    let mut free = (1..).filter({
        let taken: Vec<u32> = shown.values().copied().collect();
        move |id| !taken.contains(id)
    });
    for id in 1..=cast::to_u32(k) {
        if shown.get(&id).is_none_or(|to| *to == 0) {
            shown.insert(id, free.next().unwrap_or(id));
        }
    }
    shown
}
