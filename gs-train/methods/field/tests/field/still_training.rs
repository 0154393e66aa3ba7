//! Splats left out of the field while training.

use gs_method_field::METHODS;
use gs_synth::testkit::scene;
use gs_train::checkpoint::Checkpoint;
use gs_train::conformance::Subject;
use gs_train::registry::Registry;
use gs_train::testkit::{run, short, start};

fn registry() -> Registry {
    Registry::new(METHODS.to_vec())
}

/// The state after 60 steps, and how many splats each decision left out.
fn trained(method: &str, over: &str) -> (Checkpoint, Vec<u64>) {
    let (registry, data) = (registry(), scene("balls", 32, 7));
    let mut trainer = start(&registry, &data, method, &short(&registry, method, &[over]), 3);
    let log = run(&mut trainer, 60).into_iter().flat_map(|report| report.events);
    let counts = log.map(|line| line["still"].as_u64().expect("a number")).collect();
    (trainer.state(), counts)
}

fn tensor<'a>(state: &'a Checkpoint, name: &str) -> &'a [f32] {
    state.tensors.iter().find(|(n, _)| n == name).map(|(_, values)| &values[..]).expect("tensor")
}

#[test]
fn where_no_splat_is_still_the_run_is_the_same_to_the_bit() {
    for method in ["defgs", "fourdgs"] {
        let (plain, none) = trained(method, "");
        assert!(none.is_empty(), "{method}: the tiny preset leaves out none");
        let (other, counts) = trained(method, "still = { pixels = 1e-20, shape = 0.0, every = 5, from = 0.4 }");
        assert!(!counts.is_empty() && counts.iter().all(|n| *n == 0), "{method}: {counts:?}");
        for (name, values) in &plain.tensors {
            assert_eq!(values, tensor(&other, name), "{method}: {name}");
        }
    }
}

#[test]
fn a_wider_tolerance_leaves_out_more_splats() {
    for method in ["defgs", "fourdgs", "fags"] {
        let left_out = |pixels: f32| {
            let over = format!("still = {{ pixels = {pixels}, shape = {pixels}, every = 5, from = 0.4 }}");
            trained(method, &over).1.into_iter().sum::<u64>()
        };
        let counts = [0.02, 0.2, 1e3].map(left_out);
        assert!(counts.is_sorted() && counts[0] < counts[2], "{method}: {counts:?}");
    }
}

/// A run with still splats is saved, resumed, and shared by threads and ranks to the bit.
#[test]
fn a_run_with_still_splats_keeps_what_every_run_keeps() {
    let (registry, data) = (registry(), scene("balls", 32, 7));
    let stages = [
        ("defgs", "{ warm_up.steps = 10, follow.steps = 0, dynamic.steps = 50 }"),
        ("fourdgs", "{ coarse.steps = 10, fine.steps = 50 }"),
        ("fags", "{ warm_up.steps = 10, dynamic.steps = 50 }"),
    ];
    for (method, stages) in stages {
        let over = "still = { pixels = 5.0, shape = 5.0, every = 7, turn = 3, from = 0.2, until = 1.0 }";
        let config = short(&registry, method, &[over, &format!("schedule.stages = {stages}")]);
        // What the check of states saves half-way lies between two decisions.
        let mut trainer = start(&registry, &data, method, &config, 3);
        let log = run(&mut trainer, 30).into_iter().flat_map(|report| report.events).collect::<Vec<_>>();
        assert!(log.iter().any(|line| line["still"].as_u64() > Some(0)), "{method}: some rest");
        assert!(tensor(&trainer.state(), "still.loss").iter().any(|v| *v > 0.0), "{method}: and are watched");
        let subject = Subject::new(&registry, method, &data, &config);
        let checks = [Subject::rows, Subject::times, Subject::state, Subject::threads, Subject::ranks];
        checks.iter().try_for_each(|check| check(&subject)).expect(method);
    }
}
