//! Inputs that are wrong on purpose: typed errors that name file and field, the right exit code, never a crash.

use crate::support::{CAMERA, data, good, gs4d, ply, text, tiny_ply};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// A copy of the shared data set to spoil.
fn copy_of_data(to: &Path) {
    for folder in ["train", "val", "test"] {
        fs::create_dir_all(to.join(folder)).unwrap();
        for entry in fs::read_dir(data().join(folder)).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), to.join(folder).join(entry.file_name())).unwrap();
        }
        let name = format!("transforms_{folder}.json");
        fs::copy(data().join(&name), to.join(&name)).unwrap();
    }
}

/// Changes the training transforms, then trains; the message must name the file and the words given.
fn refused(code: i32, words: &[&str], change: impl FnOnce(&mut Value, &Path)) {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("data");
    copy_of_data(&root);
    let file = root.join("transforms_train.json");
    let mut json: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    change(&mut json, &root);
    fs::write(&file, json.to_string()).unwrap();
    let out = dir.path().join("run");
    let recipe = ["-m", "static3d", "--preset", "tiny", "--steps", "2", "--set", "init.from=random"];
    let call = gs4d(&[&["train", text(&root), "-o", text(&out)][..], &recipe].concat());
    call.fails(code, words);
    assert!(call.err.contains("\n  do "), "says what to do: {}", call.err);
    assert!(!out.join("checkpoints/latest").exists(), "nothing was learnt");
}

#[test]
fn data_faults_name_file_and_field() {
    refused(3, &["data.time", "transforms_train.json", "frames[3].time"], |j, _| j["frames"][3]["time"] = json!(7.5));
    refused(3, &["transforms_train.json", "transform_matrix"], |j, _| {
        j["frames"][1]["transform_matrix"][0][0] = json!(9.0);
    });
    refused(3, &["transforms_train.json", "camera_angle_x"], |j, _| j["camera_angle_x"] = json!("wide"));
    refused(3, &["r_002"], |_, root| fs::remove_file(root.join("train/r_002.png")).unwrap());
    refused(3, &["leaves the data folder"], |j, _| j["frames"][0]["file_path"] = json!("../../secret"));
    refused(3, &["r_004.png"], |_, root| fs::write(root.join("train/r_004.png"), b"\x89PNG\r\n\x1a\nshort").unwrap());
}

#[test]
fn broken_json_and_unknown_folders_are_data_errors() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("data");
    copy_of_data(&root);
    let whole = fs::read(root.join("transforms_train.json")).unwrap();
    for cut in [0, 1, whole.len() / 3, whole.len() - 2] {
        fs::write(root.join("transforms_train.json"), &whole[..cut]).unwrap();
        let call = gs4d(&["train", text(&root), "-m", "static3d", "-o", text(&dir.path().join("run"))]);
        call.fails(3, &["transforms_train.json"]);
    }
    let empty = dir.path().join("empty");
    fs::create_dir(&empty).unwrap();
    gs4d(&["train", text(&empty), "-m", "static3d", "-o", text(&dir.path().join("r"))])
        .fails(3, &["data.layout", "--set data.layout=NAME"]);
    gs4d(&["train", text(&dir.path().join("none")), "-m", "static3d", "-o", text(&dir.path().join("r"))])
        .fails(3, &["there is no folder"]);
}

#[test]
fn an_image_that_asks_for_too_much_memory_is_a_limit() {
    // A PNG header of 30000 x 30000 pixels and nothing behind it.
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    png.extend([30_000u32, 30_000].map(u32::to_be_bytes).concat());
    png.extend([8, 6, 0, 0, 0]);
    let crc = crc32(&png[12..]);
    png.extend(crc.to_be_bytes());
    png.extend(b"\0\0\0\0IEND\xae\x42\x60\x82");
    refused(5, &["limits.file", ".png", "30000x30000"], |_, root| {
        for view in fs::read_dir(root.join("train")).unwrap() {
            fs::write(view.unwrap().path(), &png).unwrap();
        }
    });
}

/// CRC-32 as PNG uses it.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: u8| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xedb8_8320 } else { c >> 1 })
    };
    !bytes.iter().fold(!0, |crc, &b| step(crc, b))
}

#[test]
fn a_run_that_explodes_stops_with_four_and_keeps_its_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let base = ["train", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", "60", "-o", text(&out)];
    let sets = ["--set", "schedule.lr.cloud.log_scales.start=1e30", "--set", "schedule.lr.cloud.log_scales.end=1e30"];
    let more = ["--set", "run.checkpoint_every=1", "--quiet"];
    let call = gs4d(&[&base[..], &sets, &more].concat());
    call.fails(4, &["numeric", "step", &format!("is good: gs4d inspect {}", out.display())]);
    assert!(gs_train::checkpoint::load_newest(&out.join("checkpoints")).is_ok());

    let call = gs4d(&[&base[..], &sets, &["--quiet", "-f"]].concat());
    call.fails(4, &["no checkpoint was saved", "learning rates"]);
    assert!(!call.err.contains("inspect") && !call.err.contains("last checkpoint"), "{}", call.err);
    let call = gs4d(&["inspect", text(&out)]);
    call.fails(3, &["checkpoint.none", "there is no checkpoint in"]);
    assert!(!call.err.contains("damaged"), "{}", call.err);
}

#[test]
fn a_damaged_test_image_costs_no_training() {
    let dir = tempfile::tempdir().unwrap();
    let (root, out) = (dir.path().join("data"), dir.path().join("run"));
    copy_of_data(&root);
    let image = root.join("test/r_001.png");
    let whole = fs::read(&image).unwrap();
    fs::write(&image, &whole[..whole.len() / 2]).unwrap();
    let base = ["train", text(&root), "-m", "static3d", "--preset", "tiny", "--steps", "3", "-o", text(&out), "-q"];
    let resume = ["resume", text(&out), "--accept-changed-data", "-q"];
    let advice = format!("gs4d {}", resume[..3].join(" "));
    gs4d(&base).fails(3, &["r_001.png", "the run is saved at step 3", &advice]);
    fs::write(&image, &whole).unwrap();
    let again = [&base[..], &["--continue"]].concat();
    gs4d(&again).fails(3, &["data.changed", &advice]);
    good(&resume);
    assert!(out.join("metrics.json").is_file() && out.join("report.html").is_file());
    good(&again);
    good(&["eval", text(&out)]);
}

#[test]
fn splat_files_are_refused_by_row_and_place() {
    let dir = tempfile::tempdir().unwrap();
    let camera = dir.path().join("camera.json");
    fs::write(&camera, CAMERA).unwrap();
    let draw = |bytes: &[u8]| {
        let path = dir.path().join("bad.ply");
        fs::write(&path, bytes).unwrap();
        gs4d(&["render", text(&path), "--camera", text(&camera), "-o", text(&dir.path().join("out"))])
    };
    draw(&tiny_ply(&[[0.0, 0.0, 3.0], [0.0, f32::NAN, 3.0]])).fails(3, &["bad.ply", "row 1"]);
    let whole = tiny_ply(&[[0.0, 0.0, 3.0]]);
    for cut in [3, 40, whole.len() - 1] {
        draw(&whole[..cut]).fails(3, &["bad.ply"]);
    }
    let huge = String::from_utf8_lossy(&whole[..whole.len() - 56]).replace("vertex 1", "vertex 4000000000");
    let call = draw(huge.as_bytes());
    assert!(matches!(call.code, 3 | 5), "{}", call.err);
    draw(b"solid cube").fails(3, &["bad.ply"]);
    assert!(!dir.path().join("out").exists(), "a refused scene leaves no folder");
}

#[test]
fn cameras_are_refused_by_entry_and_field() {
    let dir = tempfile::tempdir().unwrap();
    let camera = dir.path().join("camera.json");
    let draw = |json: &str| {
        fs::write(&camera, json).unwrap();
        gs4d(&["render", text(ply()), "--camera", text(&camera), "-o", text(&dir.path().join("out"))])
    };
    draw(&CAMERA.replace("\"fx\": 20", "\"fx\": -3")).fails(3, &["camera.json", "fx"]);
    draw(&CAMERA.replace("\"fx\": 20,", "")).fails(3, &["camera.json", "fx"]);
    draw(&CAMERA.replace("[1,0,0,0]", "[5,0,0,0]")).fails(3, &["camera.json", "rotation"]);
    draw(&format!("[{CAMERA}, {}]", CAMERA.replace("\"width\": 20", "\"width\": 1e9")))
        .fails(3, &["camera.json", "1", "width"]);
    draw("[]").fails(3, &["no camera"]);
    draw("{").fails(3, &["camera.json"]);
    fs::remove_file(&camera).unwrap();
    gs4d(&["render", text(ply()), "--camera", text(&camera), "-o", "x"]).fails(6, &["camera.json"]);
}

#[test]
fn more_memory_than_may_be_taken_is_refused_before_it_is_taken() {
    let dir = tempfile::tempdir().unwrap();
    let (camera, out) = (dir.path().join("camera.json"), dir.path().join("out"));
    fs::write(&camera, CAMERA.replace("\"width\": 20, \"height\": 16", "\"width\": 32768, \"height\": 32768")).unwrap();
    let picture = ["render", text(ply()), "--camera", text(&camera), "-o", text(&out), "--max-mem", "1000"];
    gs4d(&picture).fails(5, &["limits.memory", "32768x32768", "1000 MiB", "--max-mem"]);
    assert!(!out.exists(), "nothing was written");
    let many = dir.path().join("many.ply");
    fs::write(&many, tiny_ply(&vec![[0.0, 0.0, 3.0]; 20_000])).unwrap();
    gs4d(&["inspect", text(&many), "--max-mem", "2"]).fails(5, &["limits.file", "many.ply", "memory"]);
    assert_eq!(gs4d(&["inspect", text(&many), "--max-mem", "20"]).code, 0);
}

/// Without `--max-mem` the limit follows from the address space that the shell allows.
#[cfg(target_os = "linux")]
#[test]
fn a_small_address_space_is_no_reason_to_abort() {
    let dir = tempfile::tempdir().unwrap();
    let many = dir.path().join("many.ply");
    fs::write(&many, tiny_ply(&vec![[0.0, 0.0, 3.0]; 2_000_000])).unwrap();
    let script = format!("ulimit -v 250000; exec {} inspect {} --threads 1", env!("CARGO_BIN_EXE_gs4d"), text(&many));
    let output = std::process::Command::new("sh").args(["-c", &script]).output().unwrap();
    crate::support::Call::of(&output).fails(5, &["limits.file", "memory"]);
}

#[test]
fn absurd_settings_are_refused_by_name_and_range() {
    let dir = tempfile::tempdir().unwrap();
    let train = |method: &str, set: &str| {
        let out = dir.path().join("run");
        gs4d(&["train", text(data()), "-m", method, "--preset", "tiny", "--steps", "1", "--set", set, "-o", text(&out)])
    };
    train("scaffold", "decoder.appearance=9223372036854775807").fails(2, &["`decoder.appearance`", "from 0 to 1024"]);
    train("fourdgs", "field.hexplane.channels=80000").fails(2, &["`field.hexplane.channels` = 80000", "1024"]);
    train("defgs", "init.points=4294967295").fails(2, &["`init.points`"]);
    let out = dir.path().join("run");
    let wide = ["--set", "field.width=4096", "--set", "field.depth=64", "-o", text(&out)];
    let call = [&["train", text(data()), "-m", "defgs", "--preset", "tiny", "--steps", "1"][..], &wide].concat();
    gs4d(&call).fails(2, &["parameters", "268435456"]);
    gs4d(&["config", "fourdgs", "--set", "run.log_every=0"]).fails(2, &["`run.log_every` = 0"]);
}
