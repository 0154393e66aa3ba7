//! The report section on intervals and anchors: boundaries over steps, gradients of intervals, every adjustment.

use super::ReportError;
use super::chart::{Scale, chart};
use super::page::{escape, picture, section, table, wrapped};
use crate::analysis::Journal;

/// Renders the section; empty without events.
///
/// # Errors
/// If the chart or the heat map cannot be encoded.
pub(crate) fn intervals(journal: &Journal) -> Result<String, ReportError> {
    let svg = chart("Boundaries, normalised time", "step", Scale::Linear, &journal.curves())?;
    let mut charts = svg.map_or(String::new(), |svg| format!("<figure>{svg}</figure>\n"));
    if let Some(map) = journal.heat() {
        let (last, passes) = (map.span[1], map.steps.len());
        let caption = format!("mean gradient, intervals 0 (bottom) to {last}, {passes} passes from left to right");
        let picture = picture(&map.image(), &caption)?;
        charts += &format!("<span class=\"heat\">{picture}<small>{}</small></span>\n", escape(&caption));
    }
    let charts = wrapped("charts", charts);
    let rows = journal.rows().into_iter().map(|n| vec![n.name, n.value, n.meaning]);
    let content = charts + &table(&["what", "how much", "meaning"], &[], rows) + &passes(journal);
    let remark = if journal.passes.is_empty() {
        ""
    } else {
        "Busy intervals are made shorter. Gradients of each pass by themselves, the darker the larger."
    };
    Ok(section("Intervals and anchors", remark, &content))
}

/// The table of all adjustments, collapsed.
fn passes(journal: &Journal) -> String {
    let head = ["step", "threshold", "busy (mean gradient)", "moved", "refused"];
    let content = table(&head, &[0, 1], journal.passes.iter().map(|p| p.cells().to_vec()));
    if content.is_empty() {
        return content;
    }
    format!("<details><summary>{} passes</summary>\n{content}</details>\n", journal.passes.len())
}
