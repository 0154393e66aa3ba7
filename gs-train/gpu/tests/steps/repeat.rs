//! Two runs on one adapter are the same bits, whether they were looked at and interrupted or not.

use super::{after, device, gpu, resume, start};
use gs_train::checkpoint::Checkpoint;
use gs_train::testkit;

#[test]
fn two_runs_are_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    // `fourdgs` is trained twice through the program (`a_gpu_trains_the_same_bits_twice`).
    for method in ["static3d", "defgs"] {
        let run = || start(method, &[]).on(&device(&gpu)).expect("a device");
        let first = after(run(), 50);

        // Looked at after every step, and interrupted in the warm-up and in the midst of growth.
        let mut state: Option<Checkpoint> = None;
        for steps in [17, 16, 17] {
            let mut other = state.map_or_else(run, |saved| resume(&saved, Some(&gpu)));
            for _ in 0..steps {
                testkit::run(&mut other, 1);
                other.fetch().expect("the state");
            }
            state = Some(after(other, 0));
        }
        assert!(state.is_some_and(|s| s.tensors == first.tensors), "{method}");
    }
}

#[test]
#[ignore = "minutes on a GPU in software: cargo test -p gs-train-gpu --test steps -- --ignored two_hundred"]
fn two_hundred_steps_are_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    for method in ["static3d", "fourdgs", "defgs"] {
        let run = || after(start(method, &[]).on(&device(&gpu)).expect("a device"), 200);
        assert!(run().tensors == run().tensors, "{method}");
    }
}

#[test]
fn a_run_goes_on_on_the_other_device() {
    let Some(gpu) = gpu() else { return };
    let there = after(start("fourdgs", &[]).on(&device(&gpu)).expect("a device"), 40);
    let back = resume(&there, None);
    let loss = |report: &gs_train::trainer::StepReport| report.loss.total;
    let on_host = testkit::run(&mut { back }, 1).remove(0);
    let on_gpu = testkit::run(&mut resume(&there, Some(&gpu)), 1).remove(0);
    assert!((loss(&on_host) - loss(&on_gpu)).abs() < 1e-5 * loss(&on_host), "{on_host:?}\n{on_gpu:?}");
}
