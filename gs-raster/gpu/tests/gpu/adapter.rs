//! The adapter of the tests, and scenes.

use gs_core::Splats;
use gs_gpu::{Gpu, GpuError, GpuOptions};
use gs_raster::measure;
use std::sync::OnceLock;

/// The adapter, with the limits of a browser. Without one the test is skipped by name, or fails where `GS4D_REQUIRE_GPU` is
/// set. All tests share it, with its compiled kernels.
pub fn gpu() -> Option<Gpu> {
    static GPU: OnceLock<Result<Gpu, GpuError>> = OnceLock::new();
    match GPU.get_or_init(|| Gpu::open_with(&GpuOptions { browser_limits: true, ..GpuOptions::default() })) {
        Ok(gpu) => {
            println!("{}", gpu.description());
            Some(gpu.clone())
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
