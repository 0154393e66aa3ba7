//! The section that the method itself reports, drawn without knowing the method.

use super::ReportError;
use super::chart::chart;
use super::heat::heat_map;
use super::html::{collapsed, escape, figure, section, table, wrapped};
use gs_train::report::{Section, Table};

/// Renders the section; empty without content.
///
/// # Errors
/// If a chart or a heat map cannot be encoded.
pub(crate) fn method_section(of: &Section) -> Result<String, ReportError> {
    let mut charts = String::new();
    for c in &of.charts {
        charts += &figure(chart(&c.title, &c.x, c.scale, &c.curves)?);
    }
    for m in &of.matrices {
        charts += &heat_map(&m.columns, &m.caption, &m.caption)?;
    }
    let rows = of.rows.iter().map(|r| vec![r.name.clone(), r.value.clone(), r.meaning.clone()]);
    let content = wrapped("charts", charts)
        + &table(&["what", "how much", "meaning"], &[], rows)
        + &of.tables.iter().map(long_table).collect::<String>();
    Ok(section(&escape(&of.title), &escape(&of.remark), &content))
}

fn long_table(t: &Table) -> String {
    let head: Vec<String> = t.head.iter().map(|h| escape(h)).collect();
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    collapsed(&escape(&t.summary), table(&head, &t.numeric, t.rows.iter().cloned()))
}
