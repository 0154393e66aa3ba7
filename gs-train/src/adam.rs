//! Adam (Kingma and Ba 2015), fused: one pass updates a parameter and both its moments and clears its gradient.
//!
//! ```text
//! m ← β₁ m + (1 − β₁) g        v ← β₂ v + (1 − β₂) g²
//! p ← (1 − lr · λ) p − lr · (m / (1 − β₁ᵗ)) / (sqrt(v / (1 − β₂ᵗ)) + ε)
//! ```
//! `λ` is weight decay, decoupled from the gradient (AdamW, Loshchilov and Hutter 2019); 0 unless asked for. `1 − lr · λ` is
//! rounded to `f32`, as in PyTorch: below 3e-8, which DUT's 2e-4 · 1e-5 is, it takes nothing away. `t` counts the
//! updates of each block. Gradients are guarded in the same pass: a row of a row block with a gradient
//! that is not finite is left alone (value and moments), its gradient cleared, and counted; in a block shared by all
//! splats such a gradient is reported, and nothing of its chunk is updated.
//!
//! A **sparse** update leaves rows whose gradient is exactly zero as they are, value and moments (in a block shared by
//! all splats, such as a table of features, each value is a row). It is not Adam, whose momentum runs on, and it pays
//! only where few rows are touched: of a table of 12 million values, one in 200 takes as long as a dense update of all,
//! one in 20 more than twice as long.
//!
//! The loop is plain arithmetic without fused multiply-add, compiled once per instruction set: the same bits at every
//! SIMD level and for every number of threads.

mod piece;
mod refused;

pub use refused::Refused;
pub(crate) use refused::RefusedRows;

use fearless_simd::Level;
use gs_core::Param;
use piece::{Piece, all_finite};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Values per parallel piece, roughly: four arrays of this many stay in the first-level cache's neighbour.
const PIECE: usize = 8192;

/// Decay rates of Adam's moments, in `[0, 1)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamOptions {
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
}

impl Default for AdamOptions {
    /// `β₁ = 0.9`, `β₂ = 0.999` (3DGS).
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999 }
    }
}

/// How one block is updated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Learning rate, already multiplied by the extent where the rule says so.
    pub rate: f32,
    /// ε, added to the denominator.
    pub eps: f32,
    /// Rows whose gradient is exactly zero keep value and moments.
    pub sparse: bool,
    /// Weight decay `λ`, times the rate, per update (AdamW).
    pub weight_decay: f32,
    /// The rate rises linearly over so many updates of the block, its first ones; 0: it is whole from the first.
    pub ramp: u32,
}

/// The optimiser: constants, and the number of updates each block has had.
#[derive(Clone, Debug)]
pub struct Adam {
    /// `β₁` and `β₂`, the same for every block.
    pub options: AdamOptions,
    updates: BTreeMap<String, u32>,
    level: Level,
}

/// One update of a block, its factors worked out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factors {
    /// `β₁`.
    pub beta1: f32,
    /// `β₂`.
    pub beta2: f32,
    /// `lr / (1 − β₁ᵗ)`.
    pub rate: f32,
    /// `1 / sqrt(1 − β₂ᵗ)`.
    pub root: f32,
    /// `ε`.
    pub eps: f32,
    /// `1 − lr λ`.
    pub keep: f32,
}

impl Default for Adam {
    fn default() -> Self {
        Self::new(AdamOptions::default())
    }
}

impl Adam {
    /// An optimiser that has not made any update.
    pub fn new(options: AdamOptions) -> Self {
        Self { options, updates: BTreeMap::new(), level: Level::new() }
    }

    /// The number of updates of each block, for checkpoints.
    pub fn updates(&self) -> &BTreeMap<String, u32> {
        &self.updates
    }

    /// Restores the number of updates of each block.
    pub(crate) fn set_updates(&mut self, updates: BTreeMap<String, u32>) {
        self.updates = updates;
    }

    /// Forgets the number of updates; clear the moments of the blocks too.
    pub fn restart(&mut self) {
        self.updates.clear();
    }

    /// Counts an update of the block of this name, which is made elsewhere, and gives its factors.
    pub(crate) fn next(&mut self, name: &str, update: Update) -> Factors {
        let t = match self.updates.get_mut(name) {
            Some(t) => {
                *t += 1;
                *t
            }
            None => {
                self.updates.insert(name.to_owned(), 1);
                1
            }
        };
        let o = self.options;
        let correction = |beta: f32| 1.0 - f64::from(beta).powf(f64::from(t));
        let risen = if t < update.ramp { f64::from(t) / f64::from(update.ramp) } else { 1.0 };
        let rate = f64::from(update.rate) * risen;
        Factors {
            beta1: o.beta1,
            beta2: o.beta2,
            rate: (rate / correction(o.beta1)) as f32,
            root: (1.0 / correction(o.beta2).sqrt()) as f32,
            eps: update.eps,
            keep: (1.0 - rate * f64::from(update.weight_decay)) as f32,
        }
    }

    /// Updates one block and clears its gradient. What was refused is added to `refused`.
    pub fn update(&mut self, p: &mut Param, update: Update, refused: &mut Refused) {
        let rows = self.update_run(p, update, 0..p.len());
        refused.add(p, &rows);
    }

    /// The same of a run of values, in whole rows; the others, their moments and gradients stay.
    pub(crate) fn update_run(&mut self, p: &mut Param, update: Update, run: Range<usize>) -> RefusedRows {
        let factors = self.next(&p.name, update);
        let width = p.row_width.unwrap_or(1);
        let piece = width * (PIECE / width).max(1);
        let (sparse, shared, level) = (update.sparse, p.row_width.is_none(), self.level);
        let bad: Vec<(u32, Option<u32>)> = (
            p.value[run.clone()].par_chunks_mut(piece),
            p.moment1[run.clone()].par_chunks_mut(piece),
            p.moment2[run.clone()].par_chunks_mut(piece),
            p.grad[run.clone()].par_chunks_mut(piece),
        )
            .into_par_iter()
            .map(|(value, m, v, grad)| {
                let piece = Piece { value, m, v, grad };
                if !all_finite(level, piece.grad) {
                    return piece.careful(&factors, if shared { usize::MAX } else { width }, sparse);
                }
                match (sparse, width) {
                    (false, _) => piece.all(level, &factors),
                    (true, 1) => piece.touched(level, &factors),
                    (true, _) => piece.visible(level, &factors, width),
                }
                (0, None)
            })
            .collect();
        let at = |i: usize, row: u32| (run.start / width + i * (piece / width)) as u32 + row;
        RefusedRows {
            rows: bad.iter().map(|b| b.0).sum(),
            first: bad.iter().enumerate().find_map(|(i, b)| b.1.map(|row| at(i, row))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn every(rate: f32) -> Update {
        Update { rate, eps: 1e-15, sparse: false, weight_decay: 0.0, ramp: 0 }
    }

    /// The definition, in f64.
    fn reference(values: &mut [f64], grads: &[Vec<f64>], lr: f64) {
        let (b1, b2, eps) = (0.9f32 as f64, 0.999f32 as f64, 1e-15);
        let (mut m, mut v) = (vec![0.0; values.len()], vec![0.0; values.len()]);
        for (t, g) in grads.iter().enumerate() {
            for i in 0..values.len() {
                m[i] = b1 * m[i] + (1.0 - b1) * g[i];
                v[i] = b2 * v[i] + (1.0 - b2) * g[i] * g[i];
                let (mh, vh) = (m[i] / (1.0 - b1.powi(t as i32 + 1)), v[i] / (1.0 - b2.powi(t as i32 + 1)));
                values[i] -= lr * mh / (vh.sqrt() + eps);
            }
        }
    }

    #[test]
    fn follows_the_definition_at_every_length_and_level() {
        for n in [1usize, 5, 16, 17, 63, 20_000] {
            let mut rng = Rng::new(1, "adam", 0, n as u64);
            let start: Vec<f32> = (0..n).map(|_| rng.normal()).collect();
            let grads: Vec<Vec<f64>> =
                (0..10).map(|_| (0..n).map(|_| f64::from(rng.normal() * 1e-3)).collect()).collect();
            let mut want: Vec<f64> = start.iter().map(|&v| f64::from(v)).collect();
            reference(&mut want, &grads, 1e-2);
            let mut kept: Vec<Vec<f32>> = Vec::new();
            for level in [Level::new(), Level::baseline()] {
                let mut p = Param::shared("w", start.clone());
                let mut adam = Adam { level, ..Adam::default() };
                for g in &grads {
                    p.grad.iter_mut().zip(g).for_each(|(a, b)| *a = *b as f32);
                    adam.update(&mut p, every(1e-2), &mut Refused::default());
                    assert!(p.grad.iter().all(|&g| g == 0.0));
                }
                let worst = p.value.iter().zip(&want).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
                assert!(worst < 1e-6, "n = {n}: {worst:e}");
                kept.push(p.value);
            }
            assert_eq!(kept[0], kept[1], "the same bits at every level");
        }
    }

    #[test]
    fn weight_decay_is_decoupled_from_the_gradient() {
        let mut decayed = Param::shared("w", vec![2.0, -3.0]);
        let mut plain = decayed.clone();
        let (mut decays, mut adam) = (Adam::default(), Adam::default());
        for step in 1..=20 {
            for (adam, p, weight_decay) in [(&mut decays, &mut decayed, 0.5), (&mut adam, &mut plain, 0.0)] {
                p.grad = vec![0.3, 0.0];
                adam.update(p, Update { weight_decay, ..every(1e-2) }, &mut Refused::default());
            }
            // No gradient: decay alone.
            let want = -3.0 * (1.0f64 - 0.5e-2).powi(step);
            assert!((f64::from(decayed.value[1]) / want - 1.0).abs() < 1e-6 && plain.value[1] == -3.0);
        }
        assert_eq!((&decayed.moment1, &decayed.moment2), (&plain.moment1, &plain.moment2));
    }

    fn rows() -> Param {
        let mut p = Param::rows("r", 2, vec![1.0; 8]);
        p.grad = vec![1.0, 1.0, f32::NAN, 1.0, 0.0, 0.0, 1.0, f32::INFINITY];
        p.moment1.fill(0.5);
        p
    }

    #[test]
    fn bad_rows_are_left_alone_and_counted() {
        let (mut p, mut refused) = (rows(), Refused::default());
        Adam::default().update(&mut p, every(0.1), &mut refused);
        assert_eq!((refused.rows, refused.of, refused.first.clone()), (2, 4, Some(("r".into(), 1))));
        assert_eq!((&p.value[2..4], &p.moment1[2..4]), (&[1.0f32; 2][..], &[0.5f32; 2][..]));
        assert!(p.value[0] < 1.0 && p.value[4] < 1.0 && p.value.iter().all(|v| v.is_finite()));
        assert!(p.grad.iter().all(|&g| g == 0.0) && refused.shared.is_none());
    }

    #[test]
    fn a_bad_shared_gradient_is_reported_and_changes_nothing() {
        let mut p = Param::shared("w", vec![1.0; 3]);
        p.grad[1] = f32::NAN;
        let mut refused = Refused::default();
        Adam::default().update(&mut p, every(0.1), &mut refused);
        assert_eq!((refused.shared, p.value), (Some("w".into()), vec![1.0; 3]));
        // The square of a finite gradient may be infinite, and a second moment would keep it.
        for large in [1e20, -1e20] {
            let (mut p, mut refused) = (rows(), Refused::default());
            p.grad = vec![1e-3; p.len()];
            p.grad[2] = large;
            Adam::default().update(&mut p, every(0.1), &mut refused);
            assert_eq!((refused.rows, p.moment2[2]), (1, 0.0));
            assert!(p.moment2.iter().all(|v| v.is_finite()) && p.moment2.iter().any(|v| *v > 0.0));
        }
    }

    #[test]
    fn sparse_rows_without_gradient_rest() {
        let mut p = rows();
        p.grad = vec![1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
        Adam::default().update(&mut p, Update { sparse: true, ..every(0.1) }, &mut Refused::default());
        assert_eq!(
            (&p.value[2..4], &p.moment1[2..4], &p.value[6..]),
            (&[1.0f32; 2][..], &[0.5f32; 2][..], &[1.0f32; 2][..])
        );
        assert!(p.value[0] < 1.0 && p.value[4] < 1.0);
    }

    #[test]
    fn sparse_values_of_a_shared_block_rest_one_by_one() {
        let n = 20_000;
        let mut rng = Rng::new(2, "adam", 0, 0);
        let mut start = Param::shared("table", (0..n).map(|_| rng.normal()).collect());
        start.moment1.iter_mut().for_each(|m| *m = rng.normal());
        start.moment2.fill(0.25);
        // Runs of zeros, single zeros, negative zeros, and a tail shorter than a run.
        start.grad = (0..n).map(|i| if i / 50 % 3 == 0 || i % 7 == 0 { -0.0 } else { rng.normal() }).collect();
        let (mut all, mut some) = (start.clone(), start.clone());
        Adam::default().update(&mut all, every(0.1), &mut Refused::default());
        for level in [Level::new(), Level::baseline()] {
            some.clone_from(&start);
            let mut adam = Adam { level, ..Adam::default() };
            adam.update(&mut some, Update { sparse: true, ..every(0.1) }, &mut Refused::default());
            for i in 0..n {
                let want = if start.grad[i] == 0.0 { &start } else { &all };
                let got = (some.value[i], some.moment1[i], some.moment2[i]);
                assert_eq!(got, (want.value[i], want.moment1[i], want.moment2[i]), "{i}");
            }
            assert!(some.grad.iter().all(|&g| g == 0.0));
        }
    }

    #[test]
    fn a_rate_rises_over_the_first_updates_of_a_block() {
        let mut adam = Adam::default();
        let rising = Update { ramp: 4, ..every(0.1) };
        // The later block rises, too, however many updates the other has had.
        for name in ["early", "late"] {
            let mut p = Param::shared(name, vec![0.0]);
            for want in [0.025, 0.05, 0.075, 0.1, 0.1] {
                let before = p.value[0];
                p.grad[0] = 1.0;
                adam.update(&mut p, rising, &mut Refused::default());
                assert!((before - p.value[0] - want).abs() < 1e-6, "{name}: {before} {}", p.value[0]);
            }
        }
    }

    #[test]
    fn updates_are_counted_per_block_and_restored() {
        let (mut a, mut b) = (Param::shared("a", vec![0.0]), Param::shared("b", vec![0.0]));
        let mut adam = Adam::default();
        for _ in 0..3 {
            adam.update(&mut a, every(0.1), &mut Refused::default());
        }
        adam.update(&mut b, every(0.1), &mut Refused::default());
        assert_eq!((adam.updates()["a"], adam.updates()["b"]), (3, 1));
        let kept = adam.updates().clone();
        adam.restart();
        assert!(adam.updates().is_empty());
        adam.set_updates(kept);
        assert_eq!(adam.updates()["a"], 3);
    }
}
