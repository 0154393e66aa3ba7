//! Sweeps: one setting at a time, kept trials, table, CSV and page.

use crate::support::{data, good, gs4d, text};
use std::fs;

#[test]
fn a_sweep_varies_one_setting_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("sweep");
    let base = ["sweep", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", "8", "-o", text(&root)];
    let vary = ["--vary", "init.points=200|400", "--vary", "schedule.lambda_dssim=0"];
    let rows = good(&[&base[..], &vary, &["--json"]].concat()).json()["rows"].as_array().unwrap().clone();
    assert_eq!(rows.len(), 4);
    assert!(rows[0]["key"].is_null() && rows[1]["value"] == "200" && rows[3]["key"] == "schedule.lambda_dssim");
    assert!(rows[1]["megabytes"].as_f64() < rows[2]["megabytes"].as_f64());
    assert!(rows.iter().all(|r| r["psnr"].as_f64().unwrap() > 5.0 && r["steps"] == 8), "{rows:?}");
    let csv = fs::read_to_string(root.join("sweep.csv")).unwrap();
    assert!(csv.starts_with("setting,psnr") && csv.lines().count() == 5, "{csv}");
    assert!(fs::read_to_string(root.join("sweep.html")).unwrap().contains("<svg"));
    assert!(root.join("sweep.json").is_file() && root.join("static3d/seed-0/metrics.json").is_file());
    let files = || ["sweep.json", "sweep.csv", "sweep.html"].map(|name| fs::read(root.join(name)).unwrap());
    let before = files();
    let other = gs4d(&[&base[..], &vary, &["--set", "run.log_every=3"]].concat());
    assert!(other.code == 6 && other.out.is_empty() && files() == before, "{}{}", other.out, other.err);
    let again = good(&[&base[..], &vary].concat());
    assert!(!again.err.contains("seed-0") && again.out.contains("init.points=400"), "{}{}", again.err, again.out);
}

#[test]
fn bad_sweeps_are_refused_before_anything_is_trained() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("sweep");
    let with = |vary: &str| gs4d(&["sweep", text(data()), "-m", "static3d", "-o", text(&root), "--vary", vary]);
    with("init.points").fails(2, &["KEY=A|B|C"]);
    with("init.points=1|1").fails(2, &["given twice"]);
    with("no.such=1").fails(2, &["no.such"]);
    gs4d(&["sweep", text(data()), "-m", "static3d", "-o", text(&root)]).fails(2, &["--vary"]);
    let vary = ["--vary", "init.points=50|60", "--seeds", "3,3"];
    gs4d(&[&["sweep", text(data()), "-m", "static3d", "-o", text(&root)][..], &vary].concat())
        .fails(2, &["seed 3 is given twice"]);
    assert!(!root.exists());
}
