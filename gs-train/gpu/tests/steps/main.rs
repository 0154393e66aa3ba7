//! Whole steps on a GPU: against those of the host, against themselves, and across checkpoints.

mod host;
mod repeat;

use gs_data::Dataset;
use gs_gpu::{Gpu, GpuError, GpuOptions};
use gs_methods::registry;
use gs_synth::testkit::scene;
use gs_train::checkpoint::Checkpoint;
use gs_train::device::Device;
use gs_train::testkit;
use gs_train::trainer::Trainer;
use std::sync::{Arc, OnceLock};

/// The adapter, with the limits of a browser. Without one the test is skipped by name, or fails where `GS4D_REQUIRE_GPU` is set. All
/// tests share it, with its compiled kernels.
fn gpu() -> Option<Gpu> {
    static GPU: OnceLock<Result<Gpu, GpuError>> = OnceLock::new();
    match GPU.get_or_init(|| Gpu::open_with(&GpuOptions { browser_limits: true, ..GpuOptions::default() })) {
        Ok(gpu) => {
            println!("{}", gpu.description());
            Some(gpu.clone())
        }
        Err(e) => {
            assert!(std::env::var_os("GS4D_REQUIRE_GPU").is_none(), "{e}");
            println!("SKIPPED gs-train-gpu: {e}");
            None
        }
    }
}

/// The device of the adapter. All tests share it, with the kernels of a step.
fn device(gpu: &Gpu) -> Device {
    static DEVICE: OnceLock<Device> = OnceLock::new();
    DEVICE.get_or_init(|| gs_train_gpu::device(gpu)).clone()
}

/// A small scene that moves.
fn data() -> Arc<Dataset> {
    scene("balls", 40, 12)
}

/// A run of a method before its first step: 60 steps with growth, pruning, a reset and steps of the SH degree.
fn start(method: &str, over: &[&str]) -> Trainer {
    testkit::start(registry(), &data(), method, &testkit::short(registry(), method, over), 3)
}

/// A run continued on a GPU, or on the host.
fn resume(state: &Checkpoint, gpu: Option<&Gpu>) -> Trainer {
    let trainer = Trainer::resume(registry(), data(), state, None, 1 << 24).expect("a run");
    match gpu {
        Some(gpu) => trainer.on(&device(gpu)).expect("a device"),
        None => trainer,
    }
}

/// The state after so many more steps.
fn after(mut trainer: Trainer, steps: u32) -> Checkpoint {
    testkit::run(&mut trainer, steps);
    trainer.gather().expect("the state");
    trainer.state()
}
