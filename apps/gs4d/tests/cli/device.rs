//! `--device` of a program without GPU support.

use crate::support::{CAMERA, Call, STEPS, command, data, good, gs4d, ply, run, text};
use std::fs;
use std::path::Path;

const REFUSED: [&str; 3] =
    ["error[device]", "built without GPU support", "cargo install --path apps/gs4d --features gpu"];

/// A call of every verb that renders on a device, which writes to a folder.
fn calls(out: &Path) -> Vec<Vec<String>> {
    let (camera, out) = (out.join("camera.json"), |name: &str| text(&out.join(name)).to_owned());
    fs::write(&camera, CAMERA).unwrap();
    let words = |line: &[&str]| line.iter().map(|w| (*w).to_owned()).collect::<Vec<_>>();
    vec![
        words(&["demo", "-o", &out("demo")]),
        words(&["train", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", "2", "-o", &out("run")]),
        words(&["resume", text(run())]),
        words(&["eval", text(run())]),
        words(&["render", text(ply()), "--camera", text(&camera), "-o", &out("frames")]),
        words(&["view", text(run()), "--seconds", "0", "--port", "0"]),
    ]
}

fn on(device: &str, call: &[String]) -> Call {
    Call::of(&command(&[]).args(call).args(["--device", device]).output().unwrap())
}

#[test]
fn a_gpu_is_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    for call in calls(dir.path()) {
        on("gpu", &call).fails(2, &REFUSED);
        on("abacus", &call).fails(2, &["abacus", "cpu, gpu, auto"]);
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "the camera alone");
}

#[test]
fn auto_is_the_cpu_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let said = "rendering on the CPU: this gs4d was built without GPU support";
    for call in calls(dir.path()).into_iter().filter(|c| c[0] != "demo" && c[0] != "resume") {
        let auto = on("auto", &call);
        assert_eq!((auto.code, auto.err.matches(said).count()), (0, 1), "{call:?}: {}", auto.err);
    }
    let (frame, again) = (dir.path().join("frames/front.png"), dir.path().join("again"));
    let camera = dir.path().join("camera.json");
    let silent =
        good(&["render", text(ply()), "--camera", text(&camera), "-o", text(&again), "--device", "auto", "-q"]);
    assert!(!silent.err.contains(said), "{}", silent.err);
    let cpu = dir.path().join("cpu");
    good(&["render", text(ply()), "--camera", text(&camera), "-o", text(&cpu), "--device", "cpu"]);
    let bytes = |path: &Path| fs::read(path).unwrap();
    assert!(bytes(&frame) == bytes(&again.join("front.png")) && bytes(&frame) == bytes(&cpu.join("front.png")));
    let provenance = fs::read_to_string(dir.path().join("run/provenance.json")).unwrap();
    let provenance: serde_json::Value = serde_json::from_str(&provenance).unwrap();
    assert_eq!(provenance["machine"]["device"], "cpu");
}

/// A run of an older version, whose provenance names no device, was rendered on the CPU.
#[test]
fn a_run_without_a_device_is_of_the_cpu() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    crate::support::train(data(), &run, &[]);
    let file = run.join("provenance.json");
    let mut provenance: serde_json::Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    provenance["machine"].as_object_mut().unwrap().remove("device");
    fs::write(&file, provenance.to_string()).unwrap();
    let resumed = gs4d(&["resume", text(&run), "--steps", &(STEPS + 1).to_string()]);
    assert!(resumed.code == 0 && !resumed.err.contains("warning"), "{}", resumed.err);
    let provenance: serde_json::Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    assert_eq!(provenance["resumed"][0]["machine"]["device"], "cpu");
}
