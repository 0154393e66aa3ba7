//! Predicted instance masks against ground-truth masks: AP, PQ, F1, precision, recall and mIoU over many images (NVFi, OGC).
//!
//! Masks are label images: one id per pixel, any `u32`. Background is an id like any other, and ids of prediction and ground
//! truth need not correspond. In an image a predicted instance (an id that is present) is *matched* if it overlaps a
//! ground-truth one with `IoU ≥ ½`:
//! ```text
//! TP, FP, FN over all images     Pre = TP / (TP + FP)     Rec = TP / (TP + FN)     F1 = 2 Pre Rec / (Pre + Rec)
//! PQ = Σ IoU of the matched / (TP + ½ FP + ½ FN)
//! AP = mean over recalls 0, 0.01 … 1 of the best precision at that recall or more, predictions by descending confidence
//! mIoU = mean over images of the mean IoU of ground-truth instances under the best assignment (Hungarian) to predicted ones
//! ```
//! A ground-truth instance is matched at most once. (Masks of one image do not overlap, so only an instance cut into two exact
//! halves could be matched twice; recall would then exceed 1.) The mIoU of NVFi is the mean over ids `0 … largest id present`,
//! where ids absent from the image count 0 ([`SegmentScores::miou_strict`]); [`SegmentScores::miou`] is the mean over ids that
//! are present.
//!
//! ```
//! use gs_metrics::Segmentation;
//! let truth = [0, 0, 0, 0, 1, 1, 1, 1];
//! let predicted = [7, 7, 7, 5, 5, 5, 5, 5];
//! let mut all = Segmentation::default();
//! all.add(&predicted, &truth, &[1.0; 8])?;
//! let scores = all.scores().unwrap();
//! assert_eq!((scores.precision, scores.recall), (1.0, 1.0));
//! assert!((scores.miou - (3.0 / 4.0 + 4.0 / 5.0) / 2.0).abs() < 1e-12);
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use std::collections::BTreeMap;

use crate::MetricError;

mod assignment;

pub use assignment::assign;

/// Smallest IoU at which an instance is matched.
pub const MATCH_IOU: f64 = 0.5;

/// Numbers of pixels of every pair of a predicted and a ground-truth id (a contingency table).
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Overlap {
    predicted: BTreeMap<u32, u64>,
    truth: BTreeMap<u32, u64>,
    both: BTreeMap<(u32, u32), u64>,
}

impl Overlap {
    /// Counts the pixels of two label images in the same order.
    ///
    /// # Errors
    /// If the numbers of pixels differ.
    pub fn of(predicted: &[u32], truth: &[u32]) -> Result<Self, MetricError> {
        let mut overlap = Self::default();
        overlap.add(predicted, truth)?;
        Ok(overlap)
    }

    /// Adds the pixels of another image in which the ids have the same meaning.
    ///
    /// # Errors
    /// If the numbers of pixels differ.
    pub fn add(&mut self, predicted: &[u32], truth: &[u32]) -> Result<(), MetricError> {
        let shape = |labels: &[u32]| (labels.len(), 1, 1);
        if predicted.len() != truth.len() {
            let (first, second) = (shape(predicted), shape(truth));
            return Err(MetricError::Shape { what: "predicted and true labels", first, second });
        }
        for (&p, &t) in predicted.iter().zip(truth) {
            *self.predicted.entry(p).or_default() += 1;
            *self.truth.entry(t).or_default() += 1;
            *self.both.entry((p, t)).or_default() += 1;
        }
        Ok(())
    }

    /// All predicted ids present, in ascending order.
    pub fn predicted(&self) -> Vec<u32> {
        self.predicted.keys().copied().collect()
    }

    /// All ground-truth ids present, in ascending order.
    pub fn truth(&self) -> Vec<u32> {
        self.truth.keys().copied().collect()
    }

    /// Number of pixels with this predicted id and this ground-truth id.
    pub fn shared(&self, predicted: u32, truth: u32) -> u64 {
        self.both.get(&(predicted, truth)).copied().unwrap_or(0)
    }

    /// Intersection over union of two ids, in `[0, 1]`; 0 if neither is present.
    pub fn iou(&self, predicted: u32, truth: u32) -> f64 {
        let count = |of: &BTreeMap<u32, u64>, id| of.get(&id).copied().unwrap_or(0);
        let shared = self.shared(predicted, truth);
        let union = count(&self.predicted, predicted) + count(&self.truth, truth) - shared;
        if union == 0 { 0.0 } else { shared as f64 / union as f64 }
    }

    /// The one-to-one assignment of predicted ids to ground-truth ids under which most pixels agree, for consistent colours over a
    /// sequence. Predicted ids without a partner, or without a shared pixel, have no entry.
    pub fn aligned(&self) -> BTreeMap<u32, u32> {
        let (rows, columns) = (self.predicted(), self.truth());
        let cost: Vec<f64> =
            rows.iter().flat_map(|&p| columns.iter().map(move |&t| -(self.shared(p, t) as f64))).collect();
        let pairs = rows.iter().zip(assign(&cost, rows.len(), columns.len()));
        pairs.filter_map(|(&p, t)| t.map(|t| (p, columns[t]))).filter(|&(p, t)| self.shared(p, t) > 0).collect()
    }
}

/// Segmentation scores over all images, each in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SegmentScores {
    /// Average precision at `IoU ≥ ½`, 101 recalls.
    pub ap: f64,
    /// Panoptic quality: the sum of the matched IoUs over `TP + ½ FP + ½ FN`.
    pub pq: f64,
    /// Harmonic mean of precision and recall.
    pub f1: f64,
    /// Share of the predicted instances that are matched.
    pub precision: f64,
    /// Share of the ground-truth instances that are matched.
    pub recall: f64,
    /// Mean over images of the mean IoU of the ground-truth instances present.
    pub miou: f64,
    /// As `miou`, but over ids `0 … largest id present`, where absent ids count 0 (NVFi).
    pub miou_strict: f64,
    /// Number of images that were added.
    pub images: usize,
}

/// A predicted instance of one image.
#[derive(Clone, Copy, Debug)]
struct Instance {
    confidence: f64,
    matched: bool,
}

/// Accumulates label images and gives their [`SegmentScores`].
#[derive(Clone, Debug, Default)]
pub struct Segmentation {
    instances: Vec<Instance>,
    true_instances: usize,
    matched_iou: f64,
    miou: f64,
    miou_strict: f64,
    images: usize,
}

impl Segmentation {
    /// Adds an image: a predicted id, a ground-truth id and the confidence of the prediction (0 to 1) at every pixel. The
    /// confidence of an instance is the mean over its pixels.
    ///
    /// # Errors
    /// If the lists differ in length, are empty, or a confidence is not finite.
    pub fn add(&mut self, predicted: &[u32], truth: &[u32], confidence: &[f32]) -> Result<(), MetricError> {
        let shape = |n: usize| (n, 1, 1);
        if confidence.len() != predicted.len() || predicted.is_empty() {
            let (first, second) = (shape(predicted.len()), shape(confidence.len()));
            return Err(MetricError::Shape { what: "predicted labels and their confidence", first, second });
        }
        if let Some(x) = confidence.iter().position(|c| !c.is_finite()) {
            return Err(MetricError::NotFinite { which: "of confidences", x, y: 0, channel: 0 });
        }
        let overlap = Overlap::of(predicted, truth)?;
        let mut confidences: BTreeMap<u32, f64> = BTreeMap::new();
        for (id, c) in predicted.iter().zip(confidence) {
            *confidences.entry(*id).or_default() += f64::from(*c);
        }
        let mut taken = Vec::new();
        for (id, pixels) in &overlap.predicted {
            let best = overlap.truth.keys().map(|t| (overlap.iou(*id, *t), *t));
            let best = best.filter(|(_, t)| !taken.contains(t)).fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a });
            let matched = best.0 >= MATCH_IOU;
            if matched {
                taken.push(best.1);
                self.matched_iou += best.0;
            }
            self.instances.push(Instance { confidence: confidences[id] / *pixels as f64, matched });
        }
        self.true_instances += overlap.truth.len();
        let (sum, largest) = (assigned_iou(&overlap), overlap.truth.keys().max().copied().unwrap_or(0));
        self.miou += sum / overlap.truth.len() as f64;
        self.miou_strict += sum / (f64::from(largest) + 1.0);
        self.images += 1;
        Ok(())
    }

    /// The scores of all images; `None` without an image.
    pub fn scores(&self) -> Option<SegmentScores> {
        let images = Some(self.images).filter(|n| *n > 0)?;
        let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
        let tp = self.instances.iter().filter(|i| i.matched).count() as f64;
        let (predicted, truth) = (self.instances.len() as f64, self.true_instances as f64);
        let (precision, recall) = (ratio(tp, predicted), ratio(tp, truth));
        Some(SegmentScores {
            ap: average_precision(&self.instances, self.true_instances),
            // TP + ½ FP + ½ FN is half the number of all instances, predicted and ground-truth.
            pq: ratio(self.matched_iou, 0.5 * (predicted + truth)),
            f1: ratio(2.0 * precision * recall, precision + recall),
            precision,
            recall,
            miou: self.miou / images as f64,
            miou_strict: self.miou_strict / images as f64,
            images,
        })
    }
}

/// Sum of the IoUs of the ground-truth instances under the best assignment.
fn assigned_iou(overlap: &Overlap) -> f64 {
    let (rows, columns) = (overlap.truth(), overlap.predicted());
    let iou: Vec<f64> = rows.iter().flat_map(|&t| columns.iter().map(move |&p| overlap.iou(p, t))).collect();
    let cost: Vec<f64> = iou.iter().map(|v| -v).collect();
    let pairs = assign(&cost, rows.len(), columns.len());
    pairs.iter().enumerate().filter_map(|(r, c)| c.map(|c| iou[r * columns.len() + c])).sum()
}

/// Area under the envelope of precision over recall, sampled at 101 recalls.
fn average_precision(instances: &[Instance], truth: usize) -> f64 {
    let mut order: Vec<&Instance> = instances.iter().collect();
    order.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    let mut curve: Vec<(f64, f64)> = Vec::with_capacity(order.len());
    let mut matched = 0;
    for (seen, instance) in order.iter().enumerate() {
        matched += usize::from(instance.matched);
        curve.push((matched as f64 / truth.max(1) as f64, matched as f64 / (seen + 1) as f64));
    }
    let mut best: f64 = 0.0;
    for point in curve.iter_mut().rev() {
        best = best.max(point.1);
        point.1 = best;
    }
    let at = |recall: f64| curve.get(curve.partition_point(|p| p.0 < recall)).map_or(0.0, |p| p.1);
    (0..=100).map(|k| at(f64::from(k) / 100.0)).sum::<f64>() / 101.0
}

#[cfg(test)]
mod tests;
