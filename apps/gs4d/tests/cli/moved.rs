//! Scenes whose data moved, changed or never came along; checkpoints that do not verify or are of another method.

use crate::support::{CAMERA, data, good, gs4d, run, text, train};
use gs_train::checkpoint::Checkpoint;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// A generated data set of its own, and a run and a compact file of it.
fn own(dir: &Path) -> [PathBuf; 3] {
    let [data, run, compact] = ["data", "run", "scene.gs4d"].map(|name| dir.join(name));
    let views = ["--train-views", "6", "--val-views", "0", "--test-views", "2"];
    good(&[&["synth", "balls", "-o", text(&data), "--size", "32"][..], &views].concat());
    train(&data, &run, &[]);
    good(&["compact", text(&run), "-o", text(&compact), "--no-eval"]);
    [data, run, compact]
}

fn bytes(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

#[test]
fn a_scene_outlives_its_data() {
    let dir = tempfile::tempdir().unwrap();
    let [data, run, compact] = own(dir.path());
    let to = |name: &str| dir.path().join(name);
    let orbit = |scene: &Path, name: &str| {
        let out = to(name);
        good(&["render", text(scene), "--camera", "orbit", "--times", "0..1:2", "-o", text(&out)]);
        bytes(&out.join("orbit-0001.png"))
    };
    let export = |scene: &Path, name: &str| {
        let out = to(name);
        good(&["export", text(scene), "-o", text(&out), "--no-eval"]);
        bytes(&out)
    };
    let before = [orbit(&run, "a"), export(&run, "a.ply"), orbit(&compact, "b"), export(&compact, "b.ply")];
    let inside = bytes(&compact);
    let path = text(dir.path()).as_bytes();
    assert!(!inside.windows(path.len()).any(|w| w == path), "a compact file holds no path");
    let moved = to("moved");
    fs::rename(&data, &moved).unwrap();
    let after = [orbit(&run, "c"), export(&run, "c.ply"), orbit(&compact, "d"), export(&compact, "d.ply")];
    assert!(before == after, "the cameras that were kept give the same files");
    good(&["view", text(&compact), "--seconds", "0", "--port", "0", "--quiet"]);
    good(&["render", text(&compact), "--camera", "path", "--times", "0..1:2", "-o", text(&to("path"))]);
    let kept: Value = serde_json::from_slice(&bytes(&run.join("data.json"))).unwrap();
    assert_eq!(kept["splits"], serde_json::json!({"train": 6, "test": 2, "extrapolate": 0}));
    assert!(kept["times"].as_array().unwrap().len() == 6 && kept["held_out"].as_array().unwrap().len() == 2, "{kept}");
    // What needs the images says where to tell their place.
    for scene in [&run, &compact] {
        gs4d(&["eval", text(scene)]).fails(3, &["data.path", "--data DIR"]);
        gs4d(&["export", text(scene), "-o", text(&to("e.ply"))]).fails(3, &["--data DIR"]);
        assert!(!to("e.ply").exists());
    }
    gs4d(&["resume", text(&run), "--steps", "44"]).fails(3, &["data.path", "--data DIR"]);
    let scores = good(&["eval", text(&run), "--data", text(&moved), "--json"]).json();
    assert!(scores["mean"]["psnr"].is_f64());
    good(&["eval", text(&compact), "--data", text(&moved)]);
    gs4d(&["render", text(&run), "--camera", "orbit", "--data", text(&to("none")), "-o", text(&to("f"))])
        .fails(3, &["none"]);
    // The run keeps the place it was given.
    good(&["resume", text(&run), "--steps", "44", "--data", text(&moved), "--quiet"]);
    good(&["eval", text(&run)]);
}

#[test]
fn resuming_with_other_data_is_refused_or_kept_in_the_provenance() {
    let dir = tempfile::tempdir().unwrap();
    let [data, run, _] = own(dir.path());
    let resume =
        |steps: &str, more: &[&str]| gs4d(&[&["resume", text(&run), "--steps", steps, "--quiet"][..], more].concat());
    assert_eq!(resume("42", &[]).code, 0);
    fs::copy(data.join("train/r_000.png"), data.join("train/r_001.png")).unwrap();
    resume("44", &[]).fails(3, &["data.changed", "--accept-changed-data"]);
    // A session that cannot begin leaves no entry.
    let (json, before) = (data.join("transforms_train.json"), bytes(&run.join("provenance.json")));
    let views = bytes(&json);
    let mut fewer: Value = serde_json::from_slice(&views).unwrap();
    fewer["frames"].as_array_mut().unwrap().pop();
    fs::write(&json, fewer.to_string()).unwrap();
    resume("44", &["--accept-changed-data"]).fails(3, &["training views"]);
    assert_eq!(bytes(&run.join("provenance.json")), before);
    fs::write(&json, views).unwrap();
    assert_eq!(resume("44", &["--accept-changed-data"]).code, 0);
    assert_eq!(resume("46", &[]).code, 0, "the same data as the last time");
    // The same seconds at other normalised times are other data.
    let scene = data.join("scene.toml");
    let text_of = fs::read_to_string(&scene).unwrap_or_default();
    fs::write(&scene, format!("{text_of}\n[time]\nrange = \"0..2\"\n")).unwrap();
    resume("48", &[]).fails(3, &["data.changed"]);
    fs::write(&scene, text_of).unwrap();
    let provenance: Value = serde_json::from_slice(&bytes(&run.join("provenance.json"))).unwrap();
    let digests: Vec<&str> =
        provenance["resumed"].as_array().unwrap().iter().filter_map(|s| s["digest"].as_str()).collect();
    let first = provenance["data"]["digest"].as_str().unwrap();
    assert!(
        digests.len() == 3 && digests[0] == first && digests[1] != first && digests[2] == digests[1],
        "{provenance}"
    );
}

#[test]
fn another_instruction_set_is_said_on_resuming() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    train(data(), &run, &[]);
    let file = run.join("provenance.json");
    let mut provenance: Value = serde_json::from_slice(&bytes(&file)).unwrap();
    provenance["machine"]["simd"] = "four wide".into();
    fs::write(&file, provenance.to_string()).unwrap();
    let said = good(&["resume", text(&run), "--steps", "41"]).err;
    assert!(said.contains("trained with four wide") && said.contains("its bits are not"), "{said}");
}

/// A copy of the shared run whose newest checkpoint holds `bytes`; its older one is the shared run's.
fn with_newest(dir: &Path, bytes: &[u8]) -> PathBuf {
    let copy = dir.join("run");
    for folder in ["checkpoints", "renders"] {
        fs::create_dir_all(copy.join(folder)).unwrap();
    }
    for name in ["config.resolved.toml", "provenance.json", "data.json", "checkpoints/step-000040.gs4d"] {
        fs::copy(run().join(name), copy.join(name)).unwrap();
    }
    fs::write(copy.join("checkpoints/step-000050.gs4d"), bytes).unwrap();
    copy
}

#[test]
fn every_verb_says_that_it_uses_an_older_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let run = with_newest(dir.path(), b"");
    let camera = dir.path().join("camera.json");
    fs::write(&camera, CAMERA).unwrap();
    let out = |name: &str| text(&dir.path().join(name)).to_owned();
    let calls: [&[&str]; 9] = [
        &["inspect", text(&run)],
        &["eval", text(&run)],
        &["compact", text(&run), "-o", &out("a.gs4d"), "--no-eval"],
        &["export", text(&run), "-o", &out("a.ply"), "--no-eval"],
        &["render", text(&run), "--camera", text(&camera), "-o", &out("frames")],
        &["view", text(&run), "--seconds", "0", "--port", "0"],
        &["forecast", text(&run), "--until", "1.5", "-o", &out("future")],
        &["compare", text(&run), text(&run)],
        &["resume", text(&run), "--steps", "42"],
    ];
    for call in calls {
        let said = good(call).err;
        assert!(said.contains("an older checkpoint is used") && said.contains("step-000050"), "{call:?}: {said}");
    }
}

#[test]
fn a_checkpoint_of_another_method_is_refused_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let mut other = Checkpoint::load(&run().join("checkpoints/step-000040.gs4d")).unwrap();
    other.meta["method"] = "defgs".into();
    let file = dir.path().join("other.gs4d");
    other.save(&file).unwrap();
    let run = with_newest(dir.path(), &bytes(&file));
    for call in [&["eval", text(&run)][..], &["resume", text(&run), "--steps", "60"], &["inspect", text(&run)]] {
        let refused = gs4d(call);
        refused.fails(3, &["checkpoint.method", "is of method defgs; this run trains fourdgs"]);
        assert_eq!(refused.err.lines().count(), 2, "{}", refused.err);
    }
}
