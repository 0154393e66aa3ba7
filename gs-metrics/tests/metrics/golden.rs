//! Scores of the image pairs in `tests/golden`, computed by scikit-image and scipy in `f64`.
//!
//! | score | tolerance | why |
//! |---|---|---|
//! | MSE | 1e-6 relative | 8-bit steps stored as f32 |
//! | PSNR | 2e-6 dB | the same |
//! | SSIM, MS-SSIM | 1e-7 | windows and pools in f32; worst seen 1e-8 |

use gs_core::Image;
use gs_core::io::{Limits, images::decode_image};
use gs_metrics::{MsSsimOptions, SsimOptions, ms_ssim, mse, psnr, ssim};

/// Name of the pair, ground truth, distorted image.
const PAIRS: [(&str, &[u8], &[u8]); 3] = [
    ("blur", include_bytes!("../golden/blur_truth.png"), include_bytes!("../golden/blur.png")),
    ("blocks", include_bytes!("../golden/blocks_truth.png"), include_bytes!("../golden/blocks.png")),
    ("noise", include_bytes!("../golden/noise_truth.png"), include_bytes!("../golden/noise.png")),
];
/// Lines `pair, metric, value`; lines with `#` are comments.
const SCORES: &str = include_str!("../golden/scores.tsv");

fn decode(bytes: &[u8]) -> Image {
    decode_image(bytes, "a golden image", &Limits::default()).unwrap()
}

fn score(metric: &str, a: &Image, b: &Image) -> (f64, f64) {
    match metric {
        "mse" => (mse(a, b).unwrap(), 1e-6 * mse(a, b).unwrap()),
        "psnr" => (psnr(a, b).unwrap(), 2e-6),
        "ssim_valid" => (ssim(a, b, &SsimOptions::published()).unwrap(), 1e-7),
        "ssim_zero" => (ssim(a, b, &SsimOptions::default()).unwrap(), 1e-7),
        "ms_ssim" => (ms_ssim(a, b, &MsSsimOptions::default()).unwrap(), 1e-7),
        _ => panic!("no metric {metric}"),
    }
}

#[test]
fn scores_agree_with_scikit_image() {
    let mut compared = 0;
    for (name, truth, image) in PAIRS {
        let (truth, image) = (decode(truth), decode(image));
        for line in SCORES.lines().filter(|line| line.starts_with(&format!("{name}\t"))) {
            let [_, metric, want] = line.split('\t').collect::<Vec<_>>()[..] else { panic!("{line}") };
            let want: f64 = want.parse().unwrap();
            let (got, tolerance) = score(metric, &image, &truth);
            println!("{name} {metric}: {got:.9}, off by {:.1e}", got - want);
            assert!((got - want).abs() < tolerance, "{name} {metric}: {got} instead of {want}");
            compared += 1;
        }
    }
    assert_eq!(compared, 15, "three pairs with five scores each");
}
