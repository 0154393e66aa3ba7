//! Arrays on the device: grown when needed, bound with the length in use, read back through one staging buffer.

use crate::device::Gpu;
use crate::error::GpuError;
use std::sync::mpsc;

/// An array on the device.
pub struct Array {
    what: &'static str,
    buffer: wgpu::Buffer,
    /// Bytes in use; the buffer may be larger.
    bytes: u64,
}

/// Smallest size of a buffer, bytes: bindings cannot be empty.
const LEAST: u64 = 16;

impl Array {
    /// An array that holds nothing yet; `what` names it in errors.
    pub fn new(gpu: &Gpu, what: &'static str) -> Self {
        Self { what, buffer: storage(gpu, what, LEAST), bytes: LEAST }
    }

    /// An array of these values, whose bytes are a multiple of 4, and no larger.
    ///
    /// # Errors
    /// As [`Array::resize`].
    pub fn of<T: bytemuck::NoUninit>(gpu: &Gpu, what: &'static str, values: &[T]) -> Result<Self, GpuError> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let (size, allowed) = ((bytes.len() as u64).max(LEAST).next_multiple_of(4), gpu.largest_array());
        if size > allowed {
            return Err(too_large(gpu, what, size, allowed));
        }
        let array = Self { what, buffer: storage(gpu, what, size), bytes: size };
        gpu.check()?;
        gpu.queue().write_buffer(&array.buffer, 0, bytes);
        Ok(array)
    }

    /// Gives the array a length of `bytes`; what it held is lost where it has to grow.
    ///
    /// # Errors
    /// The device allows no buffer of this size, or has no memory for it.
    pub fn resize(&mut self, gpu: &Gpu, bytes: u64) -> Result<(), GpuError> {
        let bytes = if bytes == 0 { LEAST } else { bytes.next_multiple_of(4) };
        if self.buffer.size() >= bytes {
            self.bytes = bytes;
            return Ok(());
        }
        let allowed = gpu.largest_array();
        if bytes > allowed {
            return Err(too_large(gpu, self.what, bytes, allowed));
        }
        // A quarter more, so that a scene that grows does not allocate at every step.
        let size = (bytes + bytes / 4).next_multiple_of(LEAST).min(allowed);
        self.buffer = storage(gpu, self.what, size);
        self.bytes = bytes;
        gpu.check().inspect_err(|_| *self = Self::new(gpu, self.what))
    }

    /// Gives the array the length of these values, and writes them before the next work that is submitted.
    ///
    /// # Errors
    /// As [`Array::resize`].
    pub fn upload<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, values: &[T]) -> Result<(), GpuError> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        self.resize(gpu, bytes.len() as u64)?;
        if !bytes.is_empty() {
            gpu.queue().write_buffer(&self.buffer, 0, bytes);
        }
        Ok(())
    }

    /// Writes values of `bytes` at an offset in bytes; none stand for zeros.
    ///
    /// # Panics
    /// If there are some, and not so many.
    pub(crate) fn write_or_zero(&self, gpu: &Gpu, offset: u64, bytes: u64, values: &[f32]) {
        assert!(values.is_empty() || size_of_val(values) as u64 == bytes, "cotangents of another size than the frame");
        match values {
            [] => gpu.queue().write_buffer(&self.buffer, offset, &vec![0; usize::try_from(bytes).unwrap_or(0)]),
            values => gpu.queue().write_buffer(&self.buffer, offset, bytemuck::cast_slice(values)),
        }
    }

    /// The buffer behind it, which may be larger.
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Bytes in use.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The part in use, for a bind group.
    pub fn binding(&self) -> wgpu::BindingResource<'_> {
        self.part(0, self.bytes)
    }

    /// A part, for a bind group; offsets are multiples of 256.
    pub fn part(&self, offset: u64, bytes: u64) -> wgpu::BindingResource<'_> {
        let size = std::num::NonZeroU64::new(bytes);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: &self.buffer, offset, size })
    }
}

fn too_large(gpu: &Gpu, what: &'static str, bytes: u64, allowed: u64) -> GpuError {
    let (need, allowed) = (bytes.div_ceil(1 << 20), allowed >> 20);
    GpuError::TooLarge { what, need, allowed, adapter: gpu.name().to_owned() }
}

fn storage(gpu: &Gpu, what: &'static str, size: u64) -> wgpu::Buffer {
    let usage = wgpu::BufferUsages::STORAGE
        | wgpu::BufferUsages::UNIFORM
        | wgpu::BufferUsages::COPY_SRC
        | wgpu::BufferUsages::COPY_DST;
    let desc = wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false };
    gpu.device().create_buffer(&desc)
}

/// Copies arrays to the host, one after another, through one buffer.
#[derive(Default)]
pub struct Readback {
    buffer: Option<wgpu::Buffer>,
}

impl Readback {
    /// Appends the copies of `arrays` to `encoder`, submits it, waits, and hands number and bytes of each array to `take`.
    ///
    /// # Errors
    /// The device failed.
    pub fn submit(
        &mut self,
        gpu: &Gpu,
        mut encoder: wgpu::CommandEncoder,
        arrays: &[&Array],
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<(), GpuError> {
        let total: u64 = arrays.iter().map(|a| a.bytes()).sum();
        // Taken out until it is free again: after a fault another one is made.
        let staging = self.staging(gpu, total)?;
        let mut at = 0;
        for array in arrays {
            encoder.copy_buffer_to_buffer(array.buffer(), 0, &staging, at, array.bytes());
            at += array.bytes();
        }
        gpu.queue().submit([encoder.finish()]);
        let (send, receive) = mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, 0..total, move |result| {
            // The receiver waits below; it is gone only if that failed.
            send.send(result).ok();
        });
        gpu.wait()?;
        let rejected = |why: String| GpuError::Rejected { adapter: gpu.name().to_owned(), why };
        receive.recv().map_err(|e| rejected(e.to_string()))?.map_err(|e| rejected(e.to_string()))?;
        let view = staging.get_mapped_range(0..total).map_err(|e| rejected(e.to_string()))?;
        let mut rest: &[u8] = &view;
        for (i, array) in arrays.iter().enumerate() {
            let (own, tail) = rest.split_at(usize::try_from(array.bytes()).unwrap_or(usize::MAX));
            take(i, own);
            rest = tail;
        }
        drop(view);
        staging.unmap();
        self.buffer = Some(staging);
        Ok(())
    }

    fn staging(&mut self, gpu: &Gpu, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        if let Some(buffer) = self.buffer.take().filter(|b| b.size() >= bytes) {
            return Ok(buffer);
        }
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let allowed = gpu.device().limits().max_buffer_size;
        if bytes > allowed {
            return Err(too_large(gpu, "readback", bytes, allowed));
        }
        // A quarter more where that fits, as arrays have.
        let size = (bytes + bytes / 4 / 4 * 4).min(allowed / 4 * 4);
        let desc = wgpu::BufferDescriptor { label: Some("readback"), size, usage, mapped_at_creation: false };
        let buffer = gpu.device().create_buffer(&desc);
        gpu.check()?;
        Ok(buffer)
    }
}
