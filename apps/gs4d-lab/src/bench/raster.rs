//! Forward and backward rendering at every instruction set, on the scenes published CPU rasterisers were timed on.

use super::Measured;
use gs_raster::measure::{bytes_per_splat, camera, rows as measured, scene};
use gs_raster::{RasterOptions, SimdLevel};

/// Number of splats and side of the square image, pixels.
const SIZES: [(usize, u32); 4] = [(1_000, 128), (10_000, 256), (12_000, 100), (100_000, 512)];
/// The size of which PyTorch's times are known.
const TIMED: (usize, u32) = SIZES[1];
/// Milliseconds of PyTorch at that size: forward, and both ways.
const PYTORCH: [f64; 2] = [446.0, 1158.0];
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

pub(super) fn rows() -> Vec<Measured> {
    SIZES.into_iter().flat_map(|size| rows_at(size, size == TIMED)).collect()
}

/// Rows of one size at every instruction set.
fn rows_at((n, side): (usize, u32), timed: bool) -> Vec<Measured> {
    let (splats, whole) = (scene(n, DEGREE), camera(side));
    let small = ((REFERENCE_WORK / n) as f64).sqrt().clamp(8.0, f64::from(side)) as u32;
    let mut out = Vec::new();
    for level in [SimdLevel::Auto, SimdLevel::Avx2, SimdLevel::Portable] {
        let options = RasterOptions { simd: level, ..RasterOptions::default() };
        let pytorch = PYTORCH.map(|ms| timed.then_some(ms)).into_iter().chain([None]);
        let rows = measured("draw", &splats, &whole, &options, RUNS, small).into_iter().zip(pytorch);
        out.extend(rows.map(|(row, pytorch)| Measured { pytorch, ..row.into() }));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_the_timed_size_stand_beside_pytorch() {
        for timed in [false, true] {
            let rows = rows_at((50, 16), timed);
            assert!(rows.len() == 9 && rows.iter().all(|m| m.row.n == 50 && m.row.case == "draw@16" && !m.flops));
            for m in &rows {
                let of = |variant: &str| m.row.variant.starts_with(variant);
                let want = match (of("forward+backward+camera"), of("forward+backward")) {
                    (true, _) => None,
                    (_, true) => Some(1158.0),
                    _ => Some(446.0),
                };
                assert_eq!(m.pytorch, want.filter(|_| timed), "{}", m.row.variant);
            }
        }
        assert_eq!((TIMED, SIZES.contains(&(12_000, 100))), ((10_000, 256), true));
    }
}
