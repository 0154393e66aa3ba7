//! `gs4d methods`: lists methods and presets.

use crate::answer::Answer;
use serde_json::json;

/// List the methods and their presets
#[derive(clap::Args)]
pub struct Methods {}

impl Methods {
    pub fn run(self) -> Answer {
        let registry = gs_methods::registry();
        let presets = |m: &gs_train::registry::MethodEntry| m.presets.iter().map(|p| p.0).collect::<Vec<_>>();
        let text: String = registry
            .iter()
            .map(|m| format!("{:10} {}\n{:10} presets: {}\n", m.name, m.about, "", presets(m).join(", ")))
            .collect();
        let json: Vec<_> =
            registry.iter().map(|m| json!({"name": m.name, "about": m.about, "presets": presets(m)})).collect();
        Answer::new(text, json!(json))
    }
}
