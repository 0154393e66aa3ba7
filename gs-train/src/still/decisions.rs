//! What a run says of the splats it left out of the field while training.

use crate::report::{Chart, Curve, ReportRow, Scale, Section};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// A decision which splats are still, as the run logs it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Decision {
    /// The step it was made after.
    pub step: u32,
    /// Number of still splats.
    pub still: usize,
    /// Number of those that were left out and enter the field again, for their mean screen gradient was large.
    #[serde(default)]
    pub entered: usize,
    /// Number of all splats.
    pub splats: usize,
}

impl Decision {
    /// Still splats, per cent of all.
    fn share(&self) -> f64 {
        100.0 * self.still as f64 / self.splats.max(1) as f64
    }
}

/// The section of a report, from all that a run has logged; none where nothing was decided.
pub fn section(events: &[Value]) -> Option<Section> {
    let decisions: Vec<Decision> = events.iter().filter_map(|event| Decision::deserialize(event).ok()).collect();
    let last = decisions.last()?;
    let points = decisions.iter().map(|d| (f64::from(d.step), d.share())).collect();
    let course = Chart {
        title: "Still splats, % of all".into(),
        x: "step".into(),
        scale: Scale::Linear,
        curves: vec![Curve { name: String::new(), points }],
    };
    let value = format!("{} of {} ({:.1} %)", last.still, last.splats, last.share());
    let meaning = format!("left out of the field while training; last decided after step {}", last.step);
    let why = "were left out; take part until the next decision, for their mean screen gradient was large";
    let entered = ReportRow::new("entered again", last.entered.to_string(), why);
    Some(Section {
        title: "Still splats".into(),
        remark: "Splats that the field hardly moves are left out of it for most of the training.".into(),
        charts: vec![course],
        rows: vec![ReportRow::new("still splats", value, &meaning), entered],
        json: json!({ "still": last }),
        ..Section::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_decision_is_named_and_all_are_drawn() {
        let first = json!({ "step": 200, "still": 0, "splats": 30 });
        let last = json!({ "step": 400, "still": 10, "entered": 3, "splats": 40 });
        let events = [first, json!({ "step": 300, "moved": 1 }), last];
        let section = section(&events).unwrap();
        assert_eq!(section.charts[0].curves[0].points, [(200.0, 0.0), (400.0, 25.0)]);
        assert_eq!([&section.rows[0].value, &section.rows[1].value], ["10 of 40 (25.0 %)", "3"]);
        assert_eq!(section.json["still"], events[2]);
        assert_eq!(super::section(&events[1..2]), None);
    }
}
