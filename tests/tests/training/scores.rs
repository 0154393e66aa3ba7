//! Scores of a split are those of its frames, computed here by hand.

use crate::support::*;
use gs_data::{Dataset, ImageCache, Split};
use gs_raster::{Workspace, render};
use gs_train::evaluate::{EvalError, Scoring, evaluate};
use gs_train::timestamp::Timestamp;
use gs4d_eval::folders::TofOptions;
use gs4d_eval::temporal::{TemporalError, tof};

#[test]
fn a_report_holds_the_scores_of_the_drawn_frames() {
    let data = scene("balls", 32, 6);
    let mut trainer = start("fourdgs", &data);
    run(&mut trainer, 40);
    let (method, white) = (trainer.model(), [1.0; 3]);
    let images = ImageCache::new(1 << 20, 1.0);
    let report = evaluate(method, &data, Split::Test, white, &images).expect("scores");
    let mut errors = Vec::new();
    for (view, scores) in data.test.iter().zip(&report.views) {
        let splats = method.splats(&Timestamp::new(view.time), &view.camera).expect("splats");
        let options = method.raster_options(white);
        let frame = render(&splats, &view.camera, &options, &mut Workspace::new());
        let truth = images.get(view).expect("image").over(white);
        let square = |(a, b): (&f32, &f32)| f64::from(a.clamp(0.0, 1.0) - b).powi(2);
        let mse = frame.rgb.data.iter().zip(&truth.data).map(square).sum::<f64>() / truth.data.len() as f64;
        let psnr = scores.psnr.expect("not perfect");
        assert!((psnr + 10.0 * mse.log10()).abs() < 1e-4, "{}: {psnr} {mse}", view.name);
        assert!((0.0..1.0).contains(&scores.ssim) && scores.ms_ssim.is_none());
        assert_eq!((&scores.name, scores.time), (&view.name, view.time.normalised));
        errors.push(mse);
    }
    let mean = errors.iter().map(|e| -10.0 * e.log10()).sum::<f64>() / errors.len() as f64;
    let of_mean = -10.0 * (errors.iter().sum::<f64>() / errors.len() as f64).log10();
    assert!((report.mean.psnr.expect("mean") - mean).abs() < 1e-4);
    assert!((report.psnr_of_mean_mse.expect("mean") - of_mean).abs() < 1e-4 && of_mean <= mean);
    assert_eq!((report.gaussians, report.split.as_str(), report.perfect_views), (method.splat_count(), "test", 0));
    assert_eq!(report.parameter_bytes, 4 * method.param_count() as u64);
    let empty = evaluate(method, &data, Split::Val, white, &images);
    assert!(matches!(empty, Err(EvalError::NoViews("val"))));
}

/// The test views as a video: one camera, times one training moment apart.
fn filmed(data: &Dataset, n: usize, step: f32) -> Dataset {
    let first = data.train[0].clone();
    let mut data = data.clone();
    data.test = (0..n)
        .map(|i| {
            let mut view = first.clone();
            view.name = format!("film {i}");
            view.time.normalised = i as f32 * step;
            view
        })
        .collect();
    data
}

#[test]
fn motion_is_scored_along_videos_only() {
    let data = scene("balls", 48, 12);
    let mut trainer = start("fourdgs", &data);
    run(&mut trainer, 20);
    let images = ImageCache::new(1 << 20, 1.0);
    let whole = TofOptions { trim: false, crop: false };
    let (share, device) = Default::default();
    let scoring = Scoring::new([0.0; 3], &images, &share, &device);
    let score = |data: &Dataset| tof(trainer.model(), data, Split::Test, &scoring, whole);
    let film = score(&filmed(&data, 4, 0.02)).expect("a video");
    assert_eq!(film.pairs.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["film 1", "film 2", "film 3"]);
    assert!(film.mean.is_finite() && film.mean >= 0.0);

    assert!(matches!(score(&data), Err(TemporalError::Cameras { .. })));
    assert!(matches!(score(&filmed(&data, 1, 0.1)), Err(TemporalError::NoVideo(1))));
    assert!(matches!(score(&filmed(&data, 3, 0.0)), Err(TemporalError::SameTime { .. })));
    let mut sparse = filmed(&data, 2, 0.9);
    (0..40).for_each(|i| {
        let mut view = sparse.train[0].clone();
        view.time.normalised = i as f32 * 0.02;
        sparse.train.push(view);
    });
    let e = score(&sparse).unwrap_err();
    assert!(matches!(e, TemporalError::Sparse { .. }) && e.to_string().contains("sparse times"), "{e}");
}
