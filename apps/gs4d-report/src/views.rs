//! Figures of views: ground truth and renders to wipe between, with error maps.
//!
//! Without scripts, and in print, the images stand side by side.

use super::error_map::{ErrorScale, error};
use super::html::{escape, inline_image, ramp_legend};
use super::ramp::Ramp;
use super::{Comparison, ReportError};
use gs_core::Image;
use std::fmt::Write as _;

/// Adds a slider to the images of every view; loads nothing.
const SCRIPT: &str = include_str!("wipe.js");

/// The script of a page; empty for a page without views.
pub fn script(has_views: bool) -> String {
    if has_views { format!("<script>\n{SCRIPT}</script>\n") } else { String::new() }
}

/// A view with its images (ground truth first, then renders) and error maps.
pub struct ViewFigure<'a> {
    /// Name, time and scores of the view.
    pub caption: &'a str,
    /// Images to wipe between, with their names.
    pub images: Vec<(&'a str, &'a Image)>,
    /// Error maps, `[H, W, 1]`, with their names.
    pub errors: Vec<(String, Image)>,
}

impl<'a> ViewFigure<'a> {
    /// A render beside its ground truth.
    fn of(view: &'a Comparison) -> Self {
        let errors = error(&view.truth, &view.render).map(|e| ("error".to_owned(), e));
        Self {
            caption: &view.caption,
            images: vec![("ground truth", &view.truth), ("render", &view.render)],
            errors: errors.into_iter().collect(),
        }
    }
}

/// Renders the figures of views, with one error scale for all of them; empty without views.
///
/// # Errors
/// If an image cannot be encoded.
pub fn figures(views: &[ViewFigure]) -> Result<String, ReportError> {
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

/// Renders the figures of renders beside their ground truth.
///
/// # Errors
/// If an image cannot be encoded.
pub(crate) fn comparisons(views: &[Comparison]) -> Result<String, ReportError> {
    figures(&views.iter().map(ViewFigure::of).collect::<Vec<_>>())
}

fn figure(view: &ViewFigure, scale: ErrorScale) -> Result<String, ReportError> {
    let caption = escape(view.caption);
    let mut out = format!("<figure class=\"view\" data-name=\"{caption}\"><div class=\"pictures\">\n");
    let alt = |name: &str| format!("{name}: {}", view.caption);
    for (name, image) in &view.images {
        let _ = writeln!(out, "<span>{}<small>{}</small></span>", inline_image(image, &alt(name))?, escape(name));
    }
    for (name, error) in &view.errors {
        let image = inline_image(&scale.map(error), &alt(name))?;
        let _ = writeln!(out, "<span class=\"map\">{image}<small>{}</small></span>", escape(name));
    }
    let _ = writeln!(out, "</div><figcaption>{caption}</figcaption></figure>");
    Ok(out)
}
