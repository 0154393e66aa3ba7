//! Global anchor deformation (Kwak et al. 2025, MoDec-GS, Eqs. 6–7): the anchors of one time interval.
//!
//! A [`PlaneNet`] is evaluated at each anchor's canonical position and at the interval's canonical time `t_c`; its
//! heads give the changes of the anchor:
//!
//! ```text
//! (Δx, Δf, ΔO, Δl) = net(x, t_c)                     3, C, 3k, 6 values; see gs_deform::PlaneNet
//! x' = x + M Δx     f' = f + m Δf     O' = O + m ΔO     l' = exp(λ) + m Δl
//! ```
//! with the factors `M` (global) and `m` (local) of the anchor's logits ([`Dynamics`]). `Δl` is in world units and may
//! make a scale negative. Backward:
//!
//! ```text
//! g_Δx = M g_x'     g_Δf = m g_f' …     g_M = ⟨g_x', Δx⟩     g_m = ⟨g_f', Δf⟩ + ⟨g_O', ΔO⟩ + ⟨g_l', Δl⟩
//! g_x = g_x'     g_f = g_f'     g_O = g_O'     g_λ = g_l' ⊙ exp λ
//! ```
//! Changes of features, offsets and scales may be penalised ([`GadConfig::change_l2`]), with `u` the geometric mean of all
//! `exp λ`, a constant, and means over anchors and values:
//!
//! ```text
//! P = w (mean (m Δf)² + mean (m ΔO)² + mean (m Δl / u)²)
//! ```
//! Canonical positions are constants to the net. The result depends on the interval only: a [`LocalAnchors`] kept per interval
//! is an exact cache. With heads that start at zero the untrained result is the canonical anchors, bit for bit.
//!
//! ```
//! use gs_anchor::{AnchorShape, Anchors, Gad, GadConfig, GadTape, LocalAnchors};
//! use gs_core::Time;
//! use gs_deform::Aabb;
//!
//! let shape = AnchorShape { offsets: 10, features: 32, dynamics: 2 };
//! let anchors = Anchors::new(shape, &[glam::Vec3::X], &[-3.0]);
//! let gad = Gad::new(&GadConfig::default(), shape, Aabb::cube(2.0), 1)?;
//! let (mut canonical, mut deformed) = (LocalAnchors::default(), LocalAnchors::default());
//! anchors.activate(&mut canonical);
//! gad.forward(&anchors, Time::new(0.25)?, &mut GadTape::default(), &mut deformed);
//! assert_eq!(deformed, canonical, "an untrained field changes nothing");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod change;
mod dynamics;
mod moving;

pub use dynamics::{Activation, Dynamics, Factor, Sparsity, Weight};

use crate::{AnchorShape, Anchors, LocalAnchors, LocalAnchorsGrad};
use dynamics::weights_backward;
use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Param, Params, Time, cast};
use gs_deform::encode::{GridCells, HexPlaneConfig};
use gs_deform::{Aabb, DeformError, PlaneNet, PlaneNetConfig, PlaneNetTape};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A column of an anchor that the field may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GadHead {
    /// Positions by `Δx`, 3 values, world units.
    Positions,
    /// Features by `Δf`, `C` values.
    Features,
    /// Offsets by `ΔO`, `3k` values, in units of the first three scales.
    Offsets,
    /// Scales by `Δl`, 6 values, world units.
    Scales,
}

impl GadHead {
    /// All four heads in their published order.
    pub const ALL: [GadHead; 4] = [GadHead::Positions, GadHead::Features, GadHead::Offsets, GadHead::Scales];

    /// Name of the head in parameters and settings.
    pub fn name(self) -> &'static str {
        match self {
            GadHead::Positions => "positions",
            GadHead::Features => "features",
            GadHead::Offsets => "offsets",
            GadHead::Scales => "scales",
        }
    }

    fn width(self, shape: AnchorShape) -> usize {
        match self {
            GadHead::Positions => 3,
            GadHead::Features => shape.features,
            GadHead::Offsets => shape.offsets.saturating_mul(3),
            GadHead::Scales => 6,
        }
    }
}

/// Settings of a [`Gad`]; the defaults are the published ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GadConfig {
    /// The columns that change; a head that is not listed is not built.
    pub heads: Vec<GadHead>,
    /// Weight of the squared changes of features, offsets and scales, not negative; 0: no penalty (published). Of each column
    /// the mean over anchors and values counts, and their sum. Scales are in units of the geometric mean of all scales.
    pub change_l2: f32,
    /// How an anchor's logits scale the changes.
    pub dynamics: Dynamics,
    /// Size and regularisers of the network.
    pub net: PlaneNetConfig,
}

impl Default for GadConfig {
    fn default() -> Self {
        let hexplane = HexPlaneConfig {
            resolution: [32, 32, 32, 10],
            channels: 16,
            plane_tv: 1e-4,
            time_smoothness: 5e-4,
            time_l1: 5e-5,
            ..HexPlaneConfig::default()
        };
        let net = PlaneNetConfig { hexplane, ..PlaneNetConfig::default() };
        Self { heads: GadHead::ALL.to_vec(), change_l2: 0.0, dynamics: Dynamics::default(), net }
    }
}

impl GadConfig {
    /// The columns that change, and their widths.
    fn widths(&self, shape: AnchorShape) -> Vec<(&'static str, usize)> {
        self.heads.iter().map(|h| (h.name(), h.width(shape))).collect()
    }

    /// Outputs of each head for such anchors.
    pub fn head_widths(&self, shape: AnchorShape) -> Vec<usize> {
        self.heads.iter().map(|h| h.width(shape)).collect()
    }

    /// Number of parameters of the network for such anchors; the largest number where that is beyond it.
    pub fn param_count(&self, shape: AnchorShape) -> u64 {
        self.net.param_count(&self.widths(shape))
    }
}

/// Global anchor deformation; see the [module](self).
#[derive(Clone, Debug)]
pub struct Gad {
    config: GadConfig,
    net: PlaneNet,
}

/// Activations of a [`Gad`] between forward and backward, reused between calls; use one tape per field.
#[derive(Clone, Debug, Default)]
pub struct GadTape {
    net: PlaneNetTape,
    /// Canonical positions, and their cells: found again only when the positions change.
    points: Vec<Vec3>,
    places: GridCells,
    /// Canonical scales `exp λ`, `[V, 6]`.
    scales: Vec<f32>,
    blocks: Vec<Block>,
}

/// The factors of one block of anchors.
#[derive(Clone, Debug, Default)]
struct Block {
    weights: Vec<[Weight; 2]>,
    d_weights: Vec<[f32; 2]>,
    /// Cotangents of one column, `[rows, width]`.
    d: Vec<f32>,
    /// The anchors' part of the penalty on changes.
    penalty: f64,
}

impl Gad {
    /// A field over the box `aabb` for anchors of the given shape. Parameters are named `gad.planes.…`, `gad.trunk.…`,
    /// `gad.hidden.…` and `gad.positions.…`, `gad.features.…`, `gad.offsets.…`, `gad.scales.…`.
    ///
    /// # Errors
    /// If a setting is out of its domain; the message names it.
    pub fn new(config: &GadConfig, shape: AnchorShape, aabb: Aabb, seed: u64) -> Result<Self, DeformError> {
        let reject = |field, value, rule| Err(DeformError::Config { field, value, rule });
        let twice = |h: &GadHead| config.heads.iter().filter(|o| *o == h).count() > 1;
        if config.heads.is_empty() || config.heads.iter().any(twice) {
            return reject("heads", format!("{:?}", config.heads), "one to four different heads");
        }
        if !(config.change_l2 >= 0.0 && config.change_l2.is_finite()) {
            return reject("change_l2", config.change_l2.to_string(), "finite, not negative");
        }
        if !(0.0..1.0).contains(&config.dynamics.threshold) {
            return reject("threshold", config.dynamics.threshold.to_string(), "from 0 to below 1");
        }
        let net = PlaneNet::new("gad", &config.net, &config.widths(shape), aabb, seed)?;
        Ok(Self { config: config.clone(), net })
    }

    /// The settings this field was built from.
    pub fn config(&self) -> &GadConfig {
        &self.config
    }

    /// The network; its heads are in the order of [`GadConfig::heads`].
    pub fn net(&self) -> &PlaneNet {
        &self.net
    }

    /// Writes the anchors deformed to canonical time `t_c` to `out`, reusing memory.
    pub fn forward(&self, anchors: &Anchors, t_c: Time, tape: &mut GadTape, out: &mut LocalAnchors) {
        anchors.activate(out);
        let GadTape { net, points, places, scales, blocks } = tape;
        scales.clone_from(&out.scales);
        if *points != out.positions || points.is_empty() {
            points.clone_from(&out.positions);
            *places = self.net.place(points);
        }
        self.net.forward_located(places, t_c, net);
        let AnchorShape { offsets: k, features: c, .. } = anchors.shape();
        blocks.resize_with(net.blocks().len(), Block::default);
        let columns = out.offsets.par_chunks_mut(3 * k * BLOCK).zip(out.features.par_chunks_mut(c * BLOCK));
        let rows = out.positions.par_chunks_mut(BLOCK).zip(out.scales.par_chunks_mut(6 * BLOCK)).zip(columns);
        let work = net.blocks().par_iter().zip(blocks).zip(rows).enumerate();
        work.for_each(|(b, ((output, Block { weights, .. }), ((positions, scales), (offsets, features))))| {
            weights.clear();
            weights
                .extend((b * BLOCK..).take(positions.len()).map(|v| self.config.dynamics.weights(anchors.logits(v))));
            for (h, head) in self.config.heads.iter().enumerate() {
                let deltas = output.head(h);
                match head {
                    GadHead::Positions => move_points(positions, deltas, weights),
                    GadHead::Features => add_scaled(features, deltas, weights),
                    GadHead::Offsets => add_scaled(offsets, deltas, weights),
                    GadHead::Scales => add_scaled(scales, deltas, weights),
                }
            }
        });
    }

    /// Backward of [`Gad::forward`] of the same anchors with the same parameters, from the cotangents `d` of its
    /// output and, with `share`, from the penalty on changes ([`GadConfig::change_l2`]): adds to the gradients of the
    /// anchors and of the field. Returns the penalty, weight and share applied.
    pub fn backward(&mut self, anchors: &mut Anchors, tape: &mut GadTape, d: &LocalAnchorsGrad, share: f32) -> f32 {
        let factors = self.change_factors(anchors, share);
        let GadTape { net, scales, blocks, .. } = tape;
        let shape = anchors.shape();
        net.blocks_mut().par_iter_mut().zip(&mut *blocks).enumerate().for_each(|(b, (output, block))| {
            let Block { weights, d_weights, d: d_column, penalty } = block;
            *penalty = 0.0;
            d_weights.clear();
            d_weights.resize(weights.len(), [0.0; 2]);
            for (h, head) in self.config.heads.iter().enumerate() {
                let (width, which) = (head.width(shape), usize::from(*head != GadHead::Positions));
                head.gather(d, b * BLOCK..b * BLOCK + weights.len(), width, d_column);
                if factors[h] > 0.0 {
                    *penalty += change::penalise(factors[h], width, output.head(h), weights, d_column);
                }
                let rows = output.head(h).chunks_exact(width).zip(d_column.chunks_exact(width));
                for ((delta, g), d_weight) in rows.zip(&mut *d_weights) {
                    d_weight[which] += delta.iter().zip(g).map(|(delta, g)| delta * g).sum::<f32>();
                }
                let rows = output.head_grad_mut(h).chunks_exact_mut(width).zip(d_column.chunks_exact(width));
                for ((to, g), weight) in rows.zip(&*weights) {
                    to.iter_mut().zip(g).for_each(|(to, g)| *to = weight[which].value * g);
                }
            }
        });
        self.net.backward(net, None);
        anchors.add_grads(scales, d);
        let penalty = cast::to_f32(blocks.iter().map(|b| b.penalty).sum());
        let Some(dynamics) = &mut anchors.dynamics else { return penalty };
        let rows = blocks.iter().flat_map(|b| b.weights.iter().zip(&b.d_weights));
        for (to, (weights, d)) in dynamics.grad.chunks_exact_mut(shape.dynamics).zip(rows) {
            weights_backward(*weights, *d, to);
        }
        penalty
    }

    /// Adds the weighted gradients of the planes' regularisers; returns their weighted values by name.
    pub fn regularise(&mut self) -> [(&'static str, f32); 3] {
        self.net.regularise()
    }
}

impl GadHead {
    /// Copies the cotangents of this column for some anchors, `[anchors, width]`.
    fn gather(self, d: &LocalAnchorsGrad, anchors: Range<usize>, width: usize, to: &mut Vec<f32>) {
        to.clear();
        let values = anchors.start * width..anchors.end * width;
        match self {
            GadHead::Positions => to.extend(d.positions[anchors].iter().flat_map(|g| g.to_array())),
            GadHead::Features => to.extend_from_slice(&d.features[values]),
            GadHead::Offsets => to.extend_from_slice(&d.offsets[values]),
            GadHead::Scales => to.extend_from_slice(&d.scales[values]),
        }
    }
}

/// `x' = x + M Δx`.
fn move_points(points: &mut [Vec3], deltas: &[f32], weights: &[[Weight; 2]]) {
    for ((x, delta), [global, _]) in points.iter_mut().zip(deltas.as_chunks().0).zip(weights) {
        *x += Vec3::from_array(*delta) * global.value;
    }
}

/// `v' = v + m Δv`, row by row.
fn add_scaled(values: &mut [f32], deltas: &[f32], weights: &[[Weight; 2]]) {
    let width = values.len() / weights.len();
    for ((row, delta), [_, local]) in values.chunks_exact_mut(width).zip(deltas.chunks_exact(width)).zip(weights) {
        row.iter_mut().zip(delta).for_each(|(v, d)| *v += local.value * d);
    }
}

impl Params for Gad {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
    }
}
