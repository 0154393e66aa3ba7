//! Domains of settings, and sizes that are known before anything is built.

use crate::support::*;
use gs_data::Dataset;
use gs_train::domains::{Domain, domain};
use gs_train::error::MethodError;
use gs_train::registry::MethodEntry;
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::trainer::{TrainOptions, Trainer};
use std::collections::HashMap;
use std::sync::Arc;
use toml::{Table, Value};

/// Blocks whose size is no matter of settings: one value, and the boundaries of intervals.
const SMALL: [&str; 2] = ["cloud.lambda", "intervals.starts"];

/// Numbers of a configuration by dotted key; of a list its first entry.
fn numbers(config: &Table) -> Vec<(String, f64)> {
    let mut open: Vec<(String, &Value)> = config.iter().map(|(k, v)| (k.clone(), v)).collect();
    let mut found = Vec::new();
    while let Some((key, value)) = open.pop() {
        match value {
            Value::Table(table) => open.extend(table.iter().map(|(k, v)| (format!("{key}.{k}"), v))),
            Value::Array(list) => open.extend(list.first().map(|v| (key, v))),
            Value::Integer(n) => found.push((key, *n as f64)),
            Value::Float(x) => found.push((key, *x)),
            _ => {}
        }
    }
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

/// The same configuration with one number in place of another, in the type that stands there.
fn with(config: &Table, key: &str, number: f64) -> Table {
    let mut config = config.clone();
    let (section, leaf) = key.rsplit_once('.').unwrap_or(("", key));
    let sections = section.split('.').filter(|s| !s.is_empty());
    let table = sections.fold(&mut config, |t, s| t[s].as_table_mut().expect("section"));
    let slot = match &mut table[leaf] {
        Value::Array(list) => &mut list[0],
        value => value,
    };
    *slot = if slot.is_integer() { Value::Integer(number as i64) } else { Value::Float(number) };
    config
}

fn domain_of(entry: &MethodEntry, key: &str) -> Domain {
    domain(key, entry.domains).unwrap_or_else(|| panic!("{}: {key} has no domain", entry.name))
}

#[test]
fn every_number_of_every_preset_has_a_domain_that_holds_it() {
    for entry in gs_methods::registry() {
        for (preset, _) in entry.presets {
            let config = entry.config(preset).expect("preset");
            entry.check(&config).unwrap_or_else(|e| panic!("{} {preset}: {e}", entry.name));
            for (key, _) in numbers(&config) {
                let Domain { low, high, .. } = domain_of(entry, &key);
                for beyond in [2.0 * high.abs() + 1.0, low - 1.0, i64::MAX as f64, f64::NAN] {
                    let config = with(&config, &key, beyond);
                    let refused = numbers(&config).iter().any(|(k, v)| *k == key && !(low..=high).contains(v));
                    let error = entry.check(&config).map_err(|e| e.to_string());
                    match error {
                        Err(e) => assert!(e.contains(&format!("`{key}`")), "{e}"),
                        Ok(()) => assert!(!refused, "{} {key} = {beyond}", entry.name),
                    }
                }
            }
        }
    }
}

fn data_of(entry: &MethodEntry) -> Arc<Dataset> {
    if entry.needs_avatar { film("cylinder", 32, 2) } else { scene("balls", 24, 4) }
}

fn scene_of(data: &Dataset, config: &Table) -> SceneInfo {
    let mut init: InitConfig = config["init"].clone().try_into().expect("init");
    init.points = 50;
    SceneInfo::of(data, &init, 1).expect("scene")
}

/// Every method says exactly how many parameters its networks and fields will have, and builds none beyond what is allowed.
#[test]
fn sizes_are_known_before_anything_is_built() {
    for entry in gs_methods::registry() {
        let data = data_of(entry);
        for (preset, _) in entry.presets.iter().filter(|p| p.0 == "tiny" || !entry.needs_avatar) {
            let config = entry.config(preset).expect("preset");
            let mut scene = scene_of(&data, &config);
            scene.max_parameters = 0;
            let said = match entry.model(&config, &scene) {
                Err(MethodError::TooLarge { count, .. }) => count,
                Err(e) => panic!("{} {preset}: {e}", entry.name),
                Ok(_) => 0,
            };
            scene.max_parameters = said;
            let model = entry.model(&config, &scene).unwrap_or_else(|e| panic!("{} {preset}: {e}", entry.name));
            let mut built = 0;
            model.visit(&mut |p| {
                built += if p.row_width.is_none() && !SMALL.contains(&&*p.name) { p.len() as u64 } else { 0 };
            });
            assert_eq!(said, built, "{} {preset}", entry.name);
        }
    }
}

/// At either end of every domain a method is built and makes a step, or says what does not fit. Settings that many methods have are
/// tried with the first two of these.
#[test]
fn the_ends_of_domains_are_no_reason_to_panic() {
    let mut tried = HashMap::<String, u32>::new();
    for entry in of_scenes() {
        let data = scene("balls", 16, 3);
        let config = short(entry.name);
        for (key, value) in numbers(&config) {
            let tried = tried.entry(key.clone()).or_default();
            *tried += 1;
            if *tried > 2 {
                continue;
            }
            let Domain { low, high, .. } = domain_of(entry, &key);
            // As many first points are made as are asked for.
            for number in [low, high].into_iter().filter(|n| *n != value && key != "init.points") {
                eprintln!("{} {key} = {number}", entry.name);
                let config = with(&config, &key, number);
                let mut scene = scene_of(&data, &config);
                scene.max_parameters = 1 << 17;
                let Ok(model) = entry.model(&config, &scene) else { continue };
                let options = TrainOptions::default();
                let Ok(mut trainer) = Trainer::with_method(model, data.clone(), scene, options) else { continue };
                for _ in 0..2 {
                    let _ = trainer.step();
                }
            }
        }
    }
}
