//! Checkpoints of other codes as runs. What their splats are is tested in gs4d-checkpoints; here, that such a run is one as any other.

use crate::support::{data, good, gs4d, text};
use std::fs;
use std::path::PathBuf;

fn golden(name: &str) -> PathBuf {
    let tests = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../gs4d-checkpoints/tests/golden");
    tests.join(format!("{name}.safetensors"))
}

#[test]
fn a_checkpoint_becomes_a_run_that_is_scored_rendered_exported_and_lengthened() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let file = golden("4dgaussians");
    let call = ["import-checkpoint", text(&file), "--data", text(data()), "-o", text(&run)];
    let first = good(&call);
    assert!(first.out.contains("4DGaussians, iteration 40: 40 splats, method fourdgs"), "{}", first.out);
    // It was not trained on these data.
    assert!(first.err.contains("is no fit"), "{}", first.err);
    let scores = good(&["eval", text(&run), "--json"]).json();
    assert_eq!(scores["views"].as_array().unwrap().len(), 2);
    let said = good(&["inspect", text(&run), "--json"]).json();
    assert_eq!(said["summary"]["splats"].as_u64(), Some(40));
    let cameras = data().join("transforms_test.json");
    good(&["render", text(&run), "--camera", text(&cameras), "-o", text(&dir.path().join("frames"))]);
    good(&["export", text(&run), "-o", text(&dir.path().join("scene.gs4d"))]);
    let provenance = fs::read_to_string(run.join("provenance.json")).unwrap();
    assert!(provenance.contains("\"code\": \"4DGaussians\""), "{provenance}");

    gs4d(&call).fails(6, &["holds a run already"]);
    good(
        &[
            &call[..],
            &["-f", "--no-scores", "--set", "schedule.stages.fine.steps=5", "--set", "schedule.stages.coarse.steps=5"],
        ]
        .concat(),
    );
    let resumed = good(&["resume", text(&run), "--steps", "13", "--json"]).json();
    assert_eq!(resumed["step"].as_u64(), Some(13), "{resumed}");
}

#[test]
fn every_code_is_taken_over_and_its_json_says_what_it_became() {
    let dir = tempfile::tempdir().unwrap();
    for (name, method, notes) in [("deformable", "defgs", 0), ("grid4d", "grid4d", 0), ("scaffold-bank", "scaffold", 1)]
    {
        let run = dir.path().join(name);
        let json =
            good(&["import-checkpoint", text(&golden(name)), "--data", text(data()), "-o", text(&run), "--json"])
                .json();
        assert_eq!((json["method"].as_str(), json["notes"].as_array().unwrap().len()), (Some(method), notes));
        assert!(json["psnr"].as_f64().is_some(), "{json}");
    }
}

#[test]
fn what_is_no_checkpoint_is_refused_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let (run, other) = (dir.path().join("run"), dir.path().join("other.safetensors"));
    fs::write(&other, "point_cloud").unwrap();
    let call = |file: &str, data: &str| gs4d(&["import-checkpoint", file, "--data", data, "-o", text(&run)]);
    call(text(&other), text(data())).fails(3, &["no safetensors file", "checkpoints.md"]);
    call("absent.safetensors", text(data())).fails(6, &["absent.safetensors"]);
    call(text(&golden("grid4d")), text(dir.path())).fails(3, &["error[data"]);
    // The values are those of the file; the method finds what is not finite.
    let mut bytes = fs::read(golden("deformable")).unwrap();
    let last = bytes.len() - 4;
    bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&other, bytes).unwrap();
    call(text(&other), text(data())).fails(3, &["not finite"]);
    assert!(!run.exists());
}
