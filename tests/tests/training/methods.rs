//! Settings and presets of every method: layers that state only what differs, and presets that parse and build.

use crate::support::*;
use gs_train::registry::overlay;
use gs_train::trainer::{TrainOptions, Trainer};
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
