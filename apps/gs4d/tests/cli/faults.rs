//! A disk that fails at the k-th operation, for every k: the older files or the newer ones, never a mixture, never a panic.
//!
//! `cargo test --release -p gs4d --test cli faults -- --include-ignored` tries every operation of a training, too.

use crate::runs::state;
use crate::support::{Call, command, data, good, run, text, train};
use crate::whole::{assert_swept, assert_whole};
use gs_core::testkit::faults::VARIABLE;
use std::fs;
use std::path::Path;

/// What a call gives whose disk fails as `faults` says.
fn with_faults(arguments: &[&str], faults: &str) -> Call {
    Call::of(&command(arguments).env(VARIABLE, faults).output().unwrap())
}

/// Calls with the k-th operation failing in two ways, `step` operations apart, until a call has fewer operations; `before` each.
/// Whatever fails, files are whole, and the call without faults succeeds afterwards.
fn each(name: &str, arguments: &[&str], out: &Path, step: usize, before: impl Fn()) {
    for kind in ["full", "device"] {
        let mut failed = 0;
        for k in (1..).step_by(step) {
            before();
            let call = with_faults(arguments, &format!("{k}:{kind}"));
            let met = call.err.contains(VARIABLE);
            assert!(!call.err.contains("panicked"), "{name}, {kind} {k}: {}", call.err);
            assert!([0, 6].contains(&call.code), "{name}, {kind} {k}: {} {}", call.code, call.err);
            assert_whole(out, &format!("{name}, {kind} {k}"));
            failed += u32::from(call.code == 6);
            if !met {
                break;
            }
        }
        assert!(failed > 0, "{name}: {kind} was never met");
        good(arguments);
        assert_swept(out, name);
    }
}

#[test]
fn files_of_scenes() {
    let dir = tempfile::tempdir().unwrap();
    let out = |name: &str| text(&dir.path().join(name)).to_owned();
    each("compact", &["compact", text(run()), "-o", &out("a.gs4d"), "-f", "-q", "--no-eval"], dir.path(), 1, || ());
    let export = ["export", text(run()), "--times", "0..1:2", "-o", &out("plys"), "-f", "-q", "--no-eval"];
    each("export", &export, dir.path(), 1, || ());
}

/// Steps between the operations that fail in [`training`].
const STRIDE: usize = 31;

fn training(step: usize) {
    let dir = tempfile::tempdir().unwrap();
    let undisturbed = dir.path().join("undisturbed");
    let recipe = ["--set", "run.checkpoint_every=20", "--set", "run.log_every=20"];
    train(data(), &undisturbed, &recipe);
    let begun = dir.path().join("begun");
    let start = ["train", text(data()), "-m", "fourdgs", "--preset", "tiny", "--steps", "40", "-q", "-f"];
    each("train", &[&start[..], &recipe, &["-o", text(&begun)]].concat(), &begun, step, || ());
    assert_eq!(state(&begun).0, state(&undisturbed).0);
    let half = dir.path().join("half");
    let again = || {
        let _ = fs::remove_dir_all(&half);
        good(&[&start[..], &recipe, &["--time-budget", "0.001s", "-o", text(&half)]].concat());
    };
    each("resume", &["resume", text(&half), "-q"], &half, step, again);
    assert_eq!(state(&half).0, state(&undisturbed).0);
    let contest = dir.path().join("contest");
    let entries = ["-e", "static3d", "--preset", "tiny", "--steps", "10", "-q", "-o", text(&contest)];
    let clean = || drop(fs::remove_dir_all(&contest));
    each("contest", &[&["contest", text(data())][..], &entries].concat(), &contest, step, clean);
}

#[test]
fn some_operations_of_a_training() {
    training(STRIDE);
}

#[test]
#[ignore = "minutes: every operation"]
fn every_operation_of_a_training() {
    training(1);
}

#[test]
fn scores_that_cannot_be_kept_are_printed() {
    let call = with_faults(&["eval", text(run()), "--json"], "1:full");
    assert_eq!(call.code, 0, "{}", call.err);
    assert!(call.err.contains("the scores are not kept") && call.json()["mean"]["psnr"].is_f64(), "{}", call.err);
}
