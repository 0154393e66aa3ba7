//! The dense layers of a [`Grid4dField`](super::Grid4dField): from the features of the grids to the outputs of the
//! head.
//!
//! ```text
//! z_s = W_s x + b_s,   a = 2σ(z_s) − 1  (or σ)          x: canonical features; a does not depend on time
//! f_t = relu(W_t y + b_t)                               y: the three temporal grids' features, side by side
//! h = fuse(a ⊙ f_t, f_fre),   depth × (Linear, relu),   head = W_h h + b_h
//! ```
//! Each call handles one block of rows; the caller loops over blocks.

use super::branch::{Branch, BranchGrad, BranchScratch, BranchTape};
use super::config::Grid4dConfig;
use super::fourier::{Collapsed, CollapsedLayers, Waves};
use super::fuse;
use crate::apply::OffsetColumns;
use fearless_simd::Level;
use gs_core::cloud::logit;
use gs_core::nn::dense::{relu, relu_backward};
use gs_core::nn::gemm::Write;
use gs_core::nn::{Dense, DenseGrad, Init};
use gs_core::{Param, Params, Time};

#[derive(Clone, Debug)]
pub(super) struct Decoder {
    space: Dense,
    time: Dense,
    branch: Option<Branch>,
    hidden: Vec<Dense>,
    head: Dense,
    directional: bool,
    simd: Level,
}

/// Values shared by all blocks of a call.
#[derive(Clone, Debug, Default)]
pub(super) struct Shared {
    pub waves: Waves,
    collapsed: Collapsed,
}

/// Features of the grids for one block.
#[derive(Clone, Copy)]
pub(super) struct Features<'a> {
    /// Canonical, `[rows, inputs of W_s]`.
    pub space: &'a [f32],
    /// Temporal, `[rows, inputs of W_t]`.
    pub time: &'a [f32],
}

/// Cotangents of the features of a block; set, not added to.
pub(super) struct DFeatures<'a> {
    pub space: &'a mut [f32],
    pub time: &'a mut [f32],
}

/// The time-independent activations of one block.
#[derive(Clone, Debug, Default)]
pub(super) struct StaticBlock {
    /// `a`, `[rows, width]`.
    pub attention: Vec<f32>,
    /// Amplitudes of the Fourier branch, unless it is collapsed.
    pub branch: BranchTape,
}

/// The activations of one block at one timestamp.
#[derive(Clone, Debug, Default)]
pub(super) struct TimeBlock {
    /// `f_t`, `[rows, width]`.
    time: Vec<f32>,
    branch: BranchScratch,
    /// `h`, `[rows, width]`.
    fused: Vec<f32>,
    hidden: Vec<Vec<f32>>,
    /// Outputs of the head, `[rows, head width]`.
    pub head: Vec<f32>,
    pub offsets: OffsetColumns,
}

/// Parameter gradients of one chunk of blocks, and scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct ChunkGrad {
    space: DenseGrad,
    time: DenseGrad,
    branch: BranchGrad,
    hidden: Vec<DenseGrad>,
    head: DenseGrad,
    collapsed: DenseGrad,
    /// Cotangents of the offsets of the current block.
    pub d_offsets: OffsetColumns,
    /// Cotangent of the head of the current block.
    pub d_head: Vec<f32>,
    d: [Vec<f32>; 2],
}

impl Decoder {
    /// A decoder of canonical and temporal features of the given widths.
    pub(super) fn new(config: &Grid4dConfig, [space, time]: [usize; 2], seed: u64) -> Self {
        let width = config.width;
        let dense = |name: &str, i, o, init| Dense::new(&format!("field.net.{name}"), i, o, init, seed);
        let last = if config.zero_init { Init::Zero } else { Init::FanIn };
        let mut head = dense("head", width, config.head_width(), last);
        if config.gate.on {
            // η comes first, through a logistic.
            head.bias.value[0] += logit(config.gate.start);
        }
        Self {
            space: dense("space", space, width, Init::FanIn),
            time: dense("time", time, width, Init::FanIn),
            branch: config.fourier.on.then(|| Branch::new(config, seed)),
            hidden: (0..config.depth).map(|i| dense(&format!("hidden.{i}"), width, width, Init::FanIn)).collect(),
            head,
            directional: config.directional,
            simd: Level::new(),
        }
    }

    /// Computes the values shared by all blocks at a timestamp.
    pub(super) fn set_time(&self, t: Time, shared: &mut Shared) {
        if let Some(branch) = &self.branch {
            branch.set_time(t, &mut shared.waves);
        }
        match self.branch.as_ref().and_then(Branch::linear) {
            Some(amplitude) => shared.collapsed.set(&shared.waves, &self.space, amplitude, &self.head),
            None => shared.collapsed.layer = None,
        }
    }

    /// Attention and amplitudes of a block from its canonical features `space`.
    pub(super) fn forward_static(&self, space: &[f32], static_block: &mut StaticBlock) {
        let StaticBlock { attention, branch } = static_block;
        attention.resize(space.len() / self.space.inputs() * self.space.outputs(), 0.0);
        self.space.forward(space, attention);
        if let Some(net) = &self.branch {
            net.amplitudes(attention, branch);
        }
        fuse::attention(self.simd, attention, self.directional);
    }

    /// The head's outputs of a block whose time-independent activations are known.
    pub(super) fn forward(
        &self,
        shared: &Shared,
        features: Features<'_>,
        static_block: &StaticBlock,
        time_block: &mut TimeBlock,
    ) {
        let TimeBlock { time, branch: scratch, fused, hidden, head, .. } = time_block;
        let rows = features.time.len() / self.time.inputs();
        time.resize(rows * self.time.outputs(), 0.0);
        fused.resize(time.len(), 0.0);
        head.resize(rows * self.head.outputs(), 0.0);
        self.time.forward(features.time, time);
        fuse::attend(self.simd, time, &static_block.attention, fused);
        if let Some(branch) = &self.branch {
            branch.join(&shared.waves, &static_block.branch, scratch, fused);
        }
        hidden.resize_with(self.hidden.len(), Vec::new);
        for (i, layer) in self.hidden.iter().enumerate() {
            let (before, here) = hidden.split_at_mut(i);
            here[0].resize(fused.len(), 0.0);
            layer.forward(before.last().unwrap_or(fused), &mut here[0]);
            relu(&mut here[0]);
        }
        match &shared.collapsed.layer {
            // The collapsed layer's bias includes the head's.
            Some(collapsed) => collapsed.forward(features.space, head),
            None => self.head.start(&self.head.bias.value, head),
        }
        self.head.add_product(0..self.head.inputs(), hidden.last().unwrap_or(fused), head);
    }

    /// Backward of [`Decoder::forward_static`] and [`Decoder::forward`] from `grad.d_head`: adds to `grad`, sets `d`.
    pub(super) fn backward(
        &self,
        shared: &Shared,
        features: Features<'_>,
        (static_block, time_block): (&mut StaticBlock, &TimeBlock),
        d: DFeatures<'_>,
        grad: &mut ChunkGrad,
    ) {
        let ChunkGrad { d: [d_out, d_in], d_head, .. } = grad;
        let last = time_block.hidden.last().unwrap_or(&time_block.fused);
        self.head.backward(last, d_head, None, &mut grad.head);
        d_out.resize(last.len(), 0.0);
        self.head.backward_input(0..self.head.inputs(), d_head, d_out, Write::Set);
        for (i, layer) in self.hidden.iter().enumerate().rev() {
            relu_backward(&time_block.hidden[i], d_out);
            let input = if i > 0 { &time_block.hidden[i - 1] } else { &time_block.fused };
            layer.backward(input, d_out, None, &mut grad.hidden[i]);
            d_in.resize(d_out.len(), 0.0);
            layer.backward_input(0..layer.inputs(), d_out, d_in, Write::Set);
            std::mem::swap(d_out, d_in);
        }
        d_in.resize(d_out.len(), 0.0);
        if let Some(branch) = &self.branch {
            // d_in holds a ⊙ f_t here.
            fuse::product(self.simd, &static_block.attention, &time_block.time, d_in);
            branch.join_backward(&shared.waves, d_in, &time_block.branch, d_out, &mut grad.branch);
        }
        fuse::attend_backward(self.simd, &static_block.attention, &time_block.time, d_out, d_in, self.directional);
        if let Some(branch) = &self.branch {
            branch.amplitudes_backward(&mut static_block.branch, d_out, &mut grad.branch);
        }
        self.time.backward(features.time, d_in, None, &mut grad.time);
        self.time.backward_input(0..self.time.inputs(), d_in, d.time, Write::Set);
        self.space.backward(features.space, d_out, None, &mut grad.space);
        self.space.backward_input(0..self.space.inputs(), d_out, d.space, Write::Set);
        if let Some(collapsed) = &shared.collapsed.layer {
            collapsed.backward(features.space, d_head, None, &mut grad.collapsed);
            collapsed.backward_input(0..collapsed.inputs(), d_head, d.space, Write::Add);
        }
    }

    /// Sets `grad` to zero, reusing memory.
    pub(super) fn reset(&self, shared: &Shared, grad: &mut ChunkGrad) {
        grad.space.reset(&self.space);
        grad.time.reset(&self.time);
        grad.head.reset(&self.head);
        grad.hidden.resize_with(self.hidden.len(), DenseGrad::default);
        grad.hidden.iter_mut().zip(&self.hidden).for_each(|(g, l)| g.reset(l));
        if let Some(branch) = &self.branch {
            branch.reset(&mut grad.branch);
        }
        if let Some(collapsed) = &shared.collapsed.layer {
            grad.collapsed.reset(collapsed);
        }
    }

    /// Adds the chunks' gradients to the parameters, in order, then those of the collapsed branch to its layers.
    pub(super) fn add_grads(&mut self, shared: &mut Shared, chunks: &[ChunkGrad]) {
        self.space.add_grads(chunks.iter().map(|g| &g.space));
        self.time.add_grads(chunks.iter().map(|g| &g.time));
        self.head.add_grads(chunks.iter().map(|g| &g.head));
        for (i, layer) in self.hidden.iter_mut().enumerate() {
            layer.add_grads(chunks.iter().map(move |g| &g.hidden[i]));
        }
        let Some(branch) = &mut self.branch else { return };
        branch.add_grads(chunks.iter().map(|g| &g.branch));
        let Shared { waves, collapsed } = shared;
        if let (Some(layer), Some(amplitude)) = (&mut collapsed.layer, branch.linear_mut()) {
            layer.clear_grads();
            layer.add_grads(chunks.iter().map(|g| &g.collapsed));
            collapsed.backward(waves, CollapsedLayers { space: &mut self.space, amplitude, head: &mut self.head });
        }
    }
}

impl Params for Decoder {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.space.visit(f);
        self.time.visit(f);
        self.branch.iter().for_each(|b| b.visit(f));
        self.hidden.iter().chain([&self.head]).for_each(|l| l.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.space.visit_mut(f);
        self.time.visit_mut(f);
        self.branch.iter_mut().for_each(|b| b.visit_mut(f));
        self.hidden.iter_mut().chain([&mut self.head]).for_each(|l| l.visit_mut(f));
    }
}
