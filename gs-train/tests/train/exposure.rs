//! Images that were not exposed alike: the scene keeps the colours that are right for most, and the mean map is state like any other.

use gs_data::pixels::ImageU8;
use gs_data::{Dataset, ImageCache, ImageSource, Split};
use gs_metrics::Quantise;
use gs_synth::SynthOptions;
use gs_synth::gains::{exposed, gains_of};
use gs_train::conformance::Subject;
use gs_train::evaluate::{EvalReport, Scoring, evaluate_with};
use gs_train::testkit::{run, start};
use std::sync::Arc;

const FIT: &str = "schedule.exposure.fit = true";
const MAPS: &str = "exposures#";
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
fn maps_are_the_same_bits_for_any_threads_and_ranks_and_after_a_resume() {
    let data = unequal(&scene("balls", 32, 7), 2);
    let registry = gs_methods::registry();
    let config = gs_train::testkit::short(registry, "fourdgs", &[FIT, BLACK]);
    let subject = Subject::new(registry, "fourdgs", &data, &config);
    [subject.state(), subject.threads(), subject.ranks()].into_iter().for_each(|kept| kept.expect("the same bits"));
    let mut trainer = start(registry, &data, "fourdgs", &config, 3);
    run(&mut trainer, 40);
    let state = trainer.state();
    let maps = state.tensor(MAPS).expect("maps");
    assert!(maps.len() == 9 * 7 && maps.as_chunks::<9>().0.iter().all(|map| (map[0] - 1.0).abs() > 1e-3), "{maps:?}");
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
