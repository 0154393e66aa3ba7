//! Cameras and clocks that are learnt with the scene: films from disk share them, and every verb shows views with them.

use crate::support::{good, text};
use gs_core::Image;
use gs_core::io::{Limits, images, npy};
use gs_metrics::psnr;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// The PSNR of a held-out view as `gs4d render` draws it.
fn rendered(run: &Path, data: &Path, out: &Path) -> f64 {
    let call = ["render", text(run), "--camera", "dataset:0", "--format", "npy", "-o", text(out), "-f", "--json"];
    let file = good(&call).json()["files"][0].as_str().unwrap().to_owned();
    let array = npy::read(&fs::read(&file).unwrap(), "npy", &Limits::default()).unwrap();
    // Premultiplied, so over black.
    let data_of = |values: &[f32]| values.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect::<Vec<f32>>();
    let render = Image { width: 32, height: 32, channels: 3, data: data_of(&array.to_f32()) };
    let list: Value = serde_json::from_str(&fs::read_to_string(data.join("transforms_test.json")).unwrap()).unwrap();
    let name = list["frames"][0]["file_path"].as_str().unwrap();
    let truth = images::load_image(&data.join(format!("{name}.png")), &Limits::default()).unwrap();
    let over_black = |p: &[f32]| [0, 1, 2].map(|c| p[c] * p[3]);
    let data = truth.data.chunks_exact(4).flat_map(over_black).collect();
    psnr(&render, &Image { width: 32, height: 32, channels: 3, data }).unwrap()
}

#[test]
fn films_from_disk_share_corrections_and_views_are_shown_with_them() {
    let dir = tempfile::tempdir().unwrap();
    let [data, run, out] = ["data", "run", "out"].map(|name| dir.path().join(name));
    let film = ["--cameras", "3", "--held-out", "1", "--moments", "6", "--boundary", "1", "--size", "32"];
    good(&[&["synth", "sheet", "-o", text(&data)][..], &film].concat());
    let recipe = ["-m", "fourdgs", "--preset", "tiny", "--steps", "120", "--set", "schedule.background=black"];
    let learn = ["--set", "cameras.refine=true", "--set", "cameras.time=true", "--set", "cameras.after=0"];
    good(&[&["train", text(&data), "-o", text(&run)][..], &recipe, &learn].concat());
    let metrics: Value = serde_json::from_str(&fs::read_to_string(run.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(metrics["cameras"]["count"], 3, "a resting camera has one correction");
    assert!(metrics["cameras"]["time"].as_f64().unwrap() > 0.0, "its images have one clock");
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    let how = metrics["cameras"]["held_out"].as_str().unwrap();
    assert!(how.contains("held-out cameras that are not among them are placed anew"), "{how}");
    assert!(page.contains("Cameras: 3 corrections, ") && page.contains(how), "the page says it beside the scores");
    let scored = metrics["views"][0]["psnr"].as_f64().unwrap();
    let shown = rendered(&run, &data, &out);
    assert!((shown - scored).abs() < 0.01, "rendered as it was scored: {shown} {scored}");
    // A compact file holds the corrections: it opens, and is scored alike.
    let file = dir.path().join("small.gs4d");
    let psnr = &good(&["export", text(&run), "-o", text(&file), "--bits", "32", "--json"]).json()["psnr"];
    assert!(psnr["change"].as_f64().unwrap().abs() < 0.01, "{psnr}");
    // Where it stands is known from the scores.
    fs::remove_file(run.join("metrics.json")).unwrap();
    let given = rendered(&run, &data, &out);
    assert!((given - scored).abs() > 0.02, "the test would see it: {given} {scored}");
}
