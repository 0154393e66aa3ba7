//! The report section of overlays: renders coloured by attributes of the splats, each with its legend and histogram.

use super::ReportError;
use super::embed::reduced;
use super::html::{escape, inline_image, ramp_legend, section, wrapped};
use super::ramp::{Ramp, css_color};
use crate::analysis::Histogram;
use gs_core::Image;
use std::fmt::Write as _;

/// Longest side of an overlay, pixels.
pub const OVERLAY_SIDE: usize = 400;

/// A render coloured by an attribute, a direction, or parts.
#[derive(Clone, Debug, PartialEq)]
pub struct OverlayFigure {
    /// For example `lambda`, `velocity` or `parts`.
    pub name: String,
    /// RGB in `[0, 1]`, `[H, W, 3]`.
    pub image: Image,
    /// What the colours mean.
    pub legend: Legend,
    /// Histogram of the attribute over all splats, on the legend's span.
    pub histogram: Option<Histogram>,
}

/// The legend of an overlay.
#[derive(Clone, Debug, PartialEq)]
pub enum Legend {
    /// A colour map with labels at its low end, middle and high end.
    Numbers(Ramp, [String; 3]),
    /// A colour and a label for each kind.
    Kinds(Vec<([f32; 3], String)>),
    /// What the colours mean, in a sentence.
    Words(String),
}

/// Renders the section, with `more` content below the figures; empty without either. `remark` names the view.
///
/// # Errors
/// If an image cannot be encoded.
pub(crate) fn overlays(remark: &str, figures: &[OverlayFigure], more: &str) -> Result<String, ReportError> {
    let mut out = String::new();
    for f in figures {
        let alt = format!("the scene in the colours of {}", f.name);
        let _ = writeln!(out, "<figure>{}", inline_image(&reduced(&f.image, OVERLAY_SIDE), &alt)?);
        let _ = writeln!(out, "<figcaption>{}</figcaption>", escape(&f.name));
        out += &f.histogram.as_ref().map_or(String::new(), bars);
        out += &legend(&f.legend);
        out.push_str("</figure>\n");
    }
    Ok(section("What the method knows of its splats", &escape(remark), &(wrapped("overlays", out) + more)))
}

fn legend(legend: &Legend) -> String {
    match legend {
        Legend::Numbers(ramp, ticks) => ramp_legend("", ramp, ticks),
        Legend::Words(text) => format!("<small>{}</small>\n", escape(text)),
        Legend::Kinds(kinds) => {
            let kind = |(c, text): &([f32; 3], String)| {
                format!("<li><i style=\"background:{}\"></i>{}</li>", css_color(*c), escape(text))
            };
            format!("<ul class=\"kinds\">{}</ul>\n", kinds.iter().map(kind).collect::<String>())
        }
    }
}

/// The histogram as bars, with the width of the legend below.
fn bars(h: &Histogram) -> String {
    let most = h.counts.iter().copied().max().unwrap_or(0).max(1);
    let mut path = String::new();
    for (k, &count) in h.counts.iter().enumerate().filter(|(_, c)| **c > 0) {
        // A count of 1 stays visible.
        let height = (30.0 * f64::from(count) / f64::from(most)).max(0.6);
        let _ = write!(path, "M{k} 30v{:.1}h1V30z", -height);
    }
    let n: u64 = h.counts.iter().map(|c| u64::from(*c)).sum();
    let name = format!("Histogram of {}: {n} splats, mean {:.4}, fullest bin {most}", h.name, h.mean);
    let odd = if h.not_finite > 0 { format!(", {} not finite", h.not_finite) } else { String::new() };
    format!(
        "<svg class=\"bars\" role=\"img\" aria-label=\"{0}\" viewBox=\"0 0 {1} 30\" preserveAspectRatio=\"none\"><path d=\"{path}\"/></svg>\n\
         <small>mean {2:.4}{odd}</small>\n",
        escape(&name),
        h.counts.len().max(1),
        h.mean,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_their_legends_and_are_escaped() {
        let image = Image { width: 1, height: 1, channels: 3, data: vec![0.5; 3] };
        let figure =
            |name: &str, legend| OverlayFigure { name: name.into(), image: image.clone(), legend, histogram: None };
        let ticks = ["0", "½", "1 <m>"].map(str::to_owned);
        let values = [0.0f32, 0.0, 1.0, f32::NAN];
        let spread = Histogram::of("speed", None, [0.0, 1.0], &values);
        let all = [
            OverlayFigure { histogram: Some(spread), ..figure("<speed>", Legend::Numbers(Ramp::magma(), ticks)) },
            figure("parts", Legend::Kinds(vec![([1.0, 0.0, 0.0], "1: a & b".into())])),
            figure("axis", Legend::Words("x is \"red\"".into())),
        ];
        let html = overlays("At t = 0.", &all, "").unwrap();
        assert_eq!((html.matches("<img").count(), html.matches("class=\"bars\"").count()), (3, 1));
        for text in ["&lt;speed&gt;", "1 &lt;m&gt;", "#ff0000", "1: a &amp; b", "x is &quot;red&quot;", "1 not finite"]
        {
            assert!(html.contains(text), "{text} is not in {html}");
        }
        assert!(html.contains("M0 30v-30.0h1V30z") && html.contains("M63 30v-15.0h1V30z"), "{html}");
        assert_eq!(overlays("", &[], "").unwrap(), "");
    }
}
