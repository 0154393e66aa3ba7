//! The state of a run on the device: parameters, moments of the optimiser, gradients, statistics of densification.

use crate::field::Known;
use crate::kernels::Kernels;
use crate::uniforms::Uniforms;
use bytemuck::{Pod, Zeroable};
use gs_core::cast::to_u32;
use gs_core::{Cloud, Param, Params};
use gs_gpu::{Array, Gpu, GpuError, Readback, groups};
use gs_train::adam::Factors;
use gs_train::device::DeviceLoss;
use gs_train::method::Method;
use std::collections::BTreeMap;
use std::ops::Range;

/// Values of one workgroup; every block begins at a multiple, so that a workgroup lies within one block.
const GROUP: usize = 256;
/// Bytes of a value.
const BYTES: u64 = 4;
/// The statistics of densification, by their names among the buffers of a method.
const STATISTICS: [&str; 3] = ["density.grad_sum", "density.seen", "density.max_radius"];

/// Where a block of parameters lies.
struct Block {
    name: String,
    /// Its values, among those of all blocks.
    values: Range<usize>,
    /// Values of a row; none of shared blocks.
    row_width: Option<usize>,
}

/// The state, block after block.
pub(crate) struct Store {
    blocks: Vec<Block>,
    by_name: BTreeMap<String, usize>,
    pub values: Array,
    /// First and second moment of each value, side by side.
    moments: Array,
    pub grads: Array,
    /// Number of the block of each workgroup.
    owners: Array,
    updates: Array,
    pub statistics: [Array; 3],
    readback: Readback,
}

/// The update of a block; see `shaders/adam.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable, Default)]
#[repr(C)]
struct BlockUpdate {
    rate: f32,
    root: f32,
    eps: f32,
    keep: f32,
    end: u32,
    learns: u32,
    start: u32,
    width: u32,
}

/// Bytes of the largest array of a state: the moments of these values.
pub(crate) fn moments(cloud: &Cloud, field: Option<Known<'_>>) -> u64 {
    let mut values = 0;
    let mut add = |p: &Param| values += p.len().next_multiple_of(GROUP) as u64;
    cloud.visit(&mut add);
    if let Some(field) = field {
        field.visit(&mut add);
    }
    2 * BYTES * values
}

impl Store {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self {
            blocks: Vec::new(),
            by_name: BTreeMap::new(),
            values: Array::new(gpu, "parameters"),
            moments: Array::new(gpu, "moments of Adam"),
            grads: Array::new(gpu, "gradients of parameters"),
            owners: Array::new(gpu, "blocks of workgroups"),
            updates: Array::new(gpu, "updates of blocks"),
            statistics: [(); 3].map(|()| Array::new(gpu, "statistics of densification")),
            readback: Readback::default(),
        }
    }

    /// Copies the state of a method to the device.
    pub(crate) fn load(&mut self, gpu: &Gpu, method: &dyn Method) -> Result<(), GpuError> {
        let (mut values, mut moments, mut owners) = (Vec::new(), Vec::new(), Vec::new());
        self.blocks.clear();
        self.by_name.clear();
        method.visit(&mut |p| {
            let at = values.len();
            self.by_name.insert(p.name.clone(), self.blocks.len());
            owners.resize((at + p.len()).div_ceil(GROUP), to_u32(self.blocks.len()));
            self.blocks.push(Block { name: p.name.clone(), values: at..at + p.len(), row_width: p.row_width });
            values.extend_from_slice(&p.value);
            moments.extend(p.moment1.iter().zip(&p.moment2).flat_map(|(m, v)| [*m, *v]));
            values.resize(owners.len() * GROUP, 0.0);
            moments.resize(2 * values.len(), 0.0);
        });
        self.values.upload(gpu, &values)?;
        self.moments.upload(gpu, &moments)?;
        self.owners.upload(gpu, &owners)?;
        self.grads.resize(gpu, self.values.bytes())?;
        let (statistics, mut result) = (&mut self.statistics, Ok(()));
        method.buffers(&mut |b| {
            if let Some(k) = STATISTICS.iter().position(|name| *name == b.name)
                && result.is_ok()
            {
                result = statistics[k].upload(gpu, b.values);
            }
        });
        result
    }

    /// Copies it back to the method it was loaded from.
    pub(crate) fn store(&mut self, gpu: &Gpu, method: &mut dyn Method) -> Result<(), GpuError> {
        let encoder = gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("state") });
        let (mut values, mut moments): (Vec<f32>, Vec<[f32; 2]>) = Default::default();
        let mut statistics: [Vec<f32>; 3] = Default::default();
        let [a, b, c] = &self.statistics;
        self.readback.submit(gpu, encoder, &[&self.values, &self.moments, a, b, c], |i, bytes| match i {
            0 => values = bytemuck::pod_collect_to_vec(bytes),
            1 => moments = bytemuck::pod_collect_to_vec(bytes),
            _ => statistics[i - 2] = bytemuck::pod_collect_to_vec(bytes),
        })?;
        let mut blocks = self.blocks.iter();
        method.visit_mut(&mut |p| {
            let Some(block) = blocks.next().filter(|b| b.values.len() == p.len()) else { return };
            p.value.copy_from_slice(&values[block.values.clone()]);
            for (k, [m, v]) in moments[block.values.clone()].iter().enumerate() {
                (p.moment1[k], p.moment2[k]) = (*m, *v);
            }
        });
        method.buffers_mut(&mut |b| {
            if let Some(k) = STATISTICS.iter().position(|name| *name == b.name) {
                let n = b.values.len();
                b.values.copy_from_slice(&statistics[k][..n]);
            }
        });
        Ok(())
    }

    /// The values of a block.
    pub(crate) fn value(&self, name: &str) -> Option<wgpu::BindingResource<'_>> {
        self.block(name).map(|block| part(&self.values, &block.values))
    }

    /// The gradient of a block, of which every step writes all.
    pub(crate) fn grad(&self, name: &str) -> Option<wgpu::BindingResource<'_>> {
        self.block(name).map(|block| part(&self.grads, &block.values))
    }

    /// Where the values of a block stand among all.
    pub(crate) fn range(&self, name: &str) -> Option<Range<usize>> {
        self.block(name).map(|block| block.values.clone())
    }

    fn block(&self, name: &str) -> Option<&Block> {
        self.by_name.get(name).map(|i| &self.blocks[*i])
    }

    /// Counters of a step: splats whose gradients were not finite; of each block, such rows, and the first of them.
    pub(crate) fn counters(&self) -> u64 {
        1 + 2 * self.blocks.len() as u64
    }

    /// Puts what was counted into words.
    pub(crate) fn count(&self, counters: &[u32], loss: &mut DeviceLoss) {
        let Some((refused, blocks)) = counters.split_first() else { return };
        loss.refused = *refused;
        for (block, [rows, first]) in self.blocks.iter().zip(blocks.as_chunks().0) {
            match block.row_width {
                _ if *rows == 0 => {}
                Some(_) => loss.refused_rows.push((block.name.clone(), *rows, u32::MAX - first)),
                None => loss.refused_shared = loss.refused_shared.take().or_else(|| Some(block.name.clone())),
            }
        }
    }

    /// Updates all blocks that learn, unless the frame had more than `entries`.
    pub(crate) fn update(
        &mut self,
        gpu: &Gpu,
        kernels: &Kernels,
        (pass, uniforms): (&mut wgpu::ComputePass<'_>, &mut Uniforms),
        update: &dyn Fn(&str) -> Option<Factors>,
        (totals, entries, counters): (&Array, u32, &Array),
    ) -> Result<(), GpuError> {
        let mut betas = None;
        let of = |block: &Block| {
            let factors = update(&block.name);
            betas = betas.or(factors.map(|f| [f.beta1, f.beta2]));
            let idle = BlockUpdate {
                start: to_u32(block.values.start),
                end: to_u32(block.values.end),
                width: to_u32(block.row_width.unwrap_or(1)),
                ..BlockUpdate::default()
            };
            factors.map_or(idle, |f| BlockUpdate {
                rate: f.rate,
                root: f.root,
                eps: f.eps,
                keep: f.keep,
                learns: 1,
                ..idle
            })
        };
        let updates: Vec<BlockUpdate> = self.blocks.iter().map(of).collect();
        self.updates.upload(gpu, &updates)?;
        let Some([beta1, beta2]) = betas else { return Ok(()) };
        let constants = uniforms.add(&[beta1.to_bits(), beta2.to_bits(), entries, 0]);
        let arrays = [&self.updates, &self.owners, totals, &self.grads, &self.values, &self.moments, counters];
        let bound = kernels.adam.bind_part(gpu.device(), uniforms.part(&constants), &arrays);
        kernels.adam.run(pass, &bound, groups(self.values.bytes() / BYTES, GROUP as u64));
        Ok(())
    }
}

/// A stretch of values of an array.
pub(crate) fn part<'a>(array: &'a Array, values: &Range<usize>) -> wgpu::BindingResource<'a> {
    array.part(BYTES * values.start as u64, BYTES * values.len().max(1) as u64)
}
