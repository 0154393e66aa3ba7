//! Data larger than memory.

use crate::support::{Call, good, text};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Images of as many pixels as those of 1080p, 8.3 MB each when decoded; all of them are 16.6 GB.
const SIDE: &str = "1440";
/// Files of each image that is rendered.
const COPIES: usize = 200;
/// Address space of the training, KiB.
const LIMIT: &str = "3145728";

/// Ten views, each in 200 files.
fn make(data: &Path) {
    let views = ["--train-views", "10", "--val-views", "1", "--test-views", "1"];
    good(&[&["synth", "sheet", "-o", text(data), "--size", SIDE][..], &views].concat());
    let table = data.join("transforms_train.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&table).unwrap()).unwrap();
    let frames = json["frames"].as_array_mut().unwrap();
    for k in 10..10 * COPIES {
        let mut frame = frames[k % 10].clone();
        let original = format!("{}.png", frame["file_path"].as_str().unwrap());
        frame["file_path"] = format!("train/copy_{k}").into();
        fs::hard_link(data.join(original), data.join(format!("train/copy_{k}.png"))).unwrap();
        frames.push(frame);
    }
    fs::write(&table, json.to_string()).unwrap();
}

#[test]
#[ignore = "minutes: cargo test -p gs4d --test cli large:: -- --ignored"]
fn two_thousand_large_images_train_in_three_gibibytes() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    make(&data);
    let limited = |cache: &str, steps: &str| {
        let limit = ["-c", "ulimit -v $0; exec \"$@\"", LIMIT, env!("CARGO_BIN_EXE_gs4d"), "train", text(&data)];
        let run = dir.path().join(cache);
        let how = ["-m", "static3d", "--preset", "tiny", "--steps", steps, "-q", "--image-cache", cache, "-o"];
        Call::of(&Command::new("sh").args(limit).args(how).arg(run).output().unwrap())
    };
    let trained = limited("1024", "400");
    assert_eq!(trained.code, 0, "{}", trained.err);
    // The limit is one: a cache that may grow past it meets it.
    assert_ne!(limited("16384", "400").code, 0, "three gibibytes hold 400 images");
}
