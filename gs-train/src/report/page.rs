//! The HTML of a report.

use super::chart::{Curve, Scale, chart};
use super::intervals::intervals;
use super::{Comparison, Report, ReportError, Sample, base64, png};
use gs_core::Image;
use std::fmt::Write as _;

const STYLE: &str = include_str!("style.css");

/// Text that is safe inside HTML, attributes included.
pub(crate) fn escape(text: &str) -> String {
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

pub fn page(report: &Report) -> Result<String, ReportError> {
    let parts = [
        figures(report),
        curves(report)?,
        views("Truth beside drawing", "Held-out views, the worst first.", &report.views)?,
        views("The future", "Views beyond the last training time, the worst first.", &report.future)?,
        strip(report)?,
        kernels(report)?,
        intervals(&report.journal)?,
        needs(report),
        speed(report),
        settings(report),
        provenance(report),
    ];
    Ok(document(&report.title, &report.subtitle, &parts.concat()))
}

/// A self-contained page around sections.
pub fn document(title: &str, subtitle: &str, sections: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<header><h1>{title}</h1><p>{}</p></header>\n<main>\n{}</main>\n\
         </body>\n</html>\n",
        escape(subtitle),
        sections
    )
}

/// A section, or nothing if it has no content.
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

fn curves(report: &Report) -> Result<String, ReportError> {
    let against = |axis: &str, s: &Sample| (if axis == "step" { s.step } else { s.seconds }, s.value);
    let one = |name: &str, samples: &[Sample]| vec![(name.to_owned(), samples.to_vec())];
    let groups = [
        ("Training loss", Scale::Log, one("loss", &report.loss)),
        ("PSNR, dB", Scale::Linear, report.psnr.clone()),
        ("Splats", Scale::Linear, one("splats", &report.splats)),
    ];
    let mut out = String::new();
    for (title, scale, lines) in groups {
        for axis in ["step", "seconds of training"] {
            let lines: Vec<_> = lines
                .iter()
                .map(|(name, s)| Curve { name: name.clone(), points: s.iter().map(|s| against(axis, s)).collect() })
                .collect();
            if let Some(svg) = chart(title, axis, scale, &lines)? {
                let _ = writeln!(out, "<figure>{svg}</figure>");
            }
        }
    }
    let grid = if out.is_empty() { out } else { format!("<div class=\"charts\">\n{out}</div>\n") };
    Ok(section("Course of training", "Each curve against optimiser steps and against seconds.", &grid))
}

/// An image of 1, 3 or 4 channels, inline.
pub(crate) fn picture(image: &Image, alt: &str) -> Result<String, ReportError> {
    let data = base64(&png(image)?);
    let alt = escape(alt);
    Ok(format!(
        "<img alt=\"{alt}\" width=\"{}\" height=\"{}\" src=\"data:image/png;base64,{data}\">",
        image.width, image.height
    ))
}

fn views(heading: &str, remark: &str, views: &[Comparison]) -> Result<String, ReportError> {
    let mut out = String::new();
    for view in views {
        let difference = difference(&view.truth, &view.drawn);
        let caption = escape(&view.caption);
        let _ = write!(out, "<figure class=\"pair\"><div>");
        for (name, image) in [("truth", &view.truth), ("drawn", &view.drawn), ("difference × 4", &difference)] {
            if !image.data.is_empty() {
                let _ = write!(out, "<span>{}<small>{name}</small></span>", picture(image, name)?);
            }
        }
        let _ = writeln!(out, "</div><figcaption>{caption}</figcaption></figure>");
    }
    Ok(section(heading, remark, &out))
}

/// Four times the absolute difference; empty if the shapes differ.
fn difference(a: &Image, b: &Image) -> Image {
    if a.shape() != b.shape() {
        return Image::default();
    }
    let data = a.data.iter().zip(&b.data).map(|(x, y)| 4.0 * (x - y).abs()).collect();
    Image { width: a.width, height: a.height, channels: a.channels, data }
}

fn strip(report: &Report) -> Result<String, ReportError> {
    let mut out = String::new();
    for still in &report.strip {
        let caption = escape(&still.caption);
        let _ = writeln!(out, "<span>{}<small>{caption}</small></span>", picture(&still.image, &still.caption)?);
    }
    let strip = if out.is_empty() { out } else { format!("<div class=\"strip\">\n{out}</div>\n") };
    Ok(section("Through time", "One camera, evenly spaced moments.", &strip))
}

/// A table; `numeric` columns are aligned right. Cells are escaped here.
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
        let picture = picture(&map.image(), &map.name)?;
        let [low, high] = map.span;
        let (first, last) = (map.steps[0], map.steps[map.steps.len() - 1]);
        let caption = format!("{}: {low} (bottom) to {high}, steps {first} to {last}", map.name);
        let _ = writeln!(maps, "<span class=\"heat\">{picture}<small>{}</small></span>", escape(&caption));
    }
    for still in &report.jerk {
        let caption = escape(&still.caption);
        let _ = writeln!(maps, "<span>{}<small>{caption}</small></span>", picture(&still.image, &still.caption)?);
    }
    let maps = if maps.is_empty() { maps } else { format!("<div class=\"strip maps\">\n{maps}</div>\n") };
    let rows = report.analysis.iter().map(|n| vec![n.name.clone(), n.value.clone(), n.meaning.clone()]);
    let content = maps + &table(&["what", "how much", "meaning"], &[1], rows);
    let remark =
        "Heat maps: how often a quantity takes which value over training, each step by itself, the darker the more.";
    let remark = if report.heat_maps.is_empty() { "" } else { remark };
    Ok(section("Kernels and motion", remark, &content))
}

fn needs(report: &Report) -> String {
    let rows = report.needs.iter().map(|n| vec![n.name.clone(), n.value.clone(), n.meaning.clone()]);
    section("What the scene needed", "", &table(&["what", "how much", "meaning"], &[1], rows))
}

fn speed(report: &Report) -> String {
    let rows = report.speed.iter().map(|r| {
        let (ms, error) = (format!("{:.3}", r.ms), r.error.map_or("–".to_owned(), |e| format!("{e:.1e}")));
        vec![
            r.case.clone(),
            r.variant.clone(),
            r.n.to_string(),
            r.threads.to_string(),
            ms,
            error,
            r.error_kind.to_owned(),
        ]
    });
    let head = ["what", "how", "size", "threads", "ms", "error", "error is"];
    let remark = "Times are medians on the machine named below; errors are against the f64 reference.";
    section("Speed against error", remark, &table(&head, &[2, 3, 4, 5], rows))
}

fn settings(report: &Report) -> String {
    let rows = report.settings.iter().map(|r| r.to_vec());
    let content = table(&["setting", "value", "from"], &[], rows);
    let folded = if content.is_empty() {
        content
    } else {
        format!("<details><summary>{} settings</summary>\n{content}</details>\n", report.settings.len())
    };
    section("Settings", "", &folded)
}

fn provenance(report: &Report) -> String {
    section("Provenance", "", &table(&["", ""], &[], report.provenance.iter().map(|r| r.to_vec())))
}
