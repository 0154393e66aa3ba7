//! The field of Grid4D (Xu et al. 2024) and its extension FAGS: hash grids over space and over space-time, a wide
//! decoder with directional attention, a Fourier branch in time, and a gate on the motion.
//!
//! ```text
//! x = H_xyz(μ)          y = [H_xyt(μ, t), H_yzt(μ, t), H_xzt(μ, t)]             grids, encode::hash; μ detached
//! a = 2σ(W_s x + b_s) − 1        f = relu(W_t y + b_t)        h = a ⊙ f + f_fre           decoder, fourier
//! [η | ρ τ | Δr | Δs] = W_h h + b_h        μ' = R(ηρ) μ + ητ    q' = q + |q| ηΔr    s' = s + ηΔs       gate
//! ```
//! * With [`FourierConfig::on`] and [`GateConfig::on`] this is FAGS, without them Grid4D.
//! * The head starts at **zero**: the untrained field is the identity, bit for bit (except in the gate's `literal`
//!   mode).
//! * `q'` is the rotation of `q/|q| + ηΔr`; the public code does not normalise the sum, which rescales the covariance.
//!   Quaternions are always normalised before rendering here, so that is not reproduced.
//! * Splats **outside the cube** have features of zero and do not move, unless [`Grid4dConfig::compat_grid4d`].
//! * Times beyond the cube (`t` below −1/18 or above 19/18) read the grids' end values; the waves continue.
//! * Means get gradients through the rigid motion only, not through the grids.
//!
//! Optimisations that are exact up to rounding ([`ExactConfig`]): one blend of the temporal grids per call, the
//! collapsed branch, and [`Field::forward_again`] for the same splats at many timestamps.
//!
//! ```
//! use gs_core::{Geometry, Time};
//! use gs_deform::{Field, Grid4dConfig, Grid4dField};
//! use glam::Vec3;
//!
//! let mut config = Grid4dConfig { bound: 1.0, ..Grid4dConfig::default() };
//! config.canonical.log2_table = 10;
//! let means = vec![Vec3::ZERO, Vec3::splat(1.5)];
//! let splats = Geometry { means, quats: vec![[1.0, 0.0, 0.0, 0.0]; 2], scales: vec![Vec3::ONE; 2] };
//! let gates = Grid4dField::new(&config, 1)?.quantities(splats.view(), Time::new(0.5)?);
//! assert_eq!(gates, [("gate", vec![0.5, 0.0])], "half open before training; closed outside the cube");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod branch;
mod config;
mod decoder;
mod fourier;
mod fuse;
mod gate;
mod grids;
mod smooth;

pub use config::{ExactConfig, FourierConfig, Fusion, GateConfig, GateMode, Grid4dConfig, SmoothConfig, WaveTime};
pub(crate) use fourier::frequency;

use super::Field;
use crate::DeformError;
use crate::apply::{Apply, QuatRule, ScaleRule};
use crate::encode::HashGrid;
use decoder::{ChunkGrad, DFeatures, Decoder, Features, Shared, StaticBlock, TimeBlock};
use grids::{Grids, TimedTape, Times};
use gs_core::nn::{self, BLOCK, CHUNKS};
use gs_core::{Geometry, GeometryMut, GeometryRef, Param, Params, Time};
use rayon::prelude::*;
use smooth::{Smooth, StepSeed};

const APPLY: Apply = Apply { scale: ScaleRule::Add, quat: QuatRule::Unit, scale_limit: None };

/// The field of Grid4D and FAGS; see the [module](self).
#[derive(Clone, Debug)]
pub struct Grid4dField {
    config: Grid4dConfig,
    grids: Grids,
    decoder: Decoder,
    smooth: Smooth,
    seed: u64,
}

/// Activations of a [`Grid4dField`] between forward and backward.
#[derive(Clone, Debug, Default)]
pub struct Grid4dTape {
    static_state: StaticState,
    time_state: TimeState,
    scratch: BackwardScratch,
}

/// The time-independent activations of all splats.
#[derive(Clone, Debug, Default)]
struct StaticState {
    /// Means in coordinates of the unit cube.
    points: Vec<[f32; 3]>,
    /// Features of the canonical grid, `[splats, width]`.
    features: Vec<f32>,
    blocks: Vec<StaticBlock>,
}

/// The activations of all splats at one timestamp.
#[derive(Clone, Debug, Default)]
struct TimeState {
    timed: TimedTape,
    shared: Shared,
    /// Features of the temporal grids, `[splats, width]`.
    features: Vec<f32>,
    blocks: Vec<TimeBlock>,
}

/// Scratch of the backward pass.
#[derive(Clone, Debug, Default)]
struct BackwardScratch {
    d_space: Vec<f32>,
    d_time: Vec<f32>,
    chunks: Vec<ChunkGrad>,
}

impl Grid4dField {
    /// A field whose parameters are named `field.grids.xyz`, `.xyt`, `.yzt`, `.xzt` and `field.net.…`.
    ///
    /// # Errors
    /// If a setting is out of its domain; the message names it.
    pub fn new(config: &Grid4dConfig, seed: u64) -> Result<Self, DeformError> {
        config.check()?;
        let grids = Grids::new(config, seed)?;
        let decoder = Decoder::new(config, grids.widths(), seed);
        Ok(Self { config: config.clone(), grids, decoder, smooth: Smooth::default(), seed })
    }

    /// The settings this field was built from.
    pub fn config(&self) -> &Grid4dConfig {
        &self.config
    }

    /// The hash grids over xyz, xyt, yzt, xzt.
    pub fn grids(&self) -> [&HashGrid; 4] {
        self.grids.all()
    }

    /// Whether a splat at this point, in coordinates of the unit cube, moves at all.
    fn moves(&self, point: &[f32; 3]) -> bool {
        self.config.compat_grid4d || grids::inside(point)
    }

    /// Computes the time-independent part: features of the canonical grid, attention, amplitudes.
    fn encode_static(&self, canonical: GeometryRef<'_>, static_state: &mut StaticState) {
        let StaticState { points, features, blocks } = static_state;
        self.grids.normalise_all(canonical.means, points);
        self.grids.space(points, features);
        blocks.resize_with(canonical.len().div_ceil(BLOCK), StaticBlock::default);
        let rows = BLOCK * self.grids.widths()[0];
        blocks
            .par_iter_mut()
            .zip(features.par_chunks(rows))
            .for_each(|(static_block, x)| self.decoder.forward_static(x, static_block));
    }

    /// Writes the splats at timestamp `t` to `out`, given the time-independent part.
    fn forward_at(
        &self,
        canonical: GeometryRef<'_>,
        static_state: &StaticState,
        t: Time,
        time_state: &mut TimeState,
        out: &mut Geometry,
    ) {
        let TimeState { timed, shared, features, blocks } = time_state;
        self.grids.time(&static_state.points, Times::Common(grids::normalised_time(t)), timed, features);
        self.decoder.set_time(t, shared);
        out.resize(canonical.len());
        blocks.resize_with(static_state.blocks.len(), TimeBlock::default);
        let [space, time] = self.grids.widths().map(|w| w * BLOCK);
        let features = static_state.features.par_chunks(space).zip(features.par_chunks(time));
        let blocks =
            blocks.par_iter_mut().zip(&static_state.blocks).zip(features.zip(static_state.points.par_chunks(BLOCK)));
        let columns = canonical.chunks(BLOCK).zip(out.view_mut().chunks(BLOCK));
        blocks.zip(columns).for_each(|(((time_block, static_block), ((space, time), points)), (from, mut to))| {
            self.decoder.forward(shared, Features { space, time }, static_block, time_block);
            let rows = from.means.iter().zip(points).map(|(m, p)| (*m, self.moves(p)));
            gate::forward(self.config.gate, &time_block.head, rows, &mut time_block.offsets);
            APPLY.forward(from, time_block.offsets.view(), &mut to);
        });
    }

    fn backward_chunk(
        &self,
        shared: &Shared,
        chunk: ChunkOfBlocks<'_>,
        (from, d_to): (GeometryRef<'_>, GeometryRef<'_>),
        d_from: &mut GeometryMut<'_>,
    ) {
        let ChunkOfBlocks { points, features, d, static_block, time_block, grad } = chunk;
        self.decoder.reset(shared, grad);
        let [space, time] = self.grids.widths().map(|w| w * BLOCK);
        let features = features.space.chunks(space).zip(features.time.chunks(time));
        let d = d.space.chunks_mut(space).zip(d.time.chunks_mut(time));
        let blocks = static_block.iter_mut().zip(time_block).zip(points.chunks(BLOCK)).zip(features.zip(d));
        for (i, (((static_block, time_block), points), ((space, time), (d_space, d_time)))) in blocks.enumerate() {
            let (from, mut d_from) = (from.block(i, BLOCK), d_from.block(i, BLOCK));
            APPLY.backward(from, time_block.offsets.view(), d_to.block(i, BLOCK), &mut d_from, &mut grad.d_offsets);
            let rows = from.means.iter().zip(points).zip(d_from.means.iter_mut());
            let rows = rows.map(|((m, p), d)| (*m, self.moves(p), d));
            gate::backward(self.config.gate, &time_block.head, rows, &grad.d_offsets, &mut grad.d_head);
            let d = DFeatures { space: d_space, time: d_time };
            self.decoder.backward(shared, Features { space, time }, (static_block, time_block), d, grad);
        }
    }
}

/// Consecutive blocks that one backward task handles.
struct ChunkOfBlocks<'a> {
    points: &'a [[f32; 3]],
    features: Features<'a>,
    d: DFeatures<'a>,
    static_block: &'a mut [StaticBlock],
    time_block: &'a [TimeBlock],
    grad: &'a mut ChunkGrad,
}

impl Field for Grid4dField {
    type Tape = Grid4dTape;

    fn forward(&self, canonical: GeometryRef<'_>, t: Time, tape: &mut Grid4dTape, out: &mut Geometry) {
        self.encode_static(canonical, &mut tape.static_state);
        self.forward_at(canonical, &tape.static_state, t, &mut tape.time_state, out);
    }

    fn forward_again(&self, canonical: GeometryRef<'_>, t: Time, tape: &mut Grid4dTape, out: &mut Geometry) {
        match self.config.exact.cached_attention {
            true => self.forward_at(canonical, &tape.static_state, t, &mut tape.time_state, out),
            false => self.forward(canonical, t, tape, out),
        }
    }

    fn backward(
        &mut self,
        canonical: GeometryRef<'_>,
        tape: &mut Grid4dTape,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
    ) {
        let Grid4dTape { static_state, time_state, scratch: BackwardScratch { d_space, d_time, chunks } } = tape;
        d_space.resize(static_state.features.len(), 0.0);
        d_time.resize(time_state.features.len(), 0.0);
        let per_chunk = nn::blocks_per_chunk(static_state.blocks.len());
        let rows = per_chunk * BLOCK;
        chunks.resize_with(CHUNKS, ChunkGrad::default);
        let used = &mut chunks[..static_state.blocks.len().div_ceil(per_chunk)];
        let [space, time] = self.grids.widths().map(|w| w * rows);
        let features = static_state.features.par_chunks(space).zip(time_state.features.par_chunks(time));
        let d = d_space.par_chunks_mut(space).zip(d_time.par_chunks_mut(time));
        let blocks = static_state.blocks.par_chunks_mut(per_chunk).zip(time_state.blocks.par_chunks(per_chunk));
        let all_chunks = features.zip(d).zip(blocks).zip(static_state.points.par_chunks(rows)).zip(&mut *used);
        let columns = canonical.chunks(rows).zip(d_out.chunks(rows));
        let columns = columns.zip(d_canonical.view_mut().chunks(rows));
        let shared = &time_state.shared;
        all_chunks.zip(columns).for_each(|(((((features, d), blocks), points), grad), (columns, mut d_from))| {
            let (features, d) = (Features { space: features.0, time: features.1 }, DFeatures { space: d.0, time: d.1 });
            let chunk = ChunkOfBlocks { points, features, d, static_block: blocks.0, time_block: blocks.1, grad };
            self.backward_chunk(shared, chunk, columns, &mut d_from);
        });
        self.decoder.add_grads(&mut time_state.shared, used);
        self.grids.space_backward(&static_state.points, d_space);
        self.grids.time_backward(&mut time_state.timed, d_time);
    }

    fn regularise(&mut self, canonical: GeometryRef<'_>, t: Time, step: u32) -> Vec<(&'static str, f32)> {
        let Self { config, grids, smooth, seed, .. } = self;
        let (sample, means, t) = (StepSeed { seed: *seed, step }, canonical.means, grids::normalised_time(t));
        let space = smooth.space(grids, &config.smooth, means, sample);
        let time = smooth.time(grids, &config.smooth, means, t, sample);
        vec![("smooth_space", space as f32), ("smooth_time", time as f32)]
    }

    fn quantities(&self, canonical: GeometryRef<'_>, t: Time) -> Vec<(&'static str, Vec<f32>)> {
        if !self.config.gate.on {
            return Vec::new();
        }
        let mut tape = Grid4dTape::default();
        self.forward(canonical, t, &mut tape, &mut Geometry::default());
        let heads = tape.time_state.blocks.iter().flat_map(|b| b.head.chunks_exact(self.config.head_width()));
        let gate = heads
            .zip(&tape.static_state.points)
            .map(|(head, p)| if self.moves(p) { gate::Row::read(head, self.config.gate).gate } else { 0.0 });
        vec![("gate", gate.collect())]
    }
}

impl Params for Grid4dField {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.grids.visit(f);
        self.decoder.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.grids.visit_mut(f);
        self.decoder.visit_mut(f);
    }
}
