//! Splats left at rest in rendering: within their tolerance, until a parameter changes.

use gs_core::{Camera, Params, Splats, Time};
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

/// The second of two renders at the same time comes from a tape that the first left, at another time.
#[test]
fn a_warm_tape_of_rendering_changes_no_bit() {
    let (registry, data) = (Registry::new(METHODS.to_vec()), scene("balls", 32, 7));
    for method in ["fourdgs", "fags"] {
        let mut trainer = start(&registry, &data, method, &short(&registry, method, &[]), 3);
        run(&mut trainer, 59);
        let (camera, times) = (&data.train[0].camera, [0.2, 0.7, 0.2]);
        let warm = times.map(|t| splats(trainer.model(), t, camera));
        assert!(warm[0] == warm[2] && warm[0] != warm[1], "{method}");
        // The tape goes with the next change of a parameter.
        run(&mut trainer, 1);
        assert_ne!(splats(trainer.model(), 0.2, camera), warm[0], "{method}");
    }
}
