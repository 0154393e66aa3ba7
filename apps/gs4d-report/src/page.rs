//! The HTML of a report, and charts of training.

use super::chart::{Curve, Scale, chart};
use super::embed::reduced;
use super::heat::heat_map;
use super::html::{captioned, collapsed, document, escape, section, table, wrapped};
use super::method_section::method_section;
use super::overlay::overlays;
use super::scatter::scatter;
use super::views::{comparisons, script};
use super::{Comparison, Report, ReportError, ReportRow, Sample};
use crate::storage::Storage;
use std::fmt::Write as _;

/// Longest side of an image of the strip, pixels.
const MAX_STRIP_SIDE: usize = 320;
/// Renders a report; sections without content are left out.
pub(crate) fn page(report: &Report) -> Result<String, ReportError> {
    let parts = [
        figures(report),
        scores(report),
        curves(report)?,
        views("Ground truth beside render", &report.conditions, &report.views)?,
        views("The future", &report.future_conditions, &report.future)?,
        strip(report)?,
        overlays(&report.overlay_view, &report.overlays)?,
        kernels(report)?,
        report.method.as_ref().map_or(Ok(String::new()), method_section)?,
        needs(report),
        speed(report)?,
        settings(report),
        provenance(report),
        script(!(report.views.is_empty() && report.future.is_empty())),
    ];
    Ok(document(&report.title, &report.subtitle, &parts.concat()))
}

fn figures(report: &Report) -> String {
    let mut out = String::new();
    for f in &report.figures {
        let (value, name, remark) = (escape(&f.value), escape(&f.name), escape(&f.remark));
        let _ = writeln!(out, "<div class=\"card\"><b>{value}</b><span>{name}</span><small>{remark}</small></div>");
    }
    if out.is_empty() { out } else { format!("<div class=\"cards\">\n{out}</div>\n") }
}

fn scores(report: &Report) -> String {
    let rows = report.scores.iter().map(|r| r.to_vec());
    let content = table(&["metric", "mean", "median", "worst", "view"], &[1, 2, 3], rows);
    section("Scores", &escape(&report.conditions), &content)
}

fn curves(report: &Report) -> Result<String, ReportError> {
    let one = |name: &str, samples: &[Sample]| vec![(name.to_owned(), samples.to_vec())];
    let charts = training_charts("Training loss", Scale::Log, &one("loss", &report.loss))?
        + &training_charts("PSNR, dB", Scale::Linear, &report.psnr)?
        + &training_charts("Splats", Scale::Linear, &one("splats", &report.splats))?;
    let remark = "Each curve against optimiser steps and against seconds.";
    Ok(section("Course of training", remark, &wrapped("charts", charts)))
}

/// Two charts of named training curves: over steps and over seconds; empty without samples.
///
/// # Errors
/// If the plotting library fails.
pub fn training_charts(title: &str, scale: Scale, curves: &[(String, Vec<Sample>)]) -> Result<String, ReportError> {
    let mut out = String::new();
    for axis in ["step", "seconds of training"] {
        let point = |s: &Sample| (if axis == "step" { s.step } else { s.seconds }, s.value);
        let curve = |(name, samples): &(String, Vec<Sample>)| Curve {
            name: name.clone(),
            points: samples.iter().map(point).collect(),
        };
        let lines: Vec<Curve> = curves.iter().map(curve).collect();
        if let Some(svg) = chart(title, axis, scale, &lines)? {
            let _ = writeln!(out, "<figure>{svg}</figure>");
        }
    }
    Ok(out)
}

fn views(heading: &str, conditions: &str, views: &[Comparison]) -> Result<String, ReportError> {
    let remark = format!("The worst views first, then those in the middle. {}", escape(conditions));
    Ok(section(heading, &remark, &comparisons(views)?))
}

fn strip(report: &Report) -> Result<String, ReportError> {
    let mut out = String::new();
    for still in &report.strip {
        out += &captioned(&reduced(&still.image, MAX_STRIP_SIDE), &still.caption)?;
    }
    Ok(section("Through time", "One camera, evenly spaced times.", &wrapped("strip", out)))
}

fn kernels(report: &Report) -> Result<String, ReportError> {
    let mut maps = String::new();
    for map in report.heat_maps.iter().filter(|m| !m.steps.is_empty()) {
        let [low, high] = map.span;
        let (first, last) = (map.steps[0], map.steps[map.steps.len() - 1]);
        let caption = format!("{}: {low} (bottom) to {high}, steps {first} to {last}", map.name);
        maps += &heat_map(&map.counts, &map.name, &caption)?;
    }
    for still in &report.jerk {
        maps += &captioned(&still.image, &still.caption)?;
    }
    let content = wrapped("strip maps", maps) + &statistics(&report.analysis);
    let remark =
        "Heat maps: how often a quantity takes which value over training, each step by itself, the darker the more.";
    let remark = if report.heat_maps.is_empty() { "" } else { remark };
    Ok(section("Kernels and motion", remark, &content))
}

/// The table of some statistics.
fn statistics(rows: &[ReportRow]) -> String {
    let cells = rows.iter().map(|r| vec![r.name.clone(), r.value.clone(), r.meaning.clone()]);
    table(&["what", "how much", "meaning"], &[1], cells)
}

fn needs(report: &Report) -> String {
    let part = |name: &str, content: String| match content.is_empty() {
        true => content,
        false => format!("<h3>{name}</h3>\n{content}"),
    };
    let content = part("Splats", statistics(&report.needs))
        + &part("Work done and skipped", statistics(&report.work))
        + &report.storage.as_ref().map_or(String::new(), |s| part("Bytes", bytes(s)));
    section("What the scene needed", "", &content)
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

fn speed(report: &Report) -> Result<String, ReportError> {
    let rows = report.speed.iter().enumerate().map(|(k, r)| {
        let (ms, error) = (format!("{:.3}", r.ms), r.error.map_or("–".to_owned(), |e| format!("{e:.1e}")));
        vec![
            (k + 1).to_string(),
            r.case.clone(),
            r.variant.clone(),
            r.n.to_string(),
            r.threads.to_string(),
            ms,
            error,
            r.error_kind.to_owned(),
        ]
    });
    let head = ["", "what", "how", "size", "threads", "ms", "error", "error is"];
    let remark = "Times are medians on the machine named below; errors are against the f64 reference. Numbers of points are \
                  those of rows.";
    let chart = scatter(&report.speed)?;
    let chart = chart.map_or(String::new(), |svg| format!("<div class=\"charts\"><figure>{svg}</figure></div>\n"));
    Ok(section("Speed against error", remark, &(chart + &table(&head, &[0, 3, 4, 5, 6], rows))))
}

fn settings(report: &Report) -> String {
    let rows = report.settings.iter().map(|r| r.to_vec());
    let content = table(&["setting", "value", "from"], &[], rows);
    section("Settings", "", &collapsed(&format!("{} settings", report.settings.len()), content))
}

fn provenance(report: &Report) -> String {
    section("Provenance", "", &table(&["", ""], &[], report.provenance.iter().map(|r| r.to_vec())))
}
