//! Frames rendered on another device than the CPU: a fake one, which counts its calls and fails on demand.

use gs_data::{Dataset, ImageCache, Split};
use gs_raster::DeviceError;
use gs_synth::SynthOptions;
use gs_train::device::Device;
use gs_train::evaluate::{EvalError, Scoring, evaluate, evaluate_with};
use gs_train::method::MethodError;
use gs_train::ranks::Share;
use gs_train::renderer::Renderer;
use gs_train::testkit::{self, fake_device};
use gs_train::trainer::{TrainError, Trainer};
use std::sync::Arc;
use std::sync::atomic::Ordering;

fn data() -> Arc<Dataset> {
    let options = SynthOptions::of_views(24, 4, 3);
    Arc::new(gs_synth::generate("static", &options).expect("scene").dataset)
}

/// A run before its first step, on the CPU.
fn start(over: &[&str]) -> Trainer {
    let registry = gs_methods::registry();
    testkit::start(registry, &data(), "static3d", &testkit::config(registry, "static3d", "tiny", over), 1)
}

#[test]
fn a_run_renders_on_its_device() {
    for over in [&[][..], &["cameras.refine = true"]] {
        let (device, calls) = fake_device(0);
        let (mut on_cpu, mut trainer) = (start(over), start(over).on(&device).expect("a device"));
        assert_eq!((on_cpu.device().name(), trainer.device().name()), ("cpu", "fake"));
        testkit::run(&mut on_cpu, 3);
        testkit::run(&mut trainer, 3);
        assert_eq!(calls.load(Ordering::Relaxed), 6, "forward and backward of each step");
        assert!(trainer.state().tensors == on_cpu.state().tensors, "the fake has the bits of the CPU");
        let images = ImageCache::new(1 << 20, 1.0);
        let scores = trainer.evaluate(&images).expect("scores");
        assert_eq!((scores.views.len(), calls.load(Ordering::Relaxed)), (3, 9), "forward of each test view");
        assert_eq!(scores, on_cpu.evaluate(&images).expect("scores"));
    }
}

#[test]
fn a_device_that_fails_ends_the_run_and_its_checkpoint_goes_on() {
    // Forward and backward of the third step.
    for fails_at in [5, 6] {
        let (mut on_cpu, mut trainer) = (start(&[]), start(&[]).on(&fake_device(fails_at).0).expect("a device"));
        testkit::run(&mut on_cpu, 4);
        testkit::run(&mut trainer, 2);
        let checkpoint = trainer.state();
        let error = trainer.step().expect_err("the device is lost");
        assert!(matches!(error, TrainError::Method(MethodError::Device(_))), "{error:?}");
        assert_eq!((error.to_string().as_str(), error.exit_code()), ("the fake device is lost", 5));
        assert_eq!(trainer.steps_done(), 2);
        let resumed = Trainer::resume(gs_methods::registry(), data(), &checkpoint, None, 1 << 20);
        let mut resumed = resumed.expect("a run on the CPU");
        testkit::run(&mut resumed, 2);
        assert!(resumed.state().tensors == on_cpu.state().tensors, "it goes on as if nothing had happened");
    }
}

#[test]
fn renders_and_scores_name_what_failed() {
    let (trainer, data, images) = (start(&[]), data(), ImageCache::new(1 << 20, 1.0));
    let (model, view) = (trainer.model(), &data.test[0]);
    let options = model.raster_options([0.0; 3]);
    let (device, calls) = fake_device(2);
    let mut renderer = Renderer::on(&device, options.clone()).expect("a device");
    let image = renderer.view(model, view, &view.camera).expect("an image");
    assert_eq!(image, Renderer::new(options.clone()).view(model, view, &view.camera).expect("an image"));
    let error = renderer.view(model, view, &view.camera).expect_err("the device is lost");
    assert!(matches!(error, MethodError::Device(_)) && calls.load(Ordering::Relaxed) == 2, "{error}");

    let share = Share::default();
    let score = |device: &Device| {
        let scoring = Scoring::new([0.0; 3], &images, &share, device);
        evaluate_with(model, &data, Split::Test, &scoring)
    };
    assert!(matches!(score(&fake_device(3).0), Err(EvalError::Device(_))));
    let scores = evaluate(model, &data, Split::Test, [0.0; 3], &images);
    assert_eq!(score(&fake_device(0).0).expect("scores"), scores.expect("scores"));

    let closed = Device::new("closed", || Err(DeviceError::new("there is no adapter")));
    assert!(matches!(score(&closed), Err(EvalError::Device(_))));
    assert!(matches!(Renderer::on(&closed, options), Err(MethodError::Device(_))));
    let error = trainer.on(&closed).err().expect("refused");
    assert_eq!((error.to_string().as_str(), error.exit_code()), ("there is no adapter", 5));
}
