//! Settings and presets of every method: layers that state only what differs, and presets that parse and build.

use crate::support::*;
use gs_data::{DataOptions, Dataset};
use gs_synth::{SynthOptions, write, write_nerfies};
use gs_train::registry::overlay;
use gs_train::testkit::{config, start};
use gs_train::trainer::{TrainOptions, Trainer};
use std::path::Path;
use std::sync::Arc;
use toml::{Table, Value};

#[test]
fn presets_parse_and_build() {
    let data = scene("balls", 32, 4);
    for entry in of_scenes() {
        for (preset, _) in entry.presets {
            let mut config = entry.config(preset).expect("preset");
            config["init"].as_table_mut().expect("init").insert("points".into(), 100.into());
            let built =
                Trainer::new(gs_methods::registry(), data.clone(), entry.name, &config, TrainOptions::default());
            let trainer = built.unwrap_or_else(|e| panic!("{} {preset}: {e}", entry.name));
            trainer.model().schedule().check().expect("schedule");
            assert_eq!(trainer.model().name(), entry.name);
        }
        assert!(entry.config("none").is_err());
    }
    assert!(gs_methods::registry().find("none").is_err());
}

/// A capture of 24 moments such as a preset of `modec` is for, read from a folder with what the preset says of data: of a
/// moving camera, for HyperNeRF and DyCheck in their layout, or of still cameras.
fn capture(dir: &Path, preset: &str) -> Arc<Dataset> {
    let moving = SynthOptions { supersample: 1, ..SynthOptions::of_views(64, 24, 2) };
    let still = SynthOptions { cameras: 3, held_out: 1, moments: 24, boundary: 1.0, ..moving };
    let made = match preset {
        "hypernerf" | "iphone" => write_nerfies(dir, "balls", &moving, false),
        "neu3d" | "panoptic" => write(dir, "balls", &still, false),
        _ => write(dir, "balls", &moving, false),
    };
    made.expect("a folder");
    let stated = gs_methods::registry().find("modec").and_then(|m| m.preset(preset)).expect("preset").remove("data");
    let options: DataOptions = stated.map_or(Ok(DataOptions::default()), Value::try_into).expect("options of data");
    Arc::new(Dataset::open(dir, &options).expect("what was written"))
}

/// The second step is of the local stage, where both fields are at work. Where time nodes are half the moments, 12 of them remain.
#[test]
fn presets_for_kinds_of_captures_train_on_such_captures() {
    let presets = [
        ("dnerf", Some(12)),
        ("hypernerf", None),
        ("iphone", None),
        ("nvidia", Some(12)),
        ("neu3d", None),
        ("panoptic", Some(12)),
    ];
    let modec = gs_methods::registry().find("modec").expect("method");
    let general = ["paper", "ref", "fast", "tiny"];
    let kinds = modec.presets.iter().map(|p| p.0).filter(|name| !general.contains(name));
    assert!(kinds.eq(presets.map(|p| p.0)), "every preset for a kind of captures is tried");
    for (preset, nodes) in presets {
        let dir = tempfile::tempdir().expect("a folder");
        let data = capture(dir.path(), preset);
        let begin = |over: &str| {
            let short = "init.points = 200\nschedule.stages.global.steps = 1";
            let config = config(gs_methods::registry(), "modec", preset, &[short, over]);
            start(gs_methods::registry(), &data, "modec", &config, 1)
        };
        let planes = |trainer: &Trainer| {
            let mut values = 0;
            trainer.model().visit(&mut |p| values += if p.name.starts_with("lgd.planes") { p.len() } else { 0 });
            values
        };
        let mut trainer = begin("");
        let stated = nodes.map_or(String::new(), |n| format!("lgd.hexplane.resolution = [64, 64, 64, {n}]"));
        let unbounded = begin(&format!("lgd.rows_per_moment = 0.0\n{stated}"));
        assert_eq!(planes(&trainer), planes(&unbounded), "{preset}");
        let steps = run(&mut trainer, 2);
        assert!(steps.iter().all(|s| s.loss.total.is_finite() && s.loss.total > 0.0), "{preset}: {steps:?}");
        assert!(steps.iter().map(|s| s.stage.as_str()).eq(["global", "local"]), "{preset}: {steps:?}");
    }
}

#[test]
fn layers_state_only_what_differs() {
    for entry in gs_methods::registry() {
        let lay = |mut beneath: Table, layers: &[&str], what: &str| {
            for layer in layers {
                let layer: Table = layer.parse().expect("TOML");
                let again = repeated(&layer, &beneath);
                assert!(again.is_empty(), "{} {what}: {again:?} are as in the layers beneath", entry.name);
                overlay(&mut beneath, layer);
            }
        };
        lay(Table::new(), entry.defaults, "defaults");
        for (preset, layers) in entry.presets {
            lay(entry.published().expect("defaults"), layers, preset);
        }
    }
}

/// Dotted keys whose values are the same in both.
fn repeated(layer: &Table, beneath: &Table) -> Vec<String> {
    let same = |(key, value): (&String, &Value)| match (value, beneath.get(key)) {
        (Value::Table(inner), Some(Value::Table(under))) => {
            repeated(inner, under).into_iter().map(|k| format!("{key}.{k}")).collect()
        }
        (value, Some(under)) if value == under => vec![key.clone()],
        _ => Vec::new(),
    };
    layer.iter().flat_map(same).collect()
}
