//! `gs4d export`: files of plain splats that draw as the run does, and what they lose.

use crate::support::{data, good, gs4d, text, train};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// From in front of the sheet, which lies around the origin with z up.
const CAMERA: &str = r#"{"width": 48, "height": 48, "fx": 50, "fy": 50, "cx": 24, "cy": 24, "name": "front",
    "world_to_camera": [[1,0,0,0],[0,0,-1,0],[0,1,0,4],[0,0,0,1]]}"#;

/// A short run on a moving scene.
fn run() -> &'static Path {
    // A static is never dropped: its folder stays in that of the build.
    static MADE: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let make = || {
        let dir = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
        let (data, run) = (dir.path().join("sheet"), dir.path().join("run"));
        good(&["synth", "sheet", "--size", "48", "-o", text(&data)]);
        let all = ["train", text(&data), "-m", "fourdgs", "--preset", "tiny", "--steps", "200", "-q", "-o"];
        good(&[&all[..], &[text(&run)]].concat());
        (dir, run)
    };
    &MADE.get_or_init(make).1
}

#[test]
fn every_format_is_read_back_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    for (extension, allowed) in [("ply", 0.02), ("glb", 0.02), ("spz", 1.5), ("splat", 3.0)] {
        let file = dir.path().join(format!("scene.{extension}"));
        let json = good(&["export", text(run()), "-o", text(&file), "--json", "--quiet"]).json();
        let loss = json["psnr"]["loss"].as_f64().unwrap();
        // The run moves, the file is baked at each view's own time for the measurement: only the format costs.
        assert!(loss.abs() <= allowed, "{extension}: {loss} dB");
        assert_eq!(json["bytes"].as_u64().unwrap(), fs::metadata(&file).unwrap().len());
        assert!(json["files"][0]["splats"].as_u64().unwrap() > 100);
    }
}

#[test]
fn up_turns_the_files_and_costs_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let load = |p: &Path| gs_core::io::load_splats(p, &gs_core::io::Limits::default()).unwrap();
    let (lying, upright) = (dir.path().join("lying.ply"), dir.path().join("upright.ply"));
    good(&["export", text(run()), "--no-eval", "-o", text(&lying)]);
    let json = good(&["export", text(run()), "--up", "auto", "-o", text(&upright), "--json", "--quiet"]).json();
    assert!(json["psnr"]["loss"].as_f64().unwrap().abs() < 0.02, "{json}");
    // The generated scene has z up; the files of viewers have −y up.
    let up = json["rotation"].as_array().unwrap().iter().map(|row| row[2].as_f64().unwrap());
    assert!(up.zip([0.0, -1.0, 0.0]).all(|(a, b)| (a - b).abs() < 0.2), "{json}");
    let named = dir.path().join("named.ply");
    good(&["export", text(&lying), "--up", "z", "-o", text(&named)]);
    let (before, after) = (load(&lying), load(&named));
    assert!(before.means.iter().zip(&after.means).all(|(a, b)| (a.z + b.y).abs() < 1e-5 && (a.x - b.x).abs() < 1e-5));
    gs4d(&["export", text(&lying), "--up", "auto", "-f", "-o", text(&named)]).fails(2, &["--up x"]);
    gs4d(&["export", text(run()), "--up", "z", "-o", text(&dir.path().join("a.gs4d"))]).fails(2, &["--up"]);
}

#[test]
fn rigid_parts_are_written_with_their_motion_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("parts.glb");
    let all = ["export", text(run()), "--rigid", "--times", "0..1:9", "-o", text(&file), "--json", "--quiet"];
    let json = good(&all).json();
    let number = |key: &str| json[key].as_f64().unwrap_or_else(|| panic!("{key}: {json}"));
    assert!(number("moving") >= 1.0 && number("parts") >= number("moving"), "{json}");
    assert_eq!((number("frames"), number("seconds")), (9.0, 3.0));
    let bytes = fs::read(&file).unwrap();
    let scene = gs_core::io::glb::read_scene(&bytes, "parts.glb", &gs_core::io::Limits::default()).unwrap();
    let (start, end) = (scene.at(0.0), scene.at(scene.duration()));
    assert_eq!((start.len() as f64, start.len()), (number("splats"), end.len()));
    assert_ne!(start.means, end.means, "they move");
    // A waving sheet is not rigid; its parts lose something, and that is said.
    let loss = json["psnr"]["loss"].as_f64().unwrap();
    assert!(loss.is_finite() && loss < 6.0 && number("residual") > 0.0, "{json}");
    // Upright files move as the others do.
    let up = dir.path().join("up.glb");
    let turned = ["export", text(run()), "--rigid", "--times", "0..1:9", "--up", "z", "-o", text(&up), "--json", "-q"];
    let turned = good(&turned).json();
    assert!((turned["psnr"]["loss"].as_f64().unwrap() - loss).abs() < 0.05, "{turned} {loss}");
    let refused = |more: &[&str]| gs4d(&[&["export", text(run()), "--rigid"][..], more].concat());
    refused(&["-o", text(&dir.path().join("a.ply"))]).fails(2, &["--rigid", ".glb"]);
    refused(&["-o", text(&dir.path().join("a.html"))]).fails(2, &["--rigid"]);
    refused(&["-o", text(&dir.path().join("a.gs4d"))]).fails(2, &["--rigid"]);
    refused(&["-o", text(&file)]).fails(6, &["parts.glb"]);
    let other = dir.path().join("b.glb");
    refused(&["--max-error", "0.0001", "--times", "0..1:3", "-o", text(&other)]).fails(7, &["lose", "html"]);
}

#[test]
fn a_4dgs_file_holds_the_motion_and_is_measured() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.4dgs");
    let all = ["export", text(run()), "--times", "0..1:9", "-o", text(&file), "--json", "--quiet"];
    let json = good(&all).json();
    let number = |key: &str| json[key].as_f64().unwrap_or_else(|| panic!("{key}: {json}"));
    assert!(number("gaussians") >= number("splats") && number("frames") == 9.0, "{json}");
    assert_eq!(number("bytes"), fs::metadata(&file).unwrap().len() as f64);
    assert!((number("seconds") - 3.0 * 9.0 / 8.0).abs() < 1e-6, "the last frame lasts as long as the others");
    let loss = json["psnr"]["loss"].as_f64().unwrap();
    assert!(loss.abs() < 1.0, "{json}");
    gs4d(&["export", text(run()), "-o", text(&file)]).fails(6, &["scene.4dgs"]);
    gs4d(&["export", text(run()), "--up", "z", "-o", text(&dir.path().join("b.4dgs"))]).fails(2, &["--up"]);
}

#[test]
fn a_page_is_read_back_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.html");
    let all = ["export", text(run()), "--times", "0..1:9", "--tolerance", "0.25", "-o", text(&file)];
    let said = good(&all).out;
    let json = good(&[&all[..], &["-f", "--json", "--quiet"]].concat()).json();
    let number = |key: &str| json.pointer(key).and_then(|v| v.as_f64()).unwrap_or_else(|| panic!("{key}: {json}"));
    assert_eq!((number("/frames"), number("/tolerance")), (9.0, 0.25));
    assert_eq!(number("/bytes"), fs::metadata(&file).unwrap().len() as f64);
    let (splats, moving) = (number("/splats"), number("/moving"));
    assert!(splats > 100.0 && (1.0..=splats).contains(&moving) && number("/keys") >= splats, "{json}");
    let (before, after, loss) = (number("/psnr/before"), number("/psnr/after"), number("/psnr/loss"));
    assert!(loss.abs() < 1.0 && (before - after - loss).abs() < 1e-3, "{json}");
    assert!(number("/psnr/worst/loss") >= loss - 1e-6 && number("/psnr/views") >= 1.0, "{json}");
    assert_eq!((number("/psnr/from_files"), json["psnr"]["split"].as_str()), (number("/psnr/views"), Some("test")));
    for part in [
        format!("{:.2} MB, read back whole: {splats} splats at 9 times, {moving} of them move", number("/bytes") / 1e6),
        "off by more than 0.25 of its standard deviation".to_owned(),
        format!("test views (from the file, read back): {before:.3} dB as trained, {after:.3} dB as written"),
        format!("(mean loss {loss:.3} dB, worst "),
    ] {
        assert!(said.contains(&part), "{part}: {said}");
    }
}

#[test]
fn a_file_draws_what_the_run_draws_at_its_time() {
    let dir = tempfile::tempdir().unwrap();
    let (file, camera) = (dir.path().join("half.glb"), dir.path().join("camera.json"));
    fs::write(&camera, CAMERA).unwrap();
    good(&["export", text(run()), "--times", "0.5", "--no-eval", "-o", text(&file)]);
    let draw = |scene: &Path, name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        let all = ["render", text(scene), "--camera", text(&camera), "--near", "0.2", "--background", "black", "-o"];
        good(&[&all[..], &[text(&out)], more].concat());
        image(&out.join("front.png"))
    };
    let (a, b) = (draw(&file, "a", &[]), draw(run(), "b", &["--time", "0.5"]));
    assert_eq!(a.len(), b.len());
    let worst = a.iter().zip(&b).map(|(x, y)| x.abs_diff(*y)).max().unwrap();
    assert!(worst <= 2, "{worst} of 255");
    let other = draw(run(), "c", &["--time", "0"]);
    assert!(a.iter().zip(&other).any(|(x, y)| x.abs_diff(*y) > 8), "the scene moves");
}

fn image(path: &Path) -> Vec<u8> {
    let picture = gs_core::io::images::load_rgba8(path, &gs_core::io::Limits::default()).unwrap();
    picture.data
}

#[test]
fn a_sequence_is_a_folder_with_its_times() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("moments");
    let all = ["export", text(run()), "--times", "0..1:3", "--no-eval", "-o", text(&out)];
    let answer = good(&[&all[..], &["--format", "splat", "--json"]].concat()).json();
    let table: serde_json::Value = serde_json::from_slice(&fs::read(out.join("times.json")).unwrap()).unwrap();
    assert_eq!(table, answer["files"]);
    assert_eq!((table[1]["time"].as_f64(), table.as_array().unwrap().len()), (Some(0.5), 3));
    assert_eq!(table[2]["file"], "time-0002.splat", "the folder can be moved");
    assert!(out.join("time-0002.splat").exists());
    gs4d(&all).fails(6, &["exists already", "-f"]);
}

/// What is scored is what was written, sampled in time as it was.
#[test]
fn a_sequence_is_scored_by_its_own_files() {
    let dir = tempfile::tempdir().unwrap();
    let lost = |n: usize| {
        let (out, times) = (dir.path().join(n.to_string()), format!("0..1:{n}"));
        let all = ["export", text(run()), "--times", &times, "--format", "ply", "-o", text(&out), "--split", "train"];
        let answer = good(&[&all[..], &["--json"]].concat()).json();
        assert_eq!(answer["psnr"]["from_files"], answer["psnr"]["views"], "{answer}");
        answer["psnr"]["loss"].as_f64().unwrap()
    };
    let (two, many) = (lost(2), lost(33));
    assert!(two > many + 0.01, "{two} dB with two files, {many} dB with 33");
    let one = dir.path().join("one.ply");
    let answer = good(&["export", text(run()), "--times", "0.4", "-o", text(&one)]).out;
    assert!(answer.starts_with("1 file, ") && answer.contains("as no file has its time"), "{answer}");
}

#[test]
fn nothing_is_dropped_or_written_under_an_unknown_name() {
    let dir = tempfile::tempdir().unwrap();
    let (from, to) = (dir.path().join("a.ply"), dir.path().join("b.glb"));
    let sh = (0..2 * 48).map(|k| 0.01 * k as f32).collect();
    let raw = gs_core::io::RawSplats {
        means: vec![glam::Vec3::ZERO, glam::Vec3::X],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        log_scales: vec![glam::Vec3::splat(-2.0); 2],
        logit_opacities: vec![1.0; 2],
        degree: 3,
        sh,
        ..Default::default()
    };
    gs_core::io::save_splats(&from, &raw, false).unwrap();
    let call = good(&["export", text(&from), "-o", text(&to)]);
    assert!(call.out.contains("SH degree 3;"), "{}", call.out);
    let call = good(&["export", text(&from), "--sh-degree", "1", "-f", "-o", text(&to)]);
    assert!(call.out.contains("SH degree 1 (of 3);"), "{}", call.out);
    let odd = dir.path().join("scene.obj");
    gs4d(&["export", text(run()), "-o", text(&odd)]).fails(2, &[".obj", ".ply", ".gs4d"]);
    assert!(!odd.exists());
    let beyond = good(&["export", text(run()), "--times", "1.5", "--no-eval", "-o", text(&dir.path().join("c.ply"))]);
    assert!(beyond.err.contains("extrapolated"), "{}", beyond.err);
    let page = dir.path().join("c.html");
    let beyond = good(&["export", text(run()), "--times", "3..9:2", "--no-eval", "-o", text(&page)]);
    assert!(beyond.err.contains("note: time 3 lies outside training (0..1)"), "{}", beyond.err);
}

/// Files that cannot say it are written with a note.
#[test]
fn anti_aliased_splats_stay_so() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    train(data(), &at("run"), &["--set", "schedule.antialias=true"]);
    let load = |name: &str| gs_core::io::load_splats(&at(name), &gs_core::io::Limits::default()).unwrap();
    let says = |from: &str, to: &str, more: &[&str]| {
        let call = good(&[&["export", text(&at(from)), "-o", text(&at(to))][..], more].concat());
        call.err.contains("cannot say that splats are to be drawn anti-aliased")
    };
    for (name, keeps) in [("a.ply", true), ("a.spz", true), ("a.glb", false), ("a.splat", false)] {
        let note = says("run", name, &["--no-eval"]);
        assert_eq!((load(name).antialiased, note), (keeps, !keeps), "{name}");
    }
    assert!(!says("run", "a.html", &["--no-eval", "--times", "0..1:3"]));
    let page = gs4d_player::read(&fs::read_to_string(at("a.html")).unwrap()).unwrap();
    assert!(page.render_settings().antialias);
    // Converted files, too, and those whose kernels become Gaussians.
    let ply = load("a.ply");
    let kernel = gs_core::Kernel::Acutance { acutances: vec![0.5; ply.len()] };
    gs_core::io::save_splats(&at("b.ply"), &gs_core::io::RawSplats { kernel, ..ply }, false).unwrap();
    assert!(!says("b.ply", "b.spz", &[]) && load("b.spz").antialiased);
    assert!(says("b.ply", "b.glb", &[]));
}

#[test]
fn data_without_test_views_are_exported_unscored() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (dir.path().join("data"), dir.path().join("run"));
    let views = ["--train-views", "4", "--val-views", "2", "--test-views", "1"];
    good(&[&["synth", "balls", "-o", text(&data), "--size", "32"][..], &views].concat());
    fs::remove_file(data.join("transforms_test.json")).unwrap();
    good(&["train", text(&data), "-m", "fourdgs", "--preset", "tiny", "--steps", "4", "-q", "-o", text(&run)]);
    for name in ["a.ply", "a.html", "a.gs4d"] {
        let file = dir.path().join(name);
        let call = good(&["export", text(&run), "-o", text(&file)]);
        assert!(file.exists() && call.err.contains("nothing is scored, the data have no test views"), "{}", call.err);
    }
    let file = dir.path().join("b.ply");
    gs4d(&["export", text(&run), "-o", text(&file), "--max-error", "1"]).fails(3, &["no test views", "--split"]);
    assert!(!file.exists());
    gs4d(&["eval", text(&run)]).fails(3, &["no test views; they have 4 train views, 2 val views", "--split"]);
    let drawn = good(&["render", text(&run), "--camera", "dataset:0", "-o", text(&dir.path().join("frames"))]);
    assert!(drawn.err.contains("dataset:0 is the training view"), "{}", drawn.err);
    fs::write(data.join("scene.toml"), "[start]\npoints = \"x.ply\"\n").unwrap();
    gs4d(&["train", text(&data), "-m", "static3d", "-o", text(&run), "-f"])
        .fails(3, &["x.ply", "[start]", "scene.toml"]);
}

#[test]
fn a_splat_file_is_no_run() {
    let dir = tempfile::tempdir().unwrap();
    let ply = dir.path().join("a.ply");
    good(&["export", text(run()), "--no-eval", "-o", text(&ply)]);
    for name in ["b.html", "b.gs4d", "b.4dgs"] {
        let out = dir.path().join(name);
        gs4d(&["export", text(&ply), "-o", text(&out)]).fails(2, &["a.ply is a splat file", "made of a run"]);
    }
    gs4d(&["export", text(&ply), "--rigid", "-o", text(&dir.path().join("b.glb"))]).fails(2, &["is a splat file"]);
    gs4d(&["eval", text(&ply)]).fails(3, &["a.ply is a splat file", "run folder"]);
}

#[test]
fn a_run_is_kept_whole_by_its_extension() {
    let dir = tempfile::tempdir().unwrap();
    let (file, older) = (dir.path().join("a.gs4d"), dir.path().join("b.gs4d"));
    good(&["export", text(run()), "--no-eval", "--bits", "16", "-o", text(&file)]);
    let call = good(&["compact", text(run()), "--no-eval", "--bits", "16", "-o", text(&older)]);
    assert!(call.err.contains("gs4d export -o NAME.gs4d"), "{}", call.err);
    assert_eq!(fs::read(&file).unwrap(), fs::read(&older).unwrap());
    gs4d(&["export", text(run()), "--times", "0.5", "-o", text(&dir.path().join("c.gs4d"))]).fails(2, &["--times"]);
    gs4d(&["export", text(run()), "--bits", "8", "-o", text(&dir.path().join("c.ply"))]).fails(2, &[".gs4d"]);
}

#[test]
fn files_become_other_files() {
    let dir = tempfile::tempdir().unwrap();
    let (ply, glb, again) = (dir.path().join("a.ply"), dir.path().join("a.glb"), dir.path().join("b.ply"));
    good(&["export", text(run()), "--no-eval", "-o", text(&ply)]);
    good(&["export", text(&ply), "-o", text(&glb)]);
    good(&["export", text(&glb), "-o", text(&again)]);
    let load = |p: &Path| gs_core::io::load_splats(p, &gs_core::io::Limits::default()).unwrap();
    assert_eq!(load(&ply).means, load(&again).means);
    assert_eq!(load(&ply).sh, load(&again).sh);
    gs4d(&["export", text(&ply), "--times", "0..1:2", "-o", text(&dir.path().join("d"))]).fails(2, &["one moment"]);
}

#[test]
fn too_much_loss_is_an_exit_code_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("s.splat");
    // Rounding costs what training has fitted, on average; a held-out view may gain.
    let all = ["export", text(run()), "-o", text(&file), "--quiet", "--split", "train", "--max-error"];
    gs4d(&[&all[..], &["0"]].concat()).fails(7, &["--max-error allows 0", "NAME.gs4d"]);
    assert!(file.exists(), "the file stays");
    good(&[&all[..], &["30", "-f"]].concat());
    gs4d(&["export", text(run()), "-o", "x.ply", "--times", "0..1:2"]).fails(2, &["-o DIR"]);
    gs4d(&["export", text(run()), "-o", "x.ply", "--format", "glb"]).fails(2, &["disagree"]);
}
