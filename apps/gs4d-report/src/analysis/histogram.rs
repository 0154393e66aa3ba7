//! Histograms of the scalar attributes of a model's splats at one training step.

use crate::ReportRow;
use gs_train::capabilities::Quantity;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// Number of bins.
pub const BINS: usize = 64;
/// Number of times at which attributes are sampled, evenly over the training span.
pub const TIMES: usize = 8;
/// Half width of the band of λ around ½ between low-frequency and high-frequency kernels.
pub const CLASS_MARGIN: f32 = 0.02;
/// Raw kernel parameters of at least this magnitude are saturated: their sigmoid has hardly any gradient.
pub const SATURATED: f32 = 8.0;

/// A histogram of a scalar attribute.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    /// Name of the attribute.
    pub name: String,
    /// Normalised time; `None` if the attribute does not change with time, or all times are pooled.
    pub time: Option<f32>,
    /// Lower edge of the first bin, upper edge of the last one.
    pub span: [f32; 2],
    /// [`BINS`] counts; values outside the span are in the nearest bin.
    pub counts: Vec<u32>,
    /// Number of values that are not finite; they are in no bin.
    pub not_finite: u32,
    /// Mean of the finite values; 0 if there is none.
    pub mean: f64,
}

impl Histogram {
    /// Counts values over a span `[low, high]`, `low < high`.
    ///
    /// ```
    /// use gs4d_report::analysis::Histogram;
    ///
    /// let h = Histogram::of("speed", None, [0.0, 1.0], &[0.25, 0.75, 9.0, f32::NAN]);
    /// assert_eq!((h.counts[16], h.counts[48], h.counts[63], h.not_finite), (1, 1, 1, 1));
    /// ```
    pub fn of<'a>(name: &str, time: Option<f32>, span: [f32; 2], values: impl IntoIterator<Item = &'a f32>) -> Self {
        let (mut counts, mut not_finite, mut sum) = (vec![0u32; BINS], 0, 0.0);
        let [low, high] = span.map(f64::from);
        for &v in values {
            if v.is_finite() {
                let place = (f64::from(v) - low) / (high - low) * BINS as f64;
                counts[(place.max(0.0) as usize).min(BINS - 1)] += 1;
                sum += f64::from(v);
            } else {
                not_finite += 1;
            }
        }
        let n: u64 = counts.iter().map(|&c| u64::from(c)).sum();
        Self { name: name.to_owned(), time, span, counts, not_finite, mean: sum / n.max(1) as f64 }
    }

    /// The centre of the bin with the most values; the lowest of equals.
    pub fn mode(&self) -> f32 {
        let fullest = (0..self.counts.len()).rev().max_by_key(|&k| self.counts[k]).unwrap_or(0);
        self.span[0] + (self.span[1] - self.span[0]) * (fullest as f32 + 0.5) / self.counts.len().max(1) as f32
    }
}

/// Numbers of kernels by λ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Classes {
    /// λ below ½ − [`CLASS_MARGIN`].
    pub low: usize,
    /// λ within [`CLASS_MARGIN`] of ½.
    pub middle: usize,
    /// λ above ½ + [`CLASS_MARGIN`].
    pub high: usize,
}

impl Classes {
    fn of(lambdas: &[f32]) -> Self {
        let low = lambdas.iter().filter(|&&l| l < 0.5 - CLASS_MARGIN).count();
        let high = lambdas.iter().filter(|&&l| l > 0.5 + CLASS_MARGIN).count();
        Self { low, high, middle: lambdas.len() - low - high }
    }
}

/// The number of saturated raw values of a kernel parameter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Saturation {
    /// Name of the parameter.
    pub parameter: String,
    /// Number of values beyond ±[`SATURATED`].
    pub saturated: usize,
    /// Number of all values.
    pub of: usize,
}

/// Histograms of all attributes of a model at one step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Number of splats.
    pub splats: usize,
    /// First each attribute, pooled over the times where it changes; then the changing ones at each time.
    pub histograms: Vec<Histogram>,
    /// Kernels by λ, for models with one.
    pub classes: Option<Classes>,
    /// Saturation of each kernel parameter.
    pub saturation: Vec<Saturation>,
}

impl Snapshot {
    /// Samples all attributes at [`TIMES`] times.
    ///
    /// # Errors
    /// If the model cannot compute its attributes.
    pub fn of(method: &Model) -> Result<Self, MethodError> {
        let times: Vec<f32> = (0..TIMES).map(|k| k as f32 / (TIMES - 1) as f32).collect();
        let seen = times.iter().map(|&t| method.quantities(&Timestamp::normalised(t)));
        let seen = seen.collect::<Result<Vec<Vec<Quantity>>, _>>()?;
        let (mut whole, mut each, mut classes) = (Vec::new(), Vec::new(), None);
        for first in &seen[0] {
            let over: Vec<&Quantity> = seen.iter().flatten().filter(|q| q.name == first.name).collect();
            let span = over.iter().map(|q| q.span()).fold(first.span(), |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            if first.name == "lambda" {
                classes = Some(Classes::of(&first.values));
            }
            if over.iter().all(|q| q.values == first.values) {
                whole.push(Histogram::of(first.name, None, span, &first.values));
                continue;
            }
            whole.push(Histogram::of(first.name, None, span, over.iter().flat_map(|q| &q.values)));
            each.extend(over.iter().zip(&times).map(|(q, &t)| Histogram::of(q.name, Some(t), span, &q.values)));
        }
        whole.append(&mut each);
        Ok(Self { splats: method.splat_count(), histograms: whole, classes, saturation: saturation(method) })
    }

    /// Whether the model has no attributes.
    pub fn is_empty(&self) -> bool {
        self.histograms.is_empty()
    }

    /// Rows for the report.
    pub fn rows(&self) -> Vec<ReportRow> {
        let pooled = self.histograms.iter().filter(|h| h.time.is_none());
        let mut rows: Vec<ReportRow> = pooled
            .map(|h| {
                ReportRow::new(
                    &h.name,
                    format!("mean {:.3}, mode {:.3}", h.mean, h.mode()),
                    "of all splats, over all times",
                )
            })
            .collect();
        if let Some(c) = self.classes {
            let ratio = if c.high > 0 { format!("{:.2} : 1", c.low as f64 / c.high as f64) } else { "–".to_owned() };
            let counts = format!("{ratio}  ({} low, {} between, {} high)", c.low, c.middle, c.high);
            rows.push(ReportRow::new(
                "low : high frequency",
                counts,
                "kernels with lambda below 0.48 to those above 0.52",
            ));
        }
        for s in self.saturation.iter().filter(|s| s.saturated > 0) {
            let meaning = "raw values beyond ±8, which have hardly any gradient";
            rows.push(ReportRow::new(
                format!("saturated {}", s.parameter),
                format!("{} of {}", s.saturated, s.of),
                meaning,
            ));
        }
        rows
    }
}

fn saturation(method: &Model) -> Vec<Saturation> {
    let mut out = Vec::new();
    method.visit(&mut |p| {
        if ["cloud.lambda", "cloud.beta", "cloud.acutance"].contains(&p.name.as_str()) {
            let saturated = p.value.iter().filter(|v| v.abs() > SATURATED).count();
            out.push(Saturation { parameter: p.name.clone(), saturated, of: p.value.len() });
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_fall_into_their_bins() {
        let values = [0.0, 1.0 / 64.0, 0.5, 0.999, 1.0, -3.0, 7.0, f32::NAN];
        let h = Histogram::of("v", None, [0.0, 1.0], &values);
        assert_eq!((h.counts[0], h.counts[1], h.counts[32], h.counts[63], h.not_finite), (2, 1, 1, 3, 1));
        assert_eq!(h.counts.iter().sum::<u32>(), 7);
        assert_eq!(h.mode(), 1.0 - 0.5 / 64.0);
        let empty = Histogram::of("v", None, [0.0, 1.0], &[]);
        assert_eq!((empty.mean, empty.mode()), (0.0, 0.5 / 64.0));
    }

    #[test]
    fn classes_leave_a_margin_around_a_half() {
        let c = Classes::of(&[0.0, 0.47, 0.49, 0.5, 0.51, 0.53]);
        assert_eq!(c, Classes { low: 2, middle: 3, high: 1 });
        let s = Snapshot { classes: Some(c), ..Snapshot::default() };
        assert!(s.rows()[0].value.starts_with("2.00 : 1"));
    }
}
