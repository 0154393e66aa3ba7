//! A [`Checkup`] as one self-contained HTML file.

use super::{Checkup, Finding, Verdict};
use gs4d_report::ReportError;
use gs4d_report::html::{captioned, document, escape, section, table};

/// Renders a [`Checkup`] as one self-contained HTML page.
///
/// # Errors
/// If a figure cannot be encoded as PNG or JPEG.
pub fn page(c: &Checkup) -> Result<String, ReportError> {
    let mut sections = section("Findings", "", &findings(&c.findings));
    let mut topics: Vec<&str> = c.figures.iter().map(|p| p.topic).collect();
    topics.dedup();
    for topic in topics {
        let mut shown = String::new();
        for p in c.figures.iter().filter(|p| p.topic == topic) {
            shown += &captioned(&p.image, &p.caption)?;
        }
        let heading = match topic {
            "poses" => "Poses against images",
            "template" => "Template against images",
            "init" => "Points in the images",
            _ => "Cameras and box",
        };
        sections += &section(heading, "", &format!("<div class=\"strip maps\">\n{shown}</div>\n"));
    }
    if let Some(cost) = &c.cost {
        let rows = cost
            .stages
            .iter()
            .map(|s| vec![s.name.clone(), s.steps.to_string(), format!("{:.2}", s.ms[0]), format!("{:.2}", s.ms[1])]);
        let head = ["stage", "steps", "ms a step at first", "ms a step, most splats"];
        sections += &section("A training run", &escape(&cost.run), &table(&head, &[1, 2, 3], rows));
    }
    let notes = c.notes.iter().map(|n| vec![n.clone()]);
    sections += &section("What was assumed while reading", "", &table(&[""], &[], notes));
    Ok(document(&format!("doctor · {}", c.root.display()), &c.summary(), &sections))
}

fn findings(list: &[Finding]) -> String {
    let rows = list.iter().map(|f| {
        let places = if f.places.is_empty() { String::new() } else { format!(" [{}]", f.places.join(", ")) };
        vec![
            f.topic.to_owned(),
            verdict(f.verdict).to_owned(),
            format!("{}{places}", f.what),
            f.fix.clone().unwrap_or_default(),
        ]
    });
    table(&["topic", "", "what was found", "what to do"], &[0, 1], rows)
}

/// The name of a severity in the table.
fn verdict(v: Verdict) -> &'static str {
    match v {
        Verdict::Ok => "ok",
        Verdict::Note => "note",
        Verdict::Warning => "warning",
        Verdict::Problem => "problem",
    }
}
