//! `gs4d doctor` and `gs4d init`: findings, exit codes, the page, points that later openings begin with.

use crate::support::{Call, command, data, good, gs4d, text};
use gs_core::testkit::faults::VARIABLE;
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
    let told: Vec<&str> = call.err.lines().filter(|l| call.out.contains(*l)).collect();
    assert!(told.iter().any(|l| l.starts_with("layout ")) && told.iter().any(|l| l.starts_with("memory ")), "{told:?}");
    assert!(std::fs::read_to_string(&html).unwrap().contains("<img"));
    assert_eq!(good(&[&all[..], &["-f", "--quiet"]].concat()).err, "");
    let call = good(&[&all[..], &["-f", "--json"]].concat());
    assert_eq!(call.err, "");
    let json = call.json();
    assert_eq!(json["checkup"]["layout"], "blender");
    assert!(json["checkup"]["cost"]["seconds"][1].as_f64().unwrap() > 0.0);
    assert!(json["checkup"]["outlines"].is_null(), "there is no person");
}

/// Beside whatever verdict there is.
#[test]
fn a_filmed_person_has_a_table_of_outlines() {
    let dir = tempfile::tempdir().unwrap();
    let (film, html) = (dir.path().join("film"), dir.path().join("doctor.html"));
    let small = ["--cams", "8x1", "--frames", "4", "--size", "64", "--points", "500"];
    good(&[&["synth", "avatar", "-o", text(&film)][..], &small].concat());
    let all = ["doctor", text(&film), "--no-cost", "-o", text(&html)];
    let table = gs4d(&all).out;
    let json: serde_json::Value = serde_json::from_str(&gs4d(&[&all[..], &["--json"]].concat()).out).unwrap();
    let outlines = &json["checkup"]["outlines"];
    let [cameras, joints] = ["cameras", "joints"].map(|of| outlines[of].as_array().unwrap());
    assert!(cameras.len() > 3 && cameras.iter().all(|c| c["views"] == 4), "{outlines}");
    assert!(table.contains("outlines in camera") && table.contains("outlines moved by joint"), "{table}");
    for joint in joints {
        let (name, cm) = (joint["joint"].as_str().unwrap(), 100.0 * joint["metres"].as_f64().unwrap());
        let stated = table.lines().any(|l| l.starts_with(name) && l.ends_with(&format!(" {cm:.2}")));
        assert!(stated, "{name} {cm}: {table}");
    }
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
fn the_doctor_comes_again_and_keeps_what_is_not_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let html = dir.path().join("page.html");
    let all = ["doctor", text(data()), "--no-cost", "-o", text(&html)];
    good(&all);
    good(&all);
    std::fs::write(&html, "<title>mine</title>").unwrap();
    let refused = gs4d(&all);
    refused.fails(6, &["page.html", "exists"]);
    assert!(refused.out.is_empty(), "refused before anything is checked");
    assert_eq!(std::fs::read_to_string(&html).unwrap(), "<title>mine</title>");
    // What was found is told even if the page cannot be written.
    let deep = dir.path().join("new/folder/page.html");
    let all = ["doctor", text(data()), "--no-cost", "-o", text(&deep)];
    let call = Call::of(&command(&all).env(VARIABLE, "2:device").output().unwrap());
    assert!(call.code == 6 && call.out.contains("layout"), "{} {}", call.out, call.err);
    good(&all);
    assert!(deep.is_file(), "its folder is made");
    gs4d(&["doctor", text(data()), "--no-cost", "-o", text(&html.join("page.html"))]).fails(6, &["page.html"]);
}

/// In a folder where nothing can be written, such as that of the data: a full disk here, since tests may run as root.
#[test]
fn a_page_that_nobody_asked_for_is_left_out_where_it_cannot_be_written() {
    let dir = tempfile::tempdir().unwrap();
    let call = |more: &[&str], faults: &str| {
        let all = [&["doctor", text(data()), "--no-cost"][..], more].concat();
        Call::of(&command(&all).current_dir(dir.path()).env(VARIABLE, faults).output().unwrap())
    };
    let left_out = call(&[], "1:device");
    assert!(left_out.code == 0 && left_out.err.contains("the page was left out"), "{} {}", left_out.code, left_out.err);
    assert!(left_out.out.contains("0 problems") && !left_out.out.contains("doctor.html"), "{}", left_out.out);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    assert_eq!(call(&["-o", "page.html"], "1:device").code, 6, "a page that was asked for is missing");
    assert_eq!(call(&[], "9999:device").code, 0);
    assert!(dir.path().join("doctor.html").exists());
}

/// Times that are frame numbers: one proposal that is enough, which `--fix` writes.
#[test]
fn times_of_another_range_are_fixed_on_request() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, html) = (dir.path().join("data"), dir.path().join("doctor.html"));
    copy(data(), &folder);
    for split in ["train", "val", "test"] {
        let file = folder.join(format!("transforms_{split}.json"));
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let mut v: serde_json::Value = serde_json::from_str(&text).unwrap();
        for f in v["frames"].as_array_mut().unwrap() {
            f["time"] = serde_json::json!((94.0 * f["time"].as_f64().unwrap()).round());
        }
        std::fs::write(&file, v.to_string()).unwrap();
    }
    let train = ["train", text(&folder), "-m", "fourdgs", "--preset", "tiny", "--steps", "4", "-q", "-o"];
    let run = dir.path().join("run");
    gs4d(&[&train[..], &[text(&run)]].concat()).fails(3, &["data.time_range=0..94", "frame numbers"]);
    let all = ["doctor", text(&folder), "--no-cost", "-o", text(&html)];
    let call = gs4d(&all);
    assert!(call.code == 3 && call.out.contains("--fix"), "{}", call.out);
    assert_eq!(call.out.matches("problem[data.time]").count(), 1, "{}", call.out);
    let call = good(&[&all[..], &["--fix"]].concat());
    assert!(call.out.contains("wrote data.time_range=0..94 into"), "{}", call.out);
    assert!(std::fs::read_to_string(folder.join("scene.toml")).unwrap().contains("range = \"0..94\""));
    good(&[&train[..], &[text(&run)]].concat());
}

#[test]
fn a_scene_without_times_is_no_scene_to_learn_motion_from() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("data");
    copy(data(), &folder);
    for split in ["train", "val", "test"] {
        let file = folder.join(format!("transforms_{split}.json"));
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let mut v: serde_json::Value = serde_json::from_str(&text).unwrap();
        v["frames"].as_array_mut().unwrap().iter_mut().for_each(|f| {
            f.as_object_mut().unwrap().remove("time");
        });
        std::fs::write(&file, v.to_string()).unwrap();
    }
    let run = dir.path().join("run");
    let train = |method: &str| {
        gs4d(&["train", text(&folder), "-m", method, "--preset", "tiny", "--steps", "4", "-o", text(&run)])
    };
    train("fourdgs").fails(3, &["one timestamp", "data.time_from=name", "static3d"]);
    assert!(!run.exists());
    assert_eq!(train("static3d").code, 0);
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
    let call = good(&["doctor", text(&folder), "--no-cost", "--max-mem", "4000", "-o", text(&html)]);
    assert!(call.out.contains("70 points"), "{}", call.out);
    // Points that were made before are no points of the data.
    assert_eq!(good(&["init", text(&folder), "--points", "90", "-f", "--json"]).json()["from"], "hull");
    // A run begins with all of them, whatever its preset says.
    let run = dir.path().join("run");
    let train = ["train", text(&folder), "-m", "static3d", "--preset", "tiny", "--steps", "2", "-f", "-o", text(&run)];
    good(&train);
    let points = |text: &str| text.lines().find_map(|l| l.strip_prefix("points = ")).unwrap().to_owned();
    let resolved = || std::fs::read_to_string(run.join("config.resolved.toml")).unwrap();
    assert!(points(&resolved()).starts_with("90 ") && resolved().contains("scene.toml"), "{}", resolved());
    // The same call goes on with it.
    let on = |more: &[&str]| gs4d(&[&train[..6], &["--steps", "2", "--continue", "-o", text(&run)], more].concat());
    assert_eq!(on(&[]).code, 0);
    on(&["--set", "init.points=80"]).fails(6, &["other settings"]);
    let fewer = good(&[&train[..], &["--set", "schedule.density.max_splats=60"]].concat()).err;
    assert!(fewer.contains("begins with 60 of the 90 points"), "{fewer}");
    good(&[&train[..], &["--set", "init.points=40"]].concat());
    assert!(points(&resolved()).starts_with("40 "), "{}", resolved());
    let shift = ["--fix", "--set", "data.time_shift=4:-2"];
    gs4d(&[&["doctor", text(&folder)][..], &shift].concat()).fails(2, &["--fix", "data.time_shift"]);
    gs4d(&["init", text(&folder), "--from", "depth", "-f"]).fails(2, &["no depth", "leave --from out"]);
    gs4d(&["init", text(&folder), "--set", "run.seed=1", "-f"]).fails(2, &["run.seed"]);
    gs4d(&["init", text(&folder), "--bound", "0", "-f"]).fails(2, &["above 0"]);
}

/// The largest resident memory of a call until it ended, MiB.
#[cfg(target_os = "linux")]
fn peak_mib(arguments: &[&str]) -> f64 {
    let mut child = command(arguments).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak = 0.0f64;
    while child.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB"));
        peak = line.map_or(peak, |kb| kb.parse::<f64>().unwrap() / 1024.0);
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(child.wait().unwrap().success());
    peak
}

/// Of a run that sees every image twice, with scores and report: the number of splats is that of the start.
#[cfg(target_os = "linux")]
#[test]
fn the_memory_of_a_run_is_within_15_percent_of_the_estimate() {
    let dir = tempfile::tempdir().unwrap();
    let [folder, html, run] = ["data", "doctor.html", "run"].map(|name| dir.path().join(name));
    let views = ["--train-views", "12", "--val-views", "1", "--test-views", "6"];
    good(&[&["synth", "balls", "-o", text(&folder), "--size", "640"][..], &views].concat());
    let recipe = ["-m", "static3d", "--preset", "fast"];
    let doctor = [&["doctor", text(&folder), "-o", text(&html), "--json"][..], &recipe].concat();
    // So few views may give it a problem; the estimate is there all the same.
    let found: serde_json::Value = serde_json::from_str(&gs4d(&doctor).out).unwrap();
    let said = found["checkup"]["cost"]["memory_mib"][0].as_f64().unwrap();
    let train = [&["train", text(&folder), "-o", text(&run), "--steps", "24", "--quiet"][..], &recipe].concat();
    let taken = peak_mib(&train);
    assert!((said / taken - 1.0).abs() < 0.15, "said {said} MiB, taken {taken} MiB");
}
