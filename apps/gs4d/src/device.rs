//! `--device`: what renders frames, and makes steps of training where it can.

use crate::failure::{Class, Failure};
use crate::global::Global;
use gs_raster::DeviceError;
use gs_train::device::Device;

/// Flag of verbs that render on any device.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct DeviceFlag {
    /// What renders, and trains where it can. The bits of frames and of trained scenes are those of the device.
    #[arg(long, value_enum, value_name = "DEVICE", default_value_t = Choice::Cpu)]
    device: Choice,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Choice {
    Cpu,
    Gpu,
    /// The GPU if there is one, else the CPU.
    Auto,
}

impl DeviceFlag {
    /// The device that was asked for.
    pub fn open(self, global: &Global) -> Result<Device, Failure> {
        let device = self.chosen(global)?;
        if !device.is_cpu() {
            global.say(format!("rendering on {}", device.name()));
        }
        Ok(device)
    }

    fn chosen(self, global: &Global) -> Result<Device, Failure> {
        match self.device {
            Choice::Cpu => Ok(Device::default()),
            Choice::Gpu => gpu(),
            Choice::Auto => Ok(gpu_if_any().unwrap_or_else(|why| {
                global.say(format!("rendering on the CPU: {why}"));
                Device::default()
            })),
        }
    }

    /// The same for a training, which says what runs where: several ranks train on the CPU.
    pub fn open_to_train(self, global: &Global) -> Result<Device, Failure> {
        match (self.device, global.ranks.size()) {
            (_, 1) | (Choice::Cpu, _) => self.chosen(global),
            (Choice::Gpu, _) => Err(Failure::usage("ranks train on the CPU; leave --device gpu out")),
            (Choice::Auto, _) => {
                global.say("rendering on the CPU: ranks train on it");
                Ok(Device::default())
            }
        }
    }
}

impl From<DeviceError> for Failure {
    fn from(e: DeviceError) -> Self {
        Self::new(Class::Resource, "device", e.to_string())
            .remedy("render on the CPU with --device cpu; a training goes on from its last checkpoint with gs4d resume")
    }
}

/// What a program without GPU support says.
#[cfg(not(feature = "gpu"))]
const WITHOUT: &str = "this gs4d was built without GPU support";

#[cfg(not(feature = "gpu"))]
fn gpu() -> Result<Device, Failure> {
    Err(Failure::new(Class::Usage, "device", WITHOUT)
        .remedy("build it with `cargo install --path apps/gs4d --features gpu`"))
}

#[cfg(not(feature = "gpu"))]
fn gpu_if_any() -> Result<Device, String> {
    Err(WITHOUT.to_owned())
}

#[cfg(feature = "gpu")]
fn gpu() -> Result<Device, Failure> {
    Ok(of(gs_gpu::Gpu::open().map_err(DeviceError::new)?))
}

#[cfg(feature = "gpu")]
fn gpu_if_any() -> Result<Device, String> {
    let gpu = gs_gpu::Gpu::open().map_err(|e| e.to_string())?;
    if gpu.is_software() { Err(format!("{} is no GPU", gpu.name())) } else { Ok(of(gpu)) }
}

#[cfg(feature = "gpu")]
fn of(gpu: gs_gpu::Gpu) -> Device {
    gs_train_gpu::device(&gpu)
}
