//! Presets of every method parse and build.

use crate::support::*;
use gs_train::trainer::{TrainOptions, Trainer};

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
