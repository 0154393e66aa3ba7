//! The device: adapter, queue, limits, and what went wrong on it.

use crate::error::GpuError;
use crate::kernels::Kernels;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// An open GPU. Clones share it, with its compiled kernels.
///
/// ```
/// match gs_gpu::Gpu::open() {
///     Ok(gpu) => println!("{}, software: {}", gpu.name(), gpu.is_software()),
///     Err(e) => println!("{e}"), // no GPU here: the CPU renders the same frame
/// }
/// ```
#[derive(Clone)]
pub struct Gpu {
    inner: Arc<Inner>,
}

struct Inner {
    instance: wgpu::Instance,
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    faults: Arc<Faults>,
    native_exp2: OnceLock<bool>,
    float_atomics: bool,
    /// Without and with kernel profiles.
    kernels: [OnceLock<Kernels>; 2],
}

/// The first fault since the last look.
#[derive(Default)]
struct Faults {
    first: Mutex<Option<Fault>>,
}

#[derive(Clone)]
enum Fault {
    OutOfMemory,
    Lost(String),
    Rejected(String),
}

impl Faults {
    fn note(&self, fault: Fault) {
        let mut first = self.first.lock().unwrap_or_else(PoisonError::into_inner);
        // A lost device explains everything that follows.
        if first.is_none() || matches!(fault, Fault::Lost(_)) {
            *first = Some(fault);
        }
    }
}

/// Which adapter to open, and what to ask of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GpuOptions {
    /// Take an adapter that computes on the CPU, for tests.
    pub software: bool,
    /// Ask for no more than the limits that every browser guarantees (buffers of 128 MiB).
    pub browser_limits: bool,
    /// Add gradients by float atomics, where the adapter has them: two runs differ then. For measuring what the same bits
    /// cost.
    pub float_atomics: bool,
}

impl Gpu {
    /// Opens the fastest adapter.
    ///
    /// # Errors
    /// There is no adapter, or it cannot be opened.
    pub fn open() -> Result<Self, GpuError> {
        Self::open_with(&GpuOptions::default())
    }

    /// Opens an adapter with options.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn open_with(options: &GpuOptions) -> Result<Self, GpuError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            force_fallback_adapter: options.software,
            ..wgpu::RequestAdapterOptions::default()
        }))
        .map_err(|e| GpuError::NoAdapter { why: e.to_string() })?;
        let info = adapter.get_info();
        let mut limits = wgpu::Limits::default();
        if !options.browser_limits {
            let own = adapter.limits();
            limits.max_buffer_size = own.max_buffer_size;
            limits.max_storage_buffer_binding_size = own.max_storage_buffer_binding_size;
        }
        let mut wanted = wgpu::Features::TIMESTAMP_QUERY;
        wanted.set(wgpu::Features::SHADER_FLOAT32_ATOMIC, options.float_atomics);
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("gs-gpu"),
            required_features: adapter.features() & wanted,
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        }))
        .map_err(|e| GpuError::NoDevice { adapter: info.name.clone(), why: e.to_string() })?;
        Ok(Self::from_device(instance, device, queue, info))
    }

    fn from_device(
        instance: wgpu::Instance,
        device: wgpu::Device,
        queue: wgpu::Queue,
        info: wgpu::AdapterInfo,
    ) -> Self {
        let faults = Arc::new(Faults::default());
        let (errors, losses) = (Arc::clone(&faults), Arc::clone(&faults));
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            errors.note(match e {
                wgpu::Error::OutOfMemory { .. } => Fault::OutOfMemory,
                other => Fault::Rejected(other.to_string()),
            });
        }));
        device.set_device_lost_callback(move |reason, why| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                losses.note(Fault::Lost(why));
            }
        });
        let kernels = [OnceLock::new(), OnceLock::new()];
        let float_atomics = device.features().contains(wgpu::Features::SHADER_FLOAT32_ATOMIC);
        Self {
            inner: Arc::new(Inner {
                instance,
                device,
                queue,
                info,
                faults,
                native_exp2: OnceLock::new(),
                float_atomics,
                kernels,
            }),
        }
    }

    /// Name of the adapter, as its driver gives it.
    pub fn name(&self) -> &str {
        &self.inner.info.name
    }

    /// Name, interface and driver in one line: frames repeat to the bit where this line is the same.
    pub fn description(&self) -> String {
        let i = &self.inner.info;
        format!("{} ({}, {} {})", i.name, i.backend, i.driver, i.driver_info)
    }

    /// Whether the adapter computes on the CPU.
    pub fn is_software(&self) -> bool {
        self.inner.info.device_type == wgpu::DeviceType::Cpu
    }

    /// The device behind it, for kernels of one's own.
    pub fn device(&self) -> &wgpu::Device {
        &self.inner.device
    }

    /// Its queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.inner.queue
    }

    /// Bytes of the largest [`Array`](crate::Array) that the device allows.
    pub fn largest_array(&self) -> u64 {
        let limits = self.device().limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// The compiled kernels, compiled at the first call.
    pub(crate) fn kernels(&self, with_profile: bool) -> &Kernels {
        let native = *self.inner.native_exp2.get_or_init(|| crate::probe::exp2_is_accurate(self));
        self.inner.kernels[usize::from(with_profile)]
            .get_or_init(|| Kernels::new(self.device(), with_profile, native, self.float_atomics()))
    }

    /// Whether gradients are added by float atomics, which [`GpuOptions::float_atomics`] asks for and not every adapter has.
    pub fn float_atomics(&self) -> bool {
        self.inner.float_atomics
    }

    /// Looks for a fault since the last look. Callers that share a device share its faults: one may find that of another.
    ///
    /// # Errors
    /// The first fault; where the device was lost, always that.
    pub fn check(&self) -> Result<(), GpuError> {
        let mut first = self.inner.faults.first.lock().unwrap_or_else(PoisonError::into_inner);
        // A lost device stays lost.
        let fault = if matches!(*first, Some(Fault::Lost(_))) { first.clone() } else { first.take() };
        let adapter = self.inner.info.name.clone();
        match fault {
            None => Ok(()),
            Some(Fault::OutOfMemory) => Err(GpuError::OutOfMemory { adapter }),
            Some(Fault::Lost(why)) => Err(GpuError::Lost { adapter, why }),
            Some(Fault::Rejected(why)) => Err(GpuError::Rejected { adapter, why }),
        }
    }

    /// Waits until everything submitted is done.
    pub(crate) fn wait(&self) -> Result<(), GpuError> {
        // `Device::poll` panics where the device is lost; this one tells the callback. The instance has no other device.
        self.inner.instance.poll_all(true);
        self.check()
    }
}
