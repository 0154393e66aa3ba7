//! A HexPlane read by a small network with several outputs: the body of every field built on planes.
//!
//! ```text
//! f = HexPlane(p, t)                              see encode::hexplane
//! h = relu(trunk(f))                              Linear(F→W), then depth−1 × (ReLU, Linear(W→W))
//! y_k = W₂ₖ relu(W₁ₖ h + b₁ₖ) + b₂ₖ               one head k per output column; see gs_core::nn::heads
//! ```
//! Weights start Xavier-uniform with biases U(±1/√fan-in). The reference starts its last layers so too, which makes every
//! output a random, nearly constant number at the first step; here they start at **zero**, so that a net says nothing
//! until it is trained. [`PlaneNetConfig::zero_init`] switches back.
//!
//! Points lie in blocks of [`BLOCK`](gs_core::nn::BLOCK) rows; outputs and their cotangents stay in the tape, block by block, where the
//! caller reads and writes them in parallel ([`PlaneNetTape::blocks`]).

use crate::encode::{HexPlane, HexPlaneConfig, HexTape, Places};
use crate::{Aabb, DeformError};
use glam::Vec3;
use gs_core::nn::{self, CHUNKS, Heads, HeadsGrad, HeadsTape, Init, Mlp, MlpGrad, MlpTape};
use gs_core::{Param, Params, Time};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of a [`PlaneNet`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlaneNetConfig {
    /// Width of trunk and heads.
    pub width: usize,
    /// Linear layers in the trunk; 0 counts as 1, as in the reference.
    pub depth: usize,
    /// Start the heads' last layers at zero (the net says nothing) instead of as the reference does.
    pub zero_init: bool,
    /// The encoder.
    pub hexplane: HexPlaneConfig,
}

impl Default for PlaneNetConfig {
    fn default() -> Self {
        Self { width: 128, depth: 1, zero_init: true, hexplane: HexPlaneConfig::default() }
    }
}

impl PlaneNetConfig {
    fn check(&self) -> Result<(), DeformError> {
        if !(1..=4096).contains(&self.width) {
            return Err(DeformError::Config { field: "width", value: self.width.to_string(), rule: "1 to 4096" });
        }
        if self.depth > 64 {
            return Err(DeformError::Config { field: "depth", value: self.depth.to_string(), rule: "at most 64" });
        }
        Ok(())
    }
}

/// The net; see the [module](self).
#[derive(Clone, Debug)]
pub struct PlaneNet {
    hexplane: HexPlane,
    trunk: Mlp,
    heads: Heads,
}

/// Scratch of a [`PlaneNet`], reused between calls.
#[derive(Clone, Debug, Default)]
pub struct PlaneNetTape {
    hex: HexTape,
    blocks: Vec<NetBlock>,
    chunks: Vec<ChunkGrad>,
}

/// What a net says about one block of points.
#[derive(Clone, Debug, Default)]
pub struct NetBlock {
    trunk: MlpTape,
    heads: HeadsTape,
}

/// Parameter gradients of one chunk of blocks, and scratch.
#[derive(Clone, Debug, Default)]
struct ChunkGrad {
    trunk: MlpGrad,
    heads: HeadsGrad,
    d_hidden: Vec<f32>,
}

impl NetBlock {
    /// Output of head `h`, `[rows, outputs]`.
    pub fn head(&self, h: usize) -> &[f32] {
        &self.heads.out[h]
    }

    /// Cotangent of [`NetBlock::head`], same shape: to be filled in before [`PlaneNet::backward`].
    pub fn head_grad_mut(&mut self, h: usize) -> &mut [f32] {
        &mut self.heads.d_out[h]
    }
}

impl PlaneNetTape {
    /// The blocks of the last forward pass: [`BLOCK`](gs_core::nn::BLOCK) points each, the last may hold fewer.
    pub fn blocks(&self) -> &[NetBlock] {
        &self.blocks
    }

    /// The same, to write cotangents to.
    pub fn blocks_mut(&mut self) -> &mut [NetBlock] {
        &mut self.blocks
    }
}

impl PlaneNet {
    /// A net over the box with the given heads (name, outputs). Parameters are named `{name}.planes.{pair}.{level}`,
    /// `{name}.trunk.{layer}.…`, `{name}.hidden.…` (all heads' first layers) and `{name}.{head}.…`.
    ///
    /// # Errors
    /// If a setting cannot be built; the message names it.
    pub fn new(
        name: &str,
        config: &PlaneNetConfig,
        heads: &[(&str, usize)],
        aabb: Aabb,
        seed: u64,
    ) -> Result<Self, DeformError> {
        config.check()?;
        let hexplane = HexPlane::new(&format!("{name}.planes"), &config.hexplane, aabb, seed)?;
        let mut widths = vec![config.width; config.depth.max(1) + 1];
        widths[0] = hexplane.width();
        let trunk =
            Mlp::new(&format!("{name}.trunk"), &widths, Init::Xavier, Init::Xavier, seed).with_last_activation();
        let last = if config.zero_init { Init::Zero } else { Init::Xavier };
        Ok(Self { hexplane, trunk, heads: Heads::new(name, [config.width; 2], heads, last, seed) })
    }

    /// The encoder.
    pub fn hexplane(&self) -> &HexPlane {
        &self.hexplane
    }

    /// Evaluates all heads at all points at one time; outputs are left in [`PlaneNetTape::blocks`].
    pub fn forward(&self, points: &[Vec3], t: Time, tape: &mut PlaneNetTape) {
        self.hexplane.forward(points, t, &mut tape.hex);
        self.forward_dense(tape);
    }

    /// Finds the cells of points that never move, for [`PlaneNet::forward_placed`] at any time and training step.
    pub fn place(&self, points: &[Vec3]) -> Places {
        self.hexplane.place(points)
    }

    /// [`PlaneNet::forward`] for points placed before: the same bits.
    pub fn forward_placed(&self, places: &Places, t: Time, tape: &mut PlaneNetTape) {
        self.hexplane.forward_placed(places, t, &mut tape.hex);
        self.forward_dense(tape);
    }

    fn forward_dense(&self, tape: &mut PlaneNetTape) {
        tape.blocks.resize_with(tape.hex.blocks.len(), NetBlock::default);
        tape.hex.blocks.par_iter().zip(&mut tape.blocks).for_each(|(hex, block)| {
            self.trunk.forward(&hex.features, &mut block.trunk);
            self.heads.forward(block.trunk.output(), &mut block.heads);
        });
    }

    /// The way back of [`PlaneNet::forward`] from the cotangents in the tape's blocks: adds to the parameters' gradients
    /// and, where given, to `d_points` (world units). Without `d_points` the points count as constants.
    pub fn backward(&mut self, tape: &mut PlaneNetTape, d_points: Option<&mut [Vec3]>) {
        let PlaneNetTape { hex, blocks, chunks } = tape;
        let per_chunk = nn::blocks_per_chunk(blocks.len());
        chunks.resize_with(CHUNKS, ChunkGrad::default);
        let used = &mut chunks[..blocks.len().div_ceil(per_chunk)];
        let runs = hex.blocks.par_chunks_mut(per_chunk).zip(blocks.par_chunks_mut(per_chunk)).zip(&mut *used);
        runs.for_each(|((hex, blocks), grad)| {
            grad.trunk.reset(&self.trunk);
            grad.heads.reset(&self.heads);
            for (hex, block) in hex.iter_mut().zip(blocks) {
                let ChunkGrad { trunk, heads, d_hidden } = grad;
                d_hidden.resize(block.trunk.output().len(), 0.0);
                self.heads.backward(block.trunk.output(), &block.heads, d_hidden, heads);
                hex.d_features.clear();
                hex.d_features.resize(hex.features.len(), 0.0);
                self.trunk.backward(&hex.features, &mut block.trunk, d_hidden, Some(&mut hex.d_features), trunk);
            }
        });
        self.trunk.add_grads(used.iter().map(|g| &g.trunk));
        self.heads.add_grads(used.iter().map(|g| &g.heads));
        self.hexplane.backward(hex, d_points);
    }

    /// Adds the weighted gradients of the planes' regularisers; returns their weighted values by name.
    pub fn regularise(&mut self) -> [(&'static str, f32); 3] {
        self.hexplane.regularise()
    }
}

impl Params for PlaneNet {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.hexplane.visit(f);
        self.trunk.visit(f);
        self.heads.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.hexplane.visit_mut(f);
        self.trunk.visit_mut(f);
        self.heads.visit_mut(f);
    }
}
