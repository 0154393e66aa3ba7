//! `gs4d config`: the time-line of a run, and every setting of a method with where it came from and what it is.

use crate::answer::Answer;
use crate::failure::Failure;
use gs4d_run::settings::{Request, resolve};
use serde_json::json;

/// Print what happens at which step, and every setting as TOML with where it comes from
#[derive(clap::Args)]
#[command(name = "config")]
pub struct ShowConfig {
    /// Name of the method; gs4d methods lists them.
    method: String,
    /// Its preset: fast, paper, tiny or another; gs4d methods lists them.
    #[arg(long, default_value = "fast")]
    preset: String,
    /// Total number of steps; stretches or compresses the whole schedule.
    #[arg(long, value_name = "N")]
    steps: Option<u32>,
    /// Overlay one setting, for example schedule.density.until=5000 (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

impl ShowConfig {
    pub fn run(self) -> Result<Answer, Failure> {
        let request = Request {
            method: self.method,
            preset: self.preset,
            steps: self.steps,
            sets: self.sets,
            ..Request::default()
        };
        let resolved = resolve(gs_methods::registry(), &request)?;
        let rows: Vec<_> = resolved
            .config
            .iter()
            .map(|(key, s)| json!({"key": key, "value": s.value, "source": s.source.to_string(), "about": s.about}))
            .collect();
        Ok(Answer::new(resolved.to_toml()?, json!(rows)))
    }
}
