//! The field of Grid4D (Xu et al. 2024) and its extension FAGS: hash grids over space and over space-time, a wide decoder
//! with directional attention, a branch of waves in time, and a gate on the motion.
//!
//! ```text
//! x = H_xyz(μ)          y = [H_xyt(μ, t), H_yzt(μ, t), H_xzt(μ, t)]             grids, encode::hash; μ detached
//! a = 2σ(W_s x + b_s) − 1        f = relu(W_t y + b_t)        h = a ⊙ f + f_fre           decoder, fourier
//! [η | ρ τ | Δr | Δs] = W_h h + b_h        μ' = R(ηρ) μ + ητ    q' = q + |q| ηΔr    s' = s + ηΔs       gate
//! ```
//! * With [`FourierConfig::on`] and [`GateConfig::on`] this is FAGS, without them Grid4D.
//! * The head starts at **zero**: the untrained field is the identity, bit for bit (except in the gate's `literal` mode).
//! * `q'` is the rotation of `q/|q| + ηΔr`; the public code hands the sum on without normalising it, which rescales the
//!   covariance. Splats here have rotations of unit length wherever they are drawn, so that is not reproduced.
//! * What lies **outside the cube** has features of zero and does not move, unless [`Grid4dConfig::compat_grid4d`].
//! * Times beyond the cube (`t` below −1/18 or above 19/18) read the grids' end values; the waves run on.
//! * Centres receive gradients through the rigid motion only, not through the grids.
//!
//! Savings that are exact up to rounding ([`ExactConfig`]): one blend of the temporal grids per call, the collapsed
//! branch, and [`Grid4dField::freeze`] for drawing one cloud at many times.

mod branch;
mod config;
mod decoder;
mod fourier;
pub mod frozen;
mod fuse;
mod gate;
mod grids;
mod smooth;

pub use config::{ExactConfig, FourierConfig, Fusion, GateConfig, GateMode, Grid4dConfig, SmoothConfig, WaveTime};
pub use fourier::frequency;
pub use frozen::{FrozenField, StillOptions, StillReport, screen_bound};

use super::Field;
use crate::DeformError;
use crate::apply::{self, Apply, QuatRule, Rows, RowsMut, ScaleRule};
use crate::encode::HashGrid;
use decoder::{ChunkGrad, DFeatures, Decoder, Features, Moving, Shared, Still};
use grids::{Grids, TimedTape, Times};
use gs_core::nn::{self, BLOCK, CHUNKS};
use gs_core::{Param, Params, Splats, SplatsGrad, Time};
use rayon::prelude::*;
use smooth::{Draw, Smooth};

const APPLY: Apply = Apply { scale: ScaleRule::Add, quat: QuatRule::Unit, scale_limit: None };

/// The field; see the [module](self).
#[derive(Clone, Debug)]
pub struct Grid4dField {
    config: Grid4dConfig,
    grids: Grids,
    decoder: Decoder,
    smooth: Smooth,
    seed: u64,
}

/// Scratch of a [`Grid4dField`].
#[derive(Clone, Debug, Default)]
pub struct Grid4dTape {
    standing: Standing,
    playing: Playing,
    back: Back,
}

/// What does not depend on time.
#[derive(Clone, Debug, Default)]
struct Standing {
    /// Means in the unit cube.
    points: Vec<[f32; 3]>,
    /// Canonical features.
    features: Vec<f32>,
    blocks: Vec<Still>,
}

/// What does.
#[derive(Clone, Debug, Default)]
struct Playing {
    timed: TimedTape,
    shared: Shared,
    /// Temporal features.
    features: Vec<f32>,
    blocks: Vec<Moving>,
}

/// Scratch of the way back.
#[derive(Clone, Debug, Default)]
struct Back {
    d_space: Vec<f32>,
    d_time: Vec<f32>,
    chunks: Vec<ChunkGrad>,
}

impl Grid4dField {
    /// A field, its parameters named `field.grids.xyz`, `.xyt`, `.yzt`, `.xzt` and `field.net.…`.
    ///
    /// # Errors
    /// If a setting cannot be built; the message names it.
    pub fn new(config: &Grid4dConfig, seed: u64) -> Result<Self, DeformError> {
        config.check()?;
        let grids = Grids::new(config, seed)?;
        let decoder = Decoder::new(config, grids.widths(), seed);
        Ok(Self { config: config.clone(), grids, decoder, smooth: Smooth::default(), seed })
    }

    /// The settings it was built from.
    pub fn config(&self) -> &Grid4dConfig {
        &self.config
    }

    /// The grids over xyz, xyt, yzt, xzt.
    pub fn grids(&self) -> [&HashGrid; 4] {
        self.grids.all()
    }

    /// Whether a splat at this place of the unit cube moves at all.
    fn moves(&self, point: &[f32; 3]) -> bool {
        self.config.compat_grid4d || grids::inside(point)
    }

    /// Works out what does not depend on time: features of the canonical grid, attention, amplitudes.
    fn stand(&self, canonical: &Splats, standing: &mut Standing) {
        let Standing { points, features, blocks } = standing;
        self.grids.normalise_all(&canonical.means, points);
        self.grids.space(points, features);
        blocks.resize_with(canonical.len().div_ceil(BLOCK), Still::default);
        let rows = BLOCK * self.grids.widths()[0];
        blocks.par_iter_mut().zip(features.par_chunks(rows)).for_each(|(still, x)| self.decoder.still(x, still));
    }

    /// The splats at a time, given what does not depend on it.
    fn play(&self, canonical: &Splats, standing: &Standing, t: Time, playing: &mut Playing, out: &mut Splats) {
        let Playing { timed, shared, features, blocks } = playing;
        self.grids.time(&standing.points, Times::Common(grids::normalised_time(t)), timed, features);
        self.decoder.set_time(t, shared);
        apply::pass_through(canonical, out);
        blocks.resize_with(standing.blocks.len(), Moving::default);
        let [space, time] = self.grids.widths().map(|w| w * BLOCK);
        let features = standing.features.par_chunks(space).zip(features.par_chunks(time));
        let blocks = blocks.par_iter_mut().zip(&standing.blocks).zip(features.zip(standing.points.par_chunks(BLOCK)));
        let columns = apply::chunks(canonical, BLOCK).zip(apply::chunks_mut(out, BLOCK));
        blocks.zip(columns).for_each(|(((moving, still), ((space, time), points)), (from, mut to))| {
            self.decoder.forward(shared, Features { space, time }, still, moving);
            let rows = from.means.iter().zip(points).map(|(m, p)| (*m, self.moves(p)));
            gate::forward(self.config.gate, &moving.head, rows, &mut moving.offsets);
            APPLY.forward(from, moving.offsets.view(), &mut to);
        });
    }

    fn backward_run(
        &self,
        shared: &Shared,
        run: Run<'_>,
        (from, d_to): (Rows<'_>, Rows<'_>),
        d_from: &mut RowsMut<'_>,
    ) {
        let Run { points, features, d, still, moving, grad } = run;
        self.decoder.reset(shared, grad);
        let [space, time] = self.grids.widths().map(|w| w * BLOCK);
        let features = features.space.chunks(space).zip(features.time.chunks(time));
        let d = d.space.chunks_mut(space).zip(d.time.chunks_mut(time));
        let blocks = still.iter_mut().zip(moving).zip(points.chunks(BLOCK)).zip(features.zip(d));
        for (i, (((still, moving), points), ((space, time), (d_space, d_time)))) in blocks.enumerate() {
            let (from, mut d_from) = (from.block(i), d_from.block(i));
            APPLY.backward(from, moving.offsets.view(), d_to.block(i), &mut d_from, &mut grad.d_offsets);
            let rows = from.means.iter().zip(points).zip(d_from.means.iter_mut());
            let rows = rows.map(|((m, p), d)| (*m, self.moves(p), d));
            gate::backward(self.config.gate, &moving.head, rows, &grad.d_offsets, &mut grad.d_head);
            let d = DFeatures { space: d_space, time: d_time };
            self.decoder.backward(shared, Features { space, time }, (still, moving), d, grad);
        }
    }
}

/// A run of consecutive blocks on the way back.
struct Run<'a> {
    points: &'a [[f32; 3]],
    features: Features<'a>,
    d: DFeatures<'a>,
    still: &'a mut [Still],
    moving: &'a [Moving],
    grad: &'a mut ChunkGrad,
}

impl Field for Grid4dField {
    type Tape = Grid4dTape;

    fn forward(&self, canonical: &Splats, t: Time, tape: &mut Grid4dTape, out: &mut Splats) {
        self.stand(canonical, &mut tape.standing);
        self.play(canonical, &tape.standing, t, &mut tape.playing, out);
    }

    fn backward(
        &mut self,
        canonical: &Splats,
        tape: &mut Grid4dTape,
        d_out: &SplatsGrad,
        d_canonical: &mut SplatsGrad,
    ) {
        let Grid4dTape { standing, playing, back: Back { d_space, d_time, chunks } } = tape;
        d_space.resize(standing.features.len(), 0.0);
        d_time.resize(playing.features.len(), 0.0);
        let per_chunk = nn::blocks_per_chunk(standing.blocks.len());
        let rows = per_chunk * BLOCK;
        chunks.resize_with(CHUNKS, ChunkGrad::default);
        let used = &mut chunks[..standing.blocks.len().div_ceil(per_chunk)];
        let [space, time] = self.grids.widths().map(|w| w * rows);
        let features = standing.features.par_chunks(space).zip(playing.features.par_chunks(time));
        let d = d_space.par_chunks_mut(space).zip(d_time.par_chunks_mut(time));
        let blocks = standing.blocks.par_chunks_mut(per_chunk).zip(playing.blocks.par_chunks(per_chunk));
        let runs = features.zip(d).zip(blocks).zip(standing.points.par_chunks(rows)).zip(&mut *used);
        let columns = apply::chunks(canonical, rows).zip(apply::grad_chunks(d_out, rows));
        let columns = columns.zip(apply::grad_chunks_mut(d_canonical, rows));
        let shared = &playing.shared;
        runs.zip(columns).for_each(|(((((features, d), blocks), points), grad), (columns, mut d_from))| {
            let (features, d) = (Features { space: features.0, time: features.1 }, DFeatures { space: d.0, time: d.1 });
            let run = Run { points, features, d, still: blocks.0, moving: blocks.1, grad };
            self.backward_run(shared, run, columns, &mut d_from);
        });
        self.decoder.add_grads(&mut playing.shared, used);
        self.grids.space_backward(&standing.points, d_space);
        self.grids.time_backward(&mut playing.timed, d_time);
        apply::pass_through_backward(d_out, d_canonical);
    }

    fn regularise(&mut self, canonical: &Splats, t: Time, step: u32) -> Vec<(&'static str, f32)> {
        let Self { config, grids, smooth, seed, .. } = self;
        let (draw, means, t) = (Draw { seed: *seed, step }, &canonical.means, grids::normalised_time(t));
        let space = smooth.space(grids, &config.smooth, means, draw);
        let time = smooth.time(grids, &config.smooth, means, t, draw);
        vec![("smooth_space", space as f32), ("smooth_time", time as f32)]
    }

    fn quantities(&self, canonical: &Splats, t: Time) -> Vec<(&'static str, Vec<f32>)> {
        if !self.config.gate.on {
            return Vec::new();
        }
        let mut tape = Grid4dTape::default();
        self.forward(canonical, t, &mut tape, &mut Splats::default());
        let heads = tape.playing.blocks.iter().flat_map(|b| b.head.chunks_exact(self.config.head_width()));
        let gate = heads
            .zip(&tape.standing.points)
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
