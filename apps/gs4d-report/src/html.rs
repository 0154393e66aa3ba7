//! Pieces of pages: escaped text, sections, tables, embedded images.

use crate::ReportError;
use crate::embed::Inline;
use crate::ramp::Ramp;
use gs_core::Image;
use std::fmt::Write as _;

/// Content policy that forbids to load anything.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
    base-uri 'none'; form-action 'none'";

const STYLE: &str = include_str!("style.css");

/// Escapes text for HTML content and attributes.
///
/// ```
/// assert_eq!(gs4d_report::html::escape("a < b & 'c'"), "a &lt; b &amp; &#39;c&#39;");
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

/// A `<div>` of a class around content; empty without content.
pub fn wrapped(class: &str, content: String) -> String {
    if content.is_empty() { content } else { format!("<div class=\"{class}\">\n{content}</div>\n") }
}

/// A chart as a figure; empty without a chart.
pub fn figure(svg: Option<String>) -> String {
    svg.map_or(String::new(), |svg| format!("<figure>{svg}</figure>\n"))
}

/// An embedded `<img>` of 1, 3 or 4 channels with an alternative text.
///
/// # Errors
/// If the image cannot be encoded.
pub fn inline_image(image: &Image, alt: &str) -> Result<String, ReportError> {
    let Inline { width, height, address } = Inline::of(image)?;
    Ok(format!("<img alt=\"{}\" width=\"{width}\" height=\"{height}\" src=\"{address}\">", escape(alt)))
}

/// An embedded image with a caption below, which is its alternative text, too.
///
/// # Errors
/// If the image cannot be encoded.
pub fn captioned(image: &Image, caption: &str) -> Result<String, ReportError> {
    Ok(format!("<span>{}<small>{}</small></span>\n", inline_image(image, caption)?, escape(caption)))
}

/// Content below a summary that unfolds it; empty without content. Nothing is escaped here.
pub fn collapsed(summary: &str, content: String) -> String {
    if content.is_empty() {
        return content;
    }
    format!("<details><summary>{summary}</summary>\n{content}</details>\n")
}

/// A colour map as a bar with labels below it.
pub(crate) fn ramp_legend(name: &str, ramp: &Ramp, ticks: &[String]) -> String {
    let ticks: String = ticks.iter().map(|t| format!("<span>{}</span>", escape(t))).collect();
    let name = escape(name);
    format!(
        "<div class=\"legend\"><small>{name}</small><i style=\"background:{}\"></i><small class=\"ticks\">{ticks}</small></div>\n",
        ramp.css()
    )
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
        "<div class=\"scroll\" tabindex=\"0\"><table>\n<thead><tr>{}</tr></thead>\n<tbody>\n{body}</tbody>\n</table></div>\n",
        head.concat()
    )
}
