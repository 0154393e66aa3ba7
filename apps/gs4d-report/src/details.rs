//! The end of a report: folded tables, and command lines.

use super::html::{collapsed, escape, section, table};
use super::{Report, ReportRow};
use crate::storage::Storage;
use std::fmt::Write as _;

/// Folded tables: scores, splats, work, bytes, settings, machine and data.
pub(crate) fn details(report: &Report) -> String {
    let scores =
        table(&["metric", "mean", "median", "worst", "view"], &[1, 2, 3], report.scores.iter().map(|r| r.to_vec()));
    let settings = table(&["setting", "value", "from"], &[], report.settings.iter().map(|r| r.to_vec()));
    let provenance = table(&["name", "value"], &[], report.provenance.iter().map(|r| r.to_vec()));
    let content = [
        collapsed("Every score: mean, median, worst view", scores),
        collapsed("Splats and their motion", statistics(&report.needs)),
        collapsed("Work done and skipped", statistics(&report.work)),
        collapsed("Bytes by block", report.storage.as_ref().map_or(String::new(), bytes)),
        collapsed(&format!("{} settings", report.settings.len()), settings),
        collapsed("Machine, program and data", provenance),
    ];
    section("Details", "", &content.concat())
}

/// The table of some statistics.
fn statistics(rows: &[ReportRow]) -> String {
    let cells = rows.iter().map(|r| vec![r.name.clone(), r.value.clone(), r.meaning.clone()]);
    table(&["what", "how much", "meaning"], &[1], cells)
}

/// The storage by block, and by the counting rule of the paper where there is one.
fn bytes(storage: &Storage) -> String {
    let mb = |bytes: usize| format!("{:.3}", bytes as f64 / 1e6);
    let row = |name: &str, values: usize| vec![name.to_owned(), values.to_string(), mb(4 * values), mb(2 * values)];
    let blocks = storage.blocks.iter().map(|b| row(&b.block, b.values));
    let all = std::iter::once(row("all", storage.bytes() / 4));
    let mut out = table(&["parameters of", "values", "f32 MB", "f16 MB"], &[1, 2, 3], blocks.chain(all));
    if let Some(paper) = &storage.paper {
        let row = |name: &str, paper: usize, needed: usize| vec![name.to_owned(), mb(paper), mb(needed)];
        let blocks = paper.rows.iter().map(|r| row(&r.block, 4 * r.paper_values, 4 * r.needed_values));
        let all = std::iter::once(row("all", paper.paper_bytes(), paper.needed_bytes()));
        out += &table(&["as its paper counts", "paper MB", "as needed MB"], &[1, 2], blocks.chain(all));
    }
    out
}

/// Command lines with what they do.
pub(crate) fn commands(commands: &[[String; 2]]) -> String {
    let mut out = String::new();
    for [what, command] in commands {
        let _ = writeln!(out, "<dt>{}</dt><dd><code>{}</code></dd>", escape(what), escape(command));
    }
    if !out.is_empty() {
        out = format!("<dl class=\"commands\">\n{out}</dl>\n");
    }
    section("Commands", "A click selects a whole line. The folder is that of the run when this page was written.", &out)
}
