//! Where kernels are appended to.

use crate::kernels::Kernels;
use crate::uniforms::Uniforms;
use gs_gpu::Gpu;

/// A pass, and what its kernels are made of.
pub(crate) struct At<'a, 'b> {
    pub gpu: &'a Gpu,
    pub kernels: &'a Kernels,
    pub pass: &'a mut wgpu::ComputePass<'b>,
    pub uniforms: &'a mut Uniforms,
}
