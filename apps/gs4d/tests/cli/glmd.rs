//! Motion between the stages of a run, from the command line.

use crate::support::{data, good, gs4d, run, text};
use std::fs;

#[test]
fn stages_of_a_run_are_shown_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a/out");
    let call = ["glmd", text(run()), "--times", "0..1:3", "-o", text(&out), "--json"];
    let json = good(&call).json();
    assert_eq!(json["moments"].as_array().unwrap().len(), 3);
    assert_eq!(json["masks"], "rigid bodies of the generated scene");
    let flows = json["moments"][1]["flows"].as_array().unwrap();
    let which: Vec<_> = flows.iter().map(|f| (f["step"].as_str().unwrap(), f["by"].as_str().unwrap())).collect();
    assert_eq!(which, [("canonical-full", "model"), ("canonical-full", "farneback")]);
    assert!(flows[0]["mean"].as_f64().unwrap() > 0.0, "a trained field moves something: {flows:?}");
    let written: serde_json::Value = serde_json::from_slice(&fs::read(out.join("glmd.json")).unwrap()).unwrap();
    assert_eq!(written, json);
    let page = fs::read_to_string(out.join("glmd.html")).unwrap();
    assert!(page.matches("data:image/png;base64,").count() == 15 && page.contains("t = 0.500"));
    assert!(out.join("t_002.png").exists() && !out.join("t_003.png").exists());
    gs4d(&call).fails(6, &["exists", "t_000.png", "-f"]);
    let one =
        good(&[&call[..], &["-f", "--flow", "model", "--quantile", "0.95", "--anchor", "earlier"]].concat()).json();
    assert_eq!((one["moments"][0]["flows"].as_array().unwrap().len(), &one["anchor"]), (1, &"earlier".into()));
}

#[test]
fn cameras_and_masks_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let (out, masks) = (dir.path().join("out"), dir.path().join("masks"));
    let call = |more: &[&str]| gs4d(&[&["glmd", text(run()), "--times", "0.5", "-o", text(&out)], more].concat());
    call(&["--camera", "test:9"]).fails(2, &["test:9", "2 views"]);
    let file = data().join("transforms_test.json");
    call(&["--camera", &format!("{}#7", file.display())]).fails(2, &["#7", "2 cameras"]);
    gs4d(&["glmd", text(run()), "--times", "1..2", "-o", text(&out)]).fails(2, &["A..B:N"]);
    fs::create_dir(&masks).unwrap();
    call(&["--mask", text(&masks)]).fails(2, &["PNG files"]);
    fs::copy(data().join("test/r_000.png"), masks.join("a.png")).unwrap();
    let given = call(&["--mask", text(&masks), "--camera", &format!("{}#1", file.display()), "--json"]).json();
    assert_eq!(given["masks"], "given");
    fs::copy(data().join("test/r_001.png"), masks.join("b.png")).unwrap();
    call(&["--mask", text(&masks), "-f"]).fails(3, &["2 masks for 1 moments"]);
}
