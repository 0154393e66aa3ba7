//! The field of 4D Gaussian Splatting (Wu et al. 2024): a HexPlane, a trunk, and one small head per moving column.
//!
//! ```text
//! f = HexPlane(μ, t)                              see encode::hexplane
//! h = relu(trunk(f))                              Linear(F→W), then depth−1 × (ReLU, Linear(W→W))
//! δ = W₂ relu(W₁ h + b₁) + b₂                     one head each for δx (3), δs (3), δr (4)
//! μ' = μ + δx     s' = s · exp(δs)     q' = q + δr   (raw sums, as in the reference; q' is normalised where it is used)
//! ```
//! Weights start Xavier-uniform with biases U(±1/√fan-in). The reference starts its last layers so too, which moves every
//! splat by a random, nearly constant offset at the first step; here they start at **zero**, so that the field is the
//! identity bit for bit until it is trained. [`FourDgsConfig::zero_init`] switches back.
//!
//! The centre is where the grid is read, so a gradient flows through the grid into the centres; the reference keeps it
//! and so does this field. [`FourDgsConfig::detach_coordinates`] drops it, which saves about a tenth of the encoder's way back.

use super::Field;
use crate::apply::{self, Apply, OffsetColumns, Offsets, QuatRule, Rows, RowsMut, ScaleRule};
use crate::encode::hexplane::HexBlock;
use crate::encode::{HexPlane, HexPlaneConfig, HexTape};
use crate::{Aabb, DeformError};
use gs_core::nn::{self, BLOCK, CHUNKS, Init, Mlp, MlpGrad, MlpTape};
use gs_core::{Param, Params, Splats, SplatsGrad, Time};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of a [`HexPlaneField`]; the defaults are the published ones for synthetic scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FourDgsConfig {
    /// Width of trunk and heads.
    pub width: usize,
    /// Linear layers in the trunk; 0 counts as 1, as in the reference.
    pub depth: usize,
    /// Whether centres move.
    pub move_means: bool,
    /// Whether scales change.
    pub move_scales: bool,
    /// Whether rotations change.
    pub move_quats: bool,
    /// Start the heads' last layers at zero (identity field) instead of as the reference does.
    pub zero_init: bool,
    /// Treat the centres as constants where the grid is read.
    pub detach_coordinates: bool,
    /// The encoder.
    pub hexplane: HexPlaneConfig,
}

impl Default for FourDgsConfig {
    fn default() -> Self {
        Self {
            width: 64,
            depth: 1,
            move_means: true,
            move_scales: true,
            move_quats: true,
            zero_init: true,
            detach_coordinates: false,
            hexplane: HexPlaneConfig::default(),
        }
    }
}

impl FourDgsConfig {
    /// Half the channels and a grid of 48³: about two thirds of the time and a third of the parameters of the default.
    pub fn fast() -> Self {
        let hexplane = HexPlaneConfig { resolution: [48, 48, 48, 75], channels: 16, ..HexPlaneConfig::default() };
        Self { hexplane, ..Self::default() }
    }
}

const APPLY: Apply = Apply { scale: ScaleRule::Log, quat: QuatRule::Raw };

/// The field; see the [module](self).
#[derive(Clone, Debug)]
pub struct HexPlaneField {
    config: FourDgsConfig,
    hexplane: HexPlane,
    trunk: Mlp,
    /// Means, scales, quats; those that do not move have none.
    heads: [Option<Mlp>; 3],
}

/// Scratch of a [`HexPlaneField`].
#[derive(Clone, Debug, Default)]
pub struct HexPlaneTape {
    hex: HexTape,
    blocks: Vec<Block>,
    chunks: Vec<ChunkGrad>,
}

#[derive(Clone, Debug, Default)]
struct Block {
    trunk: MlpTape,
    heads: [MlpTape; 3],
    d_offsets: OffsetColumns,
    d_hidden: Vec<f32>,
}

/// Parameter gradients of one chunk of blocks.
#[derive(Clone, Debug, Default)]
struct ChunkGrad {
    trunk: MlpGrad,
    heads: [MlpGrad; 3],
}

impl HexPlaneField {
    /// A field over the box, its parameters named `field.planes.…`, `field.trunk.…`, `field.means.…` and so on.
    ///
    /// # Errors
    /// If a setting cannot be built; the message names it.
    pub fn new(config: &FourDgsConfig, aabb: Aabb, seed: u64) -> Result<Self, DeformError> {
        let width = config.width;
        if !(1..=4096).contains(&width) {
            return Err(DeformError::Config { field: "width", value: width.to_string(), rule: "1 to 4096" });
        }
        if config.depth > 64 {
            return Err(DeformError::Config { field: "depth", value: config.depth.to_string(), rule: "at most 64" });
        }
        let hexplane = HexPlane::new("field.planes", &config.hexplane, aabb, seed)?;
        let mut widths = vec![width; config.depth.max(1) + 1];
        widths[0] = hexplane.width();
        let last = if config.zero_init { Init::Zero } else { Init::Xavier };
        let head = |wanted: bool, name: &str, outputs: usize| {
            wanted.then(|| Mlp::new(name, &[width, width, outputs], Init::Xavier, last, seed))
        };
        Ok(Self {
            config: config.clone(),
            hexplane,
            trunk: Mlp::new("field.trunk", &widths, Init::Xavier, Init::Xavier, seed).with_last_relu(),
            heads: [
                head(config.move_means, "field.means", 3),
                head(config.move_scales, "field.scales", 3),
                head(config.move_quats, "field.quats", 4),
            ],
        })
    }

    /// The settings it was built from.
    pub fn config(&self) -> &FourDgsConfig {
        &self.config
    }

    /// The encoder.
    pub fn hexplane(&self) -> &HexPlane {
        &self.hexplane
    }

    fn forward_block(&self, features: &[f32], block: &mut Block, from: Rows<'_>, to: &mut RowsMut<'_>) {
        self.trunk.forward(features, &mut block.trunk);
        for (head, tape) in self.heads.iter().zip(&mut block.heads) {
            if let Some(head) = head {
                head.forward(block.trunk.output(), tape);
            }
        }
        APPLY.forward(from, offsets(&block.heads), to);
    }

    fn backward_block(
        &self,
        (hex, block): (&mut HexBlock, &mut Block),
        (from, d_to): (Rows<'_>, Rows<'_>),
        d_from: &mut RowsMut<'_>,
        grad: &mut ChunkGrad,
    ) {
        let Block { trunk, heads, d_offsets, d_hidden } = block;
        APPLY.backward(from, offsets(heads), d_to, d_from, d_offsets);
        d_hidden.clear();
        d_hidden.resize(trunk.output().len(), 0.0);
        let d_columns = [&d_offsets.means, &d_offsets.scales, &d_offsets.quats];
        for (((head, tape), grad), d) in self.heads.iter().zip(heads).zip(&mut grad.heads).zip(d_columns) {
            if let Some(head) = head {
                head.backward(trunk.output(), tape, d, Some(d_hidden), grad);
            }
        }
        hex.d_features.clear();
        hex.d_features.resize(hex.features.len(), 0.0);
        self.trunk.backward(&hex.features, trunk, d_hidden, Some(&mut hex.d_features), &mut grad.trunk);
    }

    fn reset(&self, grad: &mut ChunkGrad) {
        grad.trunk.reset(&self.trunk);
        for (grad, head) in grad.heads.iter_mut().zip(&self.heads) {
            if let Some(head) = head {
                grad.reset(head);
            }
        }
    }
}

/// The heads' outputs; a head that does not exist has an empty tape, which stands for zero offsets.
fn offsets(heads: &[MlpTape; 3]) -> Offsets<'_> {
    Offsets { means: heads[0].output(), scales: heads[1].output(), quats: heads[2].output() }
}

impl Field for HexPlaneField {
    type Tape = HexPlaneTape;

    fn forward(&self, canonical: &Splats, t: Time, tape: &mut HexPlaneTape, out: &mut Splats) {
        self.hexplane.forward(&canonical.means, t, &mut tape.hex);
        apply::pass_through(canonical, out);
        tape.blocks.resize_with(tape.hex.blocks.len(), Block::default);
        let columns = apply::chunks(canonical, BLOCK).zip(apply::chunks_mut(out, BLOCK));
        tape.hex.blocks.par_iter().zip(&mut tape.blocks).zip(columns).for_each(|((hex, block), (from, mut to))| {
            self.forward_block(&hex.features, block, from, &mut to);
        });
    }

    fn backward(
        &mut self,
        canonical: &Splats,
        tape: &mut HexPlaneTape,
        d_out: &SplatsGrad,
        d_canonical: &mut SplatsGrad,
    ) {
        let HexPlaneTape { hex, blocks, chunks } = tape;
        let per_chunk = nn::blocks_per_chunk(blocks.len());
        let rows = per_chunk * BLOCK;
        chunks.resize_with(CHUNKS, ChunkGrad::default);
        let used = &mut chunks[..blocks.len().div_ceil(per_chunk)];
        let runs = hex.blocks.par_chunks_mut(per_chunk).zip(blocks.par_chunks_mut(per_chunk)).zip(&mut *used);
        let columns = apply::chunks(canonical, rows).zip(apply::grad_chunks(d_out, rows));
        let columns = columns.zip(apply::grad_chunks_mut(d_canonical, rows));
        runs.zip(columns).for_each(|(((hex, blocks), grad), ((from, d_to), mut d_from))| {
            self.reset(grad);
            for (i, pair) in hex.iter_mut().zip(blocks).enumerate() {
                self.backward_block(pair, (from.block(i), d_to.block(i)), &mut d_from.block(i), grad);
            }
        });
        self.trunk.add_grads(used.iter().map(|g| &g.trunk));
        for (k, head) in self.heads.iter_mut().enumerate() {
            if let Some(head) = head {
                head.add_grads(used.iter().map(move |g| &g.heads[k]));
            }
        }
        let d_means = if self.config.detach_coordinates { None } else { Some(d_canonical.means.as_mut_slice()) };
        self.hexplane.backward(hex, d_means);
        apply::pass_through_backward(d_out, d_canonical);
    }

    fn regularise(&mut self, _canonical: &Splats, _t: Time, _step: u32) -> Vec<(&'static str, f32)> {
        self.hexplane.regularise().into()
    }
}

impl Params for HexPlaneField {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.hexplane.visit(f);
        self.trunk.visit(f);
        self.heads.iter().flatten().for_each(|h| h.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.hexplane.visit_mut(f);
        self.trunk.visit_mut(f);
        self.heads.iter_mut().flatten().for_each(|h| h.visit_mut(f));
    }
}
