//! What happens at which step of a run, in words.

use crate::densify::DensifyRules;
use crate::kernel::KernelConfig;
use crate::method::MethodError;
use crate::registry::{Grows, MethodEntry, section};
use crate::schedule::{Background, Decay, LearningRate, Stage, ordered};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt;
use toml::Table;

/// Steps of a run that count from the same start, from 1.
struct Clock {
    begin: u32,
    end: u32,
}

impl Clock {
    /// Its steps, as it counts them.
    fn steps(&self) -> std::ops::RangeInclusive<u32> {
        1..=self.end - self.begin + 1
    }

    /// The first and the last of some of its steps, counted from the start of the run, and their number; none of no steps.
    fn span(&self, steps: impl DoubleEndedIterator<Item = u32> + Clone) -> Option<(u32, u32, usize)> {
        let (first, last) = (steps.clone().next()?, steps.clone().next_back()?);
        Some((first + self.begin - 1, last + self.begin - 1, steps.count()))
    }
}

/// The time-line of the settings of a method. Displayed: a line for each stage, then density control, rules of the method's own by which
/// rows grow, SH degrees and learning rates.
#[derive(Clone, Debug, Deserialize)]
pub struct Timeline {
    stages: BTreeMap<String, Stage>,
    lr: BTreeMap<String, BTreeMap<String, LearningRate>>,
    density: Option<DensifyRules>,
    sh_every: u32,
    background: Background,
    /// First step, last step and number of the passes by the method's own rules, clock by clock.
    #[serde(skip)]
    own_passes: Vec<(u32, u32, usize)>,
}

impl Timeline {
    /// Reads the section `[schedule]`, where methods may have settings of their own, and, of methods with a cloud, `[cloud.kernel]`,
    /// of which only some parameters learn; both of the effective configuration, without the parts that `ablate` names.
    ///
    /// # Errors
    /// If `[schedule]` is missing or cannot be read, or the section of a method by which rows grow; those of [`MethodEntry::effective()`].
    pub fn of(entry: &MethodEntry, settings: &Table) -> Result<Self, MethodError> {
        let settings = &entry.effective(settings)?;
        let mut timeline: Self = section(entry.name, settings, "schedule")?;
        if let Some(cloud) = settings.get("cloud") {
            let kernel = cloud.get("kernel").cloned().and_then(|kernel| kernel.try_into::<KernelConfig>().ok());
            kernel.unwrap_or_default().hold_back(&mut timeline.lr);
        }
        if let Some(grows) = entry.grows {
            let grows: Grows = grows(settings)?;
            let passes = |clock: Clock| clock.span(clock.steps().filter(|step| grows(*step)));
            timeline.own_passes = timeline.clocks().into_iter().filter_map(passes).collect();
        }
        Ok(timeline)
    }

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
        for clock in self.clocks() {
            let edits = clock.steps().filter(|step| self.edits(rules, clock.begin - 1, *step));
            let passes = edits.clone().filter(|step| rules.grows_at(*step));
            let white = self.background == Background::White;
            let resets = edits.filter(|step| rules.resets_at(*step, white)).count();
            if let Some((first, last, count)) = clock.span(passes) {
                writeln!(f, "{first} to {last}: {count} passes of density control, {resets} opacity resets")?;
            }
        }
        Ok(())
    }

    fn own_passes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut passes = self.own_passes.iter();
        passes.try_for_each(|(first, last, count)| writeln!(f, "{first} to {last}: {count} passes that grow and prune"))
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
        self.own_passes(f)?;
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
    use crate::registry::overlay;
    use crate::schedule::Schedule;
    use crate::schedule::tests::schedule;
    use toml::Value;

    const ENTRY: MethodEntry = MethodEntry {
        name: "moving",
        about: "",
        defaults: &[],
        presets: &[],
        domains: &[],
        needs_avatar: false,
        grows: None,
        effective: None,
        build: |_, _| unreachable!("only its settings are read"),
    };

    fn stage(steps: u32, own_clock: bool) -> Stage {
        Stage { steps, own_clock, image_scale: 1.0, dynamic: own_clock, ..Stage::default() }
    }

    /// The time-line of a schedule and other sections.
    fn of(entry: &MethodEntry, schedule: &Schedule, others: &str) -> String {
        let mut settings: Table = others.parse().unwrap();
        let schedule = Value::try_from(schedule).unwrap();
        overlay(&mut settings, Table::from_iter([("schedule".to_owned(), schedule)]));
        Timeline::of(entry, &settings).unwrap().to_string()
    }

    #[test]
    fn a_timeline_says_what_happens_when() {
        let moving = Stage { window_parts: 5, window_until: 0.5, ..stage(4000, true) };
        let mut schedule = schedule(vec![stage(1000, false), moving]);
        schedule.density.from = 500;
        schedule.density.until = 2000;
        let text = |schedule: &Schedule| of(&ENTRY, schedule, "");
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

    #[test]
    fn rates_of_kernels_are_those_that_learn() {
        let mut schedule = schedule(vec![stage(100, false)]);
        let cloud = schedule.lr.get_mut("cloud").unwrap();
        for name in ["lambda", "beta", "acutance"] {
            cloud.insert(name.to_owned(), LearningRate::constant(2e-3));
        }
        let said = |kernel: &str| {
            let text = of(&ENTRY, &schedule, &format!("[cloud.kernel]\n{kernel}"));
            let rates = text.lines().filter_map(|line| line.strip_prefix("learning rate cloud."));
            rates.filter(|rate| !rate.starts_with("means")).map(str::to_owned).collect::<Vec<_>>()
        };
        assert!(said("kind = 'gaussian'").is_empty());
        assert_eq!(said("kind = 'frequency'\nlearn_beta = false\nfrom_step = 70"), ["lambda from step 70: 2e-3"]);
        assert_eq!(said("kind = 'acutance'"), ["acutance: 2e-3"]);
    }

    #[test]
    fn rows_grow_by_the_methods_own_rules_on_every_clock() {
        let schedule = schedule(vec![stage(1000, false), stage(4000, true)]);
        let grows = |settings: &Table| -> Result<Grows, MethodError> {
            let every: u32 =
                section("moving", settings, "growth").map(|growth: BTreeMap<String, u32>| growth["every"])?;
            Ok(Box::new(move |clock| clock > 500 && clock < 2000 && clock.is_multiple_of(every)))
        };
        let entry = MethodEntry { grows: Some(grows), ..ENTRY };
        let text = of(&entry, &schedule, "[growth]\nevery = 100");
        assert!(text.contains("600 to 1000: 5 passes that grow and prune\n"), "{text}");
        assert!(text.contains("1600 to 2900: 14 passes that grow and prune\n"), "{text}");
        assert!(Timeline::of(&entry, &Table::try_from(&schedule).unwrap()).is_err());
    }
}
