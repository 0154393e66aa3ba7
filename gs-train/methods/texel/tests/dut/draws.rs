//! Which frames and cameras a step learns from.

use super::*;
use std::collections::BTreeSet;

#[test]
fn the_warm_up_learns_from_the_first_frames() {
    let data = film("cylinder", 32, 3);
    let loss = |share: &str, frame: usize| {
        let settings = config(&[SHORT, "gaunet.residual = false", share]);
        let mut method = bare(&data, &settings, 6);
        let at = Timestamp { t: method.actor().scene.frames[frame].time };
        unrendered(&mut method, at, &data.train[0].camera)
    };
    let [all, first] = ["gaunet.warm_up_frames = 1.0", "gaunet.warm_up_frames = 0.3"];
    assert!(loss(all, 0) != loss(all, 2), "frames differ");
    assert_eq!(
        [loss(first, 0), loss(first, 1), loss(first, 2)],
        [loss(all, 0); 3],
        "0.3 of three frames is the first one"
    );
}

#[test]
fn a_share_of_geonets_steps_sees_what_one_camera_sees() {
    let data = film("cylinder", 32, 2);
    let gradients = |share: &str| {
        let stages = "schedule.stages.geometry.steps = 40\nsurface.texture = 0.0";
        let settings = config(&[SHORT, stages, share]);
        let mut method = bare(&data, &settings, 1);
        // The last layer begins at zero: moved, or nothing before it has a gradient.
        method.visit_mut(&mut |p| {
            let mut rng = Rng::new(5, &p.name, 0, 0);
            p.value.iter_mut().for_each(|v| *v += 0.02 * rng.normal());
        });
        let schedule = own_settings(settings).try_into::<Config>().expect("settings").schedule.trainer;
        let (at, camera) = (Timestamp::new(data.train[0].time), data.train[0].camera.clone());
        let of_step = |step: u32| {
            method.visit_mut(&mut |p| p.clear_grad());
            method.begin_step(&schedule.at(step));
            unrendered(&mut method, at, &camera);
            let mut all = Vec::new();
            method.visit(&mut |p| all.extend(p.grad.iter().map(|g| g.to_bits())));
            all
        };
        (1..=24).map(of_step).collect::<BTreeSet<_>>()
    };
    let cameras = bare(&data, &config(&[SHORT]), 1).actor().scene.frames[0].inputs.len();
    let [never, always] = ["surface.one_view = 0.0", "surface.one_view = 1.0"].map(gradients);
    assert_eq!((never.len(), always.len()), (1, cameras));
    assert!(never.is_disjoint(&always));
    assert_eq!(gradients("surface.one_view = 0.5"), &never | &always);
}
