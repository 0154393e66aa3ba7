//! A HexPlane and a small MLP with several heads: the network of every field built on planes.
//!
//! ```text
//! f = HexPlane(p, t)                              see encode::hexplane
//! h = relu(trunk(f))                              Linear(F→W), then depth−1 × (ReLU, Linear(W→W))
//! y_k = W₂ₖ relu(W₁ₖ h + b₁ₖ) + b₂ₖ               one head k per output column; see gs_core::nn::heads
//! ```
//! Weights start Xavier-uniform with biases U(±1/√fan-in). The reference starts its last layers the same way, which
//! makes every output a random, nearly constant number at the first step; here they start at **zero**, so that an
//! untrained net outputs zero. [`PlaneNetConfig::zero_init`] switches back.
//!
//! Points are split into blocks of [`BLOCK`](gs_core::nn::BLOCK) rows; outputs and their cotangents stay in the tape,
//! block by block, where the caller reads and writes them in parallel ([`PlaneNetTape::blocks`]).
//!
//! ```
//! use gs_core::Time;
//! use gs_deform::{Aabb, PlaneNet, PlaneNetConfig, PlaneNetTape};
//!
//! let net = PlaneNet::new("net", &PlaneNetConfig::default(), &[("means", 3), ("features", 32)], Aabb::cube(1.0), 1)?;
//! let mut tape = PlaneNetTape::default();
//! net.forward(&[glam::Vec3::ZERO; 2], Time::new(0.5)?, &mut tape);
//! assert_eq!(tape.blocks()[0].head(1), [0.0; 2 * 32], "two rows of 32 outputs, zero before training");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::encode::{GridCells, HexPlane, HexPlaneConfig, HexTape};
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
    /// Width of trunk and heads, 1 to 4096.
    pub width: usize,
    /// Linear layers in the trunk, at most 64; 0 counts as 1, as in the reference.
    pub depth: usize,
    /// Start the heads' last layers at zero, so that all outputs are zero, instead of at random as the reference does.
    pub zero_init: bool,
    /// Size and regularisers of the planes.
    pub hexplane: HexPlaneConfig,
}

impl Default for PlaneNetConfig {
    fn default() -> Self {
        Self { width: 128, depth: 1, zero_init: true, hexplane: HexPlaneConfig::default() }
    }
}

impl PlaneNetConfig {
    /// Number of parameters of a net with the given heads (name, outputs); the largest number where that is beyond it.
    pub fn param_count(&self, heads: &[(&str, usize)]) -> u64 {
        let features = self.hexplane.channels.saturating_mul(self.hexplane.levels.len());
        let trunk = Mlp::count_deep(features, self.depth.max(1) - 1, self.width, self.width);
        let layers = trunk.saturating_add(Heads::count([self.width; 2], heads));
        self.hexplane.param_count().saturating_add(layers)
    }

    /// Widths of the trunk, from the planes' features on.
    fn trunk(&self) -> Vec<usize> {
        let mut widths = vec![self.width; self.depth.max(1) + 1];
        widths[0] = self.hexplane.channels * self.hexplane.levels.len();
        widths
    }

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

/// A HexPlane with an MLP of several heads; see the [module](self).
#[derive(Clone, Debug)]
pub struct PlaneNet {
    hexplane: HexPlane,
    trunk: Mlp,
    heads: Heads,
}

/// Activations of a [`PlaneNet`] between forward and backward, reused between calls.
#[derive(Clone, Debug, Default)]
pub struct PlaneNetTape {
    hex: HexTape,
    blocks: Vec<NetBlock>,
    chunks: Vec<ChunkGrad>,
}

/// Outputs of a [`PlaneNet`] for one block of points.
#[derive(Clone, Debug, Default)]
pub struct NetBlock {
    trunk: MlpTape,
    heads: HeadsTape,
}

/// Parameter gradients of one chunk of blocks.
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

    /// Cotangent of [`NetBlock::head`], same shape: the caller fills it in before [`PlaneNet::backward`].
    pub fn head_grad_mut(&mut self, h: usize) -> &mut [f32] {
        &mut self.heads.d_out[h]
    }
}

impl PlaneNetTape {
    /// The blocks of the last forward pass: [`BLOCK`](gs_core::nn::BLOCK) points each, the last may hold fewer.
    pub fn blocks(&self) -> &[NetBlock] {
        &self.blocks
    }

    /// [`PlaneNetTape::blocks`], to write cotangents to.
    pub fn blocks_mut(&mut self) -> &mut [NetBlock] {
        &mut self.blocks
    }
}

impl PlaneNet {
    /// A net over the box `aabb` with the given heads (name, outputs). Parameters are named
    /// `{name}.planes.{pair}.{level}`, `{name}.trunk.{layer}.…`, `{name}.hidden.…` (all heads' first layers) and
    /// `{name}.{head}.…`.
    ///
    /// # Errors
    /// If a setting is out of its domain; the message names it.
    pub fn new(
        name: &str,
        config: &PlaneNetConfig,
        heads: &[(&str, usize)],
        aabb: Aabb,
        seed: u64,
    ) -> Result<Self, DeformError> {
        config.check()?;
        let hexplane = HexPlane::new(&format!("{name}.planes"), &config.hexplane, aabb, seed)?;
        let trunk = Mlp::new(&format!("{name}.trunk"), &config.trunk(), Init::Xavier, Init::Xavier, seed)
            .with_last_activation();
        let last = if config.zero_init { Init::Zero } else { Init::Xavier };
        Ok(Self { hexplane, trunk, heads: Heads::new(name, [config.width; 2], heads, last, seed) })
    }

    /// The planes that points are encoded by.
    pub fn hexplane(&self) -> &HexPlane {
        &self.hexplane
    }

    /// Evaluates all heads at all points (world units) at one timestamp; the outputs are in [`PlaneNetTape::blocks`].
    pub fn forward(&self, points: &[Vec3], t: Time, tape: &mut PlaneNetTape) {
        self.hexplane.forward(points, t, &mut tape.hex);
        self.forward_dense(tape);
    }

    /// Finds the cells of static points, for [`PlaneNet::forward_located`] at any time and training step.
    pub fn place(&self, points: &[Vec3]) -> GridCells {
        self.hexplane.place(points)
    }

    /// [`PlaneNet::forward`] for points whose cells are known: the same bits.
    pub fn forward_located(&self, places: &GridCells, t: Time, tape: &mut PlaneNetTape) {
        self.hexplane.forward_located(places, t, &mut tape.hex);
        self.forward_dense(tape);
    }

    fn forward_dense(&self, tape: &mut PlaneNetTape) {
        tape.blocks.resize_with(tape.hex.blocks.len(), NetBlock::default);
        tape.hex.blocks.par_iter().zip(&mut tape.blocks).for_each(|(hex, block)| {
            self.trunk.forward(&hex.features, &mut block.trunk);
            self.heads.forward(block.trunk.output(), &mut block.heads);
        });
    }

    /// Backward of [`PlaneNet::forward`] from the cotangents in the tape's blocks: adds to the parameters' gradients
    /// and, if given, to `d_points` (`[points]`, world units). Without `d_points` the points count as constants.
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
