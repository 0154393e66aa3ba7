//! Images that were not exposed alike: made, trained on, scored.

use crate::support::{good, gs4d, text};
use std::fs;

#[test]
fn unequal_exposures_are_made_fitted_and_scored() {
    let dir = tempfile::tempdir().unwrap();
    let (data, plain, fit) = (dir.path().join("data"), dir.path().join("plain"), dir.path().join("fit"));
    let views = ["--train-views", "6", "--val-views", "1", "--test-views", "2", "--size", "32"];
    good(&[&["synth", "balls", "--gains", "0.3", "-o", text(&data)][..], &views].concat());
    let gains: serde_json::Value = serde_json::from_str(&fs::read_to_string(data.join("gains.json")).unwrap()).unwrap();
    assert_eq!(gains["views"].as_array().unwrap().len(), 6);
    let train = [
        "train",
        text(&data),
        "-m",
        "static3d",
        "--preset",
        "tiny",
        "--steps",
        "60",
        "--set",
        "schedule.background=black",
    ];
    let said = good(&[&train[..], &["-o", text(&plain)]].concat()).out;
    assert!(!said.contains("in the colours of the images"), "{said}");
    let said = good(&[&train[..], &["-o", text(&fit), "--set", "schedule.exposure.fit=true"]].concat()).out;
    assert!(said.contains("in the colours of the images   psnr "), "{said}");
    let log = fs::read_to_string(fit.join("log.jsonl")).unwrap();
    assert!(log.contains("\"exposure\""), "{log}");
    let kept: serde_json::Value = serde_json::from_str(&fs::read_to_string(fit.join("metrics.json")).unwrap()).unwrap();
    let [own, fitted] = [&kept["mean"]["psnr"], &kept["mean"]["fitted"]["psnr"]].map(|v| v.as_f64().unwrap());
    assert!(fitted > own, "{own} {fitted}");
    // A run without maps gets the scores when it is asked for them.
    let asked = good(&["eval", text(&plain), "--fit-colors", "--json"]).json();
    assert!(asked["mean"]["fitted"]["ssim"].as_f64().is_some());
    assert!(asked["protocol"].as_str().unwrap().contains("linear map of colours"));
    assert!(good(&["eval", text(&plain), "--json"]).json()["mean"].get("fitted").is_none());
    // A run with offsets is scored with them.
    let (affine, sets) = (dir.path().join("affine"), ["schedule.exposure.fit=true", "schedule.exposure.offset=true"]);
    good(&[&train[..], &["-o", text(&affine), "--set", sets[0], "--set", sets[1]]].concat());
    let scored = good(&["eval", text(&affine), "--json"]).json();
    assert_eq!(scored["mean"]["fitted"]["offset"], true);
    assert!(scored["protocol"].as_str().unwrap().contains("affine map of colours"));

    let (nerfies, far) = (dir.path().join("nerfies"), dir.path().join("far"));
    let call = ["synth", "balls", "--layout", "nerfies", "--gains", "0.3", "-o", text(&nerfies)];
    gs4d(&call).fails(2, &["gains are for the layout dnerf"]);
    gs4d(&["synth", "balls", "--gains", "3", "-o", text(&far)]).fails(2, &["gains"]);
    assert!(!far.exists(), "what cannot be is refused before anything is written");
}
