//! Drawing and its gradient, on the scenes that published CPU peers were timed on, at every instruction set; then what
//! each shortcut of drawing costs and saves.

use gs_core::speed::BenchRow;
use gs_raster::measure::{camera, rows as measured, scene};
use gs_raster::{RasterOptions, SimdLevel};
use gs4d_run::speed::speed_against_error;

/// Splats and side of the image.
const SIZES: [(usize, u32); 3] = [(1_000, 128), (10_000, 256), (100_000, 512)];
/// SH degree of the scenes.
const DEGREE: u8 = 3;
const RUNS: usize = 5;
/// Pixels times splats that the f64 reference looks at for an error.
const REFERENCE_WORK: usize = 10_000_000;

pub fn rows() -> Vec<BenchRow> {
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
