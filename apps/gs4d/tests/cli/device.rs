//! `--device`, with and without GPU support.

use crate::support::{STEPS, data, gs4d, text};
use std::fs;
#[cfg(feature = "gpu")]
use {
    crate::runs::state,
    crate::support::good,
    gs_core::io::{Limits, images::load_image},
};
#[cfg(not(feature = "gpu"))]
use {
    crate::support::{CAMERA, Call, command, good, ply, run},
    std::path::Path,
};

#[cfg(not(feature = "gpu"))]
const REFUSED: [&str; 3] =
    ["error[device]", "built without GPU support", "cargo install --path apps/gs4d --features gpu"];

/// A call of every verb that renders on a device, which writes to a folder.
#[cfg(not(feature = "gpu"))]
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

#[cfg(not(feature = "gpu"))]
fn on(device: &str, call: &[String]) -> Call {
    Call::of(&command(&[]).args(call).args(["--device", device]).output().unwrap())
}

#[cfg(not(feature = "gpu"))]
#[test]
fn a_gpu_is_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    for call in calls(dir.path()) {
        on("gpu", &call).fails(2, &REFUSED);
        on("abacus", &call).fails(2, &["abacus", "cpu, gpu, auto"]);
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "the camera alone");
}

#[cfg(not(feature = "gpu"))]
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

/// Trained and rendered twice on whatever adapter there is; the CPU renders the same scene within a level or two.
#[cfg(feature = "gpu")]
#[test]
fn a_gpu_trains_the_same_bits_twice() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    // Few splats, with one pass of density control.
    let few =
        ["--set", "init.points=150", "--set", "schedule.density.max_splats=300", "--set", "schedule.density.until=15"];
    let steps = ["--preset", "tiny", "--steps", "24", "--seed", "3", "--device", "gpu"];
    for name in ["a", "b"] {
        let out = path(name);
        let train = ["train", text(data()), "-m", "fourdgs", "-o", text(&out)];
        let call = gs4d(&[&train[..], &steps, &few].concat());
        if call.err.contains("no GPU was found") && std::env::var_os("GS4D_REQUIRE_GPU").is_none() {
            return println!("SKIPPED a_gpu_trains_the_same_bits_twice: {}", call.err);
        }
        assert!(call.code == 0 && call.err.contains("training on "), "{}", call.err);
    }
    assert!(state(&path("a")) == state(&path("b")), "24 steps twice differ");
    let provenance = fs::read_to_string(path("a").join("provenance.json")).unwrap();
    let provenance: serde_json::Value = serde_json::from_str(&provenance).unwrap();
    assert!(provenance["machine"]["device"].as_str().is_some_and(|d| d.contains('(')), "{provenance}");
    let cameras = data().join("transforms_test.json");
    for device in ["gpu", "cpu"] {
        let out = path(device);
        good(&["render", text(&path("a")), "--camera", text(&cameras), "-o", text(&out), "--device", device]);
    }
    let mut compared = 0;
    for file in fs::read_dir(path("gpu")).unwrap().map(|e| e.unwrap().path()) {
        if file.extension().is_some_and(|e| e == "png") {
            let other = path("cpu").join(file.file_name().unwrap());
            let [a, b] = [&file, &other].map(|p| load_image(p, &Limits::default()).unwrap());
            assert!(a.data.iter().zip(&b.data).all(|(a, b)| (a - b).abs() < 2.5 / 255.0), "{}", file.display());
            compared += 1;
        }
    }
    assert!(compared > 0, "nothing was rendered");
}
