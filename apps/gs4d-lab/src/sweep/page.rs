//! HTML page of a sweep: quality against bytes, and the table.

use crate::sweep::Row;
use gs4d_report::ReportError;
use gs4d_report::chart::{Curve, Scale, chart};
use gs4d_report::html::{document, section, table};
use std::fmt::Write as _;

/// Stands below the title of every page.
pub const SUBTITLE: &str = "One setting at a time around a preset; means over seeds.";

/// Title of a chart and the plotted score.
type Quality = (&'static str, fn(&Row) -> Option<f64>);

const QUALITIES: [Quality; 3] =
    [("PSNR, dB", |r| r.psnr), ("SSIM", |r| r.ssim), ("Perceptual proxy (not LPIPS)", |r| r.proxy)];

/// A self-contained HTML page.
///
/// # Errors
/// If a chart cannot be encoded.
pub fn page(title: &str, rows: &[Row]) -> Result<String, ReportError> {
    let mut charts = String::new();
    for (name, quality) in QUALITIES {
        if let Some(svg) = chart(name, "MB (all parameters as f32)", Scale::Linear, &curves(rows, quality))? {
            let _ = writeln!(charts, "<figure>{svg}</figure>");
        }
    }
    let charts = if charts.is_empty() { charts } else { format!("<div class=\"charts\">\n{charts}</div>\n") };
    let remark = "One line for each varied setting, through its values and the preset.";
    let parts = section("Quality against bytes", remark, &charts) + &section("Settings", "", &rows_table(rows));
    Ok(document(title, SUBTITLE, &parts))
}

/// One line per key, by ascending bytes.
fn curves(rows: &[Row], quality: fn(&Row) -> Option<f64>) -> Vec<Curve> {
    let mut keys: Vec<&str> = Vec::new();
    rows.iter().filter_map(|r| r.key.as_deref()).for_each(|k| {
        if !keys.contains(&k) {
            keys.push(k);
        }
    });
    let of_key = |key: &str| {
        // The preset is a point of every line.
        let all = rows.iter().filter(|r| r.key.as_deref().is_none_or(|k| k == key));
        let mut points: Vec<(f64, f64)> = all.filter_map(|r| r.megabytes.zip(quality(r))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        points.dedup();
        Curve { name: key.to_owned(), points }
    };
    keys.iter().map(|k| of_key(k)).collect()
}

fn rows_table(rows: &[Row]) -> String {
    let (head, mut cells) = Row::table(rows, "–");
    for (cells, row) in cells.iter_mut().zip(rows) {
        cells[0].push_str(if row.repeats_preset() { " (the preset's)" } else { "" });
        if let Some(deviation) = row.psnr_deviation.filter(|d| *d > 0.0) {
            cells[1].push_str(&format!(" ± {deviation:.2}"));
        }
    }
    table(&head, &(1..head.len()).collect::<Vec<_>>(), cells.into_iter())
}
