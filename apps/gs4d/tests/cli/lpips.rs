//! LPIPS with the user's weights, and frames rounded to 8 bit.

use crate::support::{data, good, gs4d, run, text, train};
use gs_metrics::testkit::{alex, file};
use std::fs;

#[test]
fn a_run_and_a_folder_have_the_same_lpips_and_it_stays_with_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let (own, weights) = (dir.path().join("run"), dir.path().join("alex.safetensors"));
    fs::write(&weights, file(&alex())).unwrap();
    train(data(), &own, &[]);
    let before = good(&["eval", text(&own), "--json"]).json();
    assert!(before["mean"]["lpips"].is_null());
    let answer = good(&["eval", text(&own), "--lpips", text(&weights), "--json"]).json();
    let lpips = answer["mean"]["lpips"].as_f64().unwrap();
    assert!(lpips > 1e-4 && answer["lpips_weights"].as_str().unwrap().starts_with("alex "), "{lpips}");
    assert_eq!(answer["mean"]["psnr"], before["mean"]["psnr"]);
    let kept: serde_json::Value = serde_json::from_str(&fs::read_to_string(own.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(kept["mean"]["lpips"].as_f64(), Some(lpips));
    let said = good(&["eval", text(&own), "--lpips", text(&weights)]).out;
    assert!(said.contains("lpips ") && said.contains("(alex "), "{said}");

    let unit = good(&["eval", text(&own), "--lpips", text(&weights), "--lpips-range", "unit", "--json"]).json();
    assert!(unit["lpips_weights"].as_str().unwrap().ends_with("colours in [0, 1]"));
    assert!((unit["mean"]["lpips"].as_f64().unwrap() - lpips).abs() > 1e-6);
    good(&["eval", text(&own), "--lpips", text(&weights)]);

    // Rounded frames are those of PNG files.
    let frames = dir.path().join("frames");
    let cameras = data().join("transforms_test.json");
    good(&["render", text(&own), "--camera", text(&cameras), "--format", "png", "-o", text(&frames)]);
    let rounded = ["--lpips", text(&weights), "--quantise", "round", "--json"];
    let of_run = good(&[&["eval", text(&own)][..], &rounded].concat()).json();
    assert!(of_run["protocol"].as_str().unwrap().contains("rounded to 8 bit"), "{}", of_run["protocol"]);
    let after: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(own.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(after, kept, "scores of another protocol are not kept");
    let truth = data().join("test");
    let background = format!("--background={}", if before["background"][0] == 1.0 { "white" } else { "black" });
    let folders = ["eval", "--pred", text(&frames), "--gt", text(&truth), background.as_str()];
    let of_folder = good(&[&folders[..], &rounded].concat()).json();
    for score in ["psnr", "lpips"] {
        let [a, b] = [&of_run, &of_folder].map(|j| j["mean"][score].as_f64().unwrap());
        assert!((a / b - 1.0).abs() < 1e-6, "{score}: {a} {b}");
    }

    // At half size both are scored from 8 bit, and nothing is kept.
    let half = ["--half", "--json"];
    let halved = good(&[&["eval", text(&own)][..], &half].concat()).json();
    let of_folder = good(&[&folders[..], &half].concat()).json();
    for protocol in [&halved, &of_folder].map(|j| j["protocol"].as_str().unwrap()) {
        assert!(protocol.contains("rounded to 8 bit") && protocol.contains("half size"), "{protocol}");
    }
    for score in ["psnr", "ssim"] {
        let [a, b, full] = [&halved, &of_folder, &of_run].map(|j| j["mean"][score].as_f64().unwrap());
        assert!((a / b - 1.0).abs() < 1e-6 && (a / full - 1.0).abs() > 1e-5, "{score}: {a} {b} {full}");
    }
    let after = fs::read_to_string(own.join("metrics.json")).unwrap();
    assert_eq!(serde_json::from_str::<serde_json::Value>(&after).unwrap(), kept);
    gs4d(&["eval", text(&own), "--half", "--fit-colors"]).fails(2, &["--half", "--fit-colors"]);
}

#[test]
fn files_that_are_no_weights_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let weights = dir.path().join("weights.safetensors");
    fs::write(&weights, b"PK").unwrap();
    let call = ["eval", text(run()), "--lpips", text(&weights)];
    gs4d(&call).fails(3, &["no safetensors file", "weights.safetensors", "lpips and safetensors"]);
}
