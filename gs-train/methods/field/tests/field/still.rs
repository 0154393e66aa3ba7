//! Splats left at rest in rendering: within their tolerance, until a parameter changes.

use gs_core::{Camera, Splats, Time};
use gs_method_field::METHODS;
use gs_synth::testkit::scene;
use gs_train::capabilities::FreezeOptions;
use gs_train::model::Model;
use gs_train::registry::Registry;
use gs_train::still::screen_bound;
use gs_train::testkit::{run, short, start};
use gs_train::timestamp::Timestamp;

fn splats(model: &Model, t: f32, camera: &Camera) -> Splats {
    model.splats(&Timestamp::new(Time::new(t).expect("a time")), camera).expect("splats")
}

#[test]
fn what_rests_stays_within_its_tolerance_until_a_parameter_changes() {
    let (registry, data) = (Registry::new(METHODS.to_vec()), scene("balls", 32, 7));
    let cameras: Vec<Camera> = data.train.iter().map(|v| v.camera.clone()).collect();
    for method in ["defgs", "fourdgs", "fags"] {
        let mut trainer = start(&registry, &data, method, &short(&registry, method, &[]), 3);
        run(&mut trainer, 60);
        let exact = trainer.model();
        let mut counts = Vec::new();
        for (pixels, shape) in [(0.05, 1e-3), (1.0, 0.05), (1e3, 1e3)] {
            let options = FreezeOptions { pixels, shape, ..FreezeOptions::usual(&cameras) };
            let Some((mut resting, report)) = exact.freeze_static(&options) else {
                counts.push(0);
                continue;
            };
            assert!(report.bound_pixels <= pixels && report.shape <= shape, "{method}: {report:?}");
            for probe in 0..=32 {
                let [a, b] = [exact, &resting].map(|m| splats(m, probe as f32 / 32.0, &cameras[0]));
                assert_eq!((&a.opacities, &a.color, &a.kernel), (&b.opacities, &b.color, &b.kernel));
                for (a, b) in a.means.iter().zip(&b.means) {
                    // Fewer rows in a field change rounding.
                    let off = screen_bound(a.distance(*b), *b, &cameras);
                    assert!(off <= pixels + 1e-2, "{method}: off by {off} pixels at a tolerance of {pixels}");
                }
            }
            resting.visit_mut(&mut |_| {});
            resting.begin_step(60);
            assert_eq!(splats(&resting, 0.4, &cameras[0]), splats(exact, 0.4, &cameras[0]), "{method}");
            counts.push(report.still);
        }
        assert!(counts.is_sorted() && counts[2] == exact.splat_count(), "{method}: {counts:?}");
    }
}

/// A run that is rendered between its steps gives the bits of one that is not, and what a step changes is seen.
#[test]
fn a_warm_tape_of_rendering_changes_no_bit() {
    let (registry, data) = (Registry::new(METHODS.to_vec()), scene("balls", 32, 7));
    let camera = &data.train[0].camera;
    for method in ["fourdgs", "fags"] {
        let config = short(&registry, method, &[]);
        let [mut rendered, mut alone] = [0, 1].map(|_| start(&registry, &data, method, &config, 3));
        for _ in 0..60 {
            run(&mut rendered, 1);
            let [first, _, again] = [0.2, 0.7, 0.2].map(|t| splats(rendered.model(), t, camera));
            assert!(first == again, "{method}");
        }
        run(&mut alone, 60);
        let [a, b] = [&rendered, &alone].map(|trainer| splats(trainer.model(), 0.2, camera));
        assert!(a == b, "{method}");
    }
}

/// The end of a step drops what was rendered before the optimiser's update.
#[test]
fn an_update_after_a_render_is_seen() {
    let (registry, data) = (Registry::new(METHODS.to_vec()), scene("balls", 32, 7));
    let camera = &data.train[0].camera;
    let mut trainer = start(&registry, &data, "fags", &short(&registry, "fags", &[]), 3);
    run(&mut trainer, 60);
    let options = FreezeOptions { pixels: 1e3, shape: 1e3, ..FreezeOptions::usual(std::slice::from_ref(camera)) };
    let (mut model, _) = trainer.model().freeze_static(&options).expect("static splats");
    model.begin_step(60);
    splats(&model, 0.2, camera);
    model.visit_mut(&mut |p| p.value.iter_mut().filter(|_| p.name == "cloud.means").for_each(|v| *v += 0.1));
    model.end_step().expect("the end of a step");
    let after = splats(&model, 0.2, camera);
    model.begin_step(60);
    assert!(after == splats(&model, 0.2, camera));
}
