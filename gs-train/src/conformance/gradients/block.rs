//! One block under test: the functional along directions through its values.

use super::{BlockGradient, CONTRAST, Functional, Kind, MAX_DISPLACEMENT, MIN_DISPLACEMENT, POINTS, ROUNDS, Rules};
use crate::model::Model;
use gs_core::Rng;

/// A block under test, with the values it started from.
pub(super) struct Block<'a, 'f> {
    gradient: &'a BlockGradient,
    pub(super) start: Vec<f32>,
    method: &'a mut Model,
    functional: &'a mut Functional<'f>,
    seed: u64,
}

impl<'a, 'f> Block<'a, 'f> {
    pub(super) fn new(
        method: &'a mut Model,
        gradient: &'a BlockGradient,
        functional: &'a mut Functional<'f>,
        seed: u64,
    ) -> Self {
        let mut start = Vec::new();
        method.visit(&mut |p| {
            if p.name == gradient.name {
                start.clone_from(&p.value);
            }
        });
        Self { gradient, start, method, functional, seed }
    }

    /// The functional with other values of the block.
    fn at(&mut self, values: &[f32]) -> f64 {
        let name = &self.gradient.name;
        self.method.visit_mut(&mut |p| {
            if p.name == *name {
                p.value.copy_from_slice(values);
            }
        });
        (self.functional)(self.method, name)
    }

    /// Gives the block the values it started from.
    pub(super) fn restore(&mut self) {
        let (name, start) = (&self.gradient.name, &self.start);
        self.method.visit_mut(&mut |p| {
            if p.name == *name {
                p.value.copy_from_slice(start);
            }
        });
    }

    fn random(&self, purpose: &str, index: usize, len: usize) -> Vec<f64> {
        let purpose = format!("{purpose} {}", self.gradient.name);
        let mut rng = Rng::new(self.seed, &purpose, index as u32, 0);
        (0..len).map(|_| f64::from(rng.normal())).collect()
    }

    /// σ of the functional for a block with values of size `scale` and a gradient of norm `size`: over the displacements that
    /// its steps will have.
    pub(super) fn noise(&mut self, scale: f64, size: f64) -> f64 {
        let (mut noise, mut displacement) = (0.0, MIN_DISPLACEMENT * scale);
        for _ in 0..ROUNDS {
            noise = self.measure_noise(0.25 * displacement);
            let wanted = (CONTRAST * noise / size).min(MAX_DISPLACEMENT * scale);
            if wanted <= displacement {
                break;
            }
            displacement = wanted;
        }
        noise
    }

    /// σ, from points between which each value moves by `displacement`.
    fn measure_noise(&mut self, displacement: f64) -> f64 {
        let direction = unit(self.random("noise", 0, self.start.len()));
        let distance = displacement * spread(&direction).sqrt();
        let mut values: Vec<f64> = (0..POINTS).map(|k| self.along(&direction, distance * k as f64).0).collect();
        for _ in 0..4 {
            values = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        }
        values.iter_mut().for_each(|v| *v = v.abs());
        values.sort_by(f64::total_cmp);
        values[values.len() / 2] / (0.6745 * 70f64.sqrt())
    }

    /// The functional a step along a direction, and the values there.
    fn along(&mut self, direction: &[f64], step: f64) -> (f64, Vec<f32>) {
        let moved = |(v, d): (&f32, &f64)| (f64::from(*v) + step * d) as f32;
        let values: Vec<f32> = self.start.iter().zip(direction).map(moved).collect();
        (self.at(&values), values)
    }

    /// All directions of the block: what they run through, unit vectors, expected derivatives.
    pub(super) fn directions(&self, rules: &Rules<'_>, norm_of_all: f64) -> Vec<(Kind, Vec<f64>, f64)> {
        let grad = &self.gradient.grad;
        let typical = norm_of_all / (grad.len() as f64).sqrt();
        let mut all = Vec::new();
        for k in 0..rules.directions {
            all.push((Kind::Whole, unit(self.random("whole", k, grad.len())), typical));
        }
        all.push((Kind::Along, unit(grad.iter().map(|g| f64::from(*g)).collect()), norm_of_all));
        let Some(width) = self.gradient.row_width else { return all };
        let rows = grad.len() / width;
        let mut order: Vec<usize> = (0..rows).collect();
        order.sort_by_key(|row| Rng::new(self.seed, "order of rows", 0, *row as u64).bits());
        for row in order.into_iter().take(rules.rows) {
            let here = row * width..(row + 1) * width;
            let mut direction = vec![0.0; grad.len()];
            direction[here.clone()].copy_from_slice(&unit(self.random("row", row, width)));
            let of_row = norm(&grad[here]) / (width as f64).sqrt();
            all.push((Kind::Row(row), direction, of_row.max(0.5 * typical)));
        }
        all
    }

    /// Measured and predicted slope between two steps along a unit direction.
    pub(super) fn slopes(&mut self, direction: &[f64], from: f64, to: f64) -> [f64; 2] {
        let (high, hi) = self.along(direction, to);
        let (low, lo) = self.along(direction, from);
        let measured = high - low;
        let differences = hi.iter().zip(&lo).map(|(a, b)| f64::from(*a) - f64::from(*b));
        let predicted: f64 = differences.zip(&self.gradient.grad).map(|(d, g)| d * f64::from(*g)).sum();
        [measured, predicted].map(|change| change / (to - from))
    }
}

/// Norm of the values, in f64.
pub(super) fn norm(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}

/// Over how many values a unit direction is spread.
pub(super) fn spread(direction: &[f64]) -> f64 {
    1.0 / direction.iter().map(|d| d.powi(4)).sum::<f64>()
}

fn unit(mut values: Vec<f64>) -> Vec<f64> {
    let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
    values.iter_mut().for_each(|v| *v /= norm);
    values
}
