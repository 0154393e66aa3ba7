//! Published scores of public images from the shared folder. The pairs of [`golden`](crate::golden) need no such folder.
//!
//! | images | score | published | tolerance |
//! |---|---|---|---|
//! | TID2013 I01, noise of level 5 | PSNR | 21.016 dB | 5e-4 |
//! | the same | SSIM after 2 × 2 means, valid area | 0.7820 (MATLAB), 0.7823 | 3e-4 around 0.78215 |
//! | the same | SSIM without reduction | 0.5271 | 5e-5 |
//! | LPIPS example triple | PSNR / SSIM of p0 | 18.05 dB / 0.437 | 5e-3 / 5e-4 |
//! | the same | PSNR / SSIM of p1 | 13.87 dB / 0.296 | 5e-3 / 5e-4 |

use crate::data::iqa_image;
use gs_core::Image;
use gs_metrics::{SsimOptions, psnr, ssim};

/// Means over 2 × 2 pixels; even sides.
fn halved(i: &Image) -> Image {
    let mut out = Image::zeros(i.width / 2, i.height / 2, i.channels);
    for y in 0..out.height {
        for x in 0..out.width {
            for c in 0..i.channels {
                let at = |dx: usize, dy: usize| i.pixel(2 * x + dx, 2 * y + dy)[c];
                out.pixel_mut(x, y)[c] = (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) / 4.0;
            }
        }
    }
    out
}

fn published_ssim(a: &Image, b: &Image) -> f64 {
    ssim(a, b, &SsimOptions::published()).unwrap()
}

#[test]
fn noisy_pair_of_tid2013() {
    let [Some(a), Some(b)] = ["I01.BMP", "i01_01_5.bmp"].map(iqa_image) else { return };
    let (p, full, half) = (psnr(&a, &b).unwrap(), published_ssim(&a, &b), published_ssim(&halved(&a), &halved(&b)));
    println!("PSNR {p:.4} dB, SSIM {full:.5}, after reduction {half:.5}");
    assert!((p - 21.016).abs() < 5e-4, "{p}");
    assert!((full - 0.5271).abs() < 5e-5, "{full}");
    assert!((half - 0.78215).abs() < 3e-4, "{half}");
}

#[test]
fn example_triple_of_lpips() {
    let Some(truth) = iqa_image("lpips_ex_ref.png") else { return };
    for (name, want_psnr, want_ssim) in [("lpips_ex_p0.png", 18.05, 0.437), ("lpips_ex_p1.png", 13.87, 0.296)] {
        let Some(image) = iqa_image(name) else { return };
        let (p, s) = (psnr(&image, &truth).unwrap(), published_ssim(&image, &truth));
        println!("{name}: PSNR {p:.4} dB, SSIM {s:.5}");
        assert!((p - want_psnr).abs() < 5e-3, "{p}");
        assert!((s - want_ssim).abs() < 5e-4, "{s}");
    }
}
