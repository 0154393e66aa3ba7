//! The adapter of the tests, and scenes.

use gs_core::Splats;
use gs_gpu::{Gpu, GpuOptions};
use gs_raster::measure;

/// The adapter, with the limits of a browser. Without one the test is skipped by name, or fails where `GS4D_REQUIRE_GPU` is
/// set.
pub fn gpu() -> Option<Gpu> {
    match Gpu::open_with(&GpuOptions { browser_limits: true, ..GpuOptions::default() }) {
        Ok(gpu) => {
            println!("{}", gpu.description());
            Some(gpu)
        }
        Err(e) => {
            assert!(std::env::var_os("GS4D_REQUIRE_GPU").is_none(), "{e}");
            println!("SKIPPED gs-gpu: {e}");
            None
        }
    }
}

/// A scene of the benchmarks, with the Gaussian or the frequency kernel.
pub fn scene_with(n: usize, kernel: bool) -> Splats {
    let [gaussian, _, frequency, _] = measure::kernels(n).map(|(_, kernel)| kernel);
    Splats { kernel: if kernel { frequency } else { gaussian }, ..measure::scene(n, 3) }
}
