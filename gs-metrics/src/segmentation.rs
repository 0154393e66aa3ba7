//! Instance masks against true ones: AP, PQ, F1, precision, recall and mIoU (NVFi, OGC), over many images.
//!
//! Masks are label images: one id per pixel, any `u32`; background is an id like any other, and ids of prediction and truth need
//! not correspond. Per image a predicted instance (an id that is present) is *matched* if it overlaps a true one with
//! `IoU ≥ ½`:
//! ```text
//! TP, FP, FN over all images     Pre = TP / (TP + FP)     Rec = TP / (TP + FN)     F1 = 2 Pre Rec / (Pre + Rec)
//! PQ = Σ IoU of the matched / (TP + ½ FP + ½ FN)
//! AP = mean over recalls 0, 0.01 … 1 of the best precision at that recall or more, predictions in falling order of confidence
//! mIoU = mean over images of the mean IoU of true instances under the best assignment (Hungarian) to predicted ones
//! ```
//! A true instance is matched once: masks of one image do not overlap, so only an instance cut into two exact halves could be
//! matched twice, and recall then would exceed 1. NVFi's mIoU takes the mean over ids `0 … largest id present`, and ids
//! absent from the image count 0 ([`SegmentScores::miou_strict`]); [`SegmentScores::miou`] counts those that are present.

use std::collections::BTreeMap;

use crate::MetricError;

pub mod assignment;

pub use assignment::assign;

/// Overlap from which an instance is matched.
pub const MATCH: f64 = 0.5;

/// How predicted and true ids of one image overlap: pixels of every pair of ids.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Overlap {
    predicted: BTreeMap<u32, u64>,
    truth: BTreeMap<u32, u64>,
    both: BTreeMap<(u32, u32), u64>,
}

impl Overlap {
    /// Of two label images in the same order.
    ///
    /// # Errors
    /// If they have not the same number of pixels.
    pub fn of(predicted: &[u32], truth: &[u32]) -> Result<Self, MetricError> {
        let mut overlap = Self::default();
        overlap.add(predicted, truth)?;
        Ok(overlap)
    }

    /// Adds the pixels of another image, whose ids mean the same.
    ///
    /// # Errors
    /// If they have not the same number of pixels.
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

    /// Predicted ids, ascending.
    pub fn predicted(&self) -> Vec<u32> {
        self.predicted.keys().copied().collect()
    }

    /// True ids, ascending.
    pub fn truth(&self) -> Vec<u32> {
        self.truth.keys().copied().collect()
    }

    /// Pixels that have both ids.
    pub fn shared(&self, predicted: u32, truth: u32) -> u64 {
        self.both.get(&(predicted, truth)).copied().unwrap_or(0)
    }

    /// Intersection over union of two ids; 0 if neither is present.
    pub fn iou(&self, predicted: u32, truth: u32) -> f64 {
        let count = |of: &BTreeMap<u32, u64>, id| of.get(&id).copied().unwrap_or(0);
        let shared = self.shared(predicted, truth);
        let union = count(&self.predicted, predicted) + count(&self.truth, truth) - shared;
        if union == 0 { 0.0 } else { shared as f64 / union as f64 }
    }

    /// The true id that each predicted id stands for, one to one, so that most pixels agree: for the same colours over a
    /// sequence. Ids beyond the number of true ones have no entry.
    pub fn aligned(&self) -> BTreeMap<u32, u32> {
        let (rows, columns) = (self.predicted(), self.truth());
        let cost: Vec<f64> =
            rows.iter().flat_map(|&p| columns.iter().map(move |&t| -(self.shared(p, t) as f64))).collect();
        let pairs = rows.iter().zip(assign(&cost, rows.len(), columns.len()));
        pairs.filter_map(|(&p, t)| t.map(|t| (p, columns[t]))).filter(|&(p, t)| self.shared(p, t) > 0).collect()
    }

    /// The true id that most pixels of each predicted id have (of equally many the smallest).
    pub fn majority(&self) -> BTreeMap<u32, u32> {
        let mut best: BTreeMap<u32, (u64, u32)> = BTreeMap::new();
        for (&(p, t), &n) in &self.both {
            let entry = best.entry(p).or_insert((0, t));
            if n > entry.0 {
                *entry = (n, t);
            }
        }
        best.into_iter().map(|(p, (_, t))| (p, t)).collect()
    }
}

/// Scores over all images.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SegmentScores {
    /// Average precision at an overlap of ½.
    pub ap: f64,
    /// Panoptic quality.
    pub pq: f64,
    /// Harmonic mean of precision and recall.
    pub f1: f64,
    /// Part of the predicted instances that are matched.
    pub precision: f64,
    /// Part of the true instances that are matched.
    pub recall: f64,
    /// Mean IoU of the true instances that are present.
    pub miou: f64,
    /// Mean IoU over ids `0 … largest present`, absent ones counting 0 (NVFi).
    pub miou_strict: f64,
    /// Images counted.
    pub images: usize,
}

/// A predicted instance of one image.
#[derive(Clone, Copy, Debug)]
struct Instance {
    confidence: f64,
    matched: bool,
}

/// Collects images.
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
    /// Adds an image: a predicted id, a true id, and how sure the prediction is (0 to 1) at every pixel. An instance is as sure
    /// as its pixels are on average.
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
        let mut sure: BTreeMap<u32, f64> = BTreeMap::new();
        for (id, c) in predicted.iter().zip(confidence) {
            *sure.entry(*id).or_default() += f64::from(*c);
        }
        let mut taken = Vec::new();
        for (id, pixels) in &overlap.predicted {
            let best = overlap.truth.keys().map(|t| (overlap.iou(*id, *t), *t));
            let best = best.filter(|(_, t)| !taken.contains(t)).fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a });
            let matched = best.0 >= MATCH;
            if matched {
                taken.push(best.1);
                self.matched_iou += best.0;
            }
            self.instances.push(Instance { confidence: sure[id] / *pixels as f64, matched });
        }
        self.true_instances += overlap.truth.len();
        let (sum, largest) = (assigned_iou(&overlap), overlap.truth.keys().max().copied().unwrap_or(0));
        self.miou += sum / overlap.truth.len() as f64;
        self.miou_strict += sum / (f64::from(largest) + 1.0);
        self.images += 1;
        Ok(())
    }

    /// The scores; none without an image.
    pub fn scores(&self) -> Option<SegmentScores> {
        let images = Some(self.images).filter(|n| *n > 0)?;
        let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
        let tp = self.instances.iter().filter(|i| i.matched).count() as f64;
        let (predicted, truth) = (self.instances.len() as f64, self.true_instances as f64);
        let (precision, recall) = (ratio(tp, predicted), ratio(tp, truth));
        Some(SegmentScores {
            ap: average_precision(&self.instances, self.true_instances),
            // TP + ½ FP + ½ FN is half of all instances there are.
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

/// Sum of IoUs of true instances under the best assignment.
fn assigned_iou(overlap: &Overlap) -> f64 {
    let (rows, columns) = (overlap.truth(), overlap.predicted());
    let iou: Vec<f64> = rows.iter().flat_map(|&t| columns.iter().map(move |&p| overlap.iou(p, t))).collect();
    let cost: Vec<f64> = iou.iter().map(|v| -v).collect();
    let pairs = assign(&cost, rows.len(), columns.len());
    pairs.iter().enumerate().filter_map(|(r, c)| c.map(|c| iou[r * columns.len() + c])).sum()
}

/// Area under the envelope of precision over recall, 101 points.
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
