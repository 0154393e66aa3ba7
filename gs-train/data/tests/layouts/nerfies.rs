//! Generated scenes in the Nerfies layout: written, read back, and compared with what was photographed.
//!
//! | property | tolerance |
//! |---|---|
//! | cameras, read back against generated | 1e-9 |
//! | lens, read back | 1e-12 |
//! | normalised times | 1e-7 (they are f32) |
//! | undistorted images against pinhole images, full and half size | > 35 dB, on average 3 dB above bent ones |

use std::path::Path;

use gs_core::{Camera, Image};
use gs_data::{DataError, DataOptions, Dataset, ImageCache, ImageSource, View, detect};
use gs_synth::{self as synth, SynthData, SynthOptions};

const WHITE: [f32; 3] = [1.0; 3];

fn options(lens: bool) -> SynthOptions {
    SynthOptions { val_views: 1, lens, ..SynthOptions::of_views(160, 5, 3) }
}

fn open(dir: &Path, images: &str) -> Dataset {
    Dataset::open(dir, &DataOptions { images: Some(images.into()), ..Default::default() }).expect("what was written")
}

/// Views that were generated beside those read.
fn pairs<'a>(made: &'a SynthData, read: &'a Dataset) -> Vec<(&'a View, &'a View)> {
    assert_eq!((read.train.len(), read.val.len(), read.test.len()), (5, 0, 3));
    let of = |a: &'a [View], b: &'a [View]| a.iter().zip(b).collect::<Vec<_>>();
    [of(&made.dataset.train, &read.train), of(&made.dataset.test, &read.test)].concat()
}

/// Largest difference of any number of two cameras.
fn apart(a: &Camera, b: &Camera) -> f64 {
    let flat = |c: &Camera| {
        let pose = [&c.rotation.to_cols_array()[..], &c.translation.to_array()].concat();
        [&pose[..], &[c.fx, c.fy, c.cx, c.cy, f64::from(c.width), f64::from(c.height)]].concat()
    };
    flat(a).iter().zip(flat(b)).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

fn psnr(a: &Image, b: &Image) -> f64 {
    gs_metrics::psnr_from_mse(gs_metrics::mse(a, b).expect("pictures of one size"))
}

#[test]
fn cameras_times_and_lens_return() {
    for lens in [false, true] {
        let dir = tempfile::tempdir().expect("a folder");
        let made = synth::write_nerfies(dir.path(), "sheet", &options(lens), false).expect("written");
        assert_eq!(detect(dir.path()).expect("a layout").name, "hypernerf");
        for (folder, scale) in [("rgb/1x", 1.0), ("rgb/2x", 0.5)] {
            let read = open(dir.path(), folder);
            assert!(read.dynamic);
            let mut worst: f64 = 0.0;
            for (k, (made, read)) in pairs(&made, &read).into_iter().enumerate() {
                worst = worst.max(apart(&made.camera.scaled(scale), &read.camera));
                assert!((made.time.normalised - read.time.normalised).abs() < 1e-7, "{:?} {:?}", made.time, read.time);
                let [truth, own] = [made, read].map(|v| v.time.seconds);
                assert!((truth - own).abs() < 1e-7, "the clock is that of the truth: {truth} {own}");
                assert_eq!((read.camera_id, read.lens.is_some()), (u32::from(k >= 5), lens));
                let coefficients = |v: &View| v.lens.unwrap_or_default().to_array();
                let near = coefficients(made).iter().zip(coefficients(read)).all(|(a, b)| (a - b).abs() < 1e-12);
                assert!(near, "{:?} {:?}", made.lens, read.lens);
            }
            assert!(worst < 1e-9, "{folder}: {worst:.1e}");
            println!("{folder}, lens {lens}: cameras return within {worst:.1e}");
        }
    }
}

#[test]
fn undistorted_images_are_pinhole_images() {
    let cache = ImageCache::new(64 << 20, 1.0);
    for name in ["sheet", "balls"] {
        let dir = tempfile::tempdir().expect("a folder");
        let made = synth::write_nerfies(dir.path(), name, &options(true), false).expect("written");
        for (folder, scale) in [("rgb/1x", 1.0), ("rgb/2x", 0.5)] {
            let read = open(dir.path(), folder);
            let (mut figures, mut gain) = (Vec::new(), 0.0);
            for (made_view, view) in pairs(&made, &read) {
                let time = f64::from(made_view.time.normalised);
                let pinhole = made.truth.picture(&made_view.camera, time);
                let side = (scale * 160.0) as usize;
                let want = pinhole.box_downscaled(side, side).over(WHITE);
                let got = cache.get(view).expect("a picture").over(WHITE);
                figures.push(psnr(&got, &want));
                let ImageSource::Memory(bent) = &made_view.image else { panic!("generated in memory") };
                gain += (psnr(&got, &want) - psnr(&bent.box_downscaled(side, side).over(WHITE), &want)) / 8.0;
            }
            let worst = figures.iter().copied().fold(f64::INFINITY, f64::min);
            println!("{name}, {folder}: undistorted images reach {worst:.1} dB and more, {gain:.1} dB above bent ones");
            assert!(gain > 3.0, "the test would see a lens that is left: {gain:.1} dB");
            assert!(worst > 35.0, "{name}, {folder}: {figures:.1?}");
        }
    }
}

#[test]
fn points_lie_on_the_bodies_and_stills_stay_still() {
    let dir = tempfile::tempdir().expect("a folder");
    let made = synth::write_nerfies(dir.path(), "static", &options(false), false).expect("written");
    let read = open(dir.path(), "rgb/2x");
    assert!(!read.dynamic);
    let points = read.points.expect("points.npy").positions;
    assert!(points.len() > 300, "{}", points.len());
    let seen = points.iter().filter(|p| {
        made.dataset.train.iter().any(|v| {
            let q = v.camera.to_camera(p.as_dvec3());
            let at = v.camera.to_pixel(q);
            made.truth.hit(&v.camera, 0.0, at.x, at.y).is_some_and(|h| (h.depth - q.z).abs() < 1e-4)
        })
    });
    assert_eq!(seen.count(), points.len(), "every point is what some camera sees there");
}

#[test]
fn what_the_layout_cannot_hold_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let refused = |options: SynthOptions, said: &str| {
        let error = synth::write_nerfies(dir.path(), "sheet", &options, false).expect_err("refused").to_string();
        assert!(error.contains(said), "{error}");
    };
    refused(SynthOptions { size: 33, ..options(false) }, "even");
    let many = SynthOptions { size: 2, train_views: 70_002, test_views: 70_000, supersample: 1, ..options(false) };
    refused(many, "common clock");
    let error = synth::write(dir.path(), "sheet", &options(true), false).expect_err("refused").to_string();
    assert!(error.contains("pinholes"), "{error}");
    std::fs::write(dir.path().join("notes.txt"), "mine").expect("a file");
    let error = synth::write_nerfies(dir.path(), "sheet", &options(false), false).expect_err("refused");
    assert!(matches!(error, DataError::Occupied { .. }), "{error}");
}
