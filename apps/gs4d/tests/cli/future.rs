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
