//! The feature bank (Lu et al. 2024, Eq. 4; off by default): three resolutions of a feature, blended by view direction
//! and distance.
//!
//! ```text
//! w  = softmax(W₁ relu(W₀ [d, δ] + b₀) + b₁)                                     Linear(4 → C), Linear(C → 3)
//! f̂ᵢ = w₀ f[4 (i mod C/4)] + w₁ f[2 (i mod C/2)] + w₂ f[i]                       C a multiple of 4
//! ```

use gs_core::nn::{Init, Mlp, MlpGrad, MlpTape};
use gs_core::{Param, Params};

#[derive(Clone, Debug)]
pub(super) struct Bank {
    net: Mlp,
    features: usize,
}

/// Activations of the bank's network for one block.
#[derive(Clone, Debug, Default)]
pub(super) struct BankTape {
    /// Inputs `[d, δ]`, `[rows, 4]`.
    view: Vec<f32>,
    net: MlpTape,
    /// Softmax weights `w`, `[rows, 3]`.
    weights: Vec<f32>,
}

/// Parameter gradients of one chunk of blocks, and scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct BankGrad {
    net: MlpGrad,
    d_logits: Vec<f32>,
    /// Cotangent of `[d, δ]`, `[rows, 4]`; set by [`Bank::backward`].
    pub(super) d_view: Vec<f32>,
}

/// Widths of the network's layers.
fn widths(features: usize) -> [usize; 3] {
    [4, features, 3]
}

impl Bank {
    /// Number of parameters for features of width `features`.
    pub(super) fn count(features: usize) -> u64 {
        Mlp::count(&widths(features))
    }

    /// For features of width `features`, a multiple of 4.
    pub(super) fn new(features: usize, seed: u64) -> Self {
        Self { net: Mlp::new("heads.bank", &widths(features), Init::FanIn, Init::FanIn, seed), features }
    }

    /// The entries of the feature that the three copies read for entry `i`.
    fn indices(&self, i: usize) -> [usize; 3] {
        [4 * (i % (self.features / 4)), 2 * (i % (self.features / 2)), i]
    }

    /// Computes the weights of a block from `[d, δ]` of each row.
    pub(super) fn weigh(&self, view: impl Iterator<Item = [f32; 4]>, tape: &mut BankTape) {
        let BankTape { view: kept, net, weights } = tape;
        kept.clear();
        kept.extend(view.flatten());
        self.net.forward(kept, net);
        weights.clear();
        weights.extend(net.output().as_chunks().0.iter().flat_map(|z| softmax(*z)));
    }

    /// Blends the feature of row `row` of the block into `to`.
    pub(super) fn mix(&self, tape: &BankTape, row: usize, feature: &[f32], to: &mut [f32]) {
        let w = &tape.weights[3 * row..][..3];
        for (i, to) in to.iter_mut().enumerate() {
            let [a, b, c] = self.indices(i);
            *to = w[0] * feature[a] + w[1] * feature[b] + w[2] * feature[c];
        }
    }

    /// Backward of [`Bank::mix`]: adds to `d_feature`, returns the cotangents of the row's logits.
    pub(super) fn mix_backward(
        &self,
        tape: &BankTape,
        row: usize,
        feature: &[f32],
        d_mixed: &[f32],
        d_feature: &mut [f32],
    ) -> [f32; 3] {
        let w = [0, 1, 2].map(|m| tape.weights[3 * row + m]);
        let mut d_w = [0.0; 3];
        for (i, d) in d_mixed.iter().enumerate() {
            for (m, index) in self.indices(i).into_iter().enumerate() {
                d_w[m] += d * feature[index];
                d_feature[index] += w[m] * d;
            }
        }
        let mean = w[0] * d_w[0] + w[1] * d_w[1] + w[2] * d_w[2];
        std::array::from_fn(|m| w[m] * (d_w[m] - mean))
    }

    /// Backward of [`Bank::weigh`] from the cotangents of the logits: adds to `grad`, sets `grad.d_view`.
    pub(super) fn backward(&self, tape: &mut BankTape, d_logits: impl Iterator<Item = [f32; 3]>, grad: &mut BankGrad) {
        let BankGrad { net, d_logits: kept, d_view } = grad;
        kept.clear();
        kept.extend(d_logits.flatten());
        d_view.clear();
        d_view.resize(tape.view.len(), 0.0);
        self.net.backward(&tape.view, &mut tape.net, kept, Some(d_view), net);
    }

    /// Sets `grad` to zero, reusing memory.
    pub(super) fn reset(&self, grad: &mut BankGrad) {
        grad.net.reset(&self.net);
    }

    /// Adds the chunks' gradients to the parameters, in order.
    pub(super) fn add_grads<'a>(&mut self, chunks: impl Iterator<Item = &'a BankGrad> + Clone + Sync + Send) {
        self.net.add_grads(chunks.map(|g| &g.net));
    }
}

fn softmax(z: [f32; 3]) -> [f32; 3] {
    let top = z[0].max(z[1]).max(z[2]);
    let e = z.map(|v| (v - top).exp());
    let total = e[0] + e[1] + e[2];
    e.map(|v| v / total)
}

impl Params for Bank {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
    }
}
