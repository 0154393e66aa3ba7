//! Time on the device, phase by phase.

use crate::device::Gpu;
use crate::error::GpuError;
use crate::memory::{Array, Readback};
use crate::renderer::Renderer;

/// Most phases of a frame and its gradient.
const PHASES: u32 = 16;

/// Times the compute passes of a frame and of its gradient; does nothing unless it was switched on.
pub(crate) struct Timer {
    queries: Option<Queries>,
}

struct Queries {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    copied: Array,
    names: Vec<&'static str>,
}

impl Timer {
    pub(crate) const fn new() -> Self {
        Self { queries: None }
    }

    /// Begins a compute pass, timed under `name`.
    pub(crate) fn pass<'a>(
        &mut self,
        encoder: &'a mut wgpu::CommandEncoder,
        name: &'static str,
    ) -> wgpu::ComputePass<'a> {
        let timestamp_writes = self.queries.as_mut().filter(|q| q.names.len() < PHASES as usize).map(|q| {
            let first = 2 * q.names.len() as u32;
            q.names.push(name);
            wgpu::ComputePassTimestampWrites {
                query_set: &q.set,
                beginning_of_pass_write_index: Some(first),
                end_of_pass_write_index: Some(first + 1),
            }
        });
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(name), timestamp_writes })
    }
}

impl Renderer {
    /// Times the phases of the frames and gradients that follow, where the device can; see [`Renderer::times`].
    pub fn time_phases(&mut self) {
        let gpu = &self.gpu;
        let device = gpu.device();
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return;
        }
        let count = 2 * PHASES;
        let desc = wgpu::QuerySetDescriptor { label: Some("phases"), ty: wgpu::QueryType::Timestamp, count };
        let set = device.create_query_set(&desc);
        let resolved = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: u64::from(8 * count),
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        self.timer.queries = Some(Queries { set, resolved, copied: Array::new(gpu, "timestamps"), names: Vec::new() });
    }

    /// Phases since the last call, the first sixteen, and their time on the device, ms; empty where [`Renderer::time_phases`] was not called
    /// or the device has no clock.
    ///
    /// # Errors
    /// The device failed.
    pub fn times(&mut self) -> Result<Vec<(&'static str, f64)>, GpuError> {
        let gpu: &Gpu = &self.gpu;
        let Some(q) = &mut self.timer.queries else { return Ok(Vec::new()) };
        let names = std::mem::take(&mut q.names);
        if names.is_empty() {
            return Ok(Vec::new());
        }
        let bytes = 16 * names.len() as u64;
        q.copied.resize(gpu, bytes)?;
        let mut encoder =
            gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("timestamps") });
        encoder.resolve_query_set(&q.set, 0..2 * names.len() as u32, &q.resolved, 0);
        encoder.copy_buffer_to_buffer(&q.resolved, 0, q.copied.buffer(), 0, bytes);
        let period = f64::from(gpu.queue().get_timestamp_period());
        let mut ticks: Vec<u64> = Vec::new();
        Readback::default()
            .submit(gpu, encoder, &[&q.copied], |_, bytes| ticks = bytemuck::pod_collect_to_vec(bytes))?;
        let ms = |t: &[u64; 2]| t[1].saturating_sub(t[0]) as f64 * period * 1e-6;
        Ok(names.into_iter().zip(ticks.as_chunks::<2>().0.iter().map(ms)).collect())
    }
}
