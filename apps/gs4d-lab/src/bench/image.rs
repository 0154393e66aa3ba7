//! Image metrics, with errors against closed forms: two constant images of colours `a` and `b` have
//! `mse = (a − b)²` and, without zero padding, `SSIM = (2ab + C1) / (a² + b² + C1)` with `C1 = 0.01²`.

use super::Case;
use gs_core::speed::BenchRow;
use gs_core::{Image, Rng};
use gs_metrics::{Ssim, SsimOptions, mse, perceptual_proxy};
use std::hint::black_box;

const SIDE: usize = 256;
const RUNS: usize = 9;
const COLORS: [f32; 2] = [0.25, 0.75];

pub(super) fn rows() -> Vec<BenchRow> {
    let [a, b] = COLORS.map(f64::from);
    let constant = COLORS.map(|v| Image { width: SIDE, height: SIDE, channels: 3, data: vec![v; SIDE * SIDE * 3] });
    let noisy = [1, 2].map(noise);
    let values = (SIDE * SIDE * 3) as f64;
    let case =
        |variant, error_kind| Case { krate: "gs-metrics", case: format!("{SIDE}x{SIDE}x3"), variant, error_kind };
    // A metric that rejects a valid image has infinite error.
    let error = |got: Result<f64, _>, want: f64| got.map_or(f64::INFINITY, |v: f64| (v - want).abs());
    let mut ssim = Ssim::new(SsimOptions::published());
    let want = (2.0 * a * b + 1e-4) / (a * a + b * b + 1e-4);
    let ssim_error = error(ssim.value(&constant[0], &constant[1]).map_err(drop), want);
    let mse_error = error(mse(&constant[0], &constant[1]).map_err(drop), (a - b).powi(2));
    let same_error = error(perceptual_proxy(&constant[0], &constant[0]).map_err(drop), 0.0);
    let mut grad = Image::default();
    vec![
        case("mse", "closed form").row(SIDE, values, mse_error, RUNS, || {
            let _ = black_box(mse(&noisy[0], &noisy[1]));
        }),
        case("ssim", "closed form").row(SIDE, values, ssim_error, RUNS, || {
            let _ = black_box(ssim.value(&noisy[0], &noisy[1]));
        }),
        case("ssim and gradient", "closed form").row(SIDE, values, ssim_error, RUNS, || {
            let _ = black_box(ssim.value_and_grad(&noisy[0], &noisy[1], &mut grad));
        }),
        case("perceptual proxy", "identical images").row(SIDE, values, same_error, RUNS, || {
            let _ = black_box(perceptual_proxy(&noisy[0], &noisy[1]));
        }),
    ]
}

fn noise(seed: u64) -> Image {
    let mut rng = Rng::new(seed, "bench image", 0, 0);
    let data = (0..SIDE * SIDE * 3).map(|_| rng.uniform()).collect();
    Image { width: SIDE, height: SIDE, channels: 3, data }
}
