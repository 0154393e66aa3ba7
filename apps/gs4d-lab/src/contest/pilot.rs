//! How many steps fill a time budget: measured by a pilot, the unchanged recipe stopped after a share of the budget.

use gs4d_run::folder::LOG;
use gs4d_run::{RunError, RunFolder, Scored};
use serde_json::Value;
use std::path::Path;
use std::time::Duration;

/// Share of the time budget spent on the pilot.
const SHARE: f64 = 0.2;
/// Seconds per step are measured over this last share of the pilot.
const MEASURED_SHARE: f64 = 0.25;

/// Seconds of the pilot of a time budget, seconds. Whole nanoseconds, as `gs4d train --time-budget` reads them.
pub(super) fn seconds(budget: f64) -> f64 {
    Duration::from_secs_f64(SHARE * budget).as_secs_f64()
}

/// Steps that fill a time budget, seconds, by the log of a finished pilot.
///
/// # Errors
/// If the log cannot be read.
pub(super) fn steps(run: &Path, pilot: &Scored, budget: f64) -> Result<u32, RunError> {
    let lines = RunFolder::open(run)?.log_lines(LOG)?;
    // A pilot too short to have logged twice: mean over all its steps.
    let mean = || pilot.scores.train_seconds.unwrap_or(0.0) / f64::from(pilot.step.max(1));
    let per_step = settled_seconds(&lines).unwrap_or_else(mean);
    // Rounded down to two digits, so that a repeated pilot usually gives the same number of steps.
    let wanted = (budget / per_step.max(1e-6)).clamp(1.0, 1e9);
    let unit = 10f64.powf(wanted.log10().floor() - 1.0).max(1.0);
    Ok(((wanted / unit).floor() * unit) as u32)
}

/// Seconds per step over the last [`MEASURED_SHARE`] of a log; `None` for a log too short.
fn settled_seconds(lines: &[Value]) -> Option<f64> {
    let marks: Vec<[f64; 2]> =
        lines.iter().filter_map(|l| Some([l["step"].as_f64()?, l["seconds"].as_f64()?])).collect();
    let &[last_step, last] = marks.last()?;
    let [step, seconds] = marks.iter().find(|m| m[1] >= (1.0 - MEASURED_SHARE) * last && m[0] < last_step)?;
    Some((last - seconds) / (last_step - step))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_takes_what_it_took_at_the_end_of_the_pilot() {
        let line = |step: u32, seconds: f64| serde_json::json!({"step": step, "seconds": seconds});
        assert_eq!(settled_seconds(&[line(10, 1.0), line(20, 4.0), line(30, 9.0), line(40, 12.0)]), Some(0.3));
        assert_eq!(settled_seconds(&[line(10, 1.0)]), None);
        assert_eq!(settled_seconds(&[]), None);
    }

    #[test]
    fn a_command_line_gives_the_same_seconds() {
        for budget in [0.1, 0.7, 2.0, 1234.567] {
            let text = seconds(budget).to_string();
            assert_eq!(Duration::from_secs_f64(text.parse().unwrap()).as_secs_f64(), seconds(budget), "{budget}");
        }
    }
}
