//! A step on the GPU is that of the host within the tolerance of gradients.

use super::{after, device, gpu, resume, start};
use gs_gpu::Renderer;
use gs_raster::Frame;
use gs_train::checkpoint::Checkpoint;
use gs_train::testkit;
use gs_train::timestamp::Timestamp;

/// Largest relative error of the gradient of a block, in the L2 norm.
const GRADIENT: f64 = 1e-3;
/// Of losses and regularisers.
const LOSS: f64 = 1e-5;
/// Of what a step changes: where a gradient is a rounding error, Adam makes a step of it.
const STEP: f64 = 2e-2;
/// Decay of the moments.
const BETAS: [f64; 2] = [0.9f32 as f64, 0.999f32 as f64];

/// A tensor of a state as numbers.
fn numbers(state: &Checkpoint, name: &str) -> Vec<f64> {
    let tensor = state.tensors.iter().find(|t| t.0 == name).unwrap_or_else(|| panic!("no tensor {name}"));
    tensor.1.iter().map(|v| f64::from(*v)).collect()
}

/// `|a − b| / |b|`; 0 of zeros.
fn error(a: &[f64], b: &[f64]) -> f64 {
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|v| v * v).sum::<f64>().sqrt();
    let off = norm(&mut a.iter().zip(b).map(|(a, b)| a - b));
    if off == 0.0 { 0.0 } else { off / norm(&mut b.iter().copied()) }
}

/// Compares the step after `steps` steps of a method on the host.
fn compare(method: &str, steps: u32, over: &[&str]) {
    let Some(gpu) = gpu() else { return };
    let before = after(start(method, over), steps);
    let mut trainers = [resume(&before, None), resume(&before, Some(&gpu))];
    assert_eq!(trainers[1].device_lacks(), None);
    let reports = trainers.each_mut().map(|t| testkit::run(t, 1).remove(0));
    let [host, device] = trainers.map(|t| after(t, 0));
    let [a, b] = &reports;
    let close = |what: &str, a: f64, b: f64| {
        assert!((a - b).abs() <= LOSS * a.abs().max(1e-6), "{method}, {steps} steps, {what}: {a} {b}");
    };
    close("loss", a.loss.total, b.loss.total);
    close("l1", a.loss.l1, b.loss.l1);
    close("mse", a.loss.mse, b.loss.mse);
    close("ssim", a.loss.term("ssim").unwrap_or(0.0), b.loss.term("ssim").unwrap_or(0.0));
    assert_eq!(a.penalties.len(), b.penalties.len());
    for ((name, a), (other, b)) in a.penalties.iter().zip(&b.penalties) {
        assert_eq!(name, other);
        close(name, f64::from(*a), f64::from(*b));
    }
    let mut compared = 0;
    for (name, _) in &host.tensors {
        let [old, want, got] = [&before, &host, &device].map(|state| numbers(state, name));
        // Of moments, what the gradient gave; of all others, what the step changed.
        let (kept, tolerance) = match name.rsplit_once('#') {
            Some((_, "m1")) => (BETAS[0], GRADIENT),
            Some((_, "m2")) => (BETAS[1], 2.0 * GRADIENT),
            _ => (1.0, STEP),
        };
        let changed = |new: &[f64]| new.iter().zip(&old).map(|(new, old)| new - kept * old).collect::<Vec<f64>>();
        let off = error(&changed(&got), &changed(&want));
        println!("{method}, {steps} steps: {name} {off:.1e}");
        assert!(off < tolerance, "{method}, {steps} steps: {name} is off by {off:e}");
        compared += 1;
    }
    assert!(compared > 10, "{compared} tensors");
}

#[test]
fn a_cloud_at_rest() {
    for steps in [3, 45] {
        compare("static3d", steps, &[]);
    }
}

#[test]
fn a_cloud_moved_by_planes() {
    // In the warm-up, in the first step of the field, whose last layers are zero, and with a field that moves.
    for steps in [20, 30, 31, 55] {
        compare("fourdgs", steps, &[]);
    }
}

#[test]
fn a_cloud_moved_by_a_network() {
    // In the warm-up, in the first step of the field, whose heads are zero, in the stage that follows the motion, and after it.
    for steps in [10, 20, 31, 55] {
        compare("defgs", steps, &[]);
    }
    // Sixteen layers; no time network, leaky units, the other rules.
    compare("defgs", 45, &["field.depth = 16\nfield.skip = 7\nfield.bands_position = 10"]);
    compare(
        "defgs",
        45,
        &["field.time_hidden = 0\nfield.leak = 0.1\nfield.scale_rule = \"log\"\nfield.quat_rule = \"raw\""],
    );
}

#[test]
fn more_splats_than_one_workgroup_sums() {
    let many = "init.points = 1500\nschedule.density.max_splats = 2000\nfield.width = 96";
    for method in ["fourdgs", "defgs"] {
        compare(method, 45, &[many]);
    }
    // Angles far beyond what f32 resolves in radians.
    compare("defgs", 45, &["field.bands_position = 20\nfield.coordinate_scale = 50.0"]);
    // A field without any head.
    let none = "field.move_means = false\nfield.move_scales = false\nfield.move_quats = false";
    compare("fourdgs", 45, &[none]);
}

#[test]
fn settings_of_the_field_and_of_the_loss() {
    compare("fourdgs", 50, &["field.depth = 3\nfield.move_scales = false\nfield.hexplane.levels = [1, 2, 4]"]);
    compare(
        "fourdgs",
        50,
        &["field.detach_coordinates = true\nschedule.lambda_dssim = 0.0\nfield.hexplane.channels = 32"],
    );
    compare("static3d", 20, &["cloud.sh_degree = 0\nschedule.background = \"black\"\nschedule.antialias = true"]);
    // Colours of the third degree, of which one is rendered; a background that changes with the step.
    compare("static3d", 20, &["cloud.sh_degree = 3\nschedule.background = \"random\""]);
}

/// A frame with more pairs than the first attempt has room for: nothing may change before it is whole.
#[test]
fn a_frame_that_needs_more_room_is_made_again() {
    let Some(gpu) = gpu() else { return };
    let wide =
        "init.points = 1000\nschedule.density.max_splats = 1000\nschedule.density.until = 0\ncloud.spread = 30.0";
    let trainer = resume(&after(start("static3d", &[wide]), 45), None);
    let (model, camera) = (trainer.model(), &super::data().train[0].camera);
    let splats = model.splats(&Timestamp::normalised(0.0), camera).expect("splats");
    let (mut renderer, mut frame) = (Renderer::new(&gpu), Frame::default());
    renderer.render_into(&splats, camera, &model.raster_options([0.0; 3]), &mut frame).expect("a frame");
    assert!(renderer.entries() as usize > 8 * splats.len(), "{} of {}", renderer.entries(), splats.len());
    compare("static3d", 45, &[wide]);
}

#[test]
fn what_a_device_cannot_make_the_host_makes() {
    let Some(gpu) = gpu() else { return };
    for (method, over, why) in [
        ("grid4d", "", "the field is neither that of 4DGS nor that of Deformable 3D Gaussians"),
        ("static3d", "cloud.kernel.kind = \"frequency\"", "splats have a kernel of their own"),
        ("fourdgs", "field.scale_rule = \"add\"", "scales have a limit (field.scale_rule is add)"),
        ("fourdgs", "still.pixels = 0.5", "still splats are left out of the field (still.pixels)"),
        ("defgs", "field.quat_rule = \"compose\"", "field.quat_rule is compose"),
        ("defgs", "field.depth = 17", "the network has more than 16 layers"),
        ("fourdgs", "field.depth = 17", "the network has more than 16 layers"),
        ("fourdgs", "field.hexplane.levels = [1, 1, 1, 1, 1, 1, 1, 1, 1]", "the planes have more than 8 levels"),
        ("modec", "", "the method is more than a cloud and a field"),
    ] {
        let trainer = start(method, &[over]).on(&device(&gpu)).expect("a device");
        assert_eq!(trainer.device_lacks().as_deref(), Some(why), "{method} {over}");
        after(trainer, 2);
    }
}

#[test]
fn a_state_too_large_for_a_buffer_stays_on_the_host() {
    let Some(gpu) = gpu() else { return };
    let many =
        "init = { from = \"random\", points = 300000 }\ncloud.sh_degree = 3\nschedule.density.max_splats = 300000";
    let trainer = start("static3d", &[many]).on(&device(&gpu)).expect("a device");
    let why = trainer.device_lacks().expect("a reason");
    assert!(why.starts_with("Adam's moments take 136 MiB in one buffer, and the device allows 128"), "{why}");
    after(trainer, 1);
    // The field's activations are larger than the moments: known before its first step.
    let wide = "init = { from = \"random\", points = 25000 }\nschedule.density.max_splats = 25000\nfield.width = 512";
    let mut trainer = start("fourdgs", &[wide]).on(&device(&gpu)).expect("a device");
    let why = trainer.device_lacks().expect("a reason");
    assert!(why.starts_with("the field's activations and gradients take 148 MiB in one buffer"), "{why}");
    assert!(testkit::run(&mut trainer, 1)[0].events.is_empty(), "no step was made on the device before");
}
