//! `gs4d segment`: labels of splats, masks of views, scores against the bodies of a generated scene.

use crate::support::{data, good, gs4d, run, text};
use serde_json::Value;
use std::path::Path;

/// Label per splat of `labels.npy`.
fn labels(file: &Path) -> Vec<f32> {
    let bytes = std::fs::read(file).unwrap();
    let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    bytes[header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

/// A run of `trace`, which has twists, and the shared one, which has paths alone.
#[test]
fn every_splat_and_every_view_is_labelled_and_scored() {
    let dir = tempfile::tempdir().unwrap();
    let trace = dir.path().join("trace");
    let base = ["train", text(data()), "-m", "trace", "--preset", "tiny", "--steps", "8", "-o", text(&trace), "-q"];
    good(&base);
    for (run, source, k) in [(trace.as_path(), "twists", "2"), (run(), "paths", "3")] {
        let out = dir.path().join(source);
        let call = ["segment", text(run), "--k", k, "-o", text(&out), "--json"];
        let json = good(&call).json();
        assert_eq!((&json["labels_from"], &json["asked"]), (&source.into(), &k.parse::<u64>().unwrap().into()));
        let parts = json["parts"].as_array().unwrap();
        assert!(!parts.is_empty() && parts.len() <= k.parse().unwrap(), "{parts:?}");
        let labels = labels(&out.join("labels.npy"));
        for part in parts {
            let members = labels.iter().filter(|l| **l + 1.0 == part["id"].as_f64().unwrap() as f32).count();
            assert_eq!(part["splats"], members, "{part}");
        }
        assert_eq!(parts.iter().filter_map(|p| p["splats"].as_u64()).sum::<u64>(), labels.len() as u64);
        let share = |name: &str| json["scores"][name].as_f64().unwrap();
        assert!(["f1", "precision", "recall", "miou"].iter().all(|n| (0.0..=1.0).contains(&share(n))), "{json}");
        assert_eq!(json["views"], 2);
        for folder in ["masks", "labels", "overlays"] {
            let pictures = std::fs::read_dir(out.join(folder)).unwrap().count();
            assert_eq!(pictures, 2, "{folder}");
        }
        let kept: Value = serde_json::from_slice(&std::fs::read(out.join("segment.json")).unwrap()).unwrap();
        assert_eq!(kept["parts"], json["parts"]);
        gs4d(&call[..6]).fails(6, &["exists already", "-f"]);
        let table = good(&[&call[..6], &["-f", "--limit", "1"]].concat()).out;
        assert!(table.contains(&format!("parts from {source}")) && table.contains("over 1 views"), "{table}");
    }
}

#[test]
fn what_cannot_be_segmented_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let with = |more: &[&str]| gs4d(&[&["segment", text(run()), "-o", text(&out)][..], more].concat());
    with(&["--k", "0"]).fails(2, &["1 to 254"]);
    with(&["--split", "extrapolate"]).fails(3, &["no views"]);
    let still = dir.path().join("still");
    good(&["train", text(data()), "-m", "static3d", "--preset", "tiny", "--steps", "2", "-q", "-o", text(&still)]);
    gs4d(&["segment", text(&still), "-o", text(&out)]).fails(3, &["static3d has no motion"]);
    assert!(!out.exists(), "nothing is made before everything is known");
}
