//! Forward and backward rendering at every instruction set, on the scenes published CPU rasterisers were timed on; then the
//! time saved and the error made by each approximation of the rasteriser.

use super::variants::speed_against_error;
use gs_core::speed::BenchRow;
use gs_raster::measure::{bytes_per_splat, camera, rows as measured, scene};
use gs_raster::{RasterOptions, SimdLevel};

/// Number of splats and side of the square image, pixels.
const SIZES: [(usize, u32); 3] = [(1_000, 128), (10_000, 256), (100_000, 512)];
/// SH degree of the scenes.
const DEGREE: u8 = 3;
const RUNS: usize = 5;

/// Memory a splat takes in a scene.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Memory {
    /// Number of splats.
    pub splats: usize,
    /// Side of the square image, pixels.
    pub side: u32,
    /// Bytes a splat takes in a frame, and with its gradients ([`bytes_per_splat`]).
    pub bytes: [f64; 2],
}

/// Memory a splat takes in each of the scenes.
pub fn memory() -> Vec<Memory> {
    let of = |(splats, side)| {
        let bytes = bytes_per_splat(scene(splats, DEGREE).view(), &camera(side), &RasterOptions::default());
        Memory { splats, side, bytes }
    };
    SIZES.into_iter().map(of).collect()
}
/// Bound on pixels × splats of the f64 reference image.
const REFERENCE_WORK: usize = 10_000_000;

pub(super) fn rows() -> Vec<BenchRow> {
    let mut out = Vec::new();
    for (n, side) in SIZES {
        let (splats, whole) = (scene(n, DEGREE), camera(side));
        let small = ((REFERENCE_WORK / n) as f64).sqrt().clamp(8.0, f64::from(side)) as u32;
        for level in [SimdLevel::Auto, SimdLevel::Avx2, SimdLevel::Portable] {
            let options = RasterOptions { simd: level, ..RasterOptions::default() };
            out.extend(measured("draw", &splats, &whole, &options, RUNS, small));
        }
    }
    let (n, side) = SIZES[1];
    out.extend(speed_against_error(&scene(n, DEGREE), &camera(side), &RasterOptions::default()));
    out
}
