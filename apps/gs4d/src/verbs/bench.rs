//! `gs4d bench`: speed against error of the crates, on this machine.

use super::demo::speed_text;
use crate::Global;
use crate::answer::Answer;
use crate::failure::Failure;
use gs_core::speed::SpeedError;
use gs_train::bench::{GROUPS, roofs};
use gs_train::report::speed_json;
use serde_json::json;

/// Measure speed and error of drawing, metrics, fields and optimiser on this machine
#[derive(clap::Args)]
pub struct Bench {
    /// Only this crate, for example gs-raster.
    #[arg(long = "crate", value_name = "C")]
    only: Option<String>,
}

impl Bench {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let known: Vec<&str> = GROUPS.iter().map(|g| g.name).collect();
        if let Some(name) = self.only.as_deref().filter(|n| !known.contains(n)) {
            return Err(Failure::usage(format!("there are no measurements of `{name}`"))
                .remedy(format!("choose one of {}", known.join(", "))));
        }
        let mut rows: Vec<SpeedError> = Vec::new();
        for group in GROUPS.iter().filter(|g| self.only.as_deref().is_none_or(|name| name == g.name)) {
            global.say(format!("measuring {}", group.name));
            rows.extend((group.measure)());
        }
        let (fma, exp) = roofs();
        let mut text = speed_text(&rows).trim_start().to_owned();
        text.push_str(&format!(
            "roofs of this machine on {} threads: {fma:.1} GFLOP/s fused multiply-add, {exp:.2} G exponentials/s\n",
            rayon::current_num_threads()
        ));
        let roofs = json!({"fma_gflops": fma, "exp2_giga_per_second": exp, "threads": rayon::current_num_threads()});
        Ok(Answer::new(text, json!({"rows": speed_json(&rows), "roofs": roofs})))
    }
}
