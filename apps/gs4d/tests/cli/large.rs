//! Data larger than memory.

use crate::support::{Call, good, text};
use std::process::Command;

/// Images of as many pixels as those of 1080p, 8.3 MB each when decoded; all of them are 16.6 GB.
const SIDE: &str = "1440";
const VIEWS: &str = "2000";
/// Address space of the training, KiB.
const LIMIT: &str = "3145728";

#[test]
#[ignore = "makes 2000 images of two megapixels: minutes, and gigabytes of disk"]
fn two_thousand_large_images_train_in_three_gibibytes() {
    let dir = tempfile::tempdir().unwrap();
    let (data, out) = (dir.path().join("data"), dir.path().join("run"));
    let views = ["--train-views", VIEWS, "--val-views", "1", "--test-views", "2", "--supersample", "1"];
    good(&[&["synth", "sheet", "-o", text(&data), "--size", SIDE][..], &views].concat());
    let limited = |words: &[&str]| {
        let limit = ["-c", "ulimit -v $0; exec \"$@\"", LIMIT, env!("CARGO_BIN_EXE_gs4d")];
        Call::of(&Command::new("sh").args(limit).args(words).output().unwrap())
    };
    let start = ["train", text(&data), "-m", "fourdgs", "--preset", "tiny", "--steps", "40", "-q"];
    let trained = limited(&[&start[..], &["--image-cache", "1024", "-o", text(&out)]].concat());
    assert_eq!(trained.code, 0, "{}", trained.err);
    // The limit is one: a cache that may grow past it runs into it.
    let again = dir.path().join("again");
    let long = ["--steps", "400", "--image-cache", "16384", "-o", text(&again)];
    let unbounded = limited(&[&start[..7], &["-q"], &long[..]].concat());
    assert_ne!(unbounded.code, 0, "three gibibytes hold 400 images");
}
