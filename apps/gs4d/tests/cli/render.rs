//! Pictures of splat files and runs.

use crate::support::{CAMERA, command, data, good, gs4d, ply, run, text, tiny_ply};
use gs_core::io::{Limits, exr, images, npy};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};

fn camera(dir: &Path, json: &str) -> PathBuf {
    let path = dir.join("camera.json");
    fs::write(&path, json).unwrap();
    path
}

#[test]
fn every_format_holds_the_same_picture() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), CAMERA);
    let out = dir.path().join("out");
    for format in ["png", "exr", "npy"] {
        let call = ["render", text(ply()), "--camera", text(&camera), "--format", format, "-o", text(&out), "--json"];
        assert!(good(&call).json()["files"][0].as_str().unwrap().ends_with(&format!("front.{format}")));
    }
    let limits = Limits::default();
    let array = npy::read(&fs::read(out.join("front.npy")).unwrap(), "npy", &limits).unwrap();
    assert_eq!(array.shape, [16, 20, 4]);
    let values = array.to_f32();
    let middle = &values[(8 * 20 + 10) * 4..][..4];
    assert!(middle[0] > 0.5 && middle[1] < 0.1 && middle[3] > 0.5, "a red splat in the middle: {middle:?}");
    assert!((middle[0] - 0.98 * middle[3]).abs() < 0.03, "premultiplied: {middle:?}");
    let corner = &values[..4];
    assert_eq!(corner, [0.0; 4]);
    let exr = exr::load(&out.join("front.exr"), &limits).unwrap();
    assert_eq!((exr.shape(), exr.data), ((20, 16, 4), values.clone()));
    let png = images::load_image(&out.join("front.png"), &limits).unwrap();
    for (p, v) in png.data.chunks_exact(3).zip(values.chunks_exact(4)) {
        assert!((p[0] - v[0].clamp(0.0, 1.0)).abs() <= 0.5 / 255.0 + 1e-6);
    }
}

#[test]
fn depth_and_alpha_are_values_and_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), CAMERA);
    let render = |mode: &str, format: &str| {
        let out = dir.path().join(mode);
        good(&["render", text(ply()), "--camera", text(&camera), "--mode", mode, "--format", format, "-o", text(&out)]);
        out.join(format!("front.{format}"))
    };
    let limits = Limits::default();
    let values = |mode: &str| {
        let array = npy::read(&fs::read(render(mode, "npy")).unwrap(), "npy", &limits).unwrap();
        assert_eq!(array.shape, [16, 20, 1]);
        array.to_f32()
    };
    let (depth, alpha) = (values("depth"), values("alpha"));
    let middle = 8 * 20 + 10;
    assert!(alpha[middle] > 0.5 && alpha[0] == 0.0 && depth[0] == 0.0, "nothing is in the corner");
    assert!(depth.iter().zip(&alpha).all(|(d, a)| (*d > 0.0) == (*a > 0.5)));
    assert_eq!(exr::load(&render("depth", "exr"), &limits).unwrap().data, depth);
    let png = images::load_image(&render("alpha", "png"), &limits).unwrap();
    assert!(png.data.chunks_exact(3).zip(&alpha).all(|(p, a)| (p[0] - a).abs() <= 0.5 / 255.0 + 1e-6 && p[0] == p[2]));
}

/// Values of an image in numpy's format.
fn array(scene: &Path, camera: &Path, mode: &str, out: &Path) -> npy::NpyArray {
    let more = ["--mode", mode, "--format", "npy", "-o", text(out)];
    good(&[&["render", text(scene), "--camera", text(camera)][..], &more].concat());
    npy::read(&fs::read(out.join("front.npy")).unwrap(), "npy", &Limits::default()).unwrap()
}

#[test]
fn layers_of_a_method_are_drawn_as_the_viewer_draws_them() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), &CAMERA.replace("[0,0,1,0]", "[0,0,1,4]"));
    let values = |mode: &str| array(run(), &camera, mode, &dir.path().join(mode));
    let (color, motion, parts, counts) = (values("color"), values("motion"), values("segment"), values("count"));
    assert_eq!([&color.shape, &motion.shape, &parts.shape], [&[16, 20, 4]; 3]);
    let (color, motion, parts) = (color.to_f32(), motion.to_f32(), parts.to_f32());
    for (layer, name) in [(&motion, "motion"), (&parts, "segment")] {
        let pixels = || color.chunks_exact(4).zip(layer.chunks_exact(4));
        assert!(pixels().all(|(c, l)| (c[3] - l[3]).abs() < 1e-5), "{name}: the same splats cover the same pixels");
        assert!(pixels().any(|(c, l)| c[3] > 0.5 && c[..3] != l[..3]), "{name}: in colours of its own");
    }
    assert_eq!(counts.shape, [16, 20, 1]);
    let counts = counts.to_f32();
    assert!(counts.iter().zip(color.chunks_exact(4)).all(|(n, c)| (*n > 0.0) == (c[3] > 0.0) && n.fract() == 0.0));
    let shown = ["render", text(run()), "--camera", text(&camera), "-o", text(dir.path()), "--json", "--mode"];
    let json = good(&[&shown[..], &["motion"]].concat()).json();
    assert!(json["layer"]["name"] == "motion" && json["layer"]["meaning"].as_str().unwrap().contains("red"), "{json}");
    let png = images::load_image(&dir.path().join("front.png"), &Limits::default()).unwrap();
    assert!(png.data.iter().zip(motion.chunks_exact(4).flat_map(|p| &p[..3])).all(|(a, b)| (a - b).abs() < 0.003));
}

#[test]
fn an_unknown_layer_is_answered_with_those_there_are() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), CAMERA);
    let out = dir.path().join("out");
    let call = |scene: &Path, mode: &str| {
        gs4d(&["render", text(scene), "--camera", text(&camera), "--mode", mode, "-o", text(&out)])
    };
    call(run(), "velocity").fails(2, &["--mode velocity", "color, depth, alpha, count, segment, motion"]);
    call(ply(), "motion").fails(2, &["a splat file", "color, depth, alpha, count"]);
    assert!(!out.exists(), "nothing is made");
    let counts = array(ply(), &camera, "count", &out).to_f32();
    assert_eq!((counts[0], counts[8 * 20 + 10]), (0.0, 1.0), "one splat, in the middle");
}

#[test]
fn what_lies_outside_training_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let all = ["render", text(run()), "--camera", "dataset:0", "-f", "-o", text(dir.path())];
    let said = |more: &[&str]| good(&[&all[..], more].concat()).err;
    assert!(said(&["--time", "3"]).contains("note: time 3 lies outside training (0..1)"));
    assert!(said(&["--times", "-5..1:2"]).contains("note: time -5 lies outside training (0..1)"));
    assert!(!said(&["--time", "1"]).contains("note:"));
}

#[test]
fn a_folder_is_not_named_like_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let call = |name: &str| gs4d(&["render", text(ply()), "--camera", "orbit", "-o", text(&dir.path().join(name))]);
    call("video.mp4").fails(2, &["names a folder", "video --format mp4"]);
    call("a.PNG").fails(2, &["names a folder", "--format png"]);
    call("a.jpg").fails(2, &["--format png"]);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    let v1 = dir.path().join("v1.2");
    let all = ["render", text(ply()), "--camera", "orbit", "--times", "0..1:2", "--format", "y4m", "--fps", "29.97"];
    good(&[&all[..], &["-o", text(&v1)]].concat());
    let video = fs::read(v1.join("video.y4m")).unwrap();
    assert!(video.windows(11).any(|w| w == b" F29970:100".as_slice()), "29.97 frames per second");
}

#[test]
fn nothing_is_overwritten_unasked() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), CAMERA);
    let call = ["render", text(ply()), "--camera", text(&camera), "-o", text(dir.path())];
    good(&call);
    gs4d(&call).fails(6, &["exists", "front.png", "-f"]);
    good(&[&call[..], &["-f", "--background", "white"]].concat());
    let png = images::load_image(&dir.path().join("front.png"), &Limits::default()).unwrap();
    assert_eq!(png.pixel(0, 0), [1.0; 3]);
}

#[test]
fn flags_take_negative_values_and_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), CAMERA);
    let call = |more: &[&str]| {
        gs4d(&[&["render", text(ply()), "--camera", text(&camera), "-o", text(dir.path()), "-f"], more].concat())
    };
    assert_eq!(call(&["--time", "-0.5"]).code, 0);
    call(&["--background", "-1"]).fails(2, &["0 to 1"]);
    call(&["--background", "-1,0,0"]).fails(2, &["0 to 1"]);
    call(&["--time", "nan"]).fails(2, &["number"]);
    call(&["--near", "-1"]).fails(2, &["not negative"]);
    assert_eq!(call(&["--near", "4", "--antialias"]).code, 0);
    let png = images::load_image(&dir.path().join("front.png"), &Limits::default()).unwrap();
    assert!(png.data.iter().all(|v| *v == 0.0), "the splat is nearer than 4");
}

#[test]
fn names_of_cameras_cannot_leave_the_folder() {
    let dir = tempfile::tempdir().unwrap();
    let evil = CAMERA.replace("front", "../../evil");
    let camera = camera(dir.path(), &format!("[{evil}, {evil}]"));
    let out = dir.path().join("a/b/out");
    good(&["render", text(ply()), "--camera", text(&camera), "-o", text(&out)]);
    let mut names: Vec<_> = fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["evil-1.png", "evil.png"]);
    assert!(!dir.path().join("evil.png").exists() && !dir.path().join("a/evil.png").exists());
}

#[test]
fn a_run_is_drawn_at_any_time_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), &CAMERA.replace("[0,0,1,0]", "[0,0,1,4]"));
    let draw = |name: &str, time: &str, threads: &str| {
        let out = dir.path().join(name);
        let call = ["render", text(run()), "--camera", text(&camera), "--format", "npy", "-o", text(&out)];
        good(&[&call[..], &["--time", time, "--threads", threads]].concat());
        npy::read(&fs::read(out.join("front.npy")).unwrap(), "npy", &Limits::default()).unwrap().to_f32()
    };
    let first = draw("first", "0", "1");
    assert_eq!(first, draw("again", "0", "3"));
    assert!(first.chunks_exact(4).any(|p| p[3] > 0.1), "something is drawn");
    assert_ne!(first, draw("later", "1", "2"), "the scene moves");
}

#[test]
fn splats_of_a_run_rest_within_the_pixels_that_are_allowed() {
    let dir = tempfile::tempdir().unwrap();
    let camera = camera(dir.path(), &CAMERA.replace("[0,0,1,0]", "[0,0,1,4]"));
    let call = |scene: &Path, name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        gs4d(&[&["render", text(scene), "--camera", text(&camera), "--format", "npy", "-o", text(&out)], more].concat())
    };
    let draw = |name: &str, more: &[&str]| {
        let done = call(run(), name, more);
        assert_eq!(done.code, 0, "{}", done.err);
        (fs::read(dir.path().join(name).join("front.npy")).unwrap(), done.err)
    };
    let (exact, _) = draw("exact", &["--time", "1"]);
    assert_eq!(draw("none", &["--time", "1", "--static-within", "0"]).0, exact, "nothing rests that moves at all");
    let (resting, said) = draw("some", &["--time", "1", "--static-within", "1000"]);
    assert!(said.contains("splats rest, at most") && !said.contains(" 0 of"), "{said}");
    assert_ne!(resting, exact, "what rests stands half-way");
    call(run(), "beyond", &["--time", "1.5", "--static-within", "1"]).fails(2, &["--static-within", "1.5"]);
    call(ply(), "file", &["--static-within", "1"]).fails(2, &["needs a run"]);
}

#[test]
fn transforms_files_are_cameras_too() {
    let dir = tempfile::tempdir().unwrap();
    let own = data().join("transforms_test.json");
    let draw = |camera: &Path, out: &str| {
        let out = dir.path().join(out);
        gs4d(&["render", text(run()), "--camera", text(camera), "-o", text(&out), "--json"])
    };
    // The size comes from the images beside the file, or from the file.
    let files = draw(&own, "beside").json();
    let first = files["files"][0].as_str().unwrap();
    assert_eq!(files["files"].as_array().unwrap().len(), 2);
    assert_eq!(images::load_image(Path::new(first), &Limits::default()).unwrap().shape(), (48, 48, 3));
    let mut json: serde_json::Value = serde_json::from_str(&fs::read_to_string(&own).unwrap()).unwrap();
    let bare = camera(dir.path(), &json.to_string());
    draw(&bare, "bare").fails(3, &["camera.json", "`w`", "images beside"]);
    json["w"] = 32.into();
    json["h"] = 24.into();
    let sized = camera(dir.path(), &json.to_string());
    let files = draw(&sized, "sized").json();
    let first = images::load_image(Path::new(files["files"][0].as_str().unwrap()), &Limits::default()).unwrap();
    assert_eq!(first.shape(), (32, 24, 3));
}

#[test]
fn many_splats_are_inspected() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("three.ply");
    fs::write(&path, tiny_ply(&[[0.0, 1.0, 2.0], [f32::NAN, 0.0, 0.0], [1.0, 1.0, 4.0]])).unwrap();
    let json = good(&["inspect", text(&path), "--json"]).json();
    let s = &json["summary"];
    assert_eq!((s["splats"].as_u64(), s["non_finite_rows"].as_u64()), (Some(3), Some(1)));
    assert_eq!(s["non_finite_first"][0][0], 1);
    let z = s["columns"].as_array().unwrap().iter().find(|c| c["name"] == "z").unwrap().clone();
    assert_eq!((z["min"].as_f64(), z["max"].as_f64()), (Some(0.0), Some(4.0)));
    assert!(good(&["inspect", text(&path)]).out.contains("row 1, column means"));
}

#[test]
fn it_is_inspected_whether_splats_are_rendered_anti_aliased() {
    let dir = tempfile::tempdir().unwrap();
    let plain = gs_core::io::load_splats(ply(), &Limits::default()).unwrap();
    for (name, antialiased) in [("a.ply", true), ("b.ply", false), ("a.spz", true), ("b.spz", false)] {
        let path = dir.path().join(name);
        let splats = gs_core::io::RawSplats { antialiased, ..plain.clone() };
        gs_core::io::save_splats(&path, &splats, false).unwrap();
        assert_eq!(good(&["inspect", text(&path), "--json"]).json()["antialiased"], antialiased, "{name}");
        let words =
            if antialiased { "to be rendered anti-aliased\n" } else { "to be rendered without anti-aliasing\n" };
        assert!(good(&["inspect", text(&path)]).out.contains(words), "{name}");
    }
}

#[test]
fn a_video_goes_around_the_scene_while_time_passes() {
    let dir = tempfile::tempdir().unwrap();
    let all = ["render", text(run()), "--camera", "orbit", "--times", "0..1:5", "--format", "y4m", "--fps", "12"];
    let call = [&all[..], &["-o", text(dir.path()), "--json"]].concat();
    let answer = good(&call).json();
    let path = dir.path().join("video.y4m");
    assert_eq!(answer["files"][0], text(&path));
    let bytes = fs::read(&path).unwrap();
    let head = b"YUV4MPEG2 W48 H48 F12:1 Ip A1:1 C444\n";
    assert!(bytes.starts_with(head));
    assert_eq!(bytes.len(), head.len() + 5 * (6 + 3 * 48 * 48));
    let frame = |k: usize| &bytes[head.len() + k * (6 + 3 * 48 * 48)..][6..6 + 48 * 48];
    assert_ne!(frame(0), frame(2), "the camera goes on");
    gs4d(&call).fails(6, &["exists"]);
}

#[test]
fn time_passes_on_an_orbit_and_between_the_keys_of_a_path() {
    let dir = tempfile::tempdir().unwrap();
    let render = |name: &str, camera: &str, more: &[&str]| {
        let out = dir.path().join(name);
        let all = ["render", text(run()), "--camera", camera, "--size", "16x16", "--format", "npy", "-o", text(&out)];
        good(&[&all[..], more].concat());
        let mut files: Vec<_> = fs::read_dir(&out).unwrap().map(|f| f.unwrap().path()).collect();
        files.sort();
        let values = |f: PathBuf| npy::read(&fs::read(f).unwrap(), "npy", &Limits::default()).unwrap().to_f32();
        files.into_iter().map(values).collect::<Vec<Vec<f32>>>()
    };
    let orbit =
        [render("o", "orbit", &[]), render("o0", "orbit", &["--time", "0"]), render("o1", "orbit", &["--time", "1"])];
    assert_eq!(orbit.each_ref().map(Vec::len), [60; 3]);
    assert!(orbit[0][0] == orbit[1][0] && orbit[0][59] == orbit[2][59], "from the first to the last training image");
    assert!(orbit[0][59] != orbit[1][59], "this scene moves");

    let file = data().join("transforms_test.json");
    let (path, keys) = (render("p", &format!("path:{}", text(&file)), &[]), render("k", text(&file), &[]));
    let off = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    for (on_path, key) in [(0, 0), (59, keys.len() - 1)] {
        assert!(off(&path[on_path], &keys[key]) < 1e-3, "{on_path}");
    }
}

#[test]
fn pictures_have_the_size_and_angle_that_are_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let picture = |name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        good(&[&["render", text(run()), "--camera", "dataset:0", "-o", text(&out)][..], more].concat());
        let file = fs::read_dir(&out).unwrap().next().unwrap().unwrap().path();
        gs_core::io::images::load_image(&file, &gs_core::io::Limits::default()).unwrap()
    };
    let (own, twice) = (picture("own", &[]), picture("twice", &["--size", "96x96"]));
    assert_eq!([own.width, twice.width, twice.height], [48, 96, 96]);
    // The same view: means over pixels agree.
    let mean = |i: &gs_core::Image| i.data.iter().sum::<f32>() / i.data.len() as f32;
    assert!((mean(&own) - mean(&twice)).abs() < 0.02, "{} {}", mean(&own), mean(&twice));
    // A wider angle shows less of the object and more of what is behind it: white.
    let wide = picture("wide", &["--fov", "90"]);
    assert!(wide.width == 48 && mean(&wide) > mean(&own), "{} {}", mean(&wide), mean(&own));
    assert_eq!(picture("strip", &["--size", "64x32"]).height, 32);
    gs4d(&["render", text(run()), "--camera", "orbit", "--size", "big", "-o", "x"]).fails(2, &["1920x1080"]);
}

/// A stand-in for ffmpeg that keeps what it is given. It takes only names that are no protocols.
#[cfg(unix)]
#[test]
fn a_video_is_encoded_where_there_is_an_encoder() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let (bin, out) = (dir.path().join("bin"), dir.path().join("take:2"));
    fs::create_dir(&bin).unwrap();
    let all = ["render", text(run()), "--camera", "orbit", "--times", "0..1:3", "--format", "mp4", "-o", "take:2"];
    let call = |path: &str, more: &[&str]| {
        let mut command = command(&[&all[..], more].concat());
        let output = command.current_dir(dir.path()).env("PATH", path).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, err) = call(text(&bin), &[]);
    assert!(code == Some(2) && err.contains("ffmpeg") && err.contains("y4m") && !out.exists(), "{err}");
    let encoder = bin.join("ffmpeg");
    let script = "#!/bin/sh\n[ \"$1\" = -version ] && exit 0\nfor last; do :; done\n\
        case \"$last\" in file:/*) ;; *) exit 4;; esac\n/bin/cat > \"${last#file:}\"\n";
    fs::write(&encoder, script).unwrap();
    fs::set_permissions(&encoder, fs::Permissions::from_mode(0o755)).unwrap();
    let (code, err) = call(text(&bin), &[]);
    assert_eq!(code, Some(0), "{err}");
    let bytes = fs::read(out.join("video.mp4")).unwrap();
    assert!(bytes.starts_with(b"YUV4MPEG2 W48 H48") && bytes.len() > 3 * 48 * 48 * 3);
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1, "nothing unfinished stays");
    assert_eq!(call(text(&bin), &[]).0, Some(6), "nothing is overwritten");
    fs::write(&encoder, "#!/bin/sh\n[ \"$1\" = -version ] && exit 0\n/bin/cat >/dev/null\nexit 3\n").unwrap();
    let (code, err) = call(text(&bin), &["-f"]);
    assert!(code == Some(6) && err.contains("ffmpeg ended with"), "{err}");
    assert_eq!(fs::read(out.join("video.mp4")).unwrap(), bytes, "the older file stays");
}

#[test]
fn a_view_of_the_data_is_a_camera_at_any_time() {
    let dir = tempfile::tempdir().unwrap();
    let all = ["render", text(run()), "--camera", "dataset:1", "-o", text(dir.path())];
    good(&[&all[..], &["--times", "0..1:3"]].concat());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 3);
    gs4d(&["render", text(run()), "--camera", "dataset:9", "-o", text(dir.path())]).fails(2, &["N from 0 to 1"]);
    gs4d(&["render", text(ply()), "--camera", "dataset:0", "-o", text(dir.path())]).fails(2, &["needs a run"]);
    let named = gs4d(&["render", text(run()), "--camera", "obit", "-o", text(dir.path())]);
    named.fails(6, &["obit: cannot open: ", "dataset:N, orbit, path"]);
    let around = good(&["render", text(ply()), "--times", "0..1:2", "-o", text(dir.path())]);
    assert!(!around.err.contains("note:") && around.out.starts_with("2 images -> "), "{} {}", around.err, around.out);
    assert!(dir.path().join("orbit-0001.png").exists(), "the camera goes around unless it is named");
}

#[test]
fn a_camera_flies_through_those_of_a_run_or_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let out = ["--times", "0..1:3", "-o", text(dir.path())];
    good(&[&["render", text(run()), "--camera", "path"][..], &out].concat());
    let frame = |k: usize| fs::read(dir.path().join(format!("path-{k:04}.png"))).unwrap();
    assert!(frame(0) != frame(1) && frame(1) != frame(2));
    let key = |x: f64| {
        json!({"width": 32, "height": 24, "fx": 30, "fy": 30, "cx": 16, "cy": 12,
        "world_to_camera": [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]})
    };
    let keys = dir.path().join("keys.json");
    let file = format!("path:{}", text(&keys));
    let call = ["render", text(ply()), "--camera", &file, "-f"];
    fs::write(&keys, json!([key(0.0), key(1.0)]).to_string()).unwrap();
    good(&[&call[..], &out].concat());
    fs::write(&keys, json!([key(0.0)]).to_string()).unwrap();
    gs4d(&[&call[..], &out].concat()).fails(2, &["two cameras"]);
    gs4d(&[&["render", text(ply()), "--camera", "path"][..], &out].concat()).fails(2, &["needs a run"]);
}
