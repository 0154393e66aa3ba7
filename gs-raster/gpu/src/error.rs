//! What can go wrong on a GPU.

/// Why a GPU could not be opened or a frame not be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter of Vulkan, Metal or Direct3D 12 was found.
    #[error("no GPU was found ({why}); install the vendor's Vulkan driver, or render on the CPU")]
    NoAdapter {
        /// What the driver interface said.
        why: String,
    },
    /// The adapter refused to open a device.
    #[error("the GPU {adapter} cannot be opened: {why}; update its driver, or render on the CPU")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// What the driver said.
        why: String,
    },
    /// One buffer would be larger than the adapter allows.
    #[error(
        "{what} needs {need} MiB in one buffer, the GPU {adapter} allows {allowed}; use fewer splats or pixels, or the CPU"
    )]
    TooLarge {
        /// What the buffer holds.
        what: &'static str,
        /// Size asked for, MiB.
        need: u64,
        /// Largest size allowed, MiB.
        allowed: u64,
        /// Name of the adapter.
        adapter: String,
    },
    /// The device has no memory left for a buffer.
    #[error("the GPU {adapter} is out of memory; use fewer splats or pixels, or the CPU")]
    OutOfMemory {
        /// Name of the adapter.
        adapter: String,
    },
    /// The device was removed or reset.
    #[error("the GPU {adapter} was lost ({why}); what was computed on it is gone, open it again or use the CPU")]
    Lost {
        /// Name of the adapter.
        adapter: String,
        /// What the driver said.
        why: String,
    },
    /// The driver rejected a command: a fault of this crate or of the driver.
    #[error("the GPU {adapter} rejected a command: {why}; please report it, and render on the CPU meanwhile")]
    Rejected {
        /// Name of the adapter.
        adapter: String,
        /// What the driver said.
        why: String,
    },
    /// A gradient was asked for without a frame of the same splats and size before it.
    #[error("the gradient of a frame needs that frame first: call `render_into` with the same splats and camera")]
    NoFrame,
}
