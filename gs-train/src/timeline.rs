//! What happens at which step of a run, in words.

use crate::densify::DensifyRules;
use crate::schedule::{Background, Decay, LearningRate, Stage, ordered};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt;

/// Steps of a run that count from the same start, from 1.
struct Clock {
    begin: u32,
    end: u32,
}

/// The time-line of a [`Schedule`](crate::schedule::Schedule), read from a section `[schedule]`, where methods may have settings of
/// their own. Displayed: a line for each stage, then density control, SH degrees and learning rates.
#[derive(Clone, Debug, Deserialize)]
pub struct Timeline {
    stages: BTreeMap<String, Stage>,
    lr: BTreeMap<String, BTreeMap<String, LearningRate>>,
    density: Option<DensifyRules>,
    sh_every: u32,
    background: Background,
}

impl Timeline {
    fn clocks(&self) -> Vec<Clock> {
        let mut clocks: Vec<Clock> = Vec::new();
        let mut end = 0;
        for (_, stage) in ordered(&self.stages) {
            let begin = end + 1;
            end += stage.steps;
            match clocks.last_mut() {
                Some(clock) if !stage.own_clock => clock.end = end,
                _ => clocks.push(Clock { begin, end }),
            }
        }
        clocks
    }

    fn stages(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let moves = self.stages.values().any(|stage| stage.dynamic);
        let mut end = 0;
        for (name, stage) in ordered(&self.stages) {
            let begin = end + 1;
            end += stage.steps;
            writeln!(f, "{begin} to {end}: {name}{}", about(stage, begin, moves))?;
        }
        Ok(())
    }

    /// Whether rows may be edited in a step of the run, the one after `before` steps at `clock`.
    fn edits(&self, rules: &DensifyRules, before: u32, clock: u32) -> bool {
        let (step, mut end) = (before + clock, 0);
        let stage = ordered(&self.stages).into_iter().find(|(_, stage)| {
            end += stage.steps;
            step <= end
        });
        stage.is_some_and(|(_, stage)| rules.edits_at(clock, stage.field_alone, step == end))
    }

    fn density(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(rules) = &self.density else { return Ok(()) };
        for Clock { begin, end } in self.clocks() {
            let edits = (1..=end - begin + 1).filter(|clock| self.edits(rules, begin - 1, *clock));
            let passes = edits.clone().filter(|clock| rules.grows_at(*clock));
            let white = self.background == Background::White;
            let resets = edits.filter(|clock| rules.resets_at(*clock, white)).count();
            if let (Some(first), Some(last)) = (passes.clone().next(), passes.clone().next_back()) {
                let [first, last] = [first, last].map(|s| s + begin - 1);
                writeln!(
                    f,
                    "{first} to {last}: {} passes of density control, {resets} opacity resets",
                    passes.count()
                )?;
            }
        }
        Ok(())
    }

    fn rates(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (group, rates) in &self.lr {
            // What has no rate does not learn.
            let learning = rates.iter().filter(|(_, rate)| rate.start > 0.0 || rate.end > 0.0);
            for (name, LearningRate { start, end, steps, decay, from, ramp, .. }) in learning {
                let since = if *from > 0 { format!(" from step {from}") } else { String::new() };
                let decay = match decay {
                    _ if *steps == 0 || start == end => String::new(),
                    Decay::Log => format!(" to {end:e} in {steps} steps"),
                    Decay::Step => format!(", {end:e} after {steps} steps"),
                };
                let ramp = if *ramp > 0 { format!(", rising over the first {ramp} updates") } else { String::new() };
                writeln!(f, "learning rate {group}.{name}{since}: {start:e}{decay}{ramp}")?;
            }
        }
        Ok(())
    }
}

impl fmt::Display for Timeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.stages(f)?;
        self.density(f)?;
        if self.sh_every > 0 {
            writeln!(f, "every {} steps the SH degree rises", self.sh_every)?;
        }
        self.rates(f)
    }
}

/// What is particular about a stage that begins at a step, of a run in which the field `moves` the scene in some stage.
fn about(stage: &Stage, begin: u32, moves: bool) -> String {
    let mut said = String::new();
    let mut say = |what: &str| said = format!("{said}, {what}");
    match (stage.dynamic, stage.field_alone) {
        (false, _) if moves => say("the scene rests"),
        (true, true) => say("only the field learns"),
        _ => {}
    }
    if stage.first_moment {
        say("images of the first moment");
    }
    if stage.window_parts > 1 {
        let (parts, alike) = (stage.window_parts, begin + stage.alike_from());
        say(&format!("images let in by time in at most {parts} parts, all alike from step {alike}"));
        if stage.window_newest > 0.0 {
            say(&format!("{} % of the draws of the newest part", 100.0 * stage.window_newest));
        }
    }
    if stage.image_scale < 1.0 {
        say(&format!("images at {} of their size", stage.image_scale));
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::Schedule;
    use crate::schedule::tests::schedule;

    #[test]
    fn a_timeline_says_what_happens_when() {
        let stage =
            |steps, own_clock| Stage { steps, own_clock, image_scale: 1.0, dynamic: own_clock, ..Stage::default() };
        let moving = Stage { window_parts: 5, window_until: 0.5, ..stage(4000, true) };
        let mut schedule = schedule(vec![stage(1000, false), moving]);
        schedule.density.from = 500;
        schedule.density.until = 2000;
        let text =
            |schedule: &Schedule| toml::Table::try_from(schedule).unwrap().try_into::<Timeline>().unwrap().to_string();
        let want = "1 to 1000: s, the scene rests\n\
            1001 to 5000: r, images let in by time in at most 5 parts, all alike from step 3001\n\
            600 to 1000: 5 passes of density control, 0 opacity resets\n\
            1600 to 2900: 14 passes of density control, 0 opacity resets\n\
            every 1000 steps the SH degree rises\n\
            learning rate cloud.means: 1.6e-4 to 1.6e-6 in 100 steps\n\
            learning rate field.all: 1e-3\n\
            learning rate field.planes: 1e-2\n";
        assert_eq!(text(&schedule), want);
        schedule.density.until = 1001;
        assert!(text(&schedule).contains("600 to 1000: 5 passes"));
        schedule.density.at_borders = false;
        assert!(text(&schedule).contains("600 to 900: 4 passes"), "the last step of a stage edits no rows");
        schedule.density.until = 2000;
        schedule.stages.values_mut().filter(|stage| stage.dynamic).for_each(|stage| stage.field_alone = true);
        assert!(!text(&schedule).contains("14 passes"), "no rows are edited while only the field learns");
        schedule.stages.values_mut().for_each(|stage| stage.dynamic = false);
        assert!(!text(&schedule).contains("rests"), "nothing moves in any stage");
        schedule.lr.get_mut("field").unwrap().insert("all".to_owned(), LearningRate::constant(0.0));
        assert!(!text(&schedule).contains("field.all") && text(&schedule).contains("field.planes"));
    }
}
