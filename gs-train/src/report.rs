//! One HTML file that tells what a run did: figures, curves, pictures, what the scene needed, speed against error, settings.
//!
//! Everything is inline (SVG, PNG as base64, one style sheet), so the file opens offline and years later. Text from the
//! outside (names, settings) is escaped.

mod chart;
mod embed;
pub mod forecast;
mod heat;
mod intervals;
pub(crate) mod page;
pub mod sweep;

pub(crate) use chart::chart;
pub use chart::{Curve, Scale};
pub use embed::{base64, png};
pub use heat::HeatMap;

use crate::analysis::Journal;
use gs_core::Image;
use gs_core::speed::SpeedError;

/// What a report shows. Empty parts are left out of the page.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Heading, for example `bouncing · fourdgs`.
    pub title: String,
    /// One sentence below it.
    pub subtitle: String,
    /// The figures that matter: value, unit or name, and a remark (split, background).
    pub figures: Vec<Figure>,
    /// Training loss against step and seconds.
    pub loss: Vec<Sample>,
    /// PSNR (dB) against step and seconds; a name per line (`train view`, `val`).
    pub psnr: Vec<(String, Vec<Sample>)>,
    /// Number of splats against step and seconds.
    pub splats: Vec<Sample>,
    /// Views with their truth, worst first.
    pub views: Vec<Comparison>,
    /// Views beyond the last training time with their truth, worst first.
    pub future: Vec<Comparison>,
    /// The scene from one camera over time.
    pub strip: Vec<Still>,
    /// Histograms of the splats' quantities over the steps of training.
    pub heat_maps: Vec<HeatMap>,
    /// How the splats move, how their kernels are bent, what they cost.
    pub analysis: Vec<Need>,
    /// Where the motion is jerky.
    pub jerk: Vec<Still>,
    /// Where boundaries of intervals went and why, how anchors grew.
    pub journal: Journal,
    /// What the scene turned out to need.
    pub needs: Vec<Need>,
    /// Speed against error.
    pub speed: Vec<SpeedError>,
    /// Key, value, source.
    pub settings: Vec<[String; 3]>,
    /// Name and value.
    pub provenance: Vec<[String; 2]>,
}

/// A headline figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// For example `31.42 dB`.
    pub value: String,
    /// For example `PSNR`.
    pub name: String,
    /// For example `mean of 20 test views over black`.
    pub remark: String,
}

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Optimiser step.
    pub step: f64,
    /// Training seconds.
    pub seconds: f64,
    /// The value.
    pub value: f64,
}

/// A view beside its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Time and name of the view.
    pub name: String,
    /// Name of the view, time, metrics.
    pub caption: String,
    /// The photograph (3 channels).
    pub truth: Image,
    /// The drawing (3 channels).
    pub drawn: Image,
}

/// One picture of the strip.
#[derive(Clone, Debug, PartialEq)]
pub struct Still {
    /// For example `t = 0.25`.
    pub caption: String,
    /// 3 channels.
    pub image: Image,
}

/// One thing a scene needs or does not need.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Need {
    /// For example `splats that move`.
    pub name: String,
    /// For example `1 204 of 5 000 (24 %)`.
    pub value: String,
    /// What it means.
    pub meaning: String,
}

/// Rows of speed against error as one JSON value.
pub fn speed_json(rows: &[SpeedError]) -> serde_json::Value {
    // Each row writes valid JSON of its own.
    rows.iter()
        .map(|r| serde_json::from_str(&r.to_json()).unwrap_or_default())
        .collect::<Vec<serde_json::Value>>()
        .into()
}

/// Why a report was not made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A picture could not be encoded.
    #[error("cannot encode a picture for the report: {0}")]
    Png(String),
    /// A chart could not be drawn.
    #[error("cannot draw a chart for the report: {0}")]
    Chart(String),
}

impl Report {
    /// The page.
    ///
    /// # Errors
    /// If a picture or chart cannot be drawn (a picture without pixels).
    pub fn html(&self) -> Result<String, ReportError> {
        page::page(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_self_contained_and_escaped() {
        let samples: Vec<Sample> = (1..50)
            .map(|i| Sample { step: f64::from(i), seconds: f64::from(i) * 0.1, value: 1.0 / f64::from(i) })
            .collect();
        let image = Image { width: 2, height: 1, channels: 3, data: vec![0.0, 0.5, 1.0, 2.0, -1.0, 0.25] };
        let report = Report {
            title: "<script>alert(1)</script>".into(),
            figures: vec![Figure { value: "31.4 dB".into(), name: "PSNR".into(), remark: "a & b".into() }],
            loss: samples.clone(),
            psnr: vec![("val".into(), samples)],
            views: vec![Comparison {
                name: "v".into(),
                caption: "v\"1\"".into(),
                truth: image.clone(),
                drawn: image.clone(),
            }],
            strip: vec![Still { caption: "t = 0".into(), image }],
            heat_maps: vec![HeatMap {
                name: "lambda".into(),
                span: [0.0, 1.0],
                steps: vec![500, 1000],
                counts: vec![vec![4, 0], vec![1, 3]],
            }],
            analysis: vec![Need { name: "kernels".into(), value: "7 < 9".into(), meaning: "m".into() }],
            settings: vec![["a.b".into(), "1".into(), "default".into()]],
            ..Report::default()
        };
        let html = report.html().unwrap();
        assert!(html.contains("&lt;script&gt;alert(1)&lt;/script&gt;") && !html.contains("<script"));
        assert!(html.contains("a &amp; b") && html.contains("v&quot;1&quot;"));
        assert_eq!(html.matches("data:image/png;base64,").count(), 5, "truth, drawn, difference, still, heat map");
        assert!(html.contains("lambda: 0 (bottom) to 1, steps 500 to 1000") && html.contains("7 &lt; 9"));
        assert_eq!(html.matches("<svg").count(), 4, "loss and PSNR against steps and seconds");
        for outside in ["http://", "https://", "src=\"/", "@import", "url("] {
            let found = html.matches(outside).count();
            let allowed = if outside == "http://" { html.matches("xmlns=\"http://").count() } else { 0 };
            assert_eq!(found, allowed, "{outside}");
        }
        assert!(!html.contains("Speed against error"), "empty parts are left out");
    }

    #[test]
    fn a_run_without_samples_still_has_a_page() {
        let html = Report { title: "empty".into(), ..Report::default() }.html().unwrap();
        assert!(html.contains("empty") && !html.contains("<svg"));
    }
}
