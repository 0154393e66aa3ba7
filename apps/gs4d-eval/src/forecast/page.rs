//! The HTML page of a forecast: PSNR over time beyond the last training time, and frames.

use crate::forecast::{Physics, TimestampScores};
use gs4d_report::chart::{Curve, Scale, chart};
use gs4d_report::html::{captioned, document, section, table, wrapped};
use gs4d_report::{ReportError, Still};

/// Renders a forecast as one self-contained HTML page.
///
/// # Errors
/// If a chart or image cannot be encoded.
pub fn page(
    title: &str,
    moments: &[TimestampScores],
    strip: &[Still],
    physics: Option<&Physics>,
) -> Result<String, ReportError> {
    let curve = |name: &str, psnr: fn(&TimestampScores) -> Option<f64>| Curve {
        name: name.to_owned(),
        points: moments.iter().filter_map(|m| Some((m.beyond, psnr(m)?))).collect(),
    };
    let curves = [curve("all pixels", |m| m.psnr), curve("where masks count", |m| m.masked_psnr)];
    let curves: Vec<Curve> = curves.into_iter().filter(|c| !c.points.is_empty()).collect();
    let svg = chart("PSNR, dB", "normalised time beyond the last training time", Scale::Linear, &curves)?;
    let chart = svg.map_or(String::new(), |svg| format!("<div class=\"charts\">\n<figure>{svg}</figure>\n</div>\n"));
    let mut stills = String::new();
    for still in strip {
        stills += &captioned(&still.image, &still.caption)?;
    }
    let rows = physics.into_iter().flat_map(|p| &p.spreads).map(|s| {
        let number = |v: f64| format!("{v:.4}");
        vec![s.name.to_owned(), number(s.median), number(s.p90), number(s.p99), number(s.max), s.unit.clone()]
    });
    let learnt = table(&["", "median", "90 %", "99 %", "largest", "unit"], &[1, 2, 3, 4], rows);
    let parts = section("Against the truth", "Means over all views of each time.", &chart)
        + &section("Frames", "", &wrapped("strip", stills))
        + &section("What was learnt of the motion", "Visible splats.", &learnt);
    Ok(document(title, "Frames after the last training time.", &parts))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Image;

    #[test]
    fn the_page_holds_what_there_is_and_escapes_names() {
        let moment = |t: f64| TimestampScores {
            time: 0.75 + t,
            beyond: t,
            views: 3,
            psnr: Some(30.0 - 40.0 * t),
            ssim: 0.9,
            masked_psnr: None,
        };
        let image = Image { width: 1, height: 1, channels: 3, data: vec![0.5; 3] };
        let still = Still { caption: "t = 0.8".into(), image };
        let html = page("<b>", &[moment(0.1), moment(0.2)], &[still], None).unwrap();
        assert_eq!((html.matches("<svg").count(), html.matches("data:image/png").count()), (1, 1));
        assert!(html.contains("&lt;b&gt;") && !html.contains("What was learnt"));
        let empty = page("x", &[], &[], None).unwrap();
        assert!(!empty.contains("<svg") && !empty.contains("<section"));
    }
}
