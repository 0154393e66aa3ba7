//! Statistics of a flow.

use gs_core::Image;
use gs_metrics::MetricError;
use gs_metrics::flow::{Flow, Reference, circular_variance, end_point_error, mask_contrast};
use serde::Serialize;

use super::MIN_DISPLACEMENT;

/// Statistics of one flow over covered pixels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Names of the stages, for example `global-local`.
    pub step: String,
    /// `model` or `farneback`.
    pub by: &'static str,
    /// Mean length, pixels; 0 without covered pixels.
    pub mean: f64,
    /// The length that `inside` and `outside` are divided by, pixels.
    pub reference: f64,
    /// Mean of `|flow| / reference` inside the mask; `None` if the mask is empty or full.
    pub inside: Option<f64>,
    /// Mean of `|flow| / reference` outside the mask.
    pub outside: Option<f64>,
    /// `inside / outside`; `None` if nothing moves outside.
    pub ratio: Option<f64>,
    /// Circular variance of the directions, 0 to 1; `None` if nothing moves.
    pub circular_variance: Option<f64>,
    /// Circular variance inside the mask.
    pub circular_variance_inside: Option<f64>,
}

impl Scores {
    /// Statistics of a flow between two stages.
    pub(super) fn of(
        by: &'static str,
        step: &str,
        flow: &Flow,
        seen: &[bool],
        mask: &Image,
        reference: Reference,
    ) -> Result<Self, MetricError> {
        let nothing = Self {
            step: step.to_owned(),
            by,
            mean: 0.0,
            reference: 0.0,
            inside: None,
            outside: None,
            ratio: None,
            circular_variance: None,
            circular_variance_inside: None,
        };
        let flow = packed(flow, seen);
        if flow.u.is_empty() {
            return Ok(nothing);
        }
        let data: Vec<f32> = masked(&mask.data, seen).collect();
        let mask = Image { width: data.len(), height: 1, channels: 1, data };
        let lengths = flow.magnitudes();
        let mean = lengths.iter().map(|l| f64::from(*l)).sum::<f64>() / lengths.len() as f64;
        let contrast = match mask_contrast(&flow, &mask, reference) {
            Err(MetricError::EmptyMask) => None,
            other => Some(other?),
        };
        Ok(Self {
            mean,
            reference: contrast.map_or(0.0, |c| c.reference),
            inside: contrast.map(|c| c.inside),
            outside: contrast.map(|c| c.outside),
            ratio: contrast.and_then(|c| c.ratio),
            circular_variance: circular_variance(&flow, None, MIN_DISPLACEMENT)?,
            circular_variance_inside: circular_variance(&flow, Some(&mask), MIN_DISPLACEMENT)?,
            ..nothing
        })
    }

    /// The statistics by name.
    fn numbers(&self) -> [(&'static str, Option<f64>); 6] {
        [
            ("mean", Some(self.mean)),
            ("inside", self.inside),
            ("outside", self.outside),
            ("ratio", self.ratio),
            ("circular_variance", self.circular_variance),
            ("circular_variance_inside", self.circular_variance_inside),
        ]
    }
}

/// Mean distance of two flows over the `seen` pixels; `None` without any.
pub(super) fn distance(a: &Flow, b: &Flow, seen: &[bool]) -> Result<Option<f64>, MetricError> {
    let (a, b) = (packed(a, seen), packed(b, seen));
    if a.u.is_empty() { Ok(None) } else { end_point_error(&a, &b).map(Some) }
}

fn masked<'a>(values: &'a [f32], seen: &'a [bool]) -> impl Iterator<Item = f32> + 'a {
    values.iter().zip(seen).filter(|(_, seen)| **seen).map(|(v, _)| *v)
}

/// The `seen` pixels as a flow of one row.
fn packed(flow: &Flow, seen: &[bool]) -> Flow {
    let (u, v): (Vec<f32>, Vec<f32>) = (masked(&flow.u, seen).collect(), masked(&flow.v, seen).collect());
    Flow { width: u.len(), height: 1, u, v }
}

/// Mean of one statistic over all times.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mean {
    /// Names of the stages.
    pub step: String,
    /// `model` or `farneback`.
    pub by: &'static str,
    /// Name of the statistic, a field of [`Scores`].
    pub name: &'static str,
    /// Mean over the times that have it.
    pub mean: f64,
    /// Number of times that have it.
    pub moments: usize,
}

/// Means of all statistics over times, in the order of first appearance.
pub fn means<'a>(all: impl IntoIterator<Item = &'a Scores>) -> Vec<Mean> {
    let mut means: Vec<Mean> = Vec::new();
    for scores in all {
        for (name, value) in scores.numbers() {
            let Some(value) = value else { continue };
            let same = |m: &&mut Mean| m.step == scores.step && m.by == scores.by && m.name == name;
            match means.iter_mut().find(same) {
                Some(m) => {
                    m.mean += value;
                    m.moments += 1;
                }
                None => means.push(Mean { step: scores.step.clone(), by: scores.by, name, mean: value, moments: 1 }),
            }
        }
    }
    means.iter_mut().for_each(|m| m.mean /= m.moments as f64);
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    fn left(w: usize, h: usize, columns: usize) -> Image {
        let data = (0..w * h).map(|k| f32::from(k % w < columns)).collect();
        Image { width: w, height: h, channels: 1, data }
    }

    /// 4 px to the right inside the mask, 1 px every way outside, a wild value where nothing is seen.
    #[test]
    fn numbers_are_of_what_is_seen() {
        let (w, h) = (8, 4);
        let mut flow = Flow::zeros(w, h);
        let mut seen = vec![true; w * h];
        for k in 0..w * h {
            match k % w {
                0..2 => flow.u[k] = 4.0,
                7 => {
                    flow.u[k] = 99.0;
                    seen[k] = false;
                }
                x => (flow.u[k], flow.v[k]) = [(1.0, 0.0), (-1.0, 0.0)][(x + k / w) % 2],
            }
        }
        let s = Scores::of("model", "a-b", &flow, &seen, &left(w, h, 2), Reference::Longest).unwrap();
        assert_eq!((s.reference, s.inside, s.outside, s.ratio), (4.0, Some(1.0), Some(0.25), Some(4.0)));
        assert!((s.mean - (2.0 * 4.0 + 5.0) / 7.0).abs() < 1e-12);
        assert!(s.circular_variance_inside.unwrap() < 1e-7 && s.circular_variance.unwrap() > 0.5);
        let none = Scores::of("model", "a-b", &flow, &vec![false; w * h], &left(w, h, 2), Reference::Longest).unwrap();
        assert_eq!((none.mean, none.ratio, none.circular_variance), (0.0, None, None));
        let whole = Scores::of("model", "a-b", &flow, &seen, &left(w, h, 8), Reference::Longest).unwrap();
        assert_eq!((whole.inside, whole.ratio), (None, None));
        let all = means([&s, &none, &whole]);
        let ratio = all.iter().find(|m| m.name == "ratio").unwrap();
        assert_eq!((ratio.mean, ratio.moments), (4.0, 1));
        assert_eq!(all.iter().find(|m| m.name == "mean").unwrap().moments, 3);
    }

    /// No flow has no ratio, no direction, no length: it cannot pass for anything.
    #[test]
    fn no_flow_has_no_numbers() {
        let seen = vec![true; 32];
        let s = Scores::of("model", "a-b", &Flow::zeros(8, 4), &seen, &left(8, 4, 3), Reference::Longest).unwrap();
        assert_eq!((s.mean, s.reference, s.inside, s.outside), (0.0, 0.0, Some(0.0), Some(0.0)));
        assert_eq!((s.ratio, s.circular_variance, s.circular_variance_inside), (None, None, None));
    }
}
