//! `gs4d config`: every setting of a method with its default, where it came from and what it is.

use crate::answer::Answer;
use crate::failure::Failure;
use gs4d_run::settings::{Request, resolve};
use serde_json::json;

/// Print every setting of a method as TOML, each with where it comes from
#[derive(clap::Args)]
#[command(name = "config")]
pub struct ShowConfig {
    /// Name of the method; gs4d methods lists them.
    method: String,
    /// Overlay a preset: fast, paper or tiny.
    #[arg(long, default_value = "paper")]
    preset: String,
    /// Overlay one setting, for example density.until=5000 (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

impl ShowConfig {
    pub fn run(self) -> Result<Answer, Failure> {
        let request = Request { method: self.method, preset: self.preset, sets: self.sets, ..Request::default() };
        let config = resolve(gs_methods::registry(), &request)?.config;
        let rows: Vec<_> = config
            .iter()
            .map(|(key, s)| json!({"key": key, "value": s.value, "source": s.source.to_string(), "about": s.about}))
            .collect();
        Ok(Answer::new(config.to_commented_toml(), json!(rows)))
    }
}
