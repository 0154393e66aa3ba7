//! The planes of a HexPlane: features, gradients, regularisers.

use crate::pass::At;
use crate::store::Store;
use bytemuck::{Pod, Zeroable};
use gs_core::Time;
use gs_core::cast::{self, to_u32};
use gs_deform::encode::HexPlane;
use gs_gpu::{Array, Gpu, GpuError, groups};
use gs_train::method::LossValue;
use std::ops::Range;

/// Most levels; see `shaders/planes.wgsl`.
pub(crate) const MOST_LEVELS: usize = 8;
/// Planes of a level.
const PLANES: usize = 6;
/// The axes of each plane: x, y, z, t.
const AXES: [(usize, usize); PLANES] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
/// The axis of time.
const TIME: usize = 3;
/// Threads of a workgroup.
const GROUP: u64 = 256;
/// Bits of a sum over all points, without its sign.
const SUM_BITS: u32 = 30;

/// See `shaders/planes.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable, Default)]
#[repr(C)]
struct LevelUniform {
    nodes: [u32; 4],
    first: [u32; 4],
    last: [u32; 4],
    per_unit: [f32; 4],
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PlanesUniform {
    points: u32,
    levels: u32,
    channels: u32,
    time_row: u32,
    low: [f32; 4],
    spread: [u32; 4],
    all: [LevelUniform; MOST_LEVELS],
}

/// See `shaders/planes_sum.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PlaneUniform {
    at: u32,
    len: u32,
    nodes_a: u32,
    nodes_b: u32,
    number: u32,
    spread: u32,
    partial_at: u32,
    unused: u32,
    smooth: f32,
    to_one: f32,
    unused_2: [f32; 2],
}

/// One plane among all.
struct Plane {
    /// Its values among those of all planes.
    values: Range<usize>,
    /// First of its workgroups among those of all planes.
    partial_at: usize,
    timed: bool,
    smooth: f32,
    to_one: f32,
    nodes: [usize; 2],
}

/// What the planes need on the device.
pub(crate) struct Planes {
    pub features: Array,
    pub d_features: Array,
    peaks: Array,
    sums: Array,
    d_points: Array,
    pub partials: Array,
    /// The values of all planes among those of all blocks.
    region: Range<usize>,
    planes: Vec<Plane>,
    uniform: PlanesUniform,
}

impl Planes {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self {
            features: Array::new(gpu, "features of points"),
            d_features: Array::new(gpu, "gradients of features"),
            peaks: Array::new(gpu, "largest gradients of planes"),
            sums: Array::new(gpu, "gradient sums of planes"),
            d_points: Array::new(gpu, "gradients of points, by channels"),
            partials: Array::new(gpu, "regularisers of planes"),
            region: 0..0,
            planes: Vec::new(),
            uniform: PlanesUniform::zeroed(),
        }
    }

    /// Values of a row of features.
    pub(crate) fn width(&self) -> usize {
        (self.uniform.levels * self.uniform.channels) as usize
    }

    /// Prepares for steps on `points` points.
    pub(crate) fn load(&mut self, gpu: &Gpu, store: &Store, hex: &HexPlane, points: usize) -> Result<(), GpuError> {
        let config = hex.config();
        let (levels, channels) = (config.levels.len(), config.channels);
        let (box_, inverse) = (hex.aabb(), hex.aabb().inverse_size());
        let mut uniform = PlanesUniform::zeroed();
        uniform.points = to_u32(points);
        (uniform.levels, uniform.channels) = (to_u32(levels), to_u32(channels));
        uniform.low[..3].copy_from_slice(&box_.min.to_array());
        uniform.spread[0] = SUM_BITS - points.next_power_of_two().trailing_zeros().min(SUM_BITS - 1);
        let range = |level: usize, pair: usize| store.range(&hex.plane(level, pair).name).unwrap_or_default();
        let start = range(0, 0).start;
        let (mut planes, mut partial_at) = (Vec::new(), 0);
        for (l, level) in uniform.all[..levels].iter_mut().enumerate() {
            let spatial = [0, 1, 2].map(|k| config.resolution[k] * config.levels[l]);
            let nodes = [spatial[0], spatial[1], spatial[2], config.time_rows()];
            level.nodes = nodes.map(to_u32);
            for k in 0..3 {
                level.per_unit[k] = inverse[k] * (nodes[k] - 1) as f32;
            }
            for (p, (a, b)) in AXES.into_iter().enumerate() {
                let own = range(l, p);
                let values = own.start - start..own.end - start;
                let at = to_u32(values.start / 4);
                if p < 4 {
                    level.first[p] = at
                } else {
                    level.last[p - 4] = at
                };
                // Time rows that are never read count in the mean.
                let height = if b == TIME { config.resolution[TIME] } else { nodes[b] };
                let count = |rows: usize| (channels * rows * nodes[a]).max(1) as f32;
                let weight = if b == TIME { config.time_smoothness } else { config.plane_tv };
                let smooth = 2.0 * weight / count(height.saturating_sub(2));
                let to_one = if b == TIME { config.time_l1 / count(height) } else { 0.0 };
                let len = values.len();
                planes.push(Plane {
                    values,
                    partial_at,
                    timed: b == TIME,
                    smooth,
                    to_one,
                    nodes: [nodes[a], nodes[b]],
                });
                partial_at += len.div_ceil(GROUP as usize);
            }
        }
        self.region = start..range(levels - 1, PLANES - 1).end;
        (self.uniform, self.planes) = (uniform, planes);
        let rows = 4 * points as u64;
        let width = self.width() as u64;
        self.features.resize(gpu, rows * width)?;
        self.d_features.resize(gpu, rows * width)?;
        self.d_points.resize(gpu, rows * width)?;
        self.peaks.upload(gpu, &vec![0u32; levels * PLANES])?;
        self.sums.upload(gpu, &vec![0u64; self.region.len()])?;
        self.partials.resize(gpu, 8 * partial_at as u64)
    }

    /// Sets the time, and whether points learn.
    pub(crate) fn begin(&mut self, hex: &HexPlane, t: Time, points_learn: bool) {
        let config = hex.config();
        let rows = config.time_rows();
        let skipped = config.resolution[TIME] - rows;
        let last = (rows - 1) as f32;
        let position = 0.5 * (t.normalised + 1.0) * (config.resolution[TIME] - 1) as f32 - skipped as f32;
        let position = position.max(0.0).min(last);
        let row = cast::to_usize(f64::from(position).floor()).min(rows - 2);
        self.uniform.time_row = to_u32(row);
        self.uniform.low[3] = position - row as f32;
        self.uniform.spread[1] = u32::from(points_learn);
    }

    /// The features of all points.
    pub(crate) fn forward(&self, at: &mut At<'_, '_>, store: &Store, points: wgpu::BindingResource<'_>) {
        let uniform = at.uniforms.add(&self.uniform);
        let arrays = [at.uniforms.part(&uniform), points, self.texels(store), self.features.binding()];
        let kernel = &at.kernels.planes_forward;
        kernel.run(at.pass, &kernel.bind_resources(at.gpu.device(), arrays.into_iter()), self.tasks());
    }

    /// Clears what the backward pass finds the largest gradients in.
    pub(crate) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(self.peaks.buffer(), 0, None);
    }

    /// Gradients of the planes, with those of the regularisers, and of the points, which are added to theirs.
    pub(crate) fn backward(
        &self,
        at: &mut At<'_, '_>,
        store: &Store,
        points: wgpu::BindingResource<'_>,
        d_points: wgpu::BindingResource<'_>,
    ) {
        let device = at.gpu.device();
        let uniform = at.uniforms.add(&self.uniform);
        for kernel in [&at.kernels.planes_peaks, &at.kernels.planes_backward] {
            let arrays = [
                at.uniforms.part(&uniform),
                points.clone(),
                self.texels(store),
                self.d_features.binding(),
                self.peaks.binding(),
                self.sums.binding(),
                self.d_points.binding(),
            ];
            kernel.run(at.pass, &kernel.bind_resources(device, arrays.into_iter()), self.tasks());
        }
        if self.uniform.spread[1] != 0 {
            let sizes = at.uniforms.add(&[self.uniform.points, to_u32(self.width() / 4), 0, 0]);
            let arrays = [at.uniforms.part(&sizes), self.d_points.binding(), d_points];
            let kernel = &at.kernels.points_backward;
            let size = groups(self.uniform.points.into(), GROUP);
            kernel.run(at.pass, &kernel.bind_resources(device, arrays.into_iter()), size);
        }
        for (number, plane) in (0..).zip(&self.planes) {
            let own = PlaneUniform {
                at: to_u32(plane.values.start),
                len: to_u32(plane.values.len()),
                nodes_a: to_u32(plane.nodes[0]),
                nodes_b: to_u32(plane.nodes[1]),
                number,
                spread: self.uniform.spread[0],
                partial_at: to_u32(plane.partial_at),
                unused: 0,
                smooth: plane.smooth,
                to_one: plane.to_one,
                unused_2: [0.0; 2],
            };
            let own = at.uniforms.add(&own);
            let arrays = [
                at.uniforms.part(&own),
                self.texels(store),
                self.peaks.binding(),
                self.sums.binding(),
                crate::store::part(&store.grads, &self.region),
                self.partials.binding(),
            ];
            let kernel = &at.kernels.planes_sum;
            let size = groups(plane.values.len() as u64, GROUP);
            kernel.run(at.pass, &kernel.bind_resources(device, arrays.into_iter()), size);
        }
    }

    /// The regularisers, weights applied, from what was read back of [`Self::partials`].
    pub(crate) fn penalties(&self, partials: &[[f32; 2]]) -> Vec<LossValue> {
        let mut sums = [0.0f64; 3];
        for plane in &self.planes {
            let own = &partials[plane.partial_at..][..plane.values.len().div_ceil(GROUP as usize)];
            let total = |k: usize| own.iter().map(|v| f64::from(v[k])).sum::<f64>();
            sums[usize::from(plane.timed)] += 0.5 * f64::from(plane.smooth) * total(0);
            sums[2] += f64::from(plane.to_one) * total(1);
        }
        ["plane_tv", "time_smoothness", "time_l1"].into_iter().zip(sums.map(cast::to_f32)).collect()
    }

    fn texels<'a>(&self, store: &'a Store) -> wgpu::BindingResource<'a> {
        crate::store::part(&store.values, &self.region)
    }

    /// Workgroups with one thread for four channels of a point.
    fn tasks(&self) -> [u32; 2] {
        groups(u64::from(self.uniform.points) * self.width() as u64 / 4, GROUP)
    }
}
