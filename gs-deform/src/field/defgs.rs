//! The field of Deformable 3D Gaussians (Yang et al. 2024): one wide MLP from an encoded mean and time to offsets.
//!
//! ```text
//! e = (γ₁₀(μ), τ)        τ = W_b relu(W_a γ₆(t) + a) + b, or γ(t) itself without the time network
//! h₀ = σ(W₀ e),  h_i = σ(W_i h_{i−1}),  h_{skip+1} = σ(W_{skip+1} (e, h_skip)),  …        σ(y) = max(y, leak · y)
//! δx = W_x h,  δr = W_r h,  δs = W_s h                      three linear heads (with biases)
//! μ' = μ + δx     q' = |q| (q/|q| + δr)     s' = s + δs     (activated scales; see apply for the other rules)
//! ```
//! * The means are **detached** at the input, as in the reference: their gradient is that of the sum `μ + δx` only, and
//!   the encoding needs no backward.
//! * Time is the same for all splats of a call, so its columns of the first and the skip layer are folded into their
//!   biases: exact up to rounding, and a third of the first layer's work is saved.
//! * The heads start at **zero** (the identity, bit for bit); the reference starts them like the other layers, which
//!   [`DefGsConfig::zero_init`] restores. Hidden layers start at U(±1/√fan-in).
//! * Annealed smooth training is a separate function: [`smooth_time`](super::anneal::smooth_time).

use super::Field;
use super::defgs_net::{Block, ChunkGrad, DefNet, DefNetTape};
use crate::DeformError;
use crate::apply::{Apply, QuatRule, ScaleRule};
use gs_core::nn::{self, BLOCK, CHUNKS};
use gs_core::{Geometry, GeometryRef, Param, Params, Time};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of a [`DefMlp`]; the defaults are the published ones for synthetic scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DefGsConfig {
    /// Width of the hidden layers, 1 to 4096.
    pub width: usize,
    /// Number of hidden layers, 1 to 64.
    pub depth: usize,
    /// The input is concatenated again after hidden layer `skip` (from 0); no effect at `depth − 1` and beyond.
    pub skip: usize,
    /// Frequency bands of the positional encoding of means, 0 to 24.
    pub bands_position: usize,
    /// Frequency bands of the positional encoding of time, 0 to 24 (published: 10 for real scenes).
    pub bands_time: usize,
    /// Hidden width of the time network; 0: no time network, the encoded time is used directly (real scenes).
    pub time_hidden: usize,
    /// Number of outputs of the time network.
    pub time_features: usize,
    /// Factor on world coordinates before they are encoded. 1 in the reference; 1 / scene radius gives the bands the
    /// same meaning in every scene.
    pub coordinate_scale: f32,
    /// Rule for the offsets of scales.
    pub scale_rule: ScaleRule,
    /// Rule for the offsets of rotations.
    pub quat_rule: QuatRule,
    /// Start the heads at zero, so that the field is the identity, instead of at random as the reference does.
    pub zero_init: bool,
    /// Slope of hidden units below zero, 0 to 1 (published: 0, ReLU). Above 0, a unit that is never above zero still learns: small
    /// networks under high rates otherwise lose all of theirs while little moves, and stand still ever after.
    pub leak: f32,
}

impl Default for DefGsConfig {
    fn default() -> Self {
        Self {
            width: 256,
            depth: 8,
            skip: 4,
            bands_position: 10,
            bands_time: 6,
            time_hidden: 256,
            time_features: 30,
            coordinate_scale: 1.0,
            scale_rule: ScaleRule::Add,
            quat_rule: QuatRule::Unit,
            zero_init: true,
            leak: 0.0,
        }
    }
}

impl DefGsConfig {
    /// Four layers of 128 instead of eight of 256: about a seventh of the time of the default.
    pub fn fast() -> Self {
        Self { width: 128, depth: 4, skip: 2, time_hidden: 64, ..Self::default() }
    }

    fn check(&self) -> Result<(), DeformError> {
        let within = |field, v: usize, lo: usize, hi: usize, rule| {
            if (lo..=hi).contains(&v) { Ok(()) } else { Err(DeformError::Config { field, value: v.to_string(), rule }) }
        };
        within("width", self.width, 1, 4096, "1 to 4096")?;
        within("depth", self.depth, 1, 64, "1 to 64")?;
        within("bands_position", self.bands_position, 0, 24, "0 to 24")?;
        within("bands_time", self.bands_time, 0, 24, "0 to 24")?;
        within("time_hidden", self.time_hidden, 0, 4096, "0 to 4096")?;
        within("time_features", self.time_features, 1, 4096, "1 to 4096")?;
        if !(0.0..=1.0).contains(&self.leak) {
            return Err(DeformError::Config { field: "leak", value: self.leak.to_string(), rule: "0 to 1" });
        }
        if !self.coordinate_scale.is_finite() {
            let value = self.coordinate_scale.to_string();
            return Err(DeformError::Config { field: "coordinate_scale", value, rule: "finite" });
        }
        Ok(())
    }
}

/// The field of Deformable 3D Gaussians; see the [module](self).
#[derive(Clone, Debug)]
pub struct DefMlp {
    config: DefGsConfig,
    net: DefNet,
}

/// Activations of a [`DefMlp`] between forward and backward.
#[derive(Clone, Debug, Default)]
pub struct DefMlpTape {
    net: DefNetTape,
    blocks: Vec<Block>,
    chunks: Vec<ChunkGrad>,
}

impl DefMlp {
    /// A field whose parameters are named `field.time.…`, `field.layer.…`, `field.means.…`, `field.quats.…`,
    /// `field.scales.…`.
    ///
    /// # Errors
    /// If a setting is out of its domain; the message names it.
    pub fn new(config: &DefGsConfig, seed: u64) -> Result<Self, DeformError> {
        config.check()?;
        Ok(Self { config: config.clone(), net: DefNet::new(config, seed) })
    }

    /// The settings this field was built from.
    pub fn config(&self) -> &DefGsConfig {
        &self.config
    }

    /// The rules by which its offsets are applied.
    pub fn rule(&self) -> Apply {
        Apply { scale: self.config.scale_rule, quat: self.config.quat_rule, scale_limit: None }
    }
}

impl Field for DefMlp {
    type Tape = DefMlpTape;

    fn forward(&self, canonical: GeometryRef<'_>, t: Time, tape: &mut DefMlpTape, out: &mut Geometry) {
        out.resize(canonical.len());
        self.net.fold_time(t, &mut tape.net);
        tape.blocks.resize_with(canonical.len().div_ceil(BLOCK), Block::default);
        let columns = canonical.chunks(BLOCK).zip(out.view_mut().chunks(BLOCK));
        tape.blocks.par_iter_mut().zip(columns).for_each(|(block, (from, mut to))| {
            self.net.forward_block(&tape.net, from.means, block);
            self.rule().forward(from, block.offsets.view(), &mut to);
        });
    }

    fn backward(
        &mut self,
        canonical: GeometryRef<'_>,
        tape: &mut DefMlpTape,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
    ) {
        let DefMlpTape { net, blocks, chunks } = tape;
        let per_chunk = nn::blocks_per_chunk(blocks.len());
        let rows = per_chunk * BLOCK;
        chunks.resize_with(CHUNKS, ChunkGrad::default);
        let used = &mut chunks[..blocks.len().div_ceil(per_chunk)];
        let columns = canonical.chunks(rows).zip(d_out.chunks(rows));
        let columns = columns.zip(d_canonical.view_mut().chunks(rows));
        let runs = blocks.par_chunks_mut(per_chunk).zip(&mut *used).zip(columns);
        runs.for_each(|((blocks, grad), ((from, d_to), mut d_from))| {
            self.net.reset(grad);
            for (i, block) in blocks.iter_mut().enumerate() {
                let (offsets, d_offsets) = (block.offsets.view(), &mut block.d_offsets);
                self.rule().backward(
                    from.block(i, BLOCK),
                    offsets,
                    d_to.block(i, BLOCK),
                    &mut d_from.block(i, BLOCK),
                    d_offsets,
                );
                self.net.backward_block(block, grad);
            }
        });
        self.net.add_grads(net, used);
    }

    fn regularise(&mut self, _canonical: GeometryRef<'_>, _t: Time, _step: u32) -> Vec<(&'static str, f32)> {
        Vec::new()
    }
}

impl Params for DefMlp {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
    }
}
