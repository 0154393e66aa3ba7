//! Checkpoints in real folders: names, the newest that verifies, refusals of the file system.

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
    assert!(error.to_string().starts_with("cannot create"), "{error}");
    // A folder stands where the file should go: the rename fails, and no temporary file stays behind.
    fs::create_dir(dir.path().join("taken.gs4d")).unwrap();
    fs::write(dir.path().join("taken.gs4d/keep"), b"x").unwrap();
    let error = state(1).save(&dir.path().join("taken.gs4d")).unwrap_err();
    assert!(error.to_string().starts_with("cannot put in place"), "{error}");
    assert_eq!(names(dir.path()), ["taken.gs4d"]);
    // The temporary name is taken by a folder: nothing can be written, the older file stays good.
    let path = dir.path().join("run.gs4d");
    state(5).save(&path).unwrap();
    fs::create_dir(dir.path().join("run.gs4d.tmp")).unwrap();
    assert!(state(6).save(&path).is_err());
    assert_eq!(Checkpoint::load(&path).unwrap(), state(5));
    let missing = Checkpoint::load(&dir.path().join("gone.gs4d")).unwrap_err();
    assert!(missing.to_string().starts_with("cannot open"), "{missing}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.gs4d");
    state(5).save(&path).unwrap();
    std::os::unix::fs::symlink("/dev/full", dir.path().join("run.gs4d.tmp")).unwrap();
    let error = state(6).save(&path).unwrap_err();
    assert!(error.to_string().starts_with("cannot write"), "{error}");
    assert_eq!(Checkpoint::load(&path).unwrap(), state(5));
}
