//! Experiments about filmed people, each at its smallest.

use crate::support::{good, gs4d, text};
use serde_json::Value;
use std::path::Path;

const SMALL: [&str; 8] = ["--film-frames", "4", "--frames", "2", "--texels", "64", "--quiet", "--json"];
/// Pixels that textures need.
const LARGE: [&str; 2] = ["--size", "96"];
/// The smallest that learns something.
const LEARN: [&str; 12] = [
    "--size",
    "48",
    "--preset",
    "direct",
    "--steps",
    "12",
    "--set",
    "textures.unproject=48",
    "--set",
    "textures.geo=32",
    "--set",
    "textures.gau=48",
];

/// Rows of an experiment, whose files must be there.
fn rows(name: &str, dir: &Path, more: &[&str]) -> Vec<Value> {
    let out = dir.join(name);
    let found = good(&[&["lab", name, "-o", text(&out)][..], &SMALL, more].concat()).json();
    for kind in ["json", "csv", "md"] {
        assert!(out.join(format!("{name}.{kind}")).is_file(), "{name}.{kind}");
    }
    let rows = found["rows"].as_array().unwrap().clone();
    let csv = std::fs::read_to_string(out.join(format!("{name}.csv"))).unwrap();
    assert_eq!(csv.lines().count(), rows.len() + 1, "{csv}");
    rows
}

fn number(row: &Value, column: &str) -> f64 {
    row[column].as_f64().unwrap_or_else(|| panic!("no {column} in {row}"))
}

#[test]
fn textures_need_no_training() {
    let dir = tempfile::tempdir().unwrap();
    let tex = rows("tex", dir.path(), &[&LARGE[..], &["--sizes", "32,64"]].concat());
    assert_eq!(tex.len(), 2);
    assert!(number(&tex[0], "texels") * 3.0 < number(&tex[1], "texels"));
    assert!(tex.iter().all(|r| number(r, "texture dB") > 15.0 && number(r, "seen %") > 30.0), "{tex:?}");
    assert!(dir.path().join("tex/tex.svg").is_file());
    gs4d(&["lab", "tex", "-o", text(&dir.path().join("tex"))]).fails(6, &["tex-time.svg", "exists already", "-f"]);
}

#[test]
fn visibility_is_measured_against_rays() {
    let dir = tempfile::tempdir().unwrap();
    let vis = rows("vis", dir.path(), &LARGE);
    let of = |name: &str| vis.iter().find(|r| r["rule"] == name).unwrap();
    assert_eq!(vis.len(), 12);
    assert!(number(of("neighbours"), "texture dB") > number(of("four_tap"), "texture dB") + 1.0, "{vis:?}");
    assert_eq!(number(of("ray"), "false visible %") + number(of("ray"), "false hidden %"), 0.0);
    assert!(number(of("ray_footprint"), "false visible %") == 0.0);
    assert!(number(of("ray_footprint"), "texture dB") > number(of("ray"), "texture dB"));
    let grid = rows("thresholds", dir.path(), &LARGE);
    assert_eq!(grid.len(), 20);
    // A stricter gate on the angle sees less, a larger tolerance more.
    assert!(number(&grid[15], "seen %") > number(&grid[19], "seen %"));
    assert!(number(&grid[15], "seen %") > number(&grid[0], "seen %"));
}

#[test]
fn wrong_poses_and_fewer_views_cost() {
    let dir = tempfile::tempdir().unwrap();
    let motion = rows("motion", dir.path(), &LARGE);
    assert_eq!(motion.iter().filter(|r| r["mode"] == "ramp").count(), 2);
    assert!(number(&motion[0], "1st texture dB") > number(&motion[6], "1st texture dB"), "{motion:?}");
    assert_eq!(number(&motion[6], "angle deg"), number(&motion[8], "angle deg"), "the ramp ends at the largest");
    let mocap = rows("mocap", dir.path(), &LARGE);
    assert!(number(&mocap[0], "1st texture dB") > number(&mocap[5], "1st texture dB") + 1.0, "{mocap:?}");
    let views = rows("views", dir.path(), &LARGE);
    let seen = |n: usize| number(&views[n], "seen %");
    assert!(views.len() == 10 && (1..6).all(|n| seen(n) > seen(n - 1)), "{views:?}");
    assert!(seen(6) < seen(3), "one left out");
}

#[test]
fn methods_are_trained_for_what_needs_them() {
    let dir = tempfile::tempdir().unwrap();
    let ood = rows("ood", dir.path(), &LEARN);
    assert!(ood.iter().all(|r| number(r, "in-mask PSNR") > 8.0), "{ood:?}");
    assert_eq!(ood[ood.len() - 1]["motion"], "not learnt: wave");
    let light = rows("light", dir.path(), &[&LEARN[..], &["--tuning", "5"]].concat());
    assert_eq!((light.len(), number(&light[8], "steps under it")), (9, 5.0));
    assert_eq!(light[3]["light"], "other, colours varied in training");
    assert_eq!(light[7]["light"], "other, light followed");
    let parts = rows("ablate", dir.path(), &LEARN);
    assert!(parts.len() == 7 && number(&parts[0], "dB") == 0.0, "{parts:?}");
    gs4d(&["lab", "ood", "-o", text(&dir.path().join("x"))]).fails(2, &["ood", "--run", "--steps"]);
}

#[test]
fn a_run_brings_its_film() {
    let dir = tempfile::tempdir().unwrap();
    let (film, run) = (dir.path().join("film"), dir.path().join("run"));
    let small = ["--cams", "8x1", "--frames", "4", "--size", "48", "--points", "300", "--test-every", "2"];
    good(&[&["synth", "avatar", "-o", text(&film)][..], &small].concat());
    let sets: Vec<&str> = LEARN[6..].to_vec();
    let train = ["train", text(&film), "-m", "dut", "--preset", "direct", "--steps", "12", "-o", text(&run), "--quiet"];
    good(&[&train[..], &sets].concat());
    let from = ["--frames", "2", "--texels", "48", "--run", text(&run), "--json", "--quiet"];
    for (name, count) in [("motion", 9), ("ood", 2)] {
        let out = dir.path().join(name);
        let found = good(&[&["lab", name, "-o", text(&out)][..], &from].concat()).json();
        let rows = found["rows"].as_array().unwrap();
        assert!(rows.len() == count && rows.iter().all(|r| number(r, "in-mask PSNR") > 8.0), "{name}: {rows:?}");
    }
    let stages = ["--frames", "3", "--warm-up", "1", "--repeats", "2", "--size", "32", "--threads", "2", "--quiet"];
    let times = good(&[&["bench", text(&run), "--json"][..], &stages].concat()).json();
    for (times, threads) in times["times"].as_array().unwrap().iter().zip([1.0, 2.0]) {
        assert_eq!((number(times, "threads"), number(times, "frames")), (threads, 6.0));
        let stages = times["stages"].as_array().unwrap();
        assert_eq!(stages.len(), 6);
        let ms = |stage: &Value, what: &str| number(&stage[what], "mean");
        let sum: f64 = stages.iter().map(|s| ms(s, "ms")).sum();
        assert!((sum / ms(&stages[5], "accumulated") - 1.0).abs() < 1e-9 && ms(&stages[1], "ms") > 0.0, "{stages:?}");
    }
    let table = good(&[&["bench", text(&run)][..], &stages].concat()).out;
    assert!(table.contains("second texture") && table.contains("frames a second"), "{table}");
    gs4d(&["bench", text(dir.path())]).fails(3, &["no run folder"]);
    // The same film, as if it arrived now.
    let live = ["live", text(&run), text(&film), "--port", "18500"];
    let call = good(&[&live[..], &["--film-poses", "--frames", "1", "--json"]].concat());
    let shown = call.json();
    assert_eq!((shown["frames"].as_u64(), shown["passed_over"].as_u64()), (Some(1), Some(3)));
    assert!(number(&shown["latency_ms"], "splats") > 0.0 && call.err.contains("frame 3: "), "{shown} {}", call.err);
    let none = good(&[&live[..], &["--seconds", "0", "--json"]].concat()).json();
    assert_eq!((none["frames"].as_u64(), &none["latency_ms"]["median"]), (Some(0), &Value::Null));
    gs4d(&["live", text(&run), "no-such-folder"]).fails(3, &["no-such-folder"]);
    gs4d(&["live", text(crate::support::run()), text(&film)]).fails(2, &["fourdgs", "-m dut"]);
}

#[test]
fn wrong_words_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("x");
    let lab = |more: &[&str]| gs4d(&[&["lab"][..], more, &["-o", text(&out)]].concat());
    lab(&["topology"]).fails(2, &["topology", "motion, mocap"]);
    lab(&["motion", "--joint", "tail", "--film-frames", "2", "--size", "24", "-q"])
        .fails(2, &["tail", "left fore arm"]);
    lab(&["vis", "--run", text(dir.path())]).fails(3, &["no run folder"]);
    gs4d(&["lab", "vis"]).fails(2, &["-o DIR"]);
    let list = good(&["lab"]).out;
    assert!(list.lines().count() == 11 && list.contains("thresholds"), "{list}");
    assert!(!out.exists(), "nothing was written");
}
