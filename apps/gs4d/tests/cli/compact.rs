//! `gs4d export -o NAME.gs4d` by its older name: a smaller file that draws and scores as the run does.

use crate::support::{CAMERA, data, good, gs4d, run, text};
use std::fs;
use std::path::Path;

fn compact(file: &Path, bits: &str, more: &[&str]) -> serde_json::Value {
    let all = ["compact", text(run()), "-o", text(file), "--bits", bits, "--json", "--quiet"];
    good(&[&all[..], more].concat()).json()
}

#[test]
fn fewer_bits_make_smaller_files_that_score_nearly_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let mut sizes = Vec::new();
    for (bits, allowed) in [("32", 1e-9), ("16", 0.05), ("8", 0.5)] {
        let file = dir.path().join(format!("{bits}.gs4d"));
        let json = compact(&file, bits, &[]);
        let change = json["psnr"]["change"].as_f64().unwrap();
        assert!(change.abs() <= allowed, "{bits} bits: {change} dB");
        sizes.push(json["file_bytes"].as_u64().unwrap());
        assert_eq!(fs::metadata(&file).unwrap().len(), sizes[sizes.len() - 1]);
        let scores = good(&["eval", text(&file), "--data", text(data()), "--json", "--quiet"]).json();
        assert_eq!(scores["mean"]["psnr"], json["psnr"]["after"]);
    }
    assert!(sizes[1] * 10 < sizes[0] * 7 && sizes[2] * 10 < sizes[1] * 8, "{sizes:?}");
}

#[test]
fn the_file_draws_and_is_described() {
    let dir = tempfile::tempdir().unwrap();
    let (file, camera, out) = (dir.path().join("s.gs4d"), dir.path().join("camera.json"), dir.path().join("out"));
    let json = compact(&file, "8", &["--no-eval", "--no-deflate"]);
    assert!(json["psnr"]["before"].is_null());
    fs::write(&camera, CAMERA).unwrap();
    let pictures = good(&["render", text(&file), "--camera", text(&camera), "-o", text(&out), "--json"]).json();
    assert_eq!(pictures["files"].as_array().unwrap().len(), 1);
    assert!(out.join("front.png").exists());
    let about = good(&["inspect", text(&file), "--json"]).json();
    assert_eq!(about["meta"]["packing"]["bits"], 8);
    let table = good(&["inspect", text(run())]).out;
    assert!(table.contains("storage") && table.contains("cloud.means"), "{table}");
}

#[test]
fn a_checkpoint_of_a_run_scores_as_the_run() {
    let newest = fs::read_dir(run().join("checkpoints")).unwrap().map(|e| e.unwrap().path());
    let newest = newest.filter(|p| p.extension().is_some_and(|e| e == "gs4d")).max().unwrap();
    let score = |path: &Path| good(&["eval", text(path), "--json", "--quiet"]).json()["mean"]["psnr"].clone();
    assert_eq!(score(&newest), score(run()));
    let dir = tempfile::tempdir().unwrap();
    let alone = dir.path().join("alone.gs4d");
    fs::copy(&newest, &alone).unwrap();
    gs4d(&["eval", text(&alone)]).fails(3, &["holds no settings", "gs4d export"]);
}

#[test]
fn what_is_there_or_damaged_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("s.gs4d");
    compact(&file, "16", &["--no-eval"]);
    let again = ["compact", text(run()), "-o", text(&file), "--no-eval"];
    gs4d(&again).fails(6, &["exists already", "-f"]);
    good(&[&again[..], &["-f"]].concat());
    gs4d(&["compact", text(run()), "-o", text(&dir.path().join("s.bin"))]).fails(2, &[".gs4d"]);
    let whole = fs::read(&file).unwrap();
    for cut in [0, 7, 20, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(&file, &whole[..cut]).unwrap();
        for verb in
            [&["eval", text(&file)][..], &["inspect", text(&file)], &["compact", text(&file), "-f", "-o", text(&file)]]
        {
            gs4d(verb).fails(3, &["damaged"]);
        }
        assert_eq!(fs::read(&file).unwrap().len(), cut, "nothing was written");
    }
}
