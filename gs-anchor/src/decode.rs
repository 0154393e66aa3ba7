//! Anchors to Gaussians for a camera centre (Lu et al. 2024, Scaffold-GS, Eqs. 5–9), forward and backward.
//!
//! ```text
//! a   = tanh F_α(f', d)               k per anchor; only Gaussians with a > 0 exist, and a is their opacity
//! rgb = σ(F_c(f', d, e))              3k
//! q   = F_Σ(f', d)                    7k: three scale logits and a raw quaternion each
//! μ   = x' + O' ⊙ l'[0:3]     s = |l'[3:6]| ⊙ σ(q[0:3])     r = q[3:7]
//! ```
//! `d` is the unit vector from the camera centre to the anchor, `e` one learned appearance vector. All networks are
//! `Linear · ReLU · Linear`. An extent `l'[3:6]` may be negative (deformation adds to it); only squares of scales
//! matter, so its magnitude is written and its sign multiplies the gradient. The distance `δ` as an input and a bank of
//! three feature resolutions are options, as published; that a head does without `d` is ours.
//!
//! Anchors nearer to the camera centre than [`MIN_DISTANCE`] have no direction and are dropped.
//!
//! ```
//! use gs_anchor::{AnchorShape, Anchors, DecodeTape, Decoder, DecoderConfig, LocalAnchors, Visible};
//! use gs_core::Splats;
//! use glam::{DVec3, Vec3};
//!
//! let shape = AnchorShape { offsets: 10, features: 32, dynamics: 0 };
//! let decoder = Decoder::new(&DecoderConfig::default(), shape, 1)?;
//! let (mut local, mut tape, mut splats) = (LocalAnchors::default(), DecodeTape::default(), Splats::default());
//! Anchors::new(shape, &[Vec3::ZERO, Vec3::X], &[-3.0; 2]).activate(&mut local);
//! decoder.forward(&local, Visible::List(&[1]), DVec3::NEG_Z, &mut tape, &mut splats);
//! assert!(splats.means.iter().all(|m| *m == Vec3::X), "offsets are zero before training");
//! assert!(tape.rows.iter().all(|row| (10..20).contains(row)), "rows of the second anchor");
//! # Ok::<(), gs_anchor::DecoderError>(())
//! ```

mod bank;
mod gaussians;
mod heads;

use crate::{AnchorShape, LocalAnchors, LocalAnchorsGrad};
use bank::{Bank, BankGrad, BankTape};
use gaussians::{AnchorGradRows, HeadOutputs, SplatRows, ViewRay};
use glam::{DVec3, Vec3};
use gs_core::nn::{self, BLOCK, CHUNKS};
use gs_core::{Param, Params, Splats, SplatsGrad, cast};
use heads::{Fused, Heads, HeadsGrad, HeadsTape};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Anchors nearer to the camera centre than this are not decoded, world units.
pub const MIN_DISTANCE: f64 = 1e-6;

/// Which heads take an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadInputs {
    /// Whether the opacity head does.
    pub opacity: bool,
    /// Whether the colour head does.
    pub color: bool,
    /// Whether the covariance head does.
    pub covariance: bool,
}

impl HeadInputs {
    /// No head does.
    pub const NONE: Self = Self { opacity: false, color: false, covariance: false };
    /// All do.
    pub const ALL: Self = Self { opacity: true, color: true, covariance: true };

    /// In the order of the heads: opacity, colour, covariance.
    pub(crate) fn each(self) -> [bool; 3] {
        [self.opacity, self.color, self.covariance]
    }
}

/// Settings of a [`Decoder`]; the defaults are the published ones.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DecoderConfig {
    /// Width of the appearance vector `e`; 0: none.
    pub appearance: usize,
    /// Which heads take the direction `d` from camera centre to anchor as input (published: all). A head that does not gives the
    /// same to every camera.
    pub direction: HeadInputs,
    /// Which heads take the distance `δ` as input (published: none).
    pub distance: HeadInputs,
    /// Blend three resolutions of the feature by view direction and distance (the width must be a multiple of 4).
    pub feature_bank: bool,
}

impl Default for DecoderConfig {
    fn default() -> Self {
        Self { appearance: 16, direction: HeadInputs::ALL, distance: HeadInputs::NONE, feature_bank: false }
    }
}

impl DecoderConfig {
    /// Inputs of head `h` without appearance: the feature and what it takes of the view.
    pub(crate) fn inputs(&self, features: usize, h: usize) -> usize {
        features + 3 * usize::from(self.direction.each()[h]) + usize::from(self.distance.each()[h])
    }

    /// Number of parameters of a decoder for such anchors; the largest number where that is beyond it.
    pub fn param_count(&self, shape: AnchorShape) -> u64 {
        let bank = if self.feature_bank { Bank::count(shape.features) } else { 0 };
        Heads::count(self, shape).saturating_add(bank)
    }
}

/// Settings or an anchor shape that no decoder can be built for.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("decoder setting `{field}` = {value} cannot be built: it must be {rule}")]
pub struct DecoderError {
    /// Name of the setting or of the column of [`AnchorShape`].
    pub field: &'static str,
    /// The value of the setting, out of its domain.
    pub value: usize,
    /// The domain in words, after "it must be".
    pub rule: &'static str,
}

/// The selection of anchors to decode.
#[derive(Clone, Copy, Debug)]
pub enum Visible<'a> {
    /// All anchors of the [`LocalAnchors`].
    All,
    /// The anchors with these indices, strictly increasing.
    List(&'a [u32]),
}

/// The networks that decode anchors to Gaussians; see the [module](self).
#[derive(Clone, Debug)]
pub struct Decoder {
    config: DecoderConfig,
    shape: AnchorShape,
    heads: Heads,
    bank: Option<Bank>,
}

/// Activations of a [`Decoder`], for its backward and for densification statistics; reused between calls.
#[derive(Clone, Debug, Default)]
pub struct DecodeTape {
    /// Indices of the anchors that were decoded, increasing.
    pub visible: Vec<u32>,
    /// `tanh` of the opacity head, `[visible, k]`; a Gaussian exists where it is positive.
    pub activations: Vec<f32>,
    /// For each splat, in order: `anchor · k + j`, its row in [`LocalAnchors::offsets`].
    pub rows: Vec<u32>,
    fused: Fused,
    blocks: Vec<Block>,
    chunks: Vec<ChunkGrad>,
}

/// Activations of one block of anchors.
#[derive(Clone, Debug, Default)]
struct Block {
    rays: Vec<ViewRay>,
    bank: BankTape,
    heads: HeadsTape,
    color: Vec<f32>,
    covariance: Vec<f32>,
    /// Number of splats of this block, and the index of its first.
    kept: usize,
    first: usize,
}

/// Parameter gradients of one chunk of blocks.
#[derive(Clone, Debug, Default)]
struct ChunkGrad {
    heads: HeadsGrad,
    bank: BankGrad,
}

impl Decoder {
    /// A decoder for anchors of the given shape. Parameters are named `heads.opacity.…`, `heads.color.…`,
    /// `heads.covariance.…`, `heads.appearance` and `heads.bank.…`. Weights and biases start uniform in `±1/√inputs`,
    /// `e` normal.
    ///
    /// # Errors
    /// If the shape has no offsets or no features, or the feature bank is on and the width is not a multiple of 4.
    pub fn new(config: &DecoderConfig, shape: AnchorShape, seed: u64) -> Result<Self, DecoderError> {
        let refuse = |field, value, rule| Err(DecoderError { field, value, rule });
        if shape.offsets == 0 {
            return refuse("offsets", 0, "at least 1");
        }
        if shape.features == 0 {
            return refuse("features", 0, "at least 1");
        }
        if config.feature_bank && !shape.features.is_multiple_of(4) {
            return refuse("features", shape.features, "a multiple of 4 with the feature bank");
        }
        let heads = Heads::new(config, shape, seed);
        let bank = config.feature_bank.then(|| Bank::new(shape.features, seed));
        Ok(Self { config: config.clone(), shape, heads, bank })
    }

    /// The settings this decoder was built from.
    pub fn config(&self) -> &DecoderConfig {
        &self.config
    }

    /// The shape of anchors this decoder was built for.
    pub fn shape(&self) -> AnchorShape {
        self.shape
    }

    /// The same decoder without an appearance input: `e` is folded into a bias. Decodes to the same bits.
    pub fn folded(&self) -> Self {
        let config = DecoderConfig { appearance: 0, ..self.config.clone() };
        Self { config, shape: self.shape, heads: self.heads.folded(), bank: self.bank.clone() }
    }

    /// Decodes anchors for a camera at `eye` (world units) into `out`: plain colours, raw quaternions, scales ≥ 0.
    /// Splats are ordered by anchor, then by offset.
    ///
    /// # Panics
    /// If `local` is not of the decoder's shape, or a list is not increasing or names an anchor that does not exist.
    pub fn forward(
        &self,
        local: &LocalAnchors,
        visible: Visible<'_>,
        eye: DVec3,
        tape: &mut DecodeTape,
        out: &mut Splats,
    ) {
        decodable(local, visible, eye, &mut tape.visible);
        let DecodeTape { visible, activations, rows, fused, blocks, .. } = tape;
        let k = self.shape.offsets;
        self.heads.fuse(fused);
        activations.resize(visible.len() * k, 0.0);
        blocks.resize_with(visible.len().div_ceil(BLOCK), Block::default);
        let work = blocks.par_iter_mut().zip(visible.par_chunks(BLOCK)).zip(activations.par_chunks_mut(BLOCK * k));
        work.for_each(|((block, anchors), a)| self.forward_block(fused, local, anchors, eye, block, a));
        let mut kept = 0;
        for block in &mut *blocks {
            block.first = kept;
            kept += block.kept;
        }
        let mut columns = SplatRows::all(out, rows, kept);
        let columns: Vec<SplatRows<'_>> = blocks.iter().map(|b| columns.take(b.kept)).collect();
        let work = blocks.par_iter_mut().zip(visible.par_chunks(BLOCK)).zip(activations.par_chunks(BLOCK * k));
        work.zip(columns).for_each(|(((block, anchors), a), to)| {
            gaussians::write(local, anchors, block.outputs(a), to);
        });
    }

    fn forward_block(
        &self,
        fused: &Fused,
        local: &LocalAnchors,
        anchors: &[u32],
        eye: DVec3,
        block: &mut Block,
        a: &mut [f32],
    ) {
        let (width, inputs, k) = (self.shape.features, self.heads.input_width(), self.shape.offsets);
        let Block { rays, bank, heads, color, covariance, kept, .. } = block;
        rays.clear();
        rays.extend(anchors.iter().map(|&v| ViewRay::new(local.positions[v as usize], eye)));
        if let Some(net) = &self.bank {
            net.weigh(rays.iter().map(|s| s.direction.extend(s.distance).to_array()), bank);
        }
        heads.input.resize(anchors.len() * inputs, 0.0);
        for (i, (row, ray)) in heads.input.chunks_exact_mut(inputs).zip(rays).enumerate() {
            let feature = &local.features[anchors[i] as usize * width..][..width];
            let (to, rest) = row.split_at_mut(width);
            match &self.bank {
                Some(net) => net.mix(bank, i, feature, to),
                None => to.copy_from_slice(feature),
            }
            ray.direction.write_to_slice(rest);
            rest[3..].fill(ray.distance);
        }
        color.resize(anchors.len() * 3 * k, 0.0);
        covariance.resize(anchors.len() * 7 * k, 0.0);
        self.heads.forward(fused, heads, [&mut *a, color, covariance]);
        a.iter_mut().for_each(|a| *a = a.tanh());
        *kept = a.iter().filter(|a| **a > 0.0).count();
    }

    /// Backward of [`Decoder::forward`] of the same anchors with the same parameters, from the cotangents `d_out` of
    /// its splats: adds to the parameters' gradients and to `d_local` (shaped like `local`).
    ///
    /// # Panics
    /// If `local`, the tape and the cotangents do not match in size.
    pub fn backward(
        &mut self,
        local: &LocalAnchors,
        tape: &mut DecodeTape,
        d_out: &SplatsGrad,
        d_local: &mut LocalAnchorsGrad,
    ) {
        let DecodeTape { visible, activations, fused, blocks, chunks, .. } = tape;
        let k = self.shape.offsets;
        let per_chunk = nn::blocks_per_chunk(blocks.len());
        let rows = per_chunk * BLOCK;
        chunks.resize_with(CHUNKS, ChunkGrad::default);
        let used = &mut chunks[..blocks.len().div_ceil(per_chunk)];
        let mut all = AnchorGradRows::all(d_local);
        let ends = (1..=used.len()).map(|c| visible.get(c * rows).map_or(local.len(), |&v| v as usize));
        let parts: Vec<AnchorGradRows<'_>> = ends.map(|end| all.take(end)).collect();
        let work = blocks.par_chunks_mut(per_chunk).zip(visible.par_chunks(rows)).zip(activations.par_chunks(rows * k));
        work.zip(&mut *used).zip(parts).for_each(|((((blocks, anchors), a), grad), mut d)| {
            self.heads.reset(fused, &mut grad.heads);
            if let Some(bank) = &self.bank {
                bank.reset(&mut grad.bank);
            }
            for (block, (anchors, a)) in blocks.iter_mut().zip(anchors.chunks(BLOCK).zip(a.chunks(BLOCK * k))) {
                let first = block.first;
                gaussians::backward(local, anchors, block.outputs(a), (d_out, first), &mut d, &mut grad.heads.d_out);
                self.heads.backward(fused, &block.heads, &mut grad.heads);
                self.input_backward(local, anchors, block, grad, &mut d);
            }
        });
        self.heads.add_grads(fused, used.iter().map(|g| &g.heads));
        if let Some(bank) = &mut self.bank {
            bank.add_grads(used.iter().map(|g| &g.bank));
        }
    }

    /// From the cotangents of a block's inputs to those of its features and positions.
    fn input_backward(
        &self,
        local: &LocalAnchors,
        anchors: &[u32],
        block: &mut Block,
        grad: &mut ChunkGrad,
        d: &mut AnchorGradRows<'_>,
    ) {
        let (width, inputs) = (self.shape.features, self.heads.input_width());
        let ChunkGrad { heads: HeadsGrad { d_input, .. }, bank: bank_grad } = grad;
        for (row, (ray, &v)) in d_input.chunks_exact(inputs).zip(block.rays.iter().zip(anchors)) {
            let at = d.row(v);
            let d_distance = row.get(width + 3).map_or(0.0, |d| *d);
            d.positions[at] += ray.backward(Vec3::from_slice(&row[width..]), d_distance);
            if self.bank.is_none() {
                d.feature(at, width).iter_mut().zip(row).for_each(|(d, g)| *d += g);
            }
        }
        let Some(bank) = &self.bank else { return };
        let tape = &block.bank;
        let logits = d_input.chunks_exact(inputs).zip(anchors).enumerate().map(|(i, (row, &v))| {
            let feature = &local.features[v as usize * width..][..width];
            let at = d.row(v);
            bank.mix_backward(tape, i, feature, &row[..width], d.feature(at, width))
        });
        let logits: Vec<[f32; 3]> = logits.collect();
        bank.backward(&mut block.bank, logits.into_iter(), bank_grad);
        for ((g, ray), &v) in bank_grad.d_view.as_chunks::<4>().0.iter().zip(&block.rays).zip(anchors) {
            let at = d.row(v);
            d.positions[at] += ray.backward(Vec3::from_slice(g), g[3]);
        }
    }
}

impl Block {
    fn outputs<'a>(&'a mut self, activations: &'a [f32]) -> HeadOutputs<'a> {
        HeadOutputs { activations, color: &mut self.color, covariance: &mut self.covariance }
    }
}

/// The indices of the selected anchors, without those nearer to `eye` than [`MIN_DISTANCE`].
fn decodable(local: &LocalAnchors, visible: Visible<'_>, eye: DVec3, to: &mut Vec<u32>) {
    let has_direction = |v: &u32| local.positions[*v as usize].as_dvec3().distance(eye) >= MIN_DISTANCE;
    to.clear();
    match visible {
        Visible::All => to.extend((0..cast::to_u32(local.len())).filter(has_direction)),
        Visible::List(list) => {
            assert!(list.is_sorted_by(|a, b| a < b), "the list of visible anchors must increase");
            to.extend(list.iter().copied().filter(has_direction));
        }
    }
}

impl Params for Decoder {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.heads.visit(f);
        self.bank.iter().for_each(|b| b.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.heads.visit_mut(f);
        self.bank.iter_mut().for_each(|b| b.visit_mut(f));
    }
}
