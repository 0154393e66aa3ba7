//! The report of a run: what it says, and that its commands work.

use crate::support::{Call, data, good, run, text, train};
use std::fs;
use std::path::Path;
use std::process::Command;

/// The command lines of a report.
fn commands(run: &Path) -> Vec<String> {
    let html = fs::read_to_string(run.join("report.html")).unwrap();
    let lines = html.split("<code>").skip(1).map(|rest| rest.split("</code>").next().unwrap());
    lines.map(|line| line.replace("&#39;", "'").replace("&quot;", "\"").replace("&amp;", "&")).collect()
}

#[test]
fn it_says_what_its_curves_are_of_and_holds_every_scored_view() {
    let html = fs::read_to_string(run().join("report.html")).unwrap();
    let scores = good(&["eval", text(run()), "--json"]).json();
    let views = scores["views"].as_array().unwrap();
    for part in [
        "PSNR of training batches, dB, against step",
        "mean of 2 test views over white",
        "one mean square over 2 test views over white",
        "fourdgs, preset tiny, on ",
        "a view of median PSNR, over black",
        "Where the time of a training step goes",
        "aria-label=\"PSNR of each view, dB, against normalised time\"",
    ] {
        assert!(html.contains(part), "{part}");
    }
    let (_, chart) = html.split_once("PSNR of each view, dB, against normalised time").unwrap();
    let (chart, _) = chart.split_once("</svg>").unwrap();
    assert_eq!(chart.matches("<circle").count(), views.len());
    assert!(!html.contains("Speed against error") && !html.contains("steps 40 to 40"));
}

#[test]
fn views_scored_while_training_are_in_the_course() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    train(data(), &out, &["--set", "run.eval_every=20"]);
    let html = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.contains("PSNR of training batches and of val views, held out, dB, against step"));
}

#[cfg(unix)]
#[test]
fn its_commands_work_as_they_stand() {
    let dir = tempfile::tempdir().unwrap();
    let still = dir.path().join("data");
    let views = ["--size", "24", "--train-views", "4", "--val-views", "1", "--test-views", "1"];
    good(&[&["synth", "static", "-o", text(&still)][..], &views].concat());
    for (name, method, data) in [("it's a run", "fourdgs", data()), ("still", "static3d", &still)] {
        let out = dir.path().join(name);
        good(&["train", text(data), "-m", method, "--preset", "tiny", "--steps", "9", "-o", text(&out), "-q"]);
        let lines = commands(&out);
        let verbs: Vec<&str> = lines.iter().filter_map(|l| l.split(' ').nth(1)).collect();
        assert_eq!(verbs, ["view", "resume", "eval", "render", "export"], "{lines:?}");
        for line in &lines {
            let more = if line.starts_with("gs4d view") { " --seconds 0" } else { "" };
            let script = format!("gs4d() {{ '{}' \"$@\"; }}; {line}{more} -q", env!("CARGO_BIN_EXE_gs4d"));
            let call = Call::of(&Command::new("sh").args(["-c", &script]).output().unwrap());
            assert_eq!(call.code, 0, "{line}: {}", call.err);
        }
        assert!(dir.path().join(format!("{name}.ply")).is_file());
        assert_eq!(fs::read_dir(dir.path().join(format!("{name}-orbit"))).unwrap().count(), 24);
    }
}
