//! Images that were not exposed alike: the scene keeps the colours that are right for most, and the mean map is state like any other.

use gs_core::cast;
use gs_data::pixels::ImageU8;
use gs_data::{Dataset, ImageCache, ImageSource, Split};
use gs_metrics::Quantise;
use gs_synth::SynthOptions;
use gs_synth::gains::{exposed, gains_of};
use gs_train::conformance::Subject;
use gs_train::evaluate::{EvalReport, Scoring, evaluate_with};
use gs_train::testkit::{run, start};
use gs_train::trainer::Trainer;
use std::sync::Arc;

const FIT: &str = "schedule.exposure.fit = true";
const OFFSET: &str = "schedule.exposure.offset = true";
const MAPS: &str = "exposures#";
const OFFSETS: &str = "exposures#offsets";
const BLACK: &str = "schedule.background = \"black\"";

fn scene(name: &str, size: u32, views: u32) -> Arc<Dataset> {
    let options = SynthOptions { supersample: 4, ..SynthOptions::of_views(size, views, 6) };
    Arc::new(gs_synth::generate(name, &options).expect("scene").dataset)
}

/// The same with gains of its own for every training image; their mean is 1.
fn unequal(data: &Dataset, seed: u64) -> Arc<Dataset> {
    let (mut unequal, images) = (data.clone(), ImageCache::new(0, 1.0));
    let gains: Vec<[f64; 3]> = (0..data.train.len() as u64).map(|k| gains_of(0.25, seed, k)).collect();
    let mean: [f64; 3] = std::array::from_fn(|c| gains.iter().map(|g| g[c]).sum::<f64>() / gains.len() as f64);
    for (gains, view) in gains.iter().zip(&mut unequal.train) {
        let image = exposed(&images.get(view).expect("image"), std::array::from_fn(|c| gains[c] / mean[c]));
        view.image = ImageSource::Memory(Arc::new(image));
    }
    Arc::new(unequal)
}

/// An image through haze: a share of its light is lost, as much stray light is added; alpha stays.
fn through(image: &ImageU8, haze: f64) -> ImageU8 {
    let value = |(k, v): (usize, &u8)| match k % 4 {
        3 => *v,
        _ => cast::to_u8(((1.0 - haze) * f64::from(*v) + haze * 200.0).round()),
    };
    ImageU8 { data: image.data.iter().enumerate().map(value).collect(), ..*image }
}

/// The same scene with haze of its own in every training image; test images have the mean.
fn hazy(data: &Dataset) -> Arc<Dataset> {
    let (mut hazy, images) = (data.clone(), ImageCache::new(0, 1.0));
    let own = (0..data.train.len()).map(|k| 0.15 * (k % 5) as f64);
    let all = own.zip(&mut hazy.train).chain(hazy.test.iter_mut().map(|view| (0.3, view)));
    for (haze, view) in all {
        let image = through(&images.get(view).expect("image"), haze);
        view.image = ImageSource::Memory(Arc::new(image));
    }
    Arc::new(hazy)
}

fn train(data: &Arc<Dataset>, over: &[&str]) -> EvalReport {
    let registry = gs_methods::registry();
    let over = [&["schedule.stages.all.steps = 600", BLACK], over].concat();
    let config = gs_train::testkit::config(registry, "static3d", "tiny", &over);
    let mut trainer = start(registry, data, "static3d", &config, 0);
    let steps = trainer.steps();
    run(&mut trainer, steps);
    let (images, share, device) = (ImageCache::new(64 << 20, 1.0), Default::default(), Default::default());
    let model = trainer.model();
    let scoring = Scoring { fit_colors: true, ..Scoring::new(model.background(), &images, &share, &device) };
    evaluate_with(model, data, Split::Test, &scoring).expect("scores")
}

#[test]
fn images_of_unequal_exposure_teach_one_scene() {
    let equal = scene("static", 64, 40);
    let unequal = unequal(&equal, 1);
    let [right, plain, fit] = [train(&equal, &[]), train(&unequal, &[]), train(&unequal, &[FIT])];
    let own = |report: &EvalReport| report.mean.psnr.expect("finite");
    let fitted = |report: &EvalReport| report.mean.fitted.expect("asked for").psnr.expect("finite");
    for (name, report) in [("equal", &right), ("unequal", &plain), ("fit", &fit)] {
        println!("{name}: {:.2} dB, {:.2} dB in the colours of the images", own(report), fitted(report));
    }
    for score in [own, fitted] {
        let (right, plain, fit) = (score(&right), score(&plain), score(&fit));
        assert!(fit > plain + 0.5 * (right - plain), "half of what was lost is back: {right} {plain} {fit}");
    }
    assert!(right.protocol.contains("fitted: after the linear map"), "{}", right.protocol);
}

#[test]
fn images_in_which_black_is_not_black_need_offsets() {
    let data = hazy(&scene("static", 48, 20));
    let [linear, affine] = [train(&data, &[FIT]), train(&data, &[FIT, OFFSET])];
    let own = |report: &EvalReport| report.mean.psnr.expect("finite");
    println!("linear maps {:.2} dB, affine maps {:.2} dB", own(&linear), own(&affine));
    assert!(own(&affine) > own(&linear), "{} {}", own(&linear), own(&affine));
    let fitted = |report: &EvalReport| report.mean.fitted.expect("asked for");
    assert!(fitted(&affine).offset && !fitted(&linear).offset);
    assert!(affine.protocol.contains("fitted: after the affine map"), "{}", affine.protocol);
}

#[test]
fn maps_are_the_same_bits_for_any_threads_and_ranks_and_after_a_resume() {
    let data = unequal(&scene("balls", 32, 7), 2);
    let registry = gs_methods::registry();
    for offset in [false, true] {
        let config = gs_train::testkit::short(registry, "fourdgs", &[FIT, BLACK, if offset { OFFSET } else { "" }]);
        let subject = Subject::new(registry, "fourdgs", &data, &config);
        [subject.state(), subject.threads(), subject.ranks()].into_iter().for_each(|kept| kept.expect("the same bits"));
        let mut trainer = start(registry, &data, "fourdgs", &config, 3);
        run(&mut trainer, 40);
        let state = trainer.state();
        let maps = state.tensor(MAPS).expect("maps");
        let apart = maps.as_chunks::<9>().0.iter().all(|map| (map[0] - 1.0).abs() > 1e-3);
        assert!(maps.len() == 9 * 7 && apart, "{maps:?}");
        let offsets = state.tensor(OFFSETS).ok();
        assert_eq!(offsets.map(<[f32]>::len), offset.then_some(3 * 7));
        assert!(offsets.into_iter().flatten().all(|v| *v != 0.0), "{offsets:?}");
        // A state whose offsets are of other images is refused.
        let mut cut = state.clone();
        cut.tensors.iter_mut().filter(|(name, _)| name == OFFSETS).for_each(|(_, values)| values.truncate(6));
        let refused = Trainer::resume(registry, data.clone(), &cut, None, 0).err().map(|e| e.to_string());
        assert_eq!(refused.is_some_and(|why| why.contains(OFFSETS)), offset);
    }
    // Nothing is kept where nothing is fitted.
    let plain = gs_train::testkit::short(registry, "fourdgs", &[BLACK]);
    let mut plain = start(registry, &data, "fourdgs", &plain, 3);
    run(&mut plain, 5);
    assert!(plain.state().tensor(MAPS).is_err());
}

#[test]
fn scores_in_the_colours_of_the_images_are_rounded_and_need_a_pixel_that_counts() {
    let mut data = Dataset::clone(&scene("static", 24, 4));
    let size = data.test[0].camera.width as usize;
    let nothing = ImageU8 { width: size, height: size, data: [0, 0, 0, 255].repeat(size * size) };
    data.test[0].mask = Some(ImageSource::Memory(Arc::new(nothing)));
    let config = gs_train::testkit::short(gs_methods::registry(), "static3d", &[BLACK]);
    let trainer = start(gs_methods::registry(), &Arc::new(data.clone()), "static3d", &config, 0);
    let (images, share, device) = (ImageCache::new(64 << 20, 1.0), Default::default(), Default::default());
    let fitted = |quantise: Quantise| {
        let exact = Scoring::new([0.0; 3], &images, &share, &device);
        let scoring = Scoring { fit_colors: true, quantise, ..exact };
        let report = evaluate_with(trainer.model(), &data, Split::Test, &scoring).expect("scores");
        report.views.iter().map(|v| v.fitted).collect::<Vec<_>>()
    };
    let (exact, rounded) = (fitted(Quantise::None), fitted(Quantise::Truncate));
    assert_eq!(exact[0], None);
    assert!(exact.len() > 1 && exact[1..].iter().zip(&rounded[1..]).all(|(a, b)| a.is_some() && b.is_some() && a != b));
}
