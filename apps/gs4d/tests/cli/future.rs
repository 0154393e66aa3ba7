//! The future: views beyond the last training time.

use crate::support::{Call, data, good, gs4d, text, train};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// A run that has seen three quarters of the sequence.
fn run() -> &'static Path {
    static RUN: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, run) = RUN.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("run");
        train(data(), &run, &["--set", "data.time_boundary=0.75"]);
        (dir, run)
    });
    run
}

fn file(name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(run().join(name)).unwrap()).unwrap()
}

#[test]
fn the_future_is_scored_beside_the_test_views() {
    let kept = file("metrics.json");
    let future = &kept["extrapolate"];
    assert_eq!((&kept["split"], &future["split"]), (&"test".into(), &"extrapolate".into()));
    let views = future["views"].as_array().unwrap();
    assert!(views.iter().all(|v| v["time"].as_f64().unwrap() > 0.75) && views.len() >= 2, "{views:?}");
    let asked = good(&["eval", text(run()), "--split", "extrapolate", "--json"]).json();
    assert_eq!(asked["mean"]["psnr"], future["mean"]["psnr"]);
    assert_eq!(file("metrics.json"), kept, "only the test split is kept in the folder");
    let both = good(&["eval", text(run())]);
    assert!(both.out.contains("test · ") && both.out.contains("extrapolate · "), "{}", both.out);
    assert_eq!(file("metrics.json")["extrapolate"]["mean"], future["mean"]);
    let report = std::fs::read_to_string(run().join("report.html")).unwrap();
    assert!(report.contains("PSNR of the future") && report.contains("<h2>The future</h2>"));
    assert!(file("provenance.json")["data"]["extrapolate"].as_u64() == Some(views.len() as u64));
}

#[test]
fn a_contest_has_a_column_for_the_future() {
    let dir = tempfile::tempdir().unwrap();
    let contest = |folder: &str, more: &[&str]| -> Call {
        let root = dir.path().join(folder);
        let base = ["contest", text(data()), "--preset", "tiny", "-e", "static3d", "--steps", "4", "-o", text(&root)];
        good(&[&base[..], more].concat())
    };
    let with = contest("with", &["--set", "data.time_boundary=0.75"]);
    assert!(with.out.contains("ext dB"), "{}", with.out);
    assert!(!contest("without", &[]).out.contains("ext dB"));
}

#[test]
fn a_boundary_that_leaves_nothing_is_refused() {
    let none = run().join("none");
    let with = |b: &str| gs4d(&["train", text(data()), "-m", "static3d", "-o", text(&none), "--set", b]);
    with("data.time_boundary=1.5").fails(2, &["data.time_boundary = 1.5", "at most 1"]);
    gs4d(&["eval", text(crate::support::run()), "--split", "extrapolate"]).fails(3, &["no extrapolate views"]);
}

#[test]
fn frames_after_the_last_training_time_are_drawn_and_scored() {
    let out = run().join("forecast");
    let call = good(&["forecast", text(run()), "--until", "1", "-o", text(&out), "--json"]);
    let json = call.json();
    let frames = json["frames"].as_array().unwrap();
    let last = json["last_training_time"].as_f64().unwrap();
    assert!((0.6..=0.75).contains(&last) && frames.len() >= 2, "{json}");
    let mut before = last;
    for frame in frames {
        let t = frame["time"].as_f64().unwrap();
        assert!(t > before + 0.01 && t <= 1.01, "{t}");
        before = t;
        let file = frame["file"].as_str().unwrap();
        assert!(out.join(file).is_file() && file.contains(&format!("t{t:.4}")), "{file}");
        assert!(frame["render_ms"].as_f64().unwrap() > 0.0);
    }
    let truth = &json["truth"];
    assert_eq!(truth["mean"]["psnr"], file("metrics.json")["extrapolate"]["mean"]["psnr"]);
    let moments = truth["moments"].as_array().unwrap();
    assert!(moments.iter().all(|m| m["beyond"].as_f64().unwrap() > 0.0), "{moments:?}");
    // The first frame is taken by the camera and at the time of the first view of the future.
    let first = &file("metrics.json")["extrapolate"]["views"][0];
    assert_eq!((&frames[0]["view"], &frames[0]["psnr"]), (&first["name"], &first["psnr"]), "{frames:?}");
    let kept: Value = serde_json::from_slice(&std::fs::read(out.join("forecast.json")).unwrap()).unwrap();
    assert_eq!(kept["truth"], *truth);
    let page = std::fs::read_to_string(out.join("forecast.html")).unwrap();
    assert!(page.contains("<svg") && page.contains("data:image/png"));
    let again = gs4d(&["forecast", text(run()), "--until", "1", "-o", text(&out)]);
    again.fails(6, &["exists already", "-f"]);
}

#[test]
fn a_forecast_takes_other_cameras_and_paces() {
    let dir = tempfile::tempdir().unwrap();
    let (camera, out) = (dir.path().join("camera.json"), dir.path().join("out"));
    std::fs::write(&camera, crate::support::CAMERA).unwrap();
    let base = ["forecast", text(run()), "--until", "1.5", "-o", text(&out), "-f", "--no-scores"];
    for more in [&["--frames", "3", "--camera", "orbit"][..], &["--fps", "4", "--camera", text(&camera)]] {
        let call = good(&[&base[..], more].concat());
        assert!(call.out.contains(" frames after ") && call.out.contains("render "), "{}", call.out);
        assert!(!call.out.contains("PSNR") && !call.out.contains("learnt motion"), "fourdgs has no particles");
    }
    let with = |more: &[&str]| gs4d(&[&base[..], more].concat());
    with(&["--camera", "view:nobody"]).fails(3, &["no view is named", "nobody"]);
    with(&["--camera", "nowhere.json"]).fails(6, &["nowhere.json"]);
    with(&["--frames", "0"]).fails(2, &["not possible"]);
    with(&["--from", "2"]).fails(2, &["the end must be later"]);
}

#[test]
fn rounds_let_in_more_of_the_sequence() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let base =
        ["continual", text(data()), "-m", "defgs", "--preset", "tiny", "--steps-first", "4", "--steps-later", "2"];
    let call = good(&[&base[..], &["--rounds", "0.4,0.7", "--future", "0.3", "-o", text(&run), "--json"]].concat());
    let json = call.json();
    let rounds = json["rounds"].as_array().unwrap();
    assert_eq!((rounds.len(), &rounds[1]["steps"]), (2, &6.into()));
    assert!(rounds.iter().all(|r| r["extrapolation"]["psnr"].as_f64().unwrap() > 3.0), "{rounds:?}");
    let kept: Value = serde_json::from_slice(&std::fs::read(run.join("continual.json")).unwrap()).unwrap();
    assert_eq!(kept, json);
    good(&["eval", text(&run), "--split", "extrapolate"]);
    let frames = ["--frames-first", "4", "--frames-per-round", "2", "--score-next", "2", "-f", "-o", text(&run)];
    let call = good(&[&base[..], &frames].concat());
    assert!(call.out.contains("T_obs") && call.out.contains("mean over rounds"), "{}", call.out);
    let wrong = |more: &[&str]| gs4d(&[&base[..], more, &["-f", "-o", text(&run)]].concat());
    wrong(&["--rounds", "0.7,0.4"]).fails(2, &["must rise"]);
    wrong(&["--frames-first", "99"]).fails(2, &["the data have"]);
    wrong(&["--rounds", "0.5", "--frames-first", "3"]).fails(2, &["cannot be used with"]);
}
