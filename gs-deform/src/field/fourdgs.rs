//! The field of 4D Gaussian Splatting (Wu et al. 2024), and of the local stage of MoDec-GS (Kwak et al. 2025): a
//! [`PlaneNet`] with one head per deformed column.
//!
//! ```text
//! δx (3), δs (3), δr (4) = PlaneNet(μ, t)         see field::plane_net
//! μ' = μ + δx     q' = q + δr                     raw sums, as in the reference; q' is normalised where it is used
//! s' = s · exp(δs)     or     min(|s + δs|, D)    D: diagonal of the box
//! ```
//! The reference starts its last layers at random, which moves every splat by a random, nearly constant offset at the
//! first step; here they start at **zero**, so that the field is the identity bit for bit until it is trained (with
//! sums on scales: for scales from 0 to the diagonal). [`FourDgsConfig::zero_init`] switches back.
//!
//! The planes are sampled at the means, so the means get a gradient through the encoder; the reference keeps it and so
//! does this field. [`FourDgsConfig::detach_coordinates`] drops it, which saves about a tenth of the encoder's
//! backward.

use super::Field;
use super::plane_net::{NetBlock, PlaneNet, PlaneNetConfig, PlaneNetTape};
use crate::apply::{Apply, OffsetColumns, Offsets, QuatRule, ScaleRule};
use crate::encode::{HexPlane, HexPlaneConfig};
use crate::{Aabb, DeformError};
use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Geometry, GeometryRef, Param, Params, Time, cast};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Fewest time nodes that [`FourDgsConfig::for_moments`] leaves.
const LEAST_ROWS: usize = 4;

/// Settings of a [`HexPlaneField`]; the defaults are the published ones for synthetic scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FourDgsConfig {
    /// Width of trunk and heads, 1 to 4096.
    pub width: usize,
    /// Linear layers in the trunk, at most 64; 0 counts as 1, as in the reference.
    pub depth: usize,
    /// Whether there is a head for means.
    pub move_means: bool,
    /// Whether there is a head for scales.
    pub move_scales: bool,
    /// Whether there is a head for rotations.
    pub move_quats: bool,
    /// Start the heads' last layers at zero, so that the field is the identity, instead of at random as the reference
    /// does.
    pub zero_init: bool,
    /// Rule for the offsets of scales; with [`ScaleRule::Add`] scales are limited to the diagonal of the box.
    pub scale_rule: ScaleRule,
    /// Sample the planes at the means as constants: no gradient through the encoder.
    pub detach_coordinates: bool,
    /// Time nodes per moment of the training images, at most ([`Self::for_moments`]): with more the field learns each moment by itself.
    /// 0: no limit, as published.
    pub rows_per_moment: f64,
    /// Size and regularisers of the planes.
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
            scale_rule: ScaleRule::Log,
            detach_coordinates: false,
            rows_per_moment: 0.0,
            hexplane: HexPlaneConfig::default(),
        }
    }
}

impl FourDgsConfig {
    fn net(&self) -> PlaneNetConfig {
        let Self { width, depth, zero_init, ref hexplane, .. } = *self;
        PlaneNetConfig { width, depth, zero_init, hexplane: hexplane.clone() }
    }

    /// The columns that are moved, and their widths.
    fn heads(&self) -> Vec<(&'static str, usize)> {
        let wanted = [self.move_means, self.move_scales, self.move_quats];
        let columns = [("means", 3), ("scales", 3), ("quats", 4)].into_iter().zip(wanted);
        columns.filter_map(|(column, wanted)| wanted.then_some(column)).collect()
    }

    /// The same for images of so many moments, spread over times 0 … 1: no more time nodes than [`Self::rows_per_moment`] allows, at least 4.
    ///
    /// ```
    /// use gs_deform::FourDgsConfig;
    ///
    /// let config = FourDgsConfig { rows_per_moment: 0.5, ..FourDgsConfig::default() };
    /// let rows = |moments| config.clone().for_moments(moments).hexplane.resolution[3];
    /// assert_eq!((rows(30.0), rows(3.0), rows(400.0), rows(0.0)), (15, 4, 75, 75));
    /// ```
    pub fn for_moments(mut self, moments: f64) -> Self {
        let rows = &mut self.hexplane.resolution[3];
        if self.rows_per_moment > 0.0 && moments > 0.0 {
            *rows = (*rows).min(cast::to_usize((self.rows_per_moment * moments).round()).max(LEAST_ROWS));
        }
        self
    }

    /// Number of parameters of the field; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        self.net().param_count(&self.heads())
    }

    /// Half the channels and planes of 48² nodes: about two thirds of the time and a third of the parameters of the
    /// default.
    pub fn fast() -> Self {
        let hexplane = HexPlaneConfig { resolution: [48, 48, 48, 75], channels: 16, ..HexPlaneConfig::default() };
        Self { hexplane, ..Self::default() }
    }
}

/// The field of 4D Gaussian Splatting; see the [module](self).
#[derive(Clone, Debug)]
pub struct HexPlaneField {
    config: FourDgsConfig,
    net: PlaneNet,
    /// Head index of means, scales, quats; `None` for columns that are not deformed.
    heads: [Option<usize>; 3],
    apply: Apply,
}

/// Activations of a [`HexPlaneField`] between forward and backward.
#[derive(Clone, Debug, Default)]
pub struct HexPlaneTape {
    net: PlaneNetTape,
    /// Cotangents of each block's offsets.
    d_offsets: Vec<OffsetColumns>,
}

impl HexPlaneField {
    /// A field over the box `aabb`. Parameters are named `{name}.planes.…`, `{name}.trunk.…`, `{name}.hidden.…` and
    /// `{name}.means.…`, `{name}.scales.…`, `{name}.quats.…`.
    ///
    /// # Errors
    /// If a setting is out of its domain; the message names it.
    pub fn new(name: &str, config: &FourDgsConfig, aabb: Aabb, seed: u64) -> Result<Self, DeformError> {
        let wanted = [config.move_means, config.move_scales, config.move_quats];
        let head = |k: usize| wanted[k].then(|| wanted[..k].iter().filter(|w| **w).count());
        // A box without extent bounds nothing.
        let diagonal = Some(aabb.max.distance(aabb.min)).filter(|d| *d > 0.0).unwrap_or(f32::INFINITY);
        let limit = (config.scale_rule == ScaleRule::Add).then_some(diagonal);
        Ok(Self {
            config: config.clone(),
            net: PlaneNet::new(name, &config.net(), &config.heads(), aabb, seed)?,
            heads: [head(0), head(1), head(2)],
            apply: Apply { scale: config.scale_rule, quat: QuatRule::Raw, scale_limit: limit },
        })
    }

    /// Outputs of each head that there is, of means, scales and quaternions in this order.
    pub fn head_widths(&self) -> Vec<usize> {
        self.heads.iter().zip([3, 3, 4]).filter_map(|(head, width)| head.map(|_| width)).collect()
    }

    /// The settings of the [`PlaneNet`] inside.
    pub fn net_config(&self) -> PlaneNetConfig {
        self.config.net()
    }

    /// The settings this field was built from.
    pub fn config(&self) -> &FourDgsConfig {
        &self.config
    }

    /// The planes that the means are encoded by.
    pub fn hexplane(&self) -> &HexPlane {
        self.net.hexplane()
    }

    /// The rules by which this field applies its offsets.
    pub fn rule(&self) -> Apply {
        self.apply
    }

    /// Writes the offsets of splats with these means (world units) at timestamp `t` to `out`, without applying them; a
    /// column without a head is empty.
    pub fn offsets_at(&self, means: &[Vec3], t: Time, tape: &mut HexPlaneTape, out: &mut OffsetColumns) {
        self.net.forward(means, t, &mut tape.net);
        let OffsetColumns { means, scales, quats } = out;
        [&mut *means, &mut *scales, &mut *quats].into_iter().for_each(Vec::clear);
        for offsets in tape.net.blocks().iter().map(|block| self.offsets(block)) {
            means.extend_from_slice(offsets.means);
            scales.extend_from_slice(offsets.scales);
            quats.extend_from_slice(offsets.quats);
        }
    }

    /// [`Field::forward`] where the planes are sampled at `places`, one per splat (world units), and not at the means: a splat that
    /// another stage has moved can be asked about where it rests.
    ///
    /// # Panics
    /// If there are not as many places as splats.
    pub fn forward_at(
        &self,
        places: &[Vec3],
        canonical: GeometryRef<'_>,
        t: Time,
        tape: &mut HexPlaneTape,
        out: &mut Geometry,
    ) {
        assert_eq!(places.len(), canonical.len(), "a place for every splat");
        self.net.forward(places, t, &mut tape.net);
        out.resize(canonical.len());
        let columns = canonical.chunks(BLOCK).zip(out.view_mut().chunks(BLOCK));
        tape.net.blocks().par_iter().zip(columns).for_each(|(block, (from, mut to))| {
            self.apply.forward(from, self.offsets(block), &mut to);
        });
    }

    /// Backward of [`Self::forward_at`], as [`Field::backward`]; adds to `d_places`, too.
    pub fn backward_at(
        &mut self,
        canonical: GeometryRef<'_>,
        tape: &mut HexPlaneTape,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
        d_places: &mut [Vec3],
    ) {
        self.backward_heads(canonical, tape, d_out, d_canonical);
        self.net.backward(&mut tape.net, (!self.config.detach_coordinates).then_some(d_places));
    }

    /// Cotangents of the splats through the rules of offsets, and of the heads' outputs.
    fn backward_heads(
        &self,
        canonical: GeometryRef<'_>,
        tape: &mut HexPlaneTape,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
    ) {
        let HexPlaneTape { net, d_offsets } = tape;
        d_offsets.resize_with(net.blocks().len(), OffsetColumns::default);
        let columns = canonical.chunks(BLOCK).zip(d_out.chunks(BLOCK));
        let columns = columns.zip(d_canonical.view_mut().chunks(BLOCK));
        let blocks = net.blocks_mut().par_iter_mut().zip(d_offsets).zip(columns);
        blocks.for_each(|((block, d_offsets), ((from, d_to), mut d_from))| {
            self.apply.backward(from, self.offsets(block), d_to, &mut d_from, d_offsets);
            let d_columns = [&d_offsets.means, &d_offsets.scales, &d_offsets.quats];
            for (head, d) in self.heads.iter().zip(d_columns) {
                if let Some(head) = head {
                    block.head_grad_mut(*head).copy_from_slice(d);
                }
            }
        });
    }

    /// The heads' outputs for a block; a head that does not exist gives an empty column.
    fn offsets<'a>(&self, block: &'a NetBlock) -> Offsets<'a> {
        let [means, scales, quats] = self.heads.map(|head| head.map_or(&[][..], |h| block.head(h)));
        Offsets { means, scales, quats }
    }
}

impl Field for HexPlaneField {
    type Tape = HexPlaneTape;

    fn forward(&self, canonical: GeometryRef<'_>, t: Time, tape: &mut HexPlaneTape, out: &mut Geometry) {
        self.forward_at(canonical.means, canonical, t, tape, out);
    }

    fn backward(
        &mut self,
        canonical: GeometryRef<'_>,
        tape: &mut HexPlaneTape,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
    ) {
        self.backward_heads(canonical, tape, d_out, d_canonical);
        self.net.backward(&mut tape.net, (!self.config.detach_coordinates).then_some(&mut d_canonical.means[..]));
    }

    fn regularise(&mut self, _canonical: GeometryRef<'_>, _t: Time, _step: u32) -> Vec<(&'static str, f32)> {
        self.net.regularise().into()
    }
}

impl Params for HexPlaneField {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
    }
}
