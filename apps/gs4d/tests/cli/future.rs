//! The future: views beyond the last training time.

use crate::support::{Call, command, data, good, gs4d, text, train};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A run that has seen three quarters of the sequence.
fn run() -> &'static Path {
    // A static is never dropped: its folder stays in that of the build.
    static RUN: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, run) = RUN.get_or_init(|| {
        let dir = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
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
    assert!(report.contains("PSNR, extrapolated") && report.contains("<h2>Extrapolated views</h2>"));
    assert!(report.contains("\ntraining times\n"), "a band in the chart over time");
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
    // Other frames would share the table and the page.
    let other = ["forecast", text(run()), "--until", "1.31", "--frames", "1", "--no-scores", "-o", text(&out)];
    for name in ["forecast.json", "forecast.html"] {
        gs4d(&other).fails(6, &["the file exists already", name, "-f"]);
        std::fs::remove_file(out.join(name)).unwrap();
    }
    good(&other);
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
        assert!(call.err.contains("lies outside training (0..") && call.err.contains("extrapolated"), "{}", call.err);
    }
    let with = |more: &[&str]| gs4d(&[&base[..], more].concat());
    with(&["--camera", "view:nobody"]).fails(3, &["no view is named", "nobody"]);
    with(&["--camera", "nowhere.json"]).fails(6, &["nowhere.json"]);
    with(&["--frames", "0"]).fails(2, &["--frames", "0 is not in"]);
    with(&["--fps", "0"]).fails(2, &["to 1.5 are not possible", "--fps"]);
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

/// The scores of all rounds, without the seconds.
fn scores(mut json: Value) -> Value {
    for round in json["rounds"].as_array_mut().unwrap() {
        round.as_object_mut().unwrap().remove("seconds");
    }
    json
}

#[test]
fn rounds_that_were_cut_off_go_on_with_the_same_command() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, cut] = ["whole", "cut"].map(|name| dir.path().join(name));
    let base = ["continual", text(data()), "-m", "defgs", "--preset", "tiny", "--steps-first", "4"];
    let later = ["--steps-later", "2", "--rounds", "0.4,0.7", "--future", "0.3", "--json", "-o"];
    let whole = good(&[&base[..], &later, &[text(&whole)]].concat()).json();
    let again = [&base[..], &later, &[text(&cut)]].concat();
    // In round 2, while its checkpoint is written.
    let killed = command(&[&again[..], &["-f"]].concat()).env("GS4D_FAIL_WRITE", "40:kill").output().unwrap();
    assert!(killed.status.code().is_none());
    let kept: Value = serde_json::from_slice(&std::fs::read(cut.join("continual.json")).unwrap()).unwrap();
    assert_eq!(kept["rounds"].as_array().unwrap().len(), 1);

    let refused = gs4d(&["resume", text(&cut)]);
    refused.fails(2, &[&format!("is trained in rounds: go on with `gs4d {}`", again.join(" "))]);
    assert_eq!(refused.err.trim().lines().count(), 1, "{}", refused.err);
    gs4d(&[&again[..], &["--score-views", "1"]].concat()).fails(6, &["holds a run with other settings", "-f"]);
    assert_eq!(scores(good(&again).json()), scores(whole.clone()));
    assert_eq!(scores(good(&again).json()), scores(whole), "once more changes nothing");
}

#[cfg(unix)]
#[test]
fn interrupted_rounds_name_the_command_that_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let base =
        ["continual", text(data()), "-m", "defgs", "--preset", "tiny", "--steps-first", "4000", "-o", text(&out)];
    let mut begun = command(&[&base[..], &["--force"]].concat());
    let mut child = begun.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let since = Instant::now();
    while std::fs::metadata(out.join("log.jsonl")).map_or(0, |m| m.len()) == 0 {
        assert!(child.try_wait().unwrap().is_none() && since.elapsed().as_secs() < 60, "training does not begin");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let call = Call::of(&child.wait_with_output().unwrap());
    let again = format!("gs4d {}", base.join(" "));
    assert_eq!(call.code, 130, "{}", call.err);
    assert!(call.err.trim().ends_with(&again), "{}", call.err);
}
