//! Verbs without a run, and wrong use.

use crate::support::{command, good, gs4d, text};
use std::process::Stdio;

#[test]
fn wrong_use_exits_with_two() {
    gs4d(&["frobnicate"]).fails(2, &["unrecognized subcommand"]);
    gs4d(&[]).fails(2, &["Usage"]);
    gs4d(&["methods", "--no-such-flag"]).fails(2, &["--no-such-flag"]);
    gs4d(&["--quiet", "-v", "methods"]).fails(2, &["cannot be used with"]);
    gs4d(&["methods", "--threads", "0"]).fails(2, &["--threads"]);
    gs4d(&["eval"]).fails(2, &["RUN"]);
    gs4d(&["eval", "--pred", "x"]).fails(2, &["--gt"]);
    gs4d(&["bench", "--crate", "gs-nothing"]).fails(2, &["gs-nothing", "gs-raster"]);
    gs4d(&["bench", "--table", "growth", "--crate", "gs-raster"]).fails(2, &["cannot be used with"]);
    let version = good(&["--version"]).out;
    assert!(version.starts_with(&format!("gs4d {}", env!("CARGO_PKG_VERSION"))), "{version}");
    assert!(good(&["--help"]).out.contains("Exit codes"));
}

/// A run has one way to be scored, folders another.
#[test]
fn options_of_runs_and_of_folders_are_not_mixed() {
    let folders = ["eval", "--pred", "a", "--gt", "b"];
    for more in [&["--split", "val"][..], &["--data", "d"], &["--device", "cpu"], &["--fit-colors"], &["run"]] {
        gs4d(&[&folders[..], more].concat()).fails(2, &["cannot be used with"]);
    }
    gs4d(&["eval", "run", "--mask", "m"]).fails(2, &["cannot be used with", "--mask"]);
    gs4d(&["eval", "run", "--half", "--fit-colors"]).fails(2, &["cannot be used with"]);
    gs4d(&["eval", "run", "--lpips-range", "unit"]).fails(2, &["--lpips"]);
}

/// A negative number is refused as a value, not taken for a flag.
#[test]
fn negative_numbers_are_values() {
    let calls: [&[&str]; 4] = [
        &["train", "data", "-o", "out", "--steps", "-1"],
        &["train", "data", "-o", "out", "--seed", "-1"],
        &["export", "run", "-o", "a.html", "--tolerance", "-1"],
        &["compare", "methods", "data", "-o", "out", "--steps", "-1"],
    ];
    for call in calls {
        let call = gs4d(call);
        call.fails(2, &["invalid value '-1'"]);
        assert!(!call.err.contains("-- -1"), "{}", call.err);
    }
}

#[test]
fn methods_and_settings_are_listed() {
    let methods = good(&["methods", "--json"]).json();
    let names: Vec<&str> = methods.as_array().unwrap().iter().map(|m| m["name"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        [
            "static3d",
            "scaffold",
            "defgs",
            "fourdgs",
            "grid4d",
            "fags",
            "acutance",
            "modec",
            "trace",
            "trace-4dgs",
            "defgs-nvfi",
            "dut"
        ]
    );
    for name in names {
        let toml = good(&["config", name]).out;
        assert!(toml.contains("[schedule") && toml.contains("# default"), "{toml}");
    }
    let tiny = good(&["config", "static3d", "--preset", "tiny", "--set", "schedule.lambda_dssim=0.5", "--json"]).json();
    let row = |key: &str| tiny.as_array().unwrap().iter().find(|r| r["key"] == key).unwrap().clone();
    assert_eq!(row("schedule.lambda_dssim")["value"], 0.5);
    assert_eq!(row("schedule.lambda_dssim")["source"], "flag --set schedule.lambda_dssim=0.5");
    assert_eq!(row("init.points")["source"], "preset tiny");
}

/// Settings that help texts give as examples exist and may have these values.
#[test]
fn examples_of_help_texts_are_settings() {
    let verbs = ["train", "config", "doctor", "init", "eval", "export", "render", "compare", "continual", "forecast"];
    let nested = [vec!["compare", "methods"], vec!["compare", "settings"]];
    let mut tried = 0;
    for verb in verbs.map(|v| vec![v]).into_iter().chain(nested) {
        let help = good(&[&verb[..], &["--help"]].concat()).out;
        let words = help.split(|c: char| c.is_whitespace() || "\"();,".contains(c));
        for example in words.filter(|w| w.contains('=') && w.contains('.') && !w.starts_with(['-', '='])) {
            if example.starts_with(|c: char| c.is_ascii_lowercase()) && !example.contains("KEY") {
                let first = example.split('|').next().unwrap().trim_end_matches('.');
                good(&["config", "fourdgs", "--set", first]);
                tried += 1;
            }
        }
    }
    assert!(tried >= 3, "{tried}");
}

#[test]
fn a_shell_and_man_are_told_of_every_verb() {
    for shell in ["bash", "zsh", "fish"] {
        let script = good(&["completions", shell]).out;
        assert!(script.contains("gs4d") && script.contains("doctor") && script.contains("forecast"), "{shell}");
    }
    let dir = tempfile::tempdir().unwrap();
    good(&["man", text(dir.path())]);
    let page = std::fs::read_to_string(dir.path().join("gs4d-train.1")).unwrap();
    assert!(page.contains(".TH gs4d-train") && page.contains("time\\-budget"), "{page}");
    gs4d(&["man", text(dir.path())]).fails(6, &["exists"]);
}

#[test]
fn wrong_settings_exit_with_two_and_name_the_nearest() {
    gs4d(&["config", "nerf"]).fails(2, &["nerf", "static3d"]);
    gs4d(&["config", "static3d", "--preset", "huge"]).fails(2, &["huge", "tiny"]);
    gs4d(&["config", "static3d", "--set", "schedule.lambda_dsim=0.1"]).fails(2, &["schedule.lambda_dssim"]);
    gs4d(&["config", "static3d", "--set", "schedule.lr.means.eps=1e-8"]).fails(2, &["schedule.lr.cloud.means.eps"]);
    gs4d(&["config", "static3d", "--set", "schedule.lambda_dssim=nan"]).fails(2, &["finite"]);
    gs4d(&["config", "static3d", "--set", "schedule.lambda_dssim=\"a\""]).fails(2, &["must be a number"]);
    gs4d(&["config", "static3d", "--set", "schedule"]).fails(2, &["key=value"]);
}

#[test]
fn scenes_are_written_once() {
    assert!(good(&["synth"]).out.contains("balls"));
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("scene");
    let call = ["synth", "static", "-o", text(&out), "--size", "16", "--train-views", "2", "--test-views", "1"];
    let json = good(&[&call[..], &["--json"]].concat()).json();
    assert_eq!((json["scene"].as_str(), json["views"][0].as_u64()), (Some("static"), Some(2)));
    assert!(out.join("transforms_train.json").is_file() && out.join("truth.json").is_file());
    gs4d(&call).fails(6, &["not empty", "-f"]);
    good(&[&call[..], &["-f"]].concat());
    // What would be read with the new scene, and is not written anew, must go first.
    let rig = ["--cameras", "2", "--held-out", "1", "--moments", "3", "--size", "16"];
    let over = |scene: &str, more: &[&str]| gs4d(&[&["synth", scene, "-o", text(&out), "-f"][..], more].concat());
    over("falling", &rig).fails(6, &["transforms_val.json", "earlier data set", "remove it"]);
    over("balls", &["--layout", "nerfies", "--size", "16"]).fails(6, &["transforms_train.json"]);
    over("avatar", &["--size", "16"]).fails(6, &["truth.json"]);
    gs4d(&["synth", "balls", "--layout", "nerfies", "--truth", "-o", text(&dir.path().join("n"))])
        .fails(2, &["--truth"]);
    gs4d(&["synth", "nowhere", "-o", text(&dir.path().join("x"))]).fails(2, &["nowhere", "balls"]);
    gs4d(&["synth", "balls"]).fails(2, &["-o DIR"]);
}

#[test]
fn cameras_at_rest_have_a_future() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("scene");
    let rig = ["--cameras", "2", "--held-out", "1", "--moments", "5", "--size", "16", "--truth", "--truth-times", "2"];
    let json = good(&[&["synth", "falling", "-o", text(&out), "--json"][..], &rig].concat()).json();
    assert_eq!((&json["views"], &json["extrapolation_views"]), (&serde_json::json!([8, 0, 4]), &3.into()));
    assert_eq!(json["options"]["boundary"], 0.75);
    assert!(out.join("scene.toml").is_file() && out.join("maps/labels/extrapolate/c02_t004.png").is_file());
    let rest = dir.path().join("rest");
    gs4d(&["synth", "falling", "-o", text(&rest), "--cameras", "2", "--train-views", "9"]).fails(2, &["--train-views"]);
    gs4d(&["synth", "falling", "-o", text(&rest), "--boundary", "0.5"]).fails(2, &["--cameras"]);
    for flag in [["--boundary", "0.5"], ["--held-out", "1"], ["--moments", "3"]] {
        let views = ["--train-views", "4", flag[0], flag[1]];
        gs4d(&[&["synth", "falling", "-o", text(&rest)][..], &views].concat())
            .fails(2, &[flag[0], "cannot be used with"]);
    }
    gs4d(&["synth", "falling", "-o", text(&rest), "--cameras", "2", "--boundary", "0"])
        .fails(2, &["boundary", "above 0"]);
}

#[test]
fn bench_rows_have_time_and_error() {
    let json = good(&["bench", "--crate", "gs-train", "--json", "--quiet"]).json();
    let row = &json["rows"][0];
    assert_eq!(row["crate"], "gs-train");
    assert!(row["ms"].as_f64().unwrap() > 0.0 && row["error"].as_f64().unwrap() < 1e-4, "{row}");
    assert!(row["gflops"].is_null() && row["pytorch_ms"].is_null(), "{row}");
    assert!(json["roofs"]["fma_gflops"].as_f64().unwrap() > 0.1);
}

#[test]
fn bench_rows_of_layers_stand_beside_pytorch() {
    let json = good(&["bench", "--crate", "gs-core", "--json", "--quiet"]).json();
    let rows = json["rows"].as_array().unwrap();
    let named: Vec<_> = rows.iter().map(|r| (r["case"].as_str().unwrap(), r["n"].as_u64().unwrap())).collect();
    let wanted = [("mlp 84-8x256-10", 10_000), ("mlp 3x64", 100_000), ("conv 3x3 64->64", 128 * 128)];
    assert_eq!(named, wanted.map(|w| [w; 2]).concat());
    let gemm = json["roofs"]["gemm_gflops"].as_f64().unwrap();
    for (row, pytorch) in rows.iter().zip([67.0, 159.0, 21.0, 90.0, 7.3, 17.0]) {
        let (rate, share) = (row["gflops"].as_f64().unwrap(), row["of_gemm"].as_f64().unwrap());
        assert!(rate > 0.1 && (share * gemm / rate - 1.0).abs() < 1e-9, "{row}");
        assert!(row["error"].as_f64().unwrap() < 1e-5 && row["pytorch_ms"].as_f64() == Some(pytorch), "{row}");
    }
    assert!(json["pytorch"].as_str().unwrap().contains("2.15"), "{json}");
}

#[test]
fn a_reader_that_leaves_is_no_failure() {
    let mut child = command(&["config", "static3d"]).stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}
