//! Checkpoints in real folders: names, the newest that verifies, refusals of the file system.

use gs_core::io::IoError;
use gs_core::testkit::faults::{Fault, Faults, with_faults};
use gs_train::checkpoint::{Checkpoint, CheckpointError, file_name, load_newest, steps_in};
use serde_json::json;
use std::fs;

fn state(step: u32) -> Checkpoint {
    Checkpoint { meta: json!({ "step": step }), tensors: vec![("x".into(), vec![step as f32; 100])] }
}

fn names(dir: &std::path::Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn keeps_two_and_points_at_the_latest() {
    let dir = tempfile::tempdir().unwrap();
    for step in [500, 1000, 12_000, 1_234_567] {
        state(step).save_step(dir.path(), step).unwrap();
    }
    assert_eq!(names(dir.path()), ["latest", "step-012000.gs4d", "step-1234567.gs4d"]);
    let newest = load_newest(dir.path()).unwrap();
    assert_eq!(newest.checkpoint, state(1_234_567));
    assert!(newest.skipped.is_empty());
    assert_eq!(Checkpoint::load(&dir.path().join("latest")).unwrap(), state(1_234_567));
}

#[test]
fn skips_what_does_not_verify_and_says_why() {
    let dir = tempfile::tempdir().unwrap();
    state(1).save_step(dir.path(), 1).unwrap();
    let second = state(2).save_step(dir.path(), 2).unwrap();
    let mut bytes = fs::read(&second).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(&second, &bytes).unwrap();
    fs::write(dir.path().join(file_name(3)), b"").unwrap();
    let newest = load_newest(dir.path()).unwrap();
    assert_eq!(newest.checkpoint, state(1));
    let why: Vec<_> = newest.skipped.iter().map(|s| s.why.as_str()).collect();
    assert!(why[0].contains("step-000003.gs4d is damaged at byte 0"), "{why:?}");
    assert!(why[1].contains("step-000002.gs4d") && why[1].contains("tensor `x` does not match its checksum"));
    // A run that goes on from step 1 keeps it until a newer good state is safe, and never counts the damaged ones.
    state(2).save_step(dir.path(), 2).unwrap();
    assert_eq!(steps_in(dir.path()).unwrap(), [3, 2, 1]);
    fs::remove_file(dir.path().join(file_name(1))).unwrap();
    fs::remove_file(dir.path().join(file_name(2))).unwrap();
    let error = load_newest(dir.path()).unwrap_err();
    assert!(matches!(&error, CheckpointError::NoneUsable { skipped, .. } if skipped.len() == 1), "{error}");
}

#[test]
fn foreign_names_are_not_checkpoints() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["step-1.gs4d", "step-000001.gs4d.tmp", "step--00001.gs4d", "step-000001.ply", "notes.txt"] {
        fs::write(dir.path().join(name), b"x").unwrap();
    }
    assert!(steps_in(dir.path()).unwrap().is_empty());
}

#[test]
fn refusals_leave_the_older_state() {
    let dir = tempfile::tempdir().unwrap();
    let error = state(1).save(&dir.path().join("no/such/folder.gs4d")).unwrap_err();
    assert!(error.to_string().contains("cannot create"), "{error}");
    // A folder stands where the file should go: the rename fails, and no temporary file stays behind.
    fs::create_dir(dir.path().join("taken.gs4d")).unwrap();
    fs::write(dir.path().join("taken.gs4d/keep"), b"x").unwrap();
    let error = state(1).save(&dir.path().join("taken.gs4d")).unwrap_err();
    assert!(error.to_string().contains("taken.gs4d: cannot rename"), "{error}");
    assert_eq!(names(dir.path()), ["taken.gs4d"]);
    let missing = Checkpoint::load(&dir.path().join("gone.gs4d")).unwrap_err();
    assert!(missing.to_string().starts_with("cannot open"), "{missing}");
}

#[test]
fn whichever_operation_fails_an_older_step_or_the_newer_is_the_newest() {
    let fresh = || {
        let dir = tempfile::tempdir().unwrap();
        (1..=2).for_each(|step| drop(state(step).save_step(dir.path(), step).unwrap()));
        dir
    };
    let (saved, operations) = {
        let dir = fresh();
        with_faults(None, || state(3).save_step(dir.path(), 3))
    };
    saved.unwrap();
    assert_eq!(operations, 8, "create, write, flush, rename, flush of the folder; link, rename; removal");
    for first in 1..=operations {
        let dir = fresh();
        let faults = Faults { first, count: 1, kind: Fault::Device };
        let error = with_faults(Some(faults), || state(3).save_step(dir.path(), 3)).0.unwrap_err();
        assert!(error.to_string().contains("cannot "), "{first}: {error}");
        let newest = load_newest(dir.path()).unwrap();
        assert!(newest.skipped.is_empty());
        assert_eq!(newest.checkpoint, state(if first <= 4 { 2 } else { 3 }), "{first}");
        assert!(names(dir.path()).iter().all(|n| !n.ends_with(".tmp")), "{first}: {:?}", names(dir.path()));
    }
}

#[test]
fn a_full_disk_is_reported_with_the_bytes_needed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.gs4d");
    state(5).save(&path).unwrap();
    let bytes = fs::metadata(&path).unwrap().len();
    let full = Faults { first: 1, count: 100, kind: Fault::Full };
    for first in [2, 3] {
        let error = with_faults(Some(Faults { first, ..full }), || state(6).save(&path)).0.unwrap_err();
        let CheckpointError::Write(full) = &error else { panic!("{error}") };
        assert!(matches!(**full, IoError::Full { needed, .. } if needed == bytes), "{error}");
        assert!(error.to_string().starts_with("cannot write"), "{error}");
        assert_eq!(Checkpoint::load(&path).unwrap(), state(5));
    }
}

#[test]
fn writers_of_one_file_at_once_leave_a_file_that_verifies() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.gs4d");
    std::thread::scope(|scope| {
        for step in 1..=3 {
            let path = &path;
            scope.spawn(move || (0..50).for_each(|_| state(step).save(path).unwrap()));
        }
    });
    let left = Checkpoint::load(&path).unwrap();
    assert!((1..=3).any(|step| left == state(step)));
    assert_eq!(names(dir.path()), ["scene.gs4d"]);
}
