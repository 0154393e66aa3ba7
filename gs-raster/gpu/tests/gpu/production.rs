//! The GPU against the `f64` reference and against independent renderers: the scenes, the golden arrays and the tolerances of
//! gs-raster's own tests.

use crate::adapter::gpu;
use crate::common::golden::{check_gsplat, check_scenes};
use crate::common::table::{Tally, check};
use gs_gpu::Renderer;
use gs_raster::SimdLevel;

fn sweep(with_kernel: bool, seeds: std::ops::Range<u64>) {
    let Some(gpu) = gpu() else { return };
    let (mut renderer, mut tally) = (Renderer::new(&gpu), Tally::default());
    for seed in seeds {
        check(&mut renderer, seed, with_kernel, SimdLevel::Auto, &mut tally);
    }
    tally.report(gpu.name());
}

#[test]
fn the_gpu_matches_the_reference_on_500_hard_scenes() {
    sweep(false, 0..504);
}

#[test]
fn kernels_match_the_reference() {
    sweep(true, 0..256);
}

#[test]
fn the_gpu_reproduces_golden_images_and_gradients() {
    let Some(gpu) = gpu() else { return };
    check_scenes(&mut Renderer::new(&gpu));
    check_gsplat(&mut Renderer::new(&gpu));
}
