//! The nightly job: the papers' orders of methods on few generated scenes, five seeds each, small enough for a night.
//!
//! A table that has a [`Nightly`] says on which scenes, how long and with which settings. Lengths are in steps and stand in the table's file, so a job that was
//! interrupted goes on with the same ones. Rows that a paper puts within [`LEAST`] of the first are left out. [`markdown`] puts what was found on one page.

use crate::outcome::{Order, Outcome, Verdict};
use crate::page::{first_entry, unit};
use crate::reproduction::{Conditions, ReproduceError, Reproduction};
use crate::table::{Table, TableError};
use gs4d_lab::contest::Length;
use serde::Deserialize;

/// The seeds of the job.
pub const SEEDS: [u64; 5] = [0, 1, 2, 3, 4];

/// A row whose published mean is closer to that of the first is left out, in units of the first column (dB in all tables of the job): the intervals of five
/// pairs of one scene are seldom so narrow.
pub const LEAST: f64 = 0.1;

/// Title of the page.
pub const TITLE: &str = "The papers' orders, on generated scenes";

/// How the job runs a table.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Nightly {
    /// Names of generated scenes of the table's data set.
    pub scenes: Vec<String>,
    /// Steps of every trial; recipes are stretched or compressed to them.
    pub steps: u32,
    /// Settings of all trials, `KEY=VALUE`.
    #[serde(default)]
    pub sets: Vec<String>,
}

/// The tables of the job, or the one of this full name, each in a folder of its own name below that of `conditions`, without the rows that are left out
/// ([`LEAST`]). Its scenes and settings are those of its file; so are its steps, unless `conditions` names others, whose settings are applied last.
///
/// # Errors
/// As [`Reproduction::new`]; [`TableError::Unknown`] if the job has no such table.
pub fn reproductions(only: Option<&str>, conditions: &Conditions) -> Result<Vec<Reproduction>, ReproduceError> {
    let mut all = Table::all()?;
    all.retain(|t| t.nightly.is_some());
    let known = || all.iter().map(Table::full_name).collect::<Vec<_>>().join(", ");
    if let Some(name) = only.filter(|name| !all.iter().any(|t| t.full_name() == *name)) {
        return Err(TableError::Unknown { name: name.to_owned(), known: known() }.into());
    }
    all.retain(|t| only.is_none_or(|name| t.full_name() == name));
    let reproduction = |table: Table| {
        let conditions = of_table(&table, conditions)?;
        Some(Reproduction::new(without_close_rows(table), conditions))
    };
    all.into_iter().filter_map(reproduction).collect()
}

/// The table without the rows that the paper puts within [`LEAST`] of the first.
fn without_close_rows(mut table: Table) -> Table {
    let mean = |name: &str| table.published_average(name, 0);
    let first = table.runnable().next().and_then(|e| mean(&e.name));
    let is_close = |name: &str| first.zip(mean(name)).is_some_and(|(a, b)| (a - b).abs() < LEAST);
    let close: Vec<String> = table.runnable().skip(1).map(|e| e.name.clone()).filter(|n| is_close(n)).collect();
    table.entries.retain(|e| !close.contains(&e.name));
    table
}

fn of_table(table: &Table, conditions: &Conditions) -> Option<Conditions> {
    let nightly = table.nightly.as_ref()?;
    Some(Conditions {
        scenes: nightly.scenes.clone(),
        length: match conditions.length {
            Length::Recipe => Length::Steps(nightly.steps),
            other => other,
        },
        sets: nightly.sets.iter().chain(&conditions.sets).cloned().collect(),
        root: conditions.root.join(table.full_name()),
        ..conditions.clone()
    })
}

/// What the outcomes say of the papers' orders, as Markdown: per table the differences, the order found and one sentence. Seconds are not in it: a
/// job that was interrupted gives the same page.
pub fn markdown(outcomes: &[Outcome]) -> String {
    let head = "Differences of the first column of each table, pairs of the same scene and seed, ± half the 95 % interval of their mean by Student's t: over pairs, or over \
                the means of scenes where there are three. An order holds where the interval lies on the published side of 0, does not hold where it lies on the \
                other side, and is inconclusive where it holds 0 or there are fewer than three pairs. Where no published figures are known, the side of 0 is said. Generated \
                scenes stand in for the papers' and have no masks: masked columns are of whole images.";
    let left_out = format!("Rows that a paper puts within {LEAST} of the first are left out.");
    let tables: String = outcomes.iter().map(of_outcome).collect();
    format!("# {TITLE}\n\n{head} {left_out}\n{tables}")
}

fn of_outcome(outcome: &Outcome) -> String {
    let Outcome { table, title, source, columns, conditions, orders, .. } = outcome;
    let column = columns.first().map_or("", String::as_str);
    let mut text =
        format!("\n## {title}\n\n{table}: {source}. Here: {}; {conditions}. Column: {column}.\n\n", scenes(outcome));
    text.push_str(&format!("| {} less | published | here | pairs | |\n|---|---|---|---|---|\n", first_entry(outcome)));
    orders.iter().for_each(|order| text.push_str(&row(order, unit(outcome))));
    text + &format!("\n{} {}\n", sentence(outcome), ranking(outcome))
}

/// The scenes of an outcome, without their mean.
fn scenes(outcome: &Outcome) -> String {
    let own = outcome.scenes.len().max(2) - 1;
    let names: Vec<&str> = outcome.scenes.iter().take(own).map(|s| s.scene.as_str()).collect();
    names.join(", ")
}

fn row(order: &Order, unit: &str) -> String {
    let Order { other, published, ours, half_width, scenes, pairs, .. } = order;
    let signed = |v: &Option<f64>| v.map_or("–".to_owned(), |v| format!("{v:+.2}{unit}"));
    let half = half_width.map_or(String::new(), |half| format!(" ±{half:.2}"));
    let over = if *scenes > 0 { format!(" on {scenes} scenes") } else { String::new() };
    let [said, ..] = words(order);
    format!("| {other} | {} | {}{half} | {pairs}{over} | {said} |\n", signed(published), signed(ours))
}

/// What a difference says: in the table, of one in a sentence, of several.
type Words = [&'static str; 3];

const HOLDS: Words = ["holds", "holds", "hold"];
const FAILS: Words = ["does not hold", "does not hold", "do not hold"];
const ABOVE: Words = ["above 0", "is above 0", "are above 0"];
const BELOW: Words = ["below 0", "is below 0", "are below 0"];
const OPEN: Words = ["inconclusive", "is inconclusive", "are inconclusive"];
const NOT_RUN: Words = ["not run", "was not run", "were not run"];

fn words(order: &Order) -> Words {
    match (order.verdict, order.ours, order.side()) {
        (Some(Verdict::AsPublished), ..) => HOLDS,
        (Some(Verdict::Opposite), ..) => FAILS,
        (Some(Verdict::NotShown), ..) | (None, Some(_), None) => OPEN,
        (None, None, _) => NOT_RUN,
        (None, Some(_), Some(side)) if side > 0.0 => ABOVE,
        (None, Some(_), Some(_)) => BELOW,
    }
}

/// What the differences say of the paper's orders, in one sentence; of a table without published figures, on which side of 0 they are.
pub fn sentence(outcome: &Outcome) -> String {
    let is_published = |order: &Order| order.published.is_some();
    let published = outcome.orders.iter().any(is_published);
    let counted: Vec<&Order> = outcome.orders.iter().filter(|order| is_published(order) == published).collect();
    let part = |kind: Words| {
        let names: Vec<&str> = counted.iter().filter(|o| words(o) == kind).map(|o| o.other.as_str()).collect();
        let [_, one, many] = kind;
        let verb = if names.len() == 1 { one } else { many };
        (!names.is_empty()).then(|| format!("{} {verb} ({})", names.len(), names.join("; ")))
    };
    let parts = [HOLDS, FAILS, ABOVE, BELOW, OPEN, NOT_RUN].into_iter().filter_map(part).collect::<Vec<_>>().join(", ");
    let what = match (published, counted.len()) {
        (true, 1) => "published order",
        (true, _) => "published orders",
        (false, 1) => "difference without published figures",
        (false, _) => "differences without published figures",
    };
    format!("Of {} {what}, on {}, {parts}.", counted.len(), scenes(outcome))
}

/// The entries by the means of their differences, the best first.
fn ranking(outcome: &Outcome) -> String {
    let others = outcome.orders.iter().filter_map(|o| Some((o.other.as_str(), -o.ours?)));
    let mut all: Vec<(&str, f64)> = std::iter::once((first_entry(outcome), 0.0)).chain(others).collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
    format!("By their means: {}.", names.join(" > "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::{EntryOutcome, SceneOutcome};
    use crate::{Beside, Chosen, Generated, GeneratedFilm};
    use gs_synth::SynthOptions;
    use gs_synth::avatar::AvatarOptions;
    use gs4d_lab::contest::{Contest, ContestError, Event, Results, run_all};
    use std::path::Path;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

    fn conditions(root: &Path) -> Conditions {
        Conditions {
            data: Vec::new(),
            scenes: Vec::new(),
            entries: Vec::new(),
            seeds: SEEDS.to_vec(),
            preset: Some("fast".into()),
            length: Length::Recipe,
            scale: None,
            sets: Vec::new(),
            root: root.to_owned(),
        }
    }

    /// Scenes are generated ones, and settings are those of every entry.
    #[test]
    fn every_table_of_the_job_can_be_planned() {
        let all = reproductions(None, &conditions(Path::new("out"))).unwrap();
        let papers = ["fags", "modec", "trace", "dut"];
        let papers = papers.map(|paper| all.iter().filter(|r| r.table.paper == paper).count());
        assert_eq!(papers, [1, 3, 3, 1]);
        for table in &all {
            assert!(table.scenes.iter().all(Chosen::is_generated), "{}", table.table.full_name());
            assert!(matches!(table.conditions.length, Length::Steps(_)));
            for contest in table.contests(gs_methods::registry()).unwrap() {
                let plan = contest.plan().unwrap_or_else(|e| panic!("{}: {e}", table.table.full_name()));
                assert_eq!(plan.jobs.len(), table.table.runnable().count() * SEEDS.len());
            }
        }
        let own = Conditions { length: Length::Steps(7), sets: vec!["a.b=1".into()], ..conditions(Path::new("out")) };
        let one = reproductions(Some("trace-ablation-object"), &own).unwrap().remove(0);
        assert_eq!(one.conditions.length, Length::Steps(7));
        assert_eq!(one.conditions.sets.last().map(String::as_str), Some("a.b=1"));
        assert_eq!(one.conditions.root, Path::new("out/trace-ablation-object"));
        let error = reproductions(Some("dut-runtime"), &own).unwrap_err().to_string();
        assert!(error.contains("`dut-runtime`") && error.contains("trace-ablation-object"), "{error}");
    }

    #[test]
    fn rows_that_a_paper_puts_too_close_are_left_out() {
        let all = reproductions(None, &conditions(Path::new("out"))).unwrap();
        let mut left_out = Vec::new();
        for Reproduction { table, .. } in &all {
            let whole = Table::find(&table.paper, &table.name).unwrap();
            let entries = whole.entries.iter().map(|e| e.name.clone());
            left_out.extend(entries.filter(|name| !table.entries.iter().any(|e| e.name == *name)));
        }
        assert_eq!(left_out, ["without FG", "H_L 128x128x128x150", "k = 20", "1 frame", "3 frames"]);
    }

    /// A table of the job with small scenes where generated ones belong.
    fn small(root: &Path) -> Reproduction {
        let own = Conditions {
            seeds: vec![0, 1, 2],
            preset: Some("tiny".into()),
            length: Length::Steps(2),
            ..conditions(root)
        };
        let reproduction = reproductions(Some("fags-ablation"), &own).unwrap().remove(0);
        for scene in &reproduction.scenes {
            let folder = reproduction.conditions.root.join("data").join(scene.name());
            gs_synth::write(&folder, "balls", &SynthOptions::of_views(24, 6, 2), true).unwrap();
        }
        reproduction
    }

    /// The page of a table, trained until `trials` trials have begun.
    fn page(table: &Reproduction, trials: usize) -> Result<String, ContestError> {
        let (stop, begun) = (AtomicBool::new(false), AtomicUsize::new(0));
        let on_event = |_: usize, event: Event| match event {
            Event::Trial(_) if begun.fetch_add(1, Ordering::Relaxed) >= trials => stop.store(true, Ordering::Relaxed),
            Event::Failed(trial) => panic!("{trial}"),
            Event::Trial(_) | Event::Step(_) => {}
        };
        let contests: Vec<Contest> = table.contests(gs_methods::registry()).unwrap();
        let results: Vec<Results> = run_all(&contests, 2, &stop, &on_event)?;
        Ok(markdown(&[table.outcome(&results, &Beside::default())]))
    }

    #[test]
    fn an_interrupted_job_goes_on_to_the_same_page() {
        let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        let [halted, whole] = dirs.each_ref().map(|dir| small(dir.path()));
        let expected = page(&whole, usize::MAX).unwrap();
        assert!(expected.contains("Of 6 published orders, on waves-a, "), "{expected}");
        let stopped = page(&halted, 9);
        assert!(matches!(stopped, Err(ContestError::Interrupted(_))), "{stopped:?}");
        assert_eq!(page(&halted, usize::MAX).unwrap(), expected);
    }

    /// Two pairs show nothing, so the sentence is known before the training.
    #[test]
    fn stages_of_dut_are_trained_on_a_film() {
        let root = tempfile::tempdir().unwrap();
        let sides = ["textures.unproject=48", "textures.geo=32", "textures.gau=48"];
        let own = Conditions {
            seeds: vec![0, 1],
            length: Length::Steps(3),
            sets: sides.map(str::to_owned).into(),
            ..conditions(root.path())
        };
        let stages = reproductions(Some("dut-stages"), &own).unwrap().remove(0);
        let [Chosen::Generated(Generated::Film(GeneratedFilm { name, film }))] = &stages.scenes[..] else {
            panic!("{:?}", stages.scenes);
        };
        let film = AvatarOptions { size: 64, per_ring: 4, frames: 4, points: 500, ..film.clone() };
        Generated::Film(GeneratedFilm { name: name.clone(), film })
            .write(&stages.conditions.root.join("data"))
            .unwrap();
        let page = page(&stages, usize::MAX).unwrap();
        let rows: Vec<&str> = stages.table.runnable().skip(1).map(|e| e.name.as_str()).collect();
        let said = format!(
            "Of {} differences without published figures, on {name}, {} are inconclusive ({}).",
            rows.len(),
            rows.len(),
            rows.join("; ")
        );
        assert!(page.contains(&said), "`{said}` is not in {page}");
    }

    #[test]
    fn the_sentence_counts_what_holds() {
        let order = |other: &str, published: Option<f64>, ours: Option<f64>, verdict| Order {
            other: other.to_owned(),
            published,
            ours,
            half_width: ours.map(|_| 0.25),
            scenes: 0,
            pairs: 5,
            verdict,
        };
        let entry = EntryOutcome {
            entry: "full".into(),
            seeds: vec![0],
            steps: None,
            values: Vec::new(),
            perceptual_proxy: None,
            megabytes: None,
            seconds: None,
        };
        let scene = SceneOutcome { scene: "waves-a".into(), generated: true, entries: vec![entry] };
        let mut outcome = Outcome {
            table: "fags-ablation".into(),
            title: "Parts".into(),
            source: "FAGS".into(),
            protocol: String::new(),
            remark: None,
            conditions: "preset fast, 2 steps".into(),
            columns: vec!["psnr".into()],
            published: Vec::new(),
            scenes: vec![scene],
            orders: vec![
                order("a", Some(0.5), Some(0.75), Some(Verdict::AsPublished)),
                order("b", Some(0.5), Some(-0.5), Some(Verdict::Opposite)),
                order("c", Some(0.5), Some(0.125), Some(Verdict::NotShown)),
                order("d", Some(0.5), Some(0.5), Some(Verdict::AsPublished)),
                order("e", Some(0.5), None, None),
                order("f", None, Some(0.25), None),
            ],
            not_run: Vec::new(),
        };
        let said = "Of 5 published orders, on waves-a, 2 hold (a; d), 1 does not hold (b), 1 is inconclusive (c), 1 was not run (e).";
        assert_eq!(sentence(&outcome), said);
        let page = markdown(std::slice::from_ref(&outcome));
        for part in [
            "| full less | published | here | pairs | |",
            "| b | +0.50 dB | -0.50 dB ±0.25 | 5 | does not hold |",
            "| e | +0.50 dB | – | 5 | not run |",
            "| f | – | +0.25 dB ±0.25 | 5 | inconclusive |",
            "By their means: b > full > c > f > d > a.",
            said,
        ] {
            assert!(page.contains(part), "`{part}` is not in {page}");
        }
        outcome.orders.drain(..5);
        let one = "Of 1 difference without published figures, on waves-a, 1 is inconclusive (f).";
        assert_eq!(sentence(&outcome), one);
        outcome.orders.extend([order("g", None, Some(0.5), None), order("h", None, Some(-0.5), None)]);
        let three = "Of 3 differences without published figures, on waves-a, 1 is above 0 (g), 1 is below 0 (h), 1 is inconclusive (f).";
        assert_eq!(sentence(&outcome), three);
    }
}
