//! Views beside their truth: pictures to wipe between, and where they are wrong.
//!
//! Without scripts, and in print, the pictures stand side by side.

use super::error_map::{ErrorScale, error};
use super::page::{escape, picture, ramp_legend};
use super::ramp::Ramp;
use super::{Comparison, ReportError};
use gs_core::Image;
use std::fmt::Write as _;

/// Makes a wipe of the pictures of every view; loads nothing.
const SCRIPT: &str = include_str!("wipe.js");

/// The script of a page that has views.
pub fn script(has_views: bool) -> String {
    if has_views { format!("<script>\n{SCRIPT}</script>\n") } else { String::new() }
}

/// A view with its pictures: the truth first, then drawings. Maps tell where a drawing is wrong.
pub struct Shown<'a> {
    /// What it is, when, and its scores.
    pub caption: &'a str,
    /// Pictures to wipe between, with their names.
    pub pictures: Vec<(&'a str, &'a Image)>,
    /// Errors, `[H, W, 1]`, with their names.
    pub errors: Vec<(String, Image)>,
}

impl<'a> Shown<'a> {
    /// A drawing beside its truth.
    fn of(view: &'a Comparison) -> Self {
        let errors = error(&view.truth, &view.drawn).map(|e| ("error".to_owned(), e));
        Self {
            caption: &view.caption,
            pictures: vec![("truth", &view.truth), ("drawn", &view.drawn)],
            errors: errors.into_iter().collect(),
        }
    }
}

/// The figures of views, with one scale of errors for all of them; nothing without any.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn figures(views: &[Shown]) -> Result<String, ReportError> {
    let scale = ErrorScale::of(views.iter().flat_map(|v| v.errors.iter().map(|e| &e.1)));
    let mut out = String::new();
    for view in views {
        out += &figure(view, scale)?;
    }
    if !views.is_empty() {
        let name = "Error of a pixel: root mean square of the difference over the channels, colours from 0 to 1";
        out = format!("{}<div class=\"views\">\n{out}</div>\n", ramp_legend(name, &Ramp::magma(), &scale.ticks()));
    }
    Ok(out)
}

/// Drawings beside their truths.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn comparisons(views: &[Comparison]) -> Result<String, ReportError> {
    figures(&views.iter().map(Shown::of).collect::<Vec<_>>())
}

fn figure(view: &Shown, scale: ErrorScale) -> Result<String, ReportError> {
    let caption = escape(view.caption);
    let mut out = format!("<figure class=\"view\" data-name=\"{caption}\"><div class=\"pictures\">\n");
    for (name, image) in &view.pictures {
        let _ = writeln!(out, "<span>{}<small>{}</small></span>", picture(image, name)?, escape(name));
    }
    for (name, error) in &view.errors {
        let _ = writeln!(
            out,
            "<span class=\"map\">{}<small>{}</small></span>",
            picture(&scale.map(error), name)?,
            escape(name)
        );
    }
    let _ = writeln!(out, "</div><figcaption>{caption}</figcaption></figure>");
    Ok(out)
}
