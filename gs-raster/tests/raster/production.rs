//! The f32 fast path against the f64 reference on hard scenes, at every instruction set; the tolerances are those of
//! `common/table.rs`:
//!
//! | quantity | tolerance | why |
//! |---|---|---|
//! | frame, off the cutoff band | 2e-5 | exp2 polynomial 1e-7, whitened offsets 5e-6 of a standard deviation, sums of 300 samples |
//! | frame, on the band | 1.1/255 per flip | one sample may be in or out |
//! | pixels on the band | 0.5 % of all | decisions within 1e-5 of a threshold are rare |
//! | gradients per kind | cosine ≥ 0.9999, relative L2 ≤ 1e-3 | sums of f32 records in f64 |
//! | gradient of the camera | the same, for rotation, translation, focal lengths, principal point | sums of f64 over splats |

use crate::common::table::{BAND, Checked, Tally, check};
use gs_core::Color;
use gs_raster::{RasterOptions, SimdLevel, Workspace, blend_counts, measure, render};

/// The samples of a frame are those that the reference blends, where none hangs on rounding. Returns whether that was so.
fn counts_match(checked: &Checked, workspace: &mut Workspace) -> bool {
    let Checked { name, case, options, frame, want } = checked;
    if want.margin.iter().any(|m| *m < BAND) {
        return false;
    }
    let counts = blend_counts(&case.splats, options, workspace);
    assert_eq!(counts.iter().map(|c| u64::from(*c)).sum::<u64>(), want.blended_samples, "{name}: samples counted");
    assert!(counts.iter().zip(&frame.alpha).all(|(c, a)| (*c == 0) == (*a == 0.0)), "{name}");
    true
}

fn sweep(simd: SimdLevel, with_kernel: bool, seeds: impl Iterator<Item = u64>) {
    let (mut tally, mut counted) = (Tally::default(), 0);
    for seed in seeds {
        let mut workspace = Workspace::new();
        let checked = check(&mut workspace, seed, with_kernel, simd, &mut tally);
        counted += usize::from(counts_match(&checked, &mut workspace));
    }
    tally.report(&format!("{simd:?}"));
    assert!(counted > 20, "samples were counted in {counted} scenes");
}

#[test]
fn best_level_matches_the_reference_on_500_hard_scenes() {
    sweep(SimdLevel::Auto, false, 0..504);
}

#[test]
fn avx2_matches_the_reference() {
    sweep(SimdLevel::Avx2, false, 1000..1160);
}

#[test]
fn portable_matches_the_reference() {
    sweep(SimdLevel::Portable, false, 2000..2160);
}

#[test]
fn kernels_match_the_reference_at_every_level() {
    sweep(SimdLevel::Auto, true, 0..256);
    sweep(SimdLevel::Avx2, true, 1024..1088);
    sweep(SimdLevel::Portable, true, 2048..2112);
}

/// Coefficients are finite, their sum is not: neither is any pixel.
#[test]
fn colours_beyond_all_numbers_leave_the_frame_finite() {
    let mut splats = measure::scene(50, 3);
    if let Color::Sh { coeffs, .. } = &mut splats.color {
        coeffs.iter_mut().enumerate().for_each(|(k, c)| *c = if k % 5 == 0 { -3e38 } else { 3e38 });
    }
    splats.check().unwrap();
    let camera = measure::camera(48);
    let frame = render(&splats, &camera, &RasterOptions::default(), &mut Workspace::new());
    assert!(frame.rgb.data.iter().all(|v| v.is_finite()) && frame.rgb.data.iter().any(|v| *v > 1e30));
}
