//! Whole steps on a GPU: against those of the host, against themselves, and across checkpoints.

mod host;
mod repeat;

use gs_data::Dataset;
use gs_gpu::{Gpu, GpuOptions};
use gs_methods::registry;
use gs_synth::testkit::scene;
use gs_train::checkpoint::Checkpoint;
use gs_train::testkit;
use gs_train::trainer::Trainer;
use std::sync::Arc;

/// The adapter, with the limits of a browser. Without one the test is skipped by name, or fails where `GS4D_REQUIRE_GPU` is set.
fn gpu() -> Option<Gpu> {
    match Gpu::open_with(&GpuOptions { browser_limits: true, ..GpuOptions::default() }) {
        Ok(gpu) => {
            println!("{}", gpu.description());
            Some(gpu)
        }
        Err(e) => {
            assert!(std::env::var_os("GS4D_REQUIRE_GPU").is_none(), "{e}");
            println!("SKIPPED gs-train-gpu: {e}");
            None
        }
    }
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
        Some(gpu) => trainer.on(&gs_train_gpu::device(gpu)).expect("a device"),
        None => trainer,
    }
}

/// The state after so many more steps.
fn after(mut trainer: Trainer, steps: u32) -> Checkpoint {
    testkit::run(&mut trainer, steps);
    trainer.gather().expect("the state");
    trainer.state()
}
