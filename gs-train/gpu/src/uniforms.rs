//! The uniforms of a step: written while it is encoded, uploaded once before it is submitted.

use bytemuck::NoUninit;
use gs_gpu::{Array, Gpu, GpuError};
use std::ops::Range;

/// Bytes between two uniforms: the alignment of their bindings.
const STEP: usize = 256;
/// Bytes of all uniforms of a step.
const ROOM: usize = 512 * STEP;

pub(crate) struct Uniforms {
    array: Array,
    bytes: Vec<u8>,
}

impl Uniforms {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let mut array = Array::new(gpu, "constants of kernels");
        array.resize(gpu, ROOM as u64)?;
        Ok(Self { array, bytes: Vec::with_capacity(ROOM) })
    }

    /// Forgets all uniforms.
    pub(crate) fn clear(&mut self) {
        self.bytes.clear();
    }

    /// Adds one, and gives where its bytes are.
    pub(crate) fn add<T: NoUninit>(&mut self, value: &T) -> Range<usize> {
        let at = self.bytes.len();
        self.bytes.extend_from_slice(bytemuck::bytes_of(value));
        let own = at..self.bytes.len();
        self.bytes.resize(self.bytes.len().next_multiple_of(STEP), 0);
        own
    }

    /// One of them, for a bind group.
    pub(crate) fn part(&self, bytes: &Range<usize>) -> wgpu::BindingResource<'_> {
        self.array.part(bytes.start as u64, bytes.len() as u64)
    }

    /// Uploads them all, before the work that reads them is submitted.
    pub(crate) fn upload(&mut self, gpu: &Gpu) -> Result<(), GpuError> {
        self.array.upload(gpu, &self.bytes)
    }

    /// Whether so many more fit.
    pub(crate) const fn fit(count: usize) -> bool {
        count * STEP <= ROOM
    }
}
