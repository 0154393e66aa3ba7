//! Scores of folders of images.

use crate::support::{data, good, gs4d, run, text};
use std::fs;
use std::path::Path;

/// Copies the test images of the shared data.
fn copy(to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(data().join("test")).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

#[test]
fn equal_folders_are_perfect_and_others_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (dir.path().join("a"), dir.path().join("b"));
    copy(&a);
    copy(&b);
    let json = good(&["eval", "--pred", text(&a), "--gt", text(&b), "--json"]).json();
    assert_eq!((json["perfect_views"].as_u64(), json["mean"]["ssim"].as_f64()), (Some(2), Some(1.0)));
    assert!(json["mean"]["psnr"].is_null(), "infinite values are counted, not averaged");
    // The images have alpha: over white, the scored background differs from black.
    fs::copy(data().join("train/r_000.png"), a.join("r_000.png")).unwrap();
    let score = |background: &str| {
        let call = good(&["eval", "--pred", text(&a), "--gt", text(&b), "--background", background, "--json"]);
        call.json()["mean"]["psnr"].as_f64().unwrap()
    };
    let (black, white) = (score("black"), score("white"));
    assert!(black > 5.0 && black < 40.0 && white > 5.0 && (black - white).abs() > 0.1, "{black} {white}");
    let table = good(&["eval", "--pred", text(&a), "--gt", text(&b)]).out;
    assert!(table.contains("r_000") && table.contains("mean") && table.contains("inf"), "{table}");
}

#[test]
fn metrics_are_chosen_and_masks_apply() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (dir.path().join("a"), dir.path().join("b"));
    copy(&a);
    copy(&b);
    fs::copy(data().join("train/r_000.png"), a.join("r_000.png")).unwrap();
    let json = good(&["eval", "--pred", text(&a), "--gt", text(&b), "--metrics", "psnr", "--json"]).json();
    assert!(json["mean"]["psnr"].is_f64() && json["mean"]["ssim"].is_null());
    let masked =
        good(&["eval", "--pred", text(&a), "--gt", text(&b), "--mask", text(&b), "--metrics", "psnr,ssim", "--json"]);
    let mean = masked.json()["mean"].clone();
    assert!(mean["psnr"].is_f64() && mean["masked"]["psnr"].is_f64() && mean["masked"]["ssim"].is_f64(), "{mean}");
    assert_ne!(mean["psnr"], mean["masked"]["psnr"]);
    gs4d(&["eval", "--pred", text(&a), "--gt", text(&b), "--metrics", "lpips"]).fails(2, &["proxy", "masked"]);
    gs4d(&["eval", "--pred", text(&a), "--gt", text(&b), "--metrics", "masked"]).fails(2, &["--mask"]);
    gs4d(&["eval", "--pred", text(&a), "--gt", text(&b), "--no-trim"]).fails(2, &["tof"]);
}

#[test]
fn partners_must_exist_and_fit() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (dir.path().join("a"), dir.path().join("b"));
    copy(&a);
    copy(&b);
    fs::rename(a.join("r_001.png"), a.join("other.png")).unwrap();
    gs4d(&["eval", "--pred", text(&a), "--gt", text(&b)]).fails(3, &["other", text(&b)]);
    fs::remove_file(a.join("other.png")).unwrap();
    gs4d(&["eval", "--pred", text(&a), "--gt", text(&b)]).fails(3, &["r_001", text(&a)]);
    fs::write(a.join("r_001.png"), b"no image").unwrap();
    gs4d(&["eval", "--pred", text(&a), "--gt", text(&b)]).fails(3, &["r_001.png"]);
    gs4d(&["eval", "--pred", text(dir.path()), "--gt", text(&b)]).fails(3, &["no image"]);
    gs4d(&["eval", "--pred", text(&dir.path().join("none")), "--gt", text(&b)]).fails(6, &["none"]);
}

#[test]
fn videos_are_scored_by_motion() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (dir.path().join("a"), dir.path().join("b"));
    fs::create_dir_all(&a).unwrap();
    fs::create_dir_all(&b).unwrap();
    // Eight views of the generated scene as if they were a video; other names than the truths.
    for i in 0..8 {
        let view = |k: usize| data().join(format!("train/r_{k:03}.png"));
        fs::copy(view(i), a.join(format!("render_{i}.png"))).unwrap();
        fs::copy(view(i.max(1)), b.join(format!("{:06}.png", 40 + i))).unwrap();
    }
    let base = ["eval", "--pred", text(&a), "--gt", text(&b), "--metrics", "psnr,tof"];
    let with = |more: &[&str]| good(&[&base[..], more, &["--json"]].concat()).json();
    let trimmed = with(&[]);
    assert_eq!(trimmed["tof"]["pairs"].as_array().unwrap().len(), 3);
    assert_eq!(trimmed["tof"]["mean"].as_f64(), Some(0.0), "the frames differ at the left-out end only");
    let whole = with(&["--no-trim", "--no-crop", "--quantise", "round"]);
    assert_eq!(whole["tof"]["pairs"][0]["name"], "render_1");
    assert!(whole["tof"]["mean"].as_f64().unwrap() > 0.0);
    assert!(whole["protocol"].as_str().unwrap().contains("rounded to 8 bit"), "{whole}");
    let table = good(&[&base[..], &["--no-crop"]].concat()).out;
    assert!(table.contains("tof px") && table.contains("whole frames") && !table.contains("ssim  "), "{table}");
    fs::remove_file(b.join("000047.png")).unwrap();
    gs4d(&base).fails(3, &["render_7", "8 and 7"]);
    (5..8).for_each(|i| fs::remove_file(a.join(format!("render_{i}.png"))).unwrap());
    (45..47).for_each(|i| fs::remove_file(b.join(format!("{i:06}.png"))).unwrap());
    gs4d(&base).fails(3, &["at least 6 frames", "--no-trim", "leave tof out of --metrics"]);
}

#[test]
fn a_run_has_motion_only_along_a_video() {
    // The test views of the generated scene are of several cameras.
    gs4d(&["eval", text(run()), "--metrics", "tof"]).fails(3, &["one camera", "--split"]);
    gs4d(&["eval", text(run()), "--metrics", "masked"]).fails(3, &["mask"]);
}

#[test]
fn sizes_must_be_equal_and_large_enough() {
    let dir = tempfile::tempdir().unwrap();
    let small = dir.path().join("small");
    let views = ["--train-views", "1", "--test-views", "2"];
    good(&[&["synth", "balls", "-o", text(&small), "--size", "24"][..], &views].concat());
    let (a, b) = (small.join("test"), data().join("test"));
    gs4d(&["eval", "--pred", text(&a), "--gt", text(&b)]).fails(3, &["(24, 24, 3)", "(48, 48, 3)", "r_000.png"]);
    let tof = ["eval", "--pred", text(&a), "--gt", text(&a), "--metrics", "psnr,tof"];
    gs4d(&tof).fails(3, &["24x24", "--no-crop", "leave tof out of --metrics", "r_000.png"]);
}
