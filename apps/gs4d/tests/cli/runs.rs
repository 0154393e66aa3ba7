//! Runs: what they leave behind, scores, exact resumption, interruption.

use crate::support::{STEPS, command, data, good, gs4d, run, text, train};
use gs_train::checkpoint::{Checkpoint, load_newest};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn newest(run: &Path) -> Checkpoint {
    load_newest(&run.join("checkpoints")).unwrap().checkpoint
}

/// Tensors as bits, and the parts of `meta` that do not tell the time.
pub fn state(run: &Path) -> (Vec<(String, Vec<u32>)>, Value) {
    let checkpoint = newest(run);
    let bits = |v: &Vec<f32>| v.iter().map(|x| x.to_bits()).collect();
    let mut meta = checkpoint.meta.clone();
    meta.as_object_mut().unwrap().remove("train_seconds");
    (checkpoint.tensors.iter().map(|(n, v)| (n.clone(), bits(v))).collect(), meta)
}

#[test]
fn a_run_folder_is_complete() {
    let root = run();
    let config = fs::read_to_string(root.join("config.resolved.toml")).unwrap();
    assert!(config.contains("# preset tiny") && config.contains("# flag --steps 40"), "{config}");
    let provenance: Value = serde_json::from_str(&fs::read_to_string(root.join("provenance.json")).unwrap()).unwrap();
    assert_eq!(provenance["data"]["views"], serde_json::json!([8, 2, 2]));
    for key in ["version", "cpu", "threads", "simd", "device"] {
        assert!(!provenance["machine"][key].is_null(), "{key}");
    }
    let log = fs::read_to_string(root.join("log.jsonl")).unwrap();
    let last: Value = serde_json::from_str(log.lines().last().unwrap()).unwrap();
    assert_eq!(last["step"], STEPS);
    assert!(last["loss"].as_f64().unwrap() > 0.0 && last["seconds"].as_f64().unwrap() > 0.0);
    let html = fs::read_to_string(root.join("report.html")).unwrap();
    assert!(html.contains("Ground truth beside render") && html.contains("Commands"));
    assert!(root.join("checkpoints/step-000040.gs4d").is_file() && root.join("metrics.json").is_file());
    let renders: Vec<_> = fs::read_dir(root.join("renders")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(
        renders.len() == 2 && renders.iter().all(|n| n.to_str().unwrap().starts_with("step-000040_t0.")),
        "{renders:?}"
    );
}

#[test]
fn a_run_cut_off_while_its_folder_was_made_is_begun_again() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("run");
    let start = ["train", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", "1", "-o", text(&root), "-q"];
    fs::create_dir_all(root.join("checkpoints")).unwrap();
    fs::create_dir_all(root.join("renders")).unwrap();
    fs::write(root.join(".lock"), "").unwrap();
    good(&[&start[..], &["-f"]].concat());
    fs::remove_dir_all(&root).unwrap();
    let killed = command(&start).env("GS4D_FAIL_WRITE", "15:kill").output().unwrap();
    assert!(killed.status.code().is_none() && !root.exists(), "killed before the folder has its name");
    good(&start);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "nothing of the killed run is left");
}

#[test]
fn scores_have_a_fixed_shape() {
    for split in ["train", "val", "test"] {
        let json = good(&["eval", text(run()), "--split", split, "--json"]).json();
        for key in ["psnr", "ssim", "perceptual_proxy", "laplacian_ratio", "high_band_ratio"] {
            assert!(json["mean"][key].is_f64(), "{split} {key}: {json}");
        }
        assert!(json["mean"].as_object().unwrap().contains_key("ms_ssim"), "absent below 161 pixels, but named");
        assert_eq!((json["split"].as_str(), json["method"].as_str()), (Some(split), Some("fourdgs")));
        assert_eq!((json["step"].as_u64(), json["background"].as_array().unwrap().len()), (Some(STEPS.into()), 3));
        for key in ["psnr_of_mean_mse", "train_seconds", "gaussians", "bytes"] {
            assert!(json[key].as_f64().unwrap() > 0.0, "{key}");
        }
        assert_eq!(json["views"].as_array().unwrap().len(), if split == "train" { 8 } else { 2 });
    }
    assert!(good(&["eval", text(run()), "--background", "black"]).out.contains("background black"));
}

#[test]
fn a_run_is_not_overwritten_unasked() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    train(data(), &out, &[]);
    let call = ["train", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", "2", "-o", text(&out)];
    gs4d(&call).fails(6, &["holds a run already", "gs4d resume", "-f"]);
    good(&[&call[..], &["-f", "--quiet"]].concat());
    assert_eq!(newest(&out).meta["method"], "static3d");
    fs::write(dir.path().join("mine.txt"), "x").unwrap();
    let root = text(dir.path()).to_owned();
    gs4d(&["train", text(data()), "-m", "static3d", "-o", &root, "-f"]).fails(6, &["not a run's"]);
}

#[test]
fn resuming_is_exact_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let parts = dir.path().join("parts");
    train(data(), &parts, &["--time-budget", "0.001s", "--threads", "1"]);
    let first = newest(&parts).meta["step"].as_u64().unwrap();
    assert!(first < u64::from(STEPS), "the budget stopped the run early");
    good(&["resume", text(&parts), "--time-budget", "0.001s", "--threads", "3", "--quiet"]);
    let second = newest(&parts).meta["step"].as_u64().unwrap();
    assert!(second > first);
    good(&["resume", text(&parts), "--quiet"]);
    assert_eq!(state(&parts), state(run()));
    let steps: Vec<u64> = fs::read_to_string(parts.join("log.jsonl"))
        .unwrap()
        .lines()
        .map(|l| serde_json::from_str::<Value>(l).unwrap()["step"].as_u64().unwrap())
        .collect();
    assert!(steps.is_sorted() && steps.last() == Some(&STEPS.into()), "{steps:?}");
}

#[test]
fn the_image_cache_changes_no_bit_and_is_no_setting_of_the_recipe() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    train(data(), &out, &["--image-cache", "0", "--time-budget", "0.001s"]);
    good(&["resume", text(&out), "--image-cache", "1", "--time-budget", "0.001s", "--quiet"]);
    let kept = fs::read_to_string(out.join("config.resolved.toml")).unwrap();
    assert!(kept.contains("image_mib = 1 "), "{kept}");
    train(data(), &out, &["--time-budget", "0.001s", "--image-cache", "2", "--continue"]);
    good(&["resume", text(&out), "--quiet"]);
    assert_eq!(state(&out), state(run()));
}

#[test]
fn going_on_needs_a_checkpoint_and_says_where_a_budget_ended() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let base = ["train", text(data()), "-m", "static3d", "--preset", "tiny", "--continue", "-o", text(&out)];
    let short = [&base[..], &["--steps", "6"]].concat();
    good(&short);
    assert!(good(&short).err.contains("nothing is left to train"));
    let trained = state(&out);
    fs::remove_file(out.join("report.html")).unwrap();
    good(&short);
    assert!(out.join("report.html").exists() && state(&out) == trained, "a report that is missing is written");
    fs::remove_dir_all(out.join("checkpoints")).unwrap();
    fs::create_dir(out.join("checkpoints")).unwrap();
    gs4d(&short).fails(3, &["there is no checkpoint in", "-f"]);
    assert!(out.join("metrics.json").exists(), "scores stand");
    fs::remove_file(out.join("metrics.json")).unwrap();
    assert!(good(&short).err.contains("had no checkpoint: it is begun anew"));
    assert_eq!(newest(&out).meta["step"], 6);
    fs::write(out.join("checkpoints/step-000006.gs4d"), b"rubbish").unwrap();
    gs4d(&short).fails(3, &["no usable checkpoint", "step-000006.gs4d"]);

    fs::remove_dir_all(&out).unwrap();
    let long = [&base[..], &["--steps", "4000", "--time-budget", "0.001s"]].concat();
    good(&long);
    let step = newest(&out).meta["step"].as_u64().unwrap();
    let call = good(&long);
    let words = [format!("spent at step {step} of 4000"), format!("gs4d resume {}", out.display())];
    assert!(words.iter().all(|w| call.err.contains(w)) && !call.err.contains("nothing is left"), "{}", call.err);
}

#[test]
fn settings_that_were_changed_by_hand_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    train(data(), &out, &["--time-budget", "0.001s"]);
    let file = out.join("config.resolved.toml");
    let written = fs::read_to_string(&file).unwrap();
    for key in ["seed", "batch", "lambda_dssim"] {
        let edited = |line: &str| match line.split_once(" = ") {
            Some((k, _)) if k == key => format!("{key} = {}\n", if key == "lambda_dssim" { "0.9" } else { "4" }),
            _ => format!("{line}\n"),
        };
        let edited: String = written.lines().map(edited).collect();
        assert_ne!(edited, written, "{key}");
        fs::write(&file, edited).unwrap();
        gs4d(&["resume", text(&out)]).fails(3, &["config.resolved.toml was changed", "restore the file", "--config"]);
    }
    // What is no setting may change, and --steps lawfully changes what is.
    fs::write(&file, format!("# a note\n{written}")).unwrap();
    good(&["resume", text(&out), "--steps", "50", "--time-budget", "0.001s", "--quiet"]);
    good(&["resume", text(&out), "--quiet"]);
    assert_eq!(newest(&out).meta["step"].as_u64(), Some(50));
}

/// A run whose provenance knows of no settings, as those of earlier versions do, and a session that ends between its two files.
#[test]
fn older_runs_go_on_and_open() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    train(data(), &out, &["--time-budget", "0.001s"]);
    let (file, record) = (out.join("config.resolved.toml"), out.join("provenance.json"));
    let config = fs::read_to_string(&file).unwrap();
    let mut provenance: Value = serde_json::from_str(&fs::read_to_string(&record).unwrap()).unwrap();
    provenance.as_object_mut().unwrap().remove("settings").expect("kept");
    fs::write(&record, provenance.to_string()).unwrap();
    good(&["resume", text(&out), "--steps", "40", "--time-budget", "0.001s", "--quiet"]);
    fs::write(&file, &config).unwrap();
    good(&["resume", text(&out), "--steps", "40", "--quiet"]);
    // An option without effect on these data: new runs are refused.
    let config = fs::read_to_string(&file).unwrap();
    fs::write(&file, config.replace("[data]\n", "[data]\nfps = 10.0\n")).unwrap();
    good(&["eval", text(&out), "--quiet"]);
    let again = dir.path().join("again");
    let new = ["train", text(data()), "-m", "static3d", "--preset", "tiny", "--set", "data.fps=10", "-o", text(&again)];
    gs4d(&new).fails(2, &["data.fps = 10 has no effect", "leave data.fps out"]);
}

#[test]
fn motion_is_not_learnt_from_one_image() {
    let dir = tempfile::tempdir().unwrap();
    let (one, out) = (dir.path().join("one"), dir.path().join("run"));
    let views = ["--train-views", "1", "--val-views", "0", "--test-views", "1"];
    good(&[&["synth", "balls", "-o", text(&one), "--size", "24"][..], &views].concat());
    let with = |method: &str| {
        let layout = ["--set", "data.layout=blender"];
        let all = ["train", text(&one), "-m", method, "--preset", "tiny", "--steps", "2", "-q", "-o", text(&out)];
        gs4d(&[&all[..], &layout].concat())
    };
    with("fourdgs").fails(3, &["one timestamp", "-m static3d"]);
    assert_eq!(with("static3d").code, 0);
}

#[test]
fn where_nothing_is_all_verbs_say_the_same() {
    let calls: [&[&str]; 7] = [
        &["inspect", "nowhere"],
        &["view", "nowhere"],
        &["eval", "nowhere"],
        &["resume", "nowhere"],
        &["compare", "nowhere", "nowhere"],
        &["render", "nowhere", "--camera", "orbit", "-o", "none"],
        &["export", "nowhere", "-o", "none.ply"],
    ];
    for call in calls {
        gs4d(call).fails(6, &["error[io.missing]: nowhere: cannot open: ", "do   check the path"]);
    }
}

#[test]
fn the_command_that_goes_on_can_be_pasted() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("sp ace");
    let said = train(data(), &out, &["--time-budget", "0.001s"]).out;
    assert!(said.contains(&format!("gs4d resume '{}'", out.display())), "{said}");
    assert!(said.contains(&format!("gs4d view '{}'", out.display())), "{said}");
    assert!(said.contains("ms-ssim - (the images are too small)"), "{said}");
}

#[test]
fn a_finished_run_is_lengthened() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    train(data(), &out, &[]);
    let json = good(&["resume", text(&out), "--steps", "55", "--json", "--quiet"]).json();
    assert_eq!((json["step"].as_u64(), json["finished"].as_bool()), (Some(55), Some(true)));
    gs4d(&["resume", text(&out), "--steps", "5"]).fails(2, &["55 steps are made"]);
}

#[test]
fn a_damaged_checkpoint_is_skipped_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    train(data(), &out, &["--set", "run.checkpoint_every=15"]);
    let newest_file = out.join("checkpoints/step-000040.gs4d");
    let mut bytes = fs::read(&newest_file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&newest_file, &bytes).unwrap();
    let call = good(&["resume", text(&out)]);
    assert!(call.err.contains("step-000040.gs4d") && call.err.contains("checksum"), "{}", call.err);
    assert!(call.err.contains("going on from step 30"), "{}", call.err);
    assert_eq!(state(&out), state(run()));
    for name in ["step-000030.gs4d", "step-000040.gs4d"] {
        fs::write(out.join("checkpoints").join(name), b"rubbish").unwrap();
    }
    gs4d(&["resume", text(&out)]).fails(3, &["no usable checkpoint", "step-000030.gs4d", "step-000040.gs4d"]);
    gs4d(&["resume", text(dir.path())]).fails(3, &["no run folder"]);
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_is_saved_and_goes_on() {
    // These tests may themselves run where a hang-up is ignored.
    let heard: &[&str] = if cfg!(target_os = "linux") { &["env", "--default-signal=HUP"] } else { &[] };
    for signals in [&["-INT"][..], &["-TERM"], &["-HUP"], &["-USR1"]] {
        interrupted_by(heard, signals);
    }
}

/// What was started to outlive its terminal goes on when that closes.
#[cfg(target_os = "linux")]
#[test]
fn a_run_under_nohup_is_not_stopped_by_a_hangup() {
    interrupted_by(&["nohup"], &["-HUP", "-TERM"]);
}

/// Trains below `wrapper` and sends these signals; the last one only stops the run.
#[cfg(unix)]
fn interrupted_by(wrapper: &[&str], signals: &[&str]) {
    use crate::support::Call;
    use std::process::{Command, Stdio};
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let steps = "4000";
    let base = ["train", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", steps, "-o", text(&out)];
    let mut call = command(&base);
    if let [program, arguments @ ..] = wrapper {
        let mut wrapped = Command::new(program);
        wrapped.args(arguments).arg(call.get_program()).args(call.get_args());
        call = wrapped;
    }
    let mut child = call.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let pid = child.id().to_string();
    let begun = std::time::Instant::now();
    while fs::metadata(out.join("log.jsonl")).map_or(0, |m| m.len()) == 0 {
        assert!(begun.elapsed().as_secs() < 60, "training does not begin");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    for signal in signals {
        assert_eq!(child.try_wait().unwrap(), None, "ended before {signal}");
        assert!(Command::new("kill").args([*signal, &pid]).status().unwrap().success());
        std::thread::sleep(std::time::Duration::from_millis(if signals.len() > 1 { 300 } else { 0 }));
    }
    let call = Call::of(&child.wait_with_output().unwrap());
    call.fails(130, &["interrupted at step", "saved", &format!("gs4d resume {}", out.display())]);
    let stopped = newest(&out).meta["step"].as_u64().unwrap();
    assert!(stopped > 0 && stopped < 4000);
    let target = (stopped + 7).to_string();
    good(&["resume", text(&out), "--steps", &target, "--quiet"]);
    assert_eq!(newest(&out).meta["step"].as_u64().unwrap(), stopped + 7);
}

/// A reader that goes away (`| head -1`, a lost connection) ends no training.
#[test]
fn closed_output_ends_no_training() {
    use crate::support::command;
    use std::process::Stdio;
    let dir = tempfile::tempdir().unwrap();
    for (name, quiet) in [("verbose", &["--verbose"][..]), ("json", &["--json"])] {
        let out = dir.path().join(name);
        let base = ["train", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", "40", "-o", text(&out)];
        let all = [&base[..], quiet].concat();
        let mut child = command(&all).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop((child.stdout.take(), child.stderr.take()));
        let status = child.wait().unwrap();
        assert!(status.code().is_some(), "{name}: ended by a signal: {status}");
        assert_eq!(newest(&out).meta["step"].as_u64(), Some(40), "{name}: {status}");
        assert!(out.join("report.html").exists(), "{name}: {status}");
    }
}

#[test]
fn exposures_blur_the_training_views() {
    let dir = tempfile::tempdir().unwrap();
    let small = ["--size", "24", "--train-views", "2", "--val-views", "1", "--test-views", "1"];
    let synth = |out: &str, more: &[&str]| {
        let out = dir.path().join(out);
        (out.clone(), gs4d(&[&["synth", "balls", "-o", text(&out), "--json"][..], &small, more].concat()))
    };
    let (sharp, call) = synth("sharp", &[]);
    assert!(call.json()["exposure"].is_null());
    let (blurred, call) = synth("blurred", &["--exposure", "0.2", "--exposure-samples", "5", "--linear"]);
    assert_eq!(call.json()["exposure"]["samples"], 5);
    let same = |file: &str| fs::read(sharp.join(file)).unwrap() == fs::read(blurred.join(file)).unwrap();
    assert!(same("test/r_000.png") && same("val/r_000.png") && !same("train/r_001.png"));
    let exposure: Value = serde_json::from_str(&fs::read_to_string(blurred.join("exposure.json")).unwrap()).unwrap();
    assert_eq!((exposure["exposure"]["length"].as_f64(), exposure["frames"].as_f64()), (Some(0.2), Some(0.2)));
    synth("none", &["--shake", "0.1"]).1.fails(2, &["--exposure"]);
    let (refused, call) = synth("long", &["--exposure", "2"]);
    call.fails(2, &["exposure", "0 to 1"]);
    assert!(!refused.exists(), "nothing is written before the options are checked");
}

#[test]
fn runs_and_checkpoints_are_inspected() {
    let json = good(&["inspect", text(run()), "--json"]).json();
    let paths = &json["analysis"]["paths"];
    assert_eq!((paths["moments"].as_u64(), paths["cutoff"].as_u64()), (Some(8), Some(2)), "{paths}");
    assert!(paths["jerk"]["gini"].is_f64() && paths["raw"]["histogram"]["counts"].as_array().unwrap().len() == 64);
    assert!(json["economy"]["tiles_per_splat"].as_f64().unwrap() > 0.0, "{}", json["economy"]);
    let finer = ["inspect", text(run()), "--moments", "30", "--cutoff", "15"];
    assert!(good(&finer).out.contains("at 15 or more cycles over 30 moments"));
    gs4d(&["inspect", text(run()), "--moments", "30", "--cutoff", "16"]).fails(2, &["above 15"]);
    let names: Vec<&str> = json["needs"].as_array().unwrap().iter().map(|n| n["name"].as_str().unwrap()).collect();
    for name in ["splats that move", "splats at rest", "storage in all", "splats of plain colour"] {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
    let file = run().join("checkpoints/step-000040.gs4d");
    let json = good(&["inspect", text(&file), "--json"]).json();
    assert_eq!(json["meta"]["step"], STEPS);
    assert!(json["tensors"].as_array().unwrap().iter().any(|t| t["name"] == "cloud.means" && t["non_finite"] == 0));
}

#[test]
fn fags_is_trained_scored_and_ablated() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let base = ["train", text(data()), "-m", "fags", "--preset", "tiny", "--steps", "40", "-o", text(&out), "--quiet"];
    gs4d(&[&base[..], &["--set", "ablate=gate,fog"]].concat()).fails(2, &["`fog`", "fdgk, hfe, gate"]);
    gs4d(&[&base[..], &["--set", "ablate=fdgk,lambda"]].concat()).fails(2, &["leave `lambda` out already"]);
    good(&base);
    let json = good(&["eval", text(&out), "--json"]).json();
    assert!(json["method"] == "fags" && json["mean"]["psnr"].as_f64().unwrap() > 10.0, "{json}");
    let tensors: Vec<String> = newest(&out).tensors.into_iter().map(|t| t.0).collect();
    for name in ["cloud.lambda", "cloud.beta#m2", "field.grids.xyt"] {
        assert!(tensors.iter().any(|t| t == name), "{name} is not in {tensors:?}");
    }
    good(&[&base[..], &["-f", "--set", "ablate=fdgk,hfe"]].concat());
    assert!(newest(&out).tensors.iter().all(|t| t.0 != "cloud.lambda"));
}

#[test]
fn the_demo_leaves_report_pictures_and_splats() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let call = ["demo", "-o", text(&out), "--preset", "tiny", "--steps", "20", "--size", "32", "--quiet"];
    let table = good(&call).out;
    for word in ["PSNR", "SSIM", "splats", "report.html"] {
        assert!(table.contains(word), "{word} is not in {table}");
    }
    assert!(out.join("run/report.html").is_file() && out.join("scene-t0.50.ply").is_file());
    assert_eq!(fs::read_dir(out.join("frames")).unwrap().count(), 24);
    assert!(good(&["inspect", text(&out.join("scene-t0.50.ply"))]).out.contains("splats"));
    good(&["eval", text(&out.join("run"))]);
    gs4d(&call).fails(6, &["older demo", "-f"]);
    for part in ["run", "data"] {
        fs::remove_dir_all(out.join(part)).unwrap();
    }
    gs4d(&call).fails(6, &["frame-00.png", "-f"]);
}
