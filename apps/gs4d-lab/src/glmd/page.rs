//! Report page of a study: images of the stages, curves over time and a table.

use std::fmt::Write as _;

use super::{GlmdError, Mean, Scores, Still, Switches, panels};
use gs4d_report::chart::chart;
use gs4d_report::html::{document, escape, inline_image, section, table};
use gs4d_report::{Curve, ReportError, Scale};

/// Most times shown on the page, evenly spread; the folder holds all.
const MAX_TIMES: usize = 16;

/// Content of the page.
pub struct Study<'a> {
    /// Heading, for example `reach · modec`.
    pub title: &'a str,
    /// Line below the heading: camera, anchor, masks.
    pub subtitle: &'a str,
    /// Results at all times, in order.
    pub stills: &'a [Still],
    /// Means over the times, from [`super::means`].
    pub means: &'a [Mean],
    /// Gates of the anchors, from [`super::switches`].
    pub switches: &'a Switches,
}

/// A self-contained HTML page.
///
/// # Errors
/// If an image or chart cannot be encoded.
pub fn html(study: &Study<'_>) -> Result<String, GlmdError> {
    let parts = [averages(study.means), switches(study.switches)?, curves(study.stills)?, images(study.stills)?];
    Ok(document(study.title, study.subtitle, &parts.concat()))
}

fn averages(means: &[Mean]) -> String {
    let row = |m: &Mean| {
        vec![m.step.clone(), m.by.to_owned(), m.name.replace('_', " "), format!("{:.4}", m.mean), m.moments.to_string()]
    };
    let head = ["stages", "flow", "number", "mean", "moments"];
    let remark = "Inside and outside: mean length over the reference, in the mask and elsewhere, where something is seen. \
        Circular variance: 0 is one direction, 1 every direction.";
    section("What moved where", remark, &table(&head, &[3, 4], means.iter().map(row)))
}

fn switches(switches: &Switches) -> Result<String, ReportError> {
    let mut content = String::new();
    if let Some(share) = switches.global {
        let _ = writeln!(content, "<p>{:.1} % of the anchors move with their scaffold (M = 1).</p>", 100.0 * share);
    }
    if let Some(h) = &switches.local {
        let width = f64::from(h.span[1] - h.span[0]) / h.counts.len() as f64;
        let point = |(k, n): (usize, &u32)| (f64::from(h.span[0]) + (k as f64 + 0.5) * width, f64::from(*n));
        let curve = Curve { name: "anchors".into(), points: h.counts.iter().enumerate().map(point).collect() };
        let svg = chart("Anchors by σ(d_L)", "σ(d_L)", Scale::Linear, &[curve])?;
        svg.iter().for_each(|svg| content.push_str(&format!("<div class=\"charts\"><figure>{svg}</figure></div>\n")));
    }
    Ok(section("Dynamics of the anchors", "", &content))
}

/// Selects one statistic of a flow.
type Number = fn(&Scores) -> Option<f64>;

fn curves(stills: &[Still]) -> Result<String, ReportError> {
    let mut out = String::new();
    let groups: [(&str, Number); 3] = [
        ("Mean length, px", |s| Some(s.mean)),
        ("In-mask over out-of-mask", |s| s.ratio),
        ("Circular variance in the mask", |s| s.circular_variance_inside),
    ];
    for (title, value) in groups {
        let mut lines: Vec<Curve> = Vec::new();
        for (still, step) in stills.iter().flat_map(|s| s.steps.iter().map(move |step| (s, step))) {
            let Some(y) = value(&step.scores) else { continue };
            let (name, point) = (format!("{} by {}", step.name, step.by), (f64::from(still.time), y));
            match lines.iter_mut().find(|l| l.name == name) {
                Some(line) => line.points.push(point),
                None => lines.push(Curve { name, points: vec![point] }),
            }
        }
        if let Some(svg) = chart(title, "time", Scale::Linear, &lines)? {
            let _ = writeln!(out, "<figure>{svg}</figure>");
        }
    }
    let grid = if out.is_empty() { out } else { format!("<div class=\"charts\">\n{out}</div>\n") };
    Ok(section("Over time", "", &grid))
}

fn images(stills: &[Still]) -> Result<String, GlmdError> {
    let mut out = String::new();
    for still in gs_data::evenly(stills.len(), MAX_TIMES).map(|k| &stills[k]) {
        let _ = write!(out, "<h2>t = {:.3}</h2>\n<div class=\"strip maps\">\n", still.time);
        for (name, image) in panels::panels(still)? {
            let _ = writeln!(out, "<span>{}<small>{}</small></span>", inline_image(&image, &name)?, escape(&name));
        }
        out.push_str("</div>\n");
    }
    let remark = "Stages in order, then the flow between each and the next: hue is direction, saturation length, arrows \
        the mean over their cell.";
    Ok(section("Stages and flows", remark, &out))
}
