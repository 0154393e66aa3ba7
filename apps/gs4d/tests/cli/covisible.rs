//! Masks of what training images show of held-out ones.

use crate::captures::write_hypernerf;
use crate::support::{data, good, gs4d, text};
use gs_core::io::{Limits, images::load_image};
use gs_data::{DataOptions, Dataset, ImageCache};
use std::fs;

#[test]
fn a_capture_reads_the_masks_that_were_made_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    write_hypernerf(&data);
    let out = data.join("covisible/2x/val");
    let call = ["covisible", text(&data), "-o", text(&out), "--least", "2"];
    let json = good(&[&call[..], &["--json"]].concat()).json();
    assert_eq!((&json["layout"], &json["images"], &json["needed"]), (&"hypernerf".into(), &6.into(), &2.into()));
    let views = json["views"].as_array().unwrap();
    assert_eq!(views.len(), 3);
    assert!(json["use"].as_str().unwrap().contains("scored with them"), "{json}");
    let uses = |json: &serde_json::Value| json["use"].as_str().unwrap().to_owned();
    assert!(uses(&json).contains("scored with them"), "{json}");
    let other_way = data.join("rgb/../covisible/2x/val");
    let same = ["covisible", text(&data), "-o", text(&other_way), "--least", "2", "-f", "--json"];
    assert_eq!(uses(&good(&same).json()), uses(&json), "one folder, however it is written");
    let read = Dataset::open(&data, &DataOptions::default()).unwrap();
    let images = ImageCache::new(0, 1.0);
    for (view, written) in read.test.iter().zip(views) {
        assert_eq!(written["name"], view.name.as_str());
        let mask = images.mask(view).unwrap().expect("a mask");
        let share = mask.data.iter().map(|m| f64::from(*m)).sum::<f64>() / mask.data.len() as f64;
        assert!(mask.data.iter().all(|m| *m == 0.0 || *m == 1.0));
        assert!((written["share"].as_f64().unwrap() - share).abs() < 1e-9 && share > 0.0, "{written} {share}");
    }
    gs4d(&call).fails(6, &["mask exists", "000001.png", "-f"]);
    let before = fs::read(out.join("000001.png")).unwrap();
    let said = good(&[&call[..], &["-f", "--threads", "1"]].concat()).out;
    assert!(said.contains("3 masks in") && said.contains("at least 2 of 6 training images"), "{said}");
    assert_eq!(fs::read(out.join("000001.png")).unwrap(), before, "the same bytes for any number of threads");
}

#[test]
fn a_layout_without_such_masks_gets_a_folder_of_them() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("masks");
    let call = ["covisible", text(data()), "-o", text(&out), "--images", "4", "--least", "1", "--flow-only"];
    let said = good(&call).out;
    assert!(said.contains("1 of 4 training images, by flow there and back\n") && said.contains("--mask"), "{said}");
    let mask = load_image(&out.join("r_001.png"), &Limits::default()).unwrap();
    assert_eq!(mask.shape(), (48, 48, 1));
    // The folder masks scores of images by the same names.
    let test = data().join("test");
    let masked = good(&["eval", "--pred", text(&test), "--gt", text(&test), "--mask", text(&out), "--json"]).json();
    assert!(masked["mean"]["masked"]["ssim"].is_f64(), "{masked}");
}

#[test]
fn what_cannot_be_compared_is_said_first() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("masks");
    let call = |more: &[&str]| gs4d(&[&["covisible", text(data()), "-o", text(&out)], more].concat());
    call(&["--split", "train"]).fails(2, &["training images", "--split val"]);
    call(&["--split", "extrapolate"]).fails(3, &["no views"]);
    call(&["--images", "5"]).fails(3, &["at least 6 training images, and 5", "--least"]);
    call(&["--threshold", "-1"]).fails(2, &["invalid value '-1'"]);
    call(&["--set", "init.points=3"]).fails(2, &["init.points=3", "no setting of the data"]);
    assert!(!out.exists(), "nothing is made before it is clear that it can be");
}
