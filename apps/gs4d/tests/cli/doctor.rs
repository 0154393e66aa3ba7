//! `gs4d doctor` and `gs4d init`: findings, exit codes, the page, points that later openings begin with.

use crate::support::{data, good, gs4d, text};
use std::path::Path;

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target)
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

#[test]
fn sound_data_have_a_page_and_a_price() {
    let dir = tempfile::tempdir().unwrap();
    let html = dir.path().join("doctor.html");
    let all = ["doctor", text(data()), "-m", "fourdgs", "--preset", "tiny", "-o", text(&html)];
    let call = good(&all);
    for word in ["layout ", "images ", "time ", "poses ", "init ", "bound ", "memory ", "duration ", "0 problems"] {
        assert!(call.out.contains(word), "{word} is not in {}", call.out);
    }
    assert!(std::fs::read_to_string(&html).unwrap().contains("<img"));
    gs4d(&all).fails(6, &["exists"]);
    let json = good(&[&all[..], &["-f", "--json"]].concat()).json();
    assert_eq!(json["checkup"]["layout"], "blender");
    assert!(json["checkup"]["cost"]["seconds"][1].as_f64().unwrap() > 0.0);
}

#[test]
fn faults_decide_the_exit_code() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, html) = (dir.path().join("data"), dir.path().join("doctor.html"));
    copy(data(), &folder);
    let all = ["doctor", text(&folder), "--no-cost", "-f", "-o", text(&html)];
    let first = folder.join("train/r_000.png");
    std::fs::copy(folder.join("train/r_001.png"), &first).unwrap();
    let call = good(&all);
    assert!(call.out.contains("warning[images.twice]"), "{}", call.out);
    let strict = gs4d(&[&all[..], &["--strict"]].concat());
    assert_eq!(strict.code, 7, "{}", strict.err);
    std::fs::remove_file(&first).unwrap();
    let call = gs4d(&all);
    assert!(
        call.code == 3 && call.out.contains("problem[data.missing]") && call.out.contains("  do   "),
        "{}",
        call.out
    );
    let nowhere = gs4d(&["doctor", text(&dir.path().join("none")), "-f", "-o", text(&html)]);
    assert!(nowhere.code == 3 && nowhere.out.contains("data.path"), "{}", nowhere.out);
    gs4d(&["doctor", text(&folder), "--set", "data.scael=1"]).fails(2, &["data.scael"]);
}

#[test]
fn points_are_made_once_and_then_begun_with() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("data");
    copy(data(), &folder);
    let json = good(&["init", text(&folder), "--points", "150", "--bound", "1.5", "--json"]).json();
    assert!(json["points"] == 150 && json["from"] == "hull" && json["bounds"][1][2] == 1.5, "{json}");
    assert!(folder.join("start.ply").exists());
    gs4d(&["init", text(&folder)]).fails(6, &["start.ply"]);
    good(&["init", text(&folder), "--from", "random", "--points", "70", "-f"]);
    let html = dir.path().join("doctor.html");
    let call = good(&["doctor", text(&folder), "--no-cost", "-o", text(&html)]);
    assert!(call.out.contains("70 points"), "{}", call.out);
    gs4d(&["init", text(&folder), "--from", "depth", "-f"]).fails(2, &["no depth"]);
    gs4d(&["init", text(&folder), "--set", "run.seed=1", "-f"]).fails(2, &["run.seed"]);
    gs4d(&["init", text(&folder), "--bound", "0", "-f"]).fails(2, &["above 0"]);
}
