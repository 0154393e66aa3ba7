//! Scores of a generated pair of odd size, against values computed independently in `f64` from the published descriptions
//! (MS-SSIM of pytorch-msssim 1.0: valid windows, zeros on both ends of an odd side before pooling; DyCheck's masked scores).
//!
//! | score | tolerance | why |
//! |---|---|---|
//! | SSIM, MS-SSIM | 1e-6 | windows and pools in f32 |
//! | masked scores | 1e-7 | f64 from 8-bit steps stored as f32 |

use crate::frames::moved;
use gs_core::Image;
use gs_metrics::{
    MetricError, MsSsimOptions, SsimOptions, masked_perceptual_proxy, masked_psnr, masked_ssim, ms_ssim,
    perceptual_proxy, ssim,
};

const WINDOWS: f64 = 1e-6;
const MASKED: f64 = 1e-7;

fn pair() -> [Image; 2] {
    moved(301, 259, -90, 61)
}

/// A mask of a third of the patches of 23 × 31 pixels, none on the left.
fn patches() -> Image {
    let counts = |x: usize, y: usize| (x / 23 + y / 31).is_multiple_of(3) && x > 40;
    let data = (0..301 * 259).map(|i| f32::from(u8::from(counts(i % 301, i / 301)))).collect();
    Image { width: 301, height: 259, channels: 1, data }
}

#[test]
fn structural_scores() {
    let [a, b] = pair();
    let close = |got: f64, want: f64| assert!((got - want).abs() < WINDOWS, "{got} {want}");
    close(ms_ssim(&a, &b, &MsSsimOptions::default()).unwrap(), 0.406_468_006_251_059_06);
    close(ssim(&a, &b, &SsimOptions::published()).unwrap(), 0.253_678_135_792_147_26);
    close(ssim(&a, &b, &SsimOptions::default()).unwrap(), 0.278_933_105_434_171_1);
}

#[test]
fn masked_scores() {
    let ([a, b], mask) = (pair(), patches());
    let close = |got: f64, want: f64| assert!((got - want).abs() < MASKED * want.max(1.0), "{got} {want}");
    close(masked_psnr(&a, &b, &mask).unwrap(), 15.646_602_478_057_243);
    let got = masked_ssim(&a, &b, &mask).unwrap();
    close(got.whole, 0.881_600_435_702_901_5);
    close(got.seen, 0.774_210_073_970_853_3);
}

#[test]
fn the_masked_proxy_depends_on_the_mask_alone() {
    let ([a, b], mask) = (pair(), patches());
    let full = Image { data: vec![1.0; mask.data.len()], ..mask.clone() };
    assert_eq!(masked_perceptual_proxy(&a, &b, &full).unwrap(), perceptual_proxy(&a, &b).unwrap());
    let value = masked_perceptual_proxy(&a, &b, &mask).unwrap();
    assert!(value > 0.01 && value < 1.0, "{value}");
    let mut other = b.clone();
    for (p, m) in other.data.chunks_exact_mut(3).zip(&mask.data) {
        if *m == 0.0 {
            p.fill(0.5);
        }
    }
    assert_eq!(masked_perceptual_proxy(&a, &other, &mask).unwrap(), value);
    assert_eq!(masked_perceptual_proxy(&a, &a, &mask).unwrap(), 0.0);
    let empty = Image { data: vec![0.0; mask.data.len()], ..mask.clone() };
    assert_eq!(masked_perceptual_proxy(&a, &b, &empty).unwrap_err(), MetricError::EmptyMask);
}
