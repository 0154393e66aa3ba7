//! How many steps fill a time budget: measured by a pilot, the recipe compressed to a tenth of its steps. A scene grows while it trains,
//! and the whole recipe has the mean step of a compressed one; the beginning of an uncompressed one has cheaper steps.

use gs4d_run::folder::LOG;
use gs4d_run::{RunError, RunFolder, Scored};
use serde_json::Value;
use std::path::Path;

/// Share of a recipe's steps that the pilot has, and fewest steps.
const SHARE: f64 = 0.1;
const LEAST: u32 = 50;
/// A pilot that the budget stops before its end is measured over this last share.
const MEASURED_SHARE: f64 = 0.25;

/// Steps of the pilot of a recipe of so many.
pub(super) fn length(recipe: u32) -> u32 {
    ((f64::from(recipe) * SHARE) as u32).max(LEAST).min(recipe)
}

/// Steps that fill a time budget, seconds, by a finished pilot of `length` steps.
///
/// # Errors
/// If its log cannot be read.
pub(super) fn steps(run: &Path, pilot: &Scored, length: u32, budget: f64) -> Result<u32, RunError> {
    let mean = || pilot.scores.train_seconds.unwrap_or(0.0) / f64::from(pilot.step.max(1));
    let per_step = match pilot.step < length {
        // Stopped before it had grown. One too short to have logged twice gives its mean.
        true => settled_seconds(&RunFolder::open(run)?.log_lines(LOG)?).unwrap_or_else(mean),
        false => mean(),
    };
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
    fn a_step_takes_what_it_took_at_the_end_of_a_pilot_that_was_stopped() {
        let line = |step: u32, seconds: f64| serde_json::json!({"step": step, "seconds": seconds});
        assert_eq!(settled_seconds(&[line(10, 1.0), line(20, 4.0), line(30, 9.0), line(40, 12.0)]), Some(0.3));
        assert_eq!(settled_seconds(&[line(10, 1.0)]), None);
        assert_eq!(settled_seconds(&[]), None);
    }

    #[test]
    fn a_pilot_has_a_tenth_of_the_steps() {
        assert_eq!([30_000, 8600, 400, 50, 7].map(length), [3000, 860, 50, 50, 7]);
    }
}
