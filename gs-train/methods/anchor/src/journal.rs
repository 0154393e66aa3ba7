//! The section of the report on intervals and anchors: moves of interval boundaries and growth of anchors, from the events
//! of a run.
//!
//! Events of other kinds are ignored.

use gs_anchor::{Adjustment, AnchorDensifyReport};
use gs_core::cast;
use gs_train::report::{Chart, Curve, Matrix, ReportRow, Scale, Section, Table};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Most values written out in a list.
const MAX_LISTED: usize = 16;
/// Heat-map count of the busiest interval of a pass.
const FULL_COUNT: f32 = 10_000.0;

/// The events of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Journal {
    /// Adjustments of the interval boundaries, by step.
    pub passes: Vec<Pass>,
    /// Changes of the number of anchors, by step.
    pub growth: Vec<Growth>,
}

/// One adjustment of the interval boundaries.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pass {
    /// Step of the run.
    pub step: u32,
    /// Starts of the intervals afterwards, normalised time.
    pub starts: Vec<f32>,
    /// Mean gradients, threshold, moves and rejected moves.
    pub intervals: Adjustment,
}

/// One change of the number of anchors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Step of the run.
    pub step: u32,
    /// Number of anchors afterwards.
    pub anchors: usize,
    /// Anchors grown per level, and pruned.
    pub grown: AnchorDensifyReport,
}

impl Pass {
    /// Starts of the intervals before the adjustment.
    fn before(&self) -> Vec<f32> {
        let mut starts = self.starts.clone();
        for m in self.intervals.moves.iter().rev() {
            starts.get_mut(m.boundary).into_iter().for_each(|b| *b = m.from);
        }
        starts
    }

    /// The interval of an entry of the statistic: the released rule leaves out the first one.
    fn interval(&self, slot: usize) -> usize {
        slot + self.starts.len().saturating_sub(self.intervals.means.len())
    }

    /// The busiest interval and its mean gradient.
    fn busiest(&self) -> Option<(usize, f32)> {
        let seen = self.intervals.means.iter().enumerate().filter_map(|(slot, m)| m.map(|m| (slot, m)));
        seen.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(slot, mean)| (self.interval(slot), mean))
    }

    /// Step, threshold, busy intervals, moves and rejected moves, for a table.
    fn cells(&self) -> [String; 5] {
        let Adjustment { threshold, hot, moves, rejected, .. } = &self.intervals;
        let busy: Vec<String> = hot
            .iter()
            .map(|&slot| {
                let mean = self.intervals.means.get(slot).copied().flatten().unwrap_or(f32::NAN);
                format!("{} ({mean:.3e})", self.interval(slot))
            })
            .collect();
        let moves = moves.iter().map(|m| format!("{}: {:.4} → {:.4}", m.boundary, m.from, m.to));
        let refused = rejected.iter().map(|r| format!("{} at {:.4}: {}", r.boundary, r.at, r.reason));
        [
            self.step.to_string(),
            threshold.map_or("none: too few intervals seen".to_owned(), |t| format!("{t:.3e}")),
            busy.join(", "),
            moves.collect::<Vec<_>>().join(", "),
            refused.collect::<Vec<_>>().join(", "),
        ]
    }
}

impl Journal {
    /// Reads the events of a run, in order.
    pub fn of(events: &[Value]) -> Self {
        fn known<T: for<'a> Deserialize<'a>>(events: &[Value]) -> Vec<T> {
            events.iter().filter_map(|event| T::deserialize(event).ok()).collect()
        }
        Self { passes: known(events), growth: known(events) }
    }

    /// The section of the report; none without events.
    pub(crate) fn section(&self) -> Option<Section> {
        if self.passes.is_empty() && self.growth.is_empty() {
            return None;
        }
        let remark = match self.passes.is_empty() {
            true => "",
            false => "Busy intervals are made shorter. Gradients of each pass by themselves, the darker the larger.",
        };
        let boundaries = Chart {
            title: "Boundaries, normalised time".into(),
            x: "step".into(),
            scale: Scale::Linear,
            curves: self.curves(),
        };
        let passes = Table {
            summary: format!("{} passes", self.passes.len()),
            head: ["step", "threshold", "busy (mean gradient)", "moved", "refused"].map(str::to_owned).to_vec(),
            numeric: vec![0, 1],
            rows: self.passes.iter().map(|p| p.cells().to_vec()).collect(),
        };
        Some(Section {
            title: "Intervals and anchors".into(),
            remark: remark.into(),
            charts: vec![boundaries],
            matrices: self.gradients().into_iter().collect(),
            rows: self.rows(),
            tables: vec![passes],
            json: json!(self),
        })
    }

    /// Statistics over all events.
    fn rows(&self) -> Vec<ReportRow> {
        let mut rows = Vec::new();
        if let (Some(first), Some(last)) = (self.passes.first(), self.passes.last()) {
            rows.extend(self.course(first, last));
            rows.extend([self.busiest(), self.moved(), self.refused()]);
            rows.push(ReportRow::new("boundaries at first", list(&inner(&first.before()), 4), "normalised time"));
            rows.push(ReportRow::new("boundaries at last", list(&inner(&last.starts), 4), "normalised time"));
            rows.push(ReportRow::new("widths at last", list(&last.intervals.frames, 1), "frames of each interval"));
        }
        rows.extend(self.grown());
        rows
    }

    fn course(&self, first: &Pass, last: &Pass) -> [ReportRow; 2] {
        let idle = self.passes.iter().filter(|p| p.intervals.hot.is_empty()).count();
        let steps = format!("{} passes, steps {} to {}", self.passes.len(), first.step, last.step);
        [
            ReportRow::new(
                "intervals",
                last.starts.len().to_string(),
                "anchors have one deformation in each, or one at each border and a blend between (`intervals.blend`)",
            ),
            ReportRow::new("idle passes", format!("{idle} of {steps}"), "no interval was above the threshold"),
        ]
    }

    /// The interval with the largest ratio of gradient to threshold over all passes.
    fn busiest(&self) -> ReportRow {
        let of = |p: &Pass| {
            let ((interval, mean), threshold) = p.busiest().zip(p.intervals.threshold)?;
            (threshold > 0.0).then(|| (mean / threshold, interval, p.step))
        };
        let most = self.passes.iter().filter_map(of).max_by(|a, b| a.0.total_cmp(&b.0));
        let text = most.map_or("–".into(), |(times, interval, step)| {
            format!("{interval}, {times:.2} times the threshold, step {step}")
        });
        ReportRow::new("busiest interval", text, "its mean gradient of screen positions; above 1 it is made shorter")
    }

    fn moved(&self) -> ReportRow {
        let mut times: BTreeMap<usize, usize> = BTreeMap::new();
        for m in self.passes.iter().flat_map(|p| &p.intervals.moves) {
            *times.entry(m.boundary).or_default() += 1;
        }
        let each: Vec<String> = times.iter().take(MAX_LISTED).map(|(b, n)| format!("{b}: {n}")).collect();
        let total: usize = times.values().sum();
        let text = if total == 0 { "0".into() } else { format!("{total} ({})", each.join(", ")) };
        ReportRow::new("boundaries moved", text, "moves of each boundary, towards the middle of a busy interval")
    }

    fn refused(&self) -> ReportRow {
        let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
        for r in self.passes.iter().flat_map(|p| &p.intervals.rejected) {
            *reasons.entry(&r.reason).or_default() += 1;
        }
        let each: Vec<String> = reasons.iter().map(|(why, n)| format!("{n} {why}")).collect();
        let text = if each.is_empty() { "0".into() } else { each.join(", ") };
        ReportRow::new("moves refused", text, "how often, and why")
    }

    fn grown(&self) -> Option<ReportRow> {
        let last = self.growth.last()?;
        let mut levels: Vec<u64> = Vec::new();
        for g in &self.growth {
            levels.resize(levels.len().max(g.grown.per_level.len()), 0);
            levels.iter_mut().zip(&g.grown.per_level).for_each(|(sum, n)| *sum += u64::from(*n));
        }
        let levels: Vec<String> = levels.iter().map(u64::to_string).collect();
        let pruned: u64 = self.growth.iter().map(|g| u64::from(g.grown.pruned)).sum();
        let text = format!("+{} −{pruned} → {}", levels.join(" +"), last.anchors);
        Some(ReportRow::new("anchors", text, "grown on each level, the coarsest first; pruned; then left"))
    }

    /// Inner boundaries over the steps of the run, as step functions.
    pub fn curves(&self) -> Vec<Curve> {
        let Some(first) = self.passes.first() else { return Vec::new() };
        let stairs = |boundary: usize| {
            let mut at = f64::from(*first.before().get(boundary)?);
            let mut points = vec![(0.0, at)];
            for p in &self.passes {
                points.push((f64::from(p.step), at));
                at = f64::from(*p.starts.get(boundary)?);
                points.push((f64::from(p.step), at));
            }
            Some(Curve { name: String::new(), points })
        };
        (1..first.starts.len()).filter_map(stairs).collect()
    }

    /// Mean gradient of every interval at every pass, relative to the busiest one of the pass; `None` without passes.
    fn gradients(&self) -> Option<Matrix> {
        let n = self.passes.first()?.starts.len();
        let column = |p: &Pass| {
            let mut counts = vec![0; n];
            let most = p.busiest().map_or(0.0, |(_, mean)| mean).max(f32::MIN_POSITIVE);
            for (slot, mean) in p.intervals.means.iter().enumerate() {
                let count = counts.get_mut(p.interval(slot));
                count
                    .into_iter()
                    .for_each(|c| *c = cast::to_u32(cast::to_usize(FULL_COUNT * mean.unwrap_or(0.0) / most)));
            }
            counts
        };
        let (last, passes) = (n.saturating_sub(1), self.passes.len());
        Some(Matrix {
            caption: format!("mean gradient, intervals 0 (bottom) to {last}, {passes} passes from left to right"),
            columns: self.passes.iter().map(column).collect(),
        })
    }
}

/// All boundaries except the fixed first one.
fn inner(starts: &[f32]) -> Vec<f32> {
    starts.iter().skip(1).copied().collect()
}

fn list(values: &[f32], digits: usize) -> String {
    let mut words: Vec<String> = values.iter().take(MAX_LISTED).map(|v| format!("{v:.digits$}")).collect();
    if values.len() > MAX_LISTED {
        words.push(format!("… ({} in all)", values.len()));
    }
    if words.is_empty() { "none".into() } else { words.join(" ") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_anchor::intervals::{IntervalConfig, Intervals, Rule};

    /// The lines that two passes over eight intervals leave, the fifth of which is busy; then two of growth.
    fn lines(rule: Rule) -> Vec<Value> {
        let config = IntervalConfig { step: 0.1, rule, ..IntervalConfig::default() };
        let mut i = Intervals::new(&config, 101).expect("intervals");
        let mut lines = vec![json!({"step": 3, "weather": "fair"}), json!(7), json!({"step": 4, "intervals": {}})];
        for pass in 1..=2u32 {
            for k in 0..200 {
                let t = k as f32 / 199.0;
                i.observe(t, if (0.5..0.62).contains(&t) { 9.0 } else { 1.0 }, 1, 1.0);
            }
            let step = 1000 * pass + 50;
            let did = i.adjust(1000 * pass, step).expect("a pass");
            lines.push(json!({"step": step, "starts": i.starts.value, "intervals": did}));
        }
        for (step, levels) in [(1100, [4, 2, 1]), (1200, [0, 0, 5])] {
            let grown = json!({"added": 12, "pruned": 3, "per_level": levels});
            lines.push(json!({"step": step, "anchors": 100, "grown": grown}));
        }
        lines
    }

    fn value(rows: &[ReportRow], name: &str) -> String {
        rows.iter().find(|r| r.name == name).map_or("absent".into(), |r| r.value.clone())
    }

    #[test]
    fn events_are_summed_up() {
        let journal = Journal::of(&lines(Rule::Clean));
        assert_eq!((journal.passes.len(), journal.growth.len()), (2, 2), "other lines are passed over");
        let rows = journal.rows();
        let says = |name: &str, want: &str| assert_eq!(value(&rows, name), want, "{name}");
        says("intervals", "8");
        says("idle passes", "0 of 2 passes, steps 1050 to 2050");
        says("boundaries moved", "4 (4: 2, 5: 2)");
        says("moves refused", "0");
        says("boundaries at first", "0.1250 0.2500 0.3750 0.5000 0.6250 0.7500 0.8750");
        says("boundaries at last", "0.1250 0.2500 0.3750 0.5250 0.6000 0.7500 0.8750");
        says("widths at last", "12.5 12.5 12.5 15.0 7.5 15.0 12.5 12.5");
        says("anchors", "+4 +2 +6 −6 → 100");
        assert!(value(&rows, "busiest interval").starts_with("4, 1."), "{}", value(&rows, "busiest interval"));
    }

    #[test]
    fn boundaries_are_stairs_and_busy_intervals_are_dark() {
        let journal = Journal::of(&lines(Rule::Clean));
        let curves = journal.curves();
        assert_eq!(curves.len(), 7);
        let wanted = [(0.0, 0.5), (1050.0, 0.5), (1050.0, 0.5125), (2050.0, 0.5125), (2050.0, 0.525)];
        for (got, want) in curves[3].points.iter().zip(wanted) {
            assert!(got.0 == want.0 && (got.1 - want.1).abs() < 1e-6, "{got:?} {want:?}");
        }
        assert_eq!(journal.passes.iter().map(|p| p.step).collect::<Vec<_>>(), [1050, 2050]);
        let gradients = journal.gradients().expect("passes");
        assert_eq!(gradients.columns.iter().map(Vec::len).collect::<Vec<_>>(), [8, 8]);
        assert_eq!(gradients.caption, "mean gradient, intervals 0 (bottom) to 7, 2 passes from left to right");
        for column in &gradients.columns {
            let darkest = (0..8).max_by_key(|&c| column[c]);
            assert_eq!((darkest, column[4], column[0]), (Some(4), 10_000, column[7]));
        }
        // 9.0 in the fifth, 1.0 elsewhere, but for the border of the burst.
        assert!((1000..1300).contains(&gradients.columns[0][0]), "{:?}", gradients.columns);
    }

    #[test]
    fn the_section_has_a_chart_a_heat_map_statistics_and_every_pass() {
        let journal = Journal::of(&lines(Rule::Clean));
        let section = journal.section().expect("events");
        assert_eq!(section.title, "Intervals and anchors");
        assert_eq!((section.charts[0].curves.len(), section.matrices.len(), section.rows.len()), (7, 1, 9));
        let [passes] = &section.tables[..] else { panic!("{:?}", section.tables) };
        assert_eq!((passes.summary.as_str(), passes.rows.len()), ("2 passes", 2));
        assert!(passes.rows.iter().all(|r| r.len() == passes.head.len()));
        assert_eq!(section.json["growth"][1]["anchors"], 100);
        assert_eq!(section.json["passes"][0]["step"], 1050);

        let grown: Vec<Value> = lines(Rule::Clean).into_iter().filter(|e| e["grown"].is_object()).collect();
        let section = Journal::of(&grown).section().expect("growth");
        assert!(section.remark.is_empty() && section.matrices.is_empty() && section.tables[0].rows.is_empty());
        assert_eq!(value(&section.rows, "anchors"), "+4 +2 +6 −6 → 100");
    }

    #[test]
    fn the_released_rule_counts_intervals_from_the_second() {
        let journal = Journal::of(&lines(Rule::Ref));
        let pass = &journal.passes[0];
        assert_eq!((pass.intervals.hot.as_slice(), pass.intervals.means.len()), (&[3][..], 7));
        assert_eq!(pass.busiest().map(|b| b.0), Some(4));
        assert!(pass.cells()[2].starts_with("4 ("), "{:?}", pass.cells());
        assert_eq!(journal.gradients().expect("passes").columns[0][0], 0);
    }

    #[test]
    fn odd_lines_do_not_stop_it() {
        let none = Journal::of(&[]);
        assert!(none.section().is_none() && none.rows().is_empty() && none.gradients().is_none());
        let odd = json!({"step": 1, "starts": [0.0], "intervals": {
            "clock": 1, "step": 1, "means": [null, 1.0, 2.0], "threshold": null, "hot": [9],
            "moves": [{"boundary": 77, "from": 0.1, "to": 0.2}],
            "rejected": [{"boundary": 5, "at": 0.5, "reason": "busy on both sides"}], "frames": []}});
        let journal = Journal::of(&[odd]);
        assert_eq!((journal.passes.len(), journal.curves().len()), (1, 0));
        let rows = journal.rows();
        assert_eq!(value(&rows, "moves refused"), "1 busy on both sides");
        assert_eq!((value(&rows, "boundaries at last"), value(&rows, "busiest interval")), ("none".into(), "–".into()));
        assert_eq!(journal.gradients().expect("a pass").columns, [[0]]);
    }
}
