//! A [`Checkup`] as one self-contained HTML file.

use super::{Checkup, Finding, Verdict};
use gs4d_report::ReportError;
use gs4d_report::html::{captioned, document, escape, section, table};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// How the page's title begins.
const TITLE: &str = "doctor · ";

/// Whether a file is a page of the doctor, which another may replace.
pub fn is_page(path: &Path) -> bool {
    let mut head = vec![0; 4096];
    let read = File::open(path).and_then(|mut f| f.read(&mut head)).unwrap_or(0);
    String::from_utf8_lossy(&head[..read]).contains(&format!("<title>{TITLE}"))
}

/// Renders a [`Checkup`] as one self-contained HTML page.
///
/// # Errors
/// If a figure cannot be encoded as PNG or JPEG.
pub fn page(c: &Checkup) -> Result<String, ReportError> {
    let mut sections = section("Findings", "", &findings(&c.findings));
    let mut topics: Vec<&str> = Vec::new();
    c.figures.iter().for_each(|p| {
        if !topics.contains(&p.topic) {
            topics.push(p.topic)
        }
    });
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
    Ok(document(&format!("{TITLE}{}", c.root.display()), &c.summary(), &sections))
}

/// The table of findings; the colour of a row is that of its severity.
fn findings(list: &[Finding]) -> String {
    let row = |f: &Finding| {
        let places = f.places.iter().map(|p| format!("<br>{}", escape(p))).collect::<String>();
        let (class, what) = (verdict(f.verdict), escape(&f.what));
        let fix = f.fix.as_deref().map_or(String::new(), escape);
        format!(
            "<tr class=\"{class}\"><td>{}</td><td>{class}</td><td>{what}{places}</td><td>{fix}</td></tr>\n",
            f.topic
        )
    };
    let head = "<tr><th>topic</th><th></th><th>what was found</th><th>what to do</th></tr>";
    let rows: String = list.iter().map(row).collect();
    format!(
        "<div class=\"scroll\"><table class=\"findings\">\n<thead>{head}</thead>\n<tbody>\n{rows}</tbody>\n</table></div>\n"
    )
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
