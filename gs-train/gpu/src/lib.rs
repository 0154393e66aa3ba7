//! Whole steps of training on the GPU: what [`gs_train::device::DeviceSteps`] asks for, for a cloud of Gaussians at rest, moved by a
//! HexPlane field or by a network of place and time (`static3d`, `fourdgs`, `defgs`).
//!
//! ```
//! use gs_gpu::Gpu;
//! use gs_train::device::Device;
//!
//! let Ok(gpu) = Gpu::open() else { return }; // no GPU: train on the CPU
//! let device: Device = gs_train_gpu::device(&gpu);
//! println!("trainer.on(&device)? trains on {}", device.name());
//! ```
//!
//! # A step
//! 1. planes: six samples per point and channel, their product, or encoded places; layers of the network, in tiles of 64 × 64;
//! 2. activate: raw parameters and offsets to splats;
//! 3. frame and gradients of splats: [`gs_gpu::Renderer`];
//! 4. loss: L1 and SSIM against the image, which stays on the device, and the cotangent of the frame;
//! 5. back through activation, layers and planes, with the regularisers of the planes;
//! 6. Adam over all blocks, and the statistics of densification.
//!
//! What comes back are sums of losses and counters. Densification is that of the host, the same for every device: the state is copied
//! there and back in the steps in which it edits rows.
//!
//! # Same bits
//! No float atomics. Gradients of layers are summed over rows in chunks of fixed size, added in order. Gradients of planes are sums over
//! all points in no fixed order, so they are taken in integers (`shaders/planes_backward.wgsl`), where order does not matter.

#![warn(unreachable_pub)]
#![warn(clippy::allow_attributes_without_reason)]

mod field;
mod images;
mod kernels;
mod loss;
mod net;
mod network_field;
mod pass;
mod plane_field;
mod planes;
mod steps;
mod store;
mod uniforms;

use gs_gpu::{Gpu, Renderer};
use gs_raster::DeviceError;
use gs_train::device::Device;
use std::sync::OnceLock;
pub use steps::Steps;

/// The device of an open GPU: it renders, and makes whole steps of the methods that it can. Trainings on it and on its clones share the
/// kernels of a step.
pub fn device(gpu: &Gpu) -> Device {
    let (render, train, kernels) = (gpu.clone(), gpu.clone(), OnceLock::new());
    Device::new(gpu.description(), move || Ok(Box::new(Renderer::new(&render))))
        .with_steps(move || Ok(Box::new(Steps::with_kernels(&train, &kernels).map_err(DeviceError::new)?)))
}
