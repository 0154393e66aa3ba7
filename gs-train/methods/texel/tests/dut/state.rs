//! What a run stores and what it computes anew: interruptions, threads, caches, mean textures, other films.

use super::*;
use gs_train::model::Model;
use gs_train::saved;
use gs_train::testkit::timeless;

#[test]
fn interruptions_and_threads_do_not_change_a_bit() {
    let data = film("cylinder", 32, 3);
    for over in [&[SHORT][..], &[SHORT, DIRECT], &[SHORT, "jitter = 0.3\nsurface.refresh = 2"]] {
        let config = config(over);
        let steps = start(&data, &config).steps();
        let mut whole = start(&data, &config);
        let mut states = vec![whole.state()];
        for _ in 0..steps {
            whole.step().expect("step");
            states.push(whole.state());
        }
        let last = timeless(whole.state());
        for from in [0, 3, 5, 7, steps - 1] {
            let mut resumed =
                Trainer::resume(&registry(), data.clone(), &states[from as usize], None, 1 << 20).expect("resume");
            run(&mut resumed, steps - from);
            assert!(timeless(resumed.state()) == last, "resumed at {from}");
        }
        for threads in [1, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            let state = pool.install(|| {
                let mut trainer = start(&data, &config);
                run(&mut trainer, steps);
                timeless(trainer.state())
            });
            assert!(state == last, "{threads} threads");
        }
    }
}

#[test]
fn a_small_cache_changes_nothing() {
    let data = film("cylinder", 32, 3);
    let states = ["cache_mib = 0", "cache_mib = 64"].map(|cache| {
        let mut trainer = start(&data, &config(&[SHORT, cache]));
        run(&mut trainer, 15);
        trainer.state().tensors
    });
    assert!(states[0] == states[1]);
}

#[test]
fn a_frame_of_its_own_images_is_that_of_the_film() {
    let data = film("person", 32, 3);
    for over in [
        &[SHORT][..],
        &[SHORT, "follow_light = true"],
        &[SHORT, "input = \"first\""],
        &[SHORT, "input = \"single\"", "schedule.stages.geometry.steps = 0"],
    ] {
        let method = bare(&data, &config(over), 15);
        let actor = method.actor();
        for frame in &actor.scene.frames {
            let images = actor.images(frame).expect("images");
            let made = method.splats_of(&frame.pose, &images).expect("splats");
            let camera = &frame.inputs[0].camera;
            assert_eq!(made, method.splats(&Timestamp { t: frame.time }, camera).expect("splats"));
        }
        let frames = &actor.scene.frames;
        let images = actor.images(&frames[0]).expect("images");
        let other = method.splats_of(&frames[2].pose, &images).expect("splats");
        assert_ne!(other, method.splats_of(&frames[0].pose, &images).expect("splats"), "the pose counts");
    }
}

/// The mean textures a run learnt with are its own: another film's would be others.
#[test]
fn a_run_over_another_film_draws_the_same() {
    let data = film("person", 48, 4);
    let mut other = Dataset::clone(&data);
    let person = Arc::make_mut(other.avatar.as_mut().expect("person"));
    person.frames.truncate(1);
    let at = Timestamp::new(person.frames[0].time);
    let camera = &data.train[0].camera;
    for over in [&[SHORT, RESIDUAL][..], &[SHORT, DIRECT]] {
        let config = config(over);
        let mut trainer = start(&data, &config);
        let steps = trainer.steps();
        run(&mut trainer, steps);
        let state = trainer.state();
        let of =
            |film: &Dataset| saved::load_with(&registry(), &state, None, film.avatar.clone()).expect("state").model;
        let (here, there) = (of(&data), of(&other));
        let splats = |model: &Model| model.splats(&at, camera).expect("splats");
        assert!(splats(&here) == splats(&there), "{over:?}");
        assert_eq!(mean(&*here).len(), 3);
        assert!(mean(&*here) == mean(&*there));
        // Made of the other film they differ, and so does what is drawn: a checkpoint without them says nothing of them.
        assert!(mean(&*here) != mean(&bare(&other, &config, 15)));
        let mut old = state.clone();
        old.tensors.retain(|(name, _)| !name.starts_with("mean."));
        let old = saved::load_with(&registry(), &old, None, other.avatar.clone()).expect("state").model;
        assert!(splats(&old) != splats(&here), "{over:?}");
    }
}

#[test]
fn mean_colours_are_made_anew_of_second_textures() {
    let data = film("person", 48, 3);
    let config = config(&[SHORT, "surface.refresh = 2"]);
    let mut trainer = start(&data, &config);
    let mut means = vec![mean(&**trainer.model())];
    for _ in 0..7 {
        run(&mut trainer, 1);
        means.push(mean(&**trainer.model()));
    }
    // Steps 2 and 4 of the five of GeoNet, and GauNet's texels alone.
    let renewed: Vec<bool> = means.windows(2).map(|pair| pair[0] != pair[1]).collect();
    assert_eq!(renewed, [false, true, false, true, false, false, false]);
    assert!(means.iter().all(|m| m[0] == means[0][0]));
    let state = trainer.state();
    let mut resumed = Trainer::resume(&registry(), data.clone(), &state, None, 1 << 20).expect("resume");
    assert!(mean(&**resumed.model()) == means[7]);
    run(&mut resumed, 3);
    run(&mut trainer, 3);
    assert!(timeless(resumed.state()) == timeless(trainer.state()));
}
