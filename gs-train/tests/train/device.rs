//! Frames rendered on another device than the CPU: a fake one, which counts its calls and fails on demand.

use gs_core::Camera;
use gs_data::{Dataset, ImageCache, ImageU8, Split};
use gs_raster::DeviceError;
use gs_synth::SynthOptions;
use gs_train::device::{Device, DeviceLoss, DeviceStep, DeviceSteps};
use gs_train::evaluate::{EvalError, Scoring, evaluate, evaluate_with};
use gs_train::method::{Method, MethodError, MovedCloud};
use gs_train::ranks::Share;
use gs_train::renderer::Renderer;
use gs_train::testkit::{self, fake_device};
use gs_train::trainer::{TrainError, Trainer};
use std::collections::BTreeSet;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

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

/// Makes whole steps that add one to every value, and notes what is asked of it.
#[derive(Default)]
struct AddsOne {
    calls: Arc<Mutex<Vec<&'static str>>>,
    /// Steps that it can make; 0: any number.
    most: usize,
    images: BTreeSet<usize>,
    values: Vec<Vec<f32>>,
}

impl DeviceSteps for AddsOne {
    fn lacks(&self, _cloud: &MovedCloud<'_>, _camera: &Camera) -> Option<String> {
        let made = self.calls.lock().expect("calls").iter().filter(|call| **call == "step").count();
        (self.most > 0 && made >= self.most).then(|| "it is tired".to_owned())
    }

    fn load(&mut self, method: &dyn Method) -> Result<(), DeviceError> {
        self.calls.lock().expect("calls").push("load");
        self.values.clear();
        method.visit(&mut |p| self.values.push(p.value.clone()));
        Ok(())
    }

    fn has_image(&self, view: usize, _scale: f64) -> bool {
        self.images.contains(&view)
    }

    fn put_image(&mut self, view: usize, _scale: f64, image: &ImageU8) -> Result<(), DeviceError> {
        assert_eq!((image.width, self.images.insert(view)), (24, true), "each image once");
        Ok(())
    }

    fn step(&mut self, step: &DeviceStep<'_>) -> Result<DeviceLoss, DeviceError> {
        assert!(self.images.contains(&step.view) && (step.update)("cloud.means").is_some());
        self.calls.lock().expect("calls").push("step");
        self.values.iter_mut().flatten().for_each(|v| *v += 1.0);
        Ok(DeviceLoss { l1: 0.5, ..DeviceLoss::default() })
    }

    fn store(&mut self, method: &mut dyn Method) -> Result<(), DeviceError> {
        self.calls.lock().expect("calls").push("store");
        let mut values = self.values.iter();
        method.visit_mut(&mut |p| p.value.clone_from(values.next().expect("a block")));
        Ok(())
    }
}

#[test]
fn whole_steps_stay_on_the_device_until_the_host_looks() {
    let run = |over: &[&str], device: &Device| start(over).on(device).expect("a device");
    let calls = Arc::new(Mutex::new(Vec::new()));
    let noted = calls.clone();
    let device =
        fake_device(0).0.with_steps(move || Ok(Box::new(AddsOne { calls: noted.clone(), ..AddsOne::default() })));
    let taken = || std::mem::take(&mut *calls.lock().expect("calls"));
    let opacity = |trainer: &Trainer| {
        let mut first = 0.0;
        trainer.model().visit(&mut |p| first = if p.name == "cloud.logit_opacities" { p.value[0] } else { first });
        first
    };

    let mut trainer = run(&["schedule.density.until = 0"], &device);
    let before = opacity(&trainer);
    assert_eq!(trainer.device_lacks(), None);
    let reports = testkit::run(&mut trainer, 3);
    assert_eq!((reports[0].loss.l1, reports[0].quarantined), (0.5, 0));
    assert_eq!((taken(), opacity(&trainer)), (vec!["load", "step", "step", "step"], before));
    trainer.gather().expect("the state");
    trainer.gather().expect("the same state");
    assert_eq!((taken(), opacity(&trainer)), (vec!["store"], before + 3.0));
    testkit::run(&mut trainer, 1);
    assert_eq!(taken(), ["step"], "what was looked at is still there");

    // Rows are edited in every second step, on the host.
    let edits = "schedule.density.from = 0\nschedule.density.every = 2\nschedule.density.reset_every = 0";
    testkit::run(&mut run(&[edits], &device), 4);
    assert_eq!(taken(), ["load", "step", "step", "store", "load", "step", "step", "store"]);

    // Where the device can make no more, the log says so, once; rows are edited in the step before.
    let noted = calls.clone();
    let tires = fake_device(0)
        .0
        .with_steps(move || Ok(Box::new(AddsOne { calls: noted.clone(), most: 2, ..AddsOne::default() })));
    let reports = testkit::run(&mut run(&[edits], &tires), 4);
    assert_eq!(taken(), ["load", "step", "step", "store"]);
    let events: Vec<_> = reports.iter().flat_map(|r| &r.events).filter(|e| !e["made_on_the_cpu"].is_null()).collect();
    assert!(events.len() == 1 && events[0]["made_on_the_cpu"] == "it is tired" && events[0]["step"] == 3, "{events:?}");

    // What a step on a device has no part for the host makes.
    for (over, why) in [
        ("schedule.batch = 2", "steps have more than one view"),
        ("schedule.lambda_fre = 0.1", "the amplitude-spectrum loss (schedule.lambda_fre) is on"),
        ("schedule.dssim = \"ssim_box\"", "schedule.dssim is not ssim"),
        ("schedule.exposure.fit = true\nschedule.exposure.after = 0.0", "exposures are fitted"),
        ("cameras.refine = true", "cameras are refined"),
        ("schedule.sparse_adam = true", "updates are sparse"),
        ("schedule.lr.cloud.means.sparse = true", "updates are sparse"),
    ] {
        let mut trainer = run(&[over], &device);
        assert_eq!(trainer.device_lacks().as_deref(), Some(why), "{over}");
        testkit::run(&mut trainer, 2);
        assert_eq!(taken(), [""; 0], "{over}");
    }
}
