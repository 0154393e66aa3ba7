//! Speed against error of rendering a trained scene: variants of the rasteriser, timed and compared with the f64 reference
//! that blends every sample.

use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Camera, Splats};
use gs_raster::reference::{self, Cutoff, Scene};
use gs_raster::{Frame, RasterOptions, SimdLevel, Workspace, render_into};

/// Most pixels times splats of the reference (about a second).
const REFERENCE_WORK: f64 = 6e7;
/// Timed repetitions of each variant; the median is reported.
const REPEATS: usize = 7;

/// Measures variants of rendering `splats`, at a resolution reduced so that the reference takes about a second. Empty without
/// splats.
pub(super) fn speed_against_error(splats: &Splats, camera: &Camera, options: &RasterOptions) -> Vec<BenchRow> {
    if splats.is_empty() {
        return Vec::new();
    }
    let work = f64::from(camera.width) * f64::from(camera.height) * splats.len() as f64;
    let camera = camera.scaled((REFERENCE_WORK / work).sqrt().min(1.0));
    let exact = RasterOptions { stop: 0.0, ..options.clone() };
    let truth = reference::render(&Scene::<f64>::new(splats), &camera, &exact, Cutoff::Hard);
    let truth: Vec<f64> = truth.rgb.into_iter().flatten().collect();
    let variants = [
        ("widest SIMD, stop at T < 1e-4 (default)", options.clone()),
        ("AVX2 at most", RasterOptions { simd: SimdLevel::Avx2, ..options.clone() }),
        ("portable", RasterOptions { simd: SimdLevel::Portable, ..options.clone() }),
        ("stop at T < 1e-3", RasterOptions { stop: 1e-3, ..options.clone() }),
        ("stop at T < 1e-2", RasterOptions { stop: 1e-2, ..options.clone() }),
        ("no early stop", exact),
        ("samples below 1/64 skipped", RasterOptions { min_alpha: 1.0 / 64.0, ..options.clone() }),
    ];
    variants.iter().map(|(name, o)| row(name, splats, &camera, o, &truth)).collect()
}

fn row(name: &str, splats: &Splats, camera: &Camera, options: &RasterOptions, truth: &[f64]) -> BenchRow {
    let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
    render_into(splats, camera, options, &mut workspace, &mut frame);
    let error = frame.rgb.data.iter().zip(truth).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
    let seconds = median_seconds(REPEATS, || render_into(splats, camera, options, &mut workspace, &mut frame));
    BenchRow {
        krate: "gs-raster",
        case: format!("draw {}x{}", camera.width, camera.height),
        variant: name.to_owned(),
        n: splats.len(),
        threads: rayon::current_num_threads(),
        ms: 1e3 * seconds,
        work: f64::from(camera.width) * f64::from(camera.height),
        error: Some(error),
        error_kind: "largest colour difference from f64, every sample blended",
    }
}
