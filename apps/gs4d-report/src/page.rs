//! The HTML of a report, and the building blocks of all HTML pages.

use super::chart::{Curve, Scale, chart};
use super::embed::{Inline, reduced};
use super::heat::heat_map;
use super::method_section::method_section;
use super::overlay::overlays;
use super::ramp::Ramp;
use super::scatter::scatter;
use super::views::{comparisons, script};
use super::{Comparison, Report, ReportError, ReportRow, Sample};
use crate::storage::Storage;
use gs_core::Image;
use std::fmt::Write as _;

/// Longest side of an image of the strip, pixels.
const MAX_STRIP_SIDE: usize = 320;
/// Content policy that forbids to load anything.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
    base-uri 'none'; form-action 'none'";

const STYLE: &str = include_str!("style.css");

/// Escapes text for HTML content and attributes.
///
/// ```
/// assert_eq!(gs4d_report::page::escape("a < b & 'c'"), "a &lt; b &amp; &#39;c&#39;");
/// ```
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

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

/// A self-contained page around the HTML of sections. Title and subtitle are escaped here.
pub fn document(title: &str, subtitle: &str, sections: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<header><h1>{title}</h1><p>{}</p></header>\n<main>\n{}</main>\n\
         </body>\n</html>\n",
        escape(subtitle),
        sections
    )
}

/// A section of HTML content with a heading; empty without content. Nothing is escaped here.
pub fn section(heading: &str, remark: &str, content: &str) -> String {
    if content.is_empty() {
        return String::new();
    }
    let remark = if remark.is_empty() { String::new() } else { format!("<p class=\"remark\">{remark}</p>\n") };
    format!("<section>\n<h2>{heading}</h2>\n{remark}{content}</section>\n")
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

/// A `<div>` of a class around content; empty without content.
pub fn wrapped(class: &str, content: String) -> String {
    if content.is_empty() { content } else { format!("<div class=\"{class}\">\n{content}</div>\n") }
}

/// An embedded `<img>` of 1, 3 or 4 channels with an alternative text.
///
/// # Errors
/// If the image cannot be encoded.
pub fn picture(image: &Image, alt: &str) -> Result<String, ReportError> {
    let Inline { width, height, address } = Inline::of(image)?;
    Ok(format!("<img alt=\"{}\" width=\"{width}\" height=\"{height}\" src=\"{address}\">", escape(alt)))
}

/// An embedded image with a caption below, which is its alternative text, too.
///
/// # Errors
/// If the image cannot be encoded.
pub fn captioned(image: &Image, caption: &str) -> Result<String, ReportError> {
    Ok(format!("<span>{}<small>{}</small></span>\n", picture(image, caption)?, escape(caption)))
}

/// Content below a summary that unfolds it; empty without content. Nothing is escaped here.
pub(super) fn collapsed(summary: &str, content: String) -> String {
    if content.is_empty() {
        return content;
    }
    format!("<details><summary>{summary}</summary>\n{content}</details>\n")
}

/// A colour map as a bar with labels below it.
pub(super) fn ramp_legend(name: &str, ramp: &Ramp, ticks: &[String]) -> String {
    let ticks: String = ticks.iter().map(|t| format!("<span>{}</span>", escape(t))).collect();
    let name = escape(name);
    format!(
        "<div class=\"legend\"><small>{name}</small><i style=\"background:{}\"></i><small class=\"ticks\">{ticks}</small></div>\n",
        ramp.css()
    )
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

/// A table; the columns in `numeric` are aligned right. Cells are escaped here, `head` is not. Empty without rows.
pub fn table(head: &[&str], numeric: &[usize], rows: impl Iterator<Item = Vec<String>>) -> String {
    let class = |i: usize| if numeric.contains(&i) { " class=\"n\"" } else { "" };
    let mut body = String::new();
    for row in rows {
        let cells: Vec<_> =
            row.iter().enumerate().map(|(i, c)| format!("<td{}>{}</td>", class(i), escape(c))).collect();
        let _ = writeln!(body, "<tr>{}</tr>", cells.concat());
    }
    if body.is_empty() {
        return body;
    }
    let head: Vec<_> = head.iter().enumerate().map(|(i, h)| format!("<th{}>{h}</th>", class(i))).collect();
    format!(
        "<div class=\"scroll\"><table>\n<thead><tr>{}</tr></thead>\n<tbody>\n{body}</tbody>\n</table></div>\n",
        head.concat()
    )
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
