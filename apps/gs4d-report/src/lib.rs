//! One HTML file that tells what a run did: figures, curves, pictures, what the scene needed, speed against error, settings.
//!
//! Everything is inline (SVG, pictures as base64, one style sheet, one script of a screen), so the file opens offline and
//! years later; a content policy forbids it to load anything. Text from the outside (names, settings) is escaped. Pictures
//! are of bounded size, and so is the page. Without scripts, and in print, what can be wiped between stands side by side.

pub mod analysis;
pub mod chart;
pub mod embed;
pub mod error_map;
pub mod heat;
pub mod inspect;
pub mod intervals;
pub mod needs;
pub mod overlay;
pub mod page;
pub mod ramp;
pub mod scatter;
pub mod storage;
pub mod views;

pub use chart::{Curve, Scale};
pub use embed::{base64, png};
pub use heat::HeatMap;
pub use overlay::{Legend, OverlayFigure};
pub use ramp::Ramp;

use crate::analysis::Journal;
use crate::storage::Storage;
use gs_core::Image;
use gs_core::speed::BenchRow;

/// What a report shows. Empty parts are left out of the page.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Heading, for example `bouncing · fourdgs`.
    pub title: String,
    /// One sentence below it.
    pub subtitle: String,
    /// The figures that matter: value, unit or name, and a remark (split, background).
    pub figures: Vec<Figure>,
    /// What the scores are of: split, number of views, size, background, mask.
    pub conditions: String,
    /// The same of the scores beyond the last training time.
    pub future_conditions: String,
    /// Metric, mean, median, worst, and the view that is worst.
    pub scores: Vec<[String; 5]>,
    /// Training loss against step and seconds.
    pub loss: Vec<Sample>,
    /// PSNR (dB) against step and seconds; a name per line (`train view`, `val`).
    pub psnr: Vec<(String, Vec<Sample>)>,
    /// Number of splats against step and seconds.
    pub splats: Vec<Sample>,
    /// Views with their truth: the worst first, then those in the middle.
    pub views: Vec<Comparison>,
    /// Views beyond the last training time with their truth, in the same order.
    pub future: Vec<Comparison>,
    /// The scene from one camera over time.
    pub strip: Vec<Still>,
    /// Histograms of the splats' quantities over the steps of training.
    pub heat_maps: Vec<HeatMap>,
    /// What the method knows of its splats, drawn.
    pub overlays: Vec<OverlayFigure>,
    /// What they were drawn at.
    pub overlay_view: String,
    /// How the splats move, how their kernels are bent, what they cost.
    pub analysis: Vec<Need>,
    /// Where the motion is jerky.
    pub jerk: Vec<Still>,
    /// Where boundaries of intervals went and why, how anchors grew.
    pub journal: Journal,
    /// What the scene turned out to need.
    pub needs: Vec<Need>,
    /// What drawing and training took, and what they skipped.
    pub work: Vec<Need>,
    /// Its bytes.
    pub storage: Option<Storage>,
    /// Speed against error.
    pub speed: Vec<BenchRow>,
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
pub fn speed_json(rows: &[BenchRow]) -> serde_json::Value {
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

    const HOSTILE: &str = "<script>alert(1)</script><img src=http://x.y onerror=\"a()\"> & 'b'";

    fn full() -> Report {
        let samples: Vec<Sample> = (1..50)
            .map(|i| Sample { step: f64::from(i), seconds: f64::from(i) * 0.1, value: 1.0 / f64::from(i) })
            .collect();
        let image = Image { width: 2, height: 1, channels: 3, data: vec![0.0, 0.5, 1.0, 2.0, -1.0, 0.25] };
        let text = || HOSTILE.to_owned();
        let need = || Need { name: text(), value: "7 < 9".into(), meaning: text() };
        let still = || Still { caption: text(), image: image.clone() };
        let view = || Comparison { name: text(), caption: text(), truth: image.clone(), drawn: image.clone() };
        Report {
            title: text(),
            subtitle: text(),
            figures: vec![Figure { value: "31.4 dB".into(), name: text(), remark: "a & b".into() }],
            conditions: text(),
            future_conditions: text(),
            scores: vec![[text(), "1".into(), "1".into(), "1".into(), text()]],
            loss: samples.clone(),
            psnr: vec![(text(), samples.clone()), ("val".into(), samples)],
            splats: Vec::new(),
            views: vec![view()],
            future: vec![view()],
            strip: vec![still()],
            heat_maps: vec![HeatMap {
                name: "lambda".into(),
                span: [0.0, 1.0],
                steps: vec![500, 1000],
                counts: vec![vec![4, 0], vec![1, 3]],
            }],
            overlays: vec![OverlayFigure {
                name: text(),
                image: image.clone(),
                legend: Legend::Words(text()),
                histogram: None,
            }],
            overlay_view: text(),
            analysis: vec![need()],
            jerk: vec![still()],
            journal: Journal::default(),
            needs: vec![need()],
            work: vec![need()],
            storage: None,
            speed: Vec::new(),
            settings: vec![[text(), text(), text()]],
            provenance: vec![[text(), text()]],
        }
    }

    #[test]
    fn every_text_from_outside_is_escaped() {
        let html = full().html().unwrap();
        assert!(html.contains("&lt;script&gt;alert(1)&lt;/script&gt;") && !html.contains("<script>alert"));
        assert!(!html.contains("<img src=http") && !html.contains("onerror=\"a"));
        assert!(html.contains("a &amp; b") && html.contains("7 &lt; 9"));
        assert!(html.contains("lambda: 0 (bottom) to 1, steps 500 to 1000"));
    }

    /// What the page would have to fetch, and what could fetch it.
    #[test]
    fn nothing_comes_from_outside() {
        let html = full().html().unwrap();
        let pictures = html.matches("src=\"data:image/png;base64,").count();
        assert_eq!(pictures, 2 * 3 + 4, "truth, drawn and error twice; still, heat map, overlay, jerk");
        assert_eq!(html.matches("src=\"").count(), pictures, "no other source");
        assert_eq!(html.matches("<svg").count(), 4, "loss and PSNR against steps and seconds");
        assert_eq!(
            html.matches("http://").count(),
            html.matches("xmlns=\"http://").count() + html.matches("img src=http://x.y").count()
        );
        for outside in ["https://", "href=", "@import", "url(", "<link", "<iframe", "<object"] {
            assert!(!html.contains(outside), "{outside}");
        }
        let (_, script) = html.split_once("<script>").unwrap();
        let (script, rest) = script.split_once("</script>").unwrap();
        assert!(!rest.contains("<script"), "one script");
        for way in ["fetch", "XMLHttp", "import", "innerHTML", "eval", "WebSocket", "location", "document.write"] {
            assert!(!script.contains(way), "{way}");
        }
        assert!(html.contains("Content-Security-Policy") && html.contains("default-src 'none'"));
    }

    #[test]
    fn a_page_can_be_read_in_the_dark_on_paper_and_on_a_phone() {
        let html = full().html().unwrap();
        for part in ["prefers-color-scheme: dark", "@media print", "max-width: 520px", "name=\"viewport\""] {
            assert!(html.contains(part), "{part}");
        }
        assert_eq!(html.matches("<img ").count(), html.matches("<img alt=\"").count(), "every picture has a text");
        assert_eq!(html.matches("<svg").count(), html.matches("<svg role=\"img\" aria-label=\"").count());
        assert_eq!(full().html().unwrap(), html, "the same report is the same page");
    }

    #[test]
    fn the_page_stays_small_however_large_the_pictures() {
        let noise = |k: usize| (k.wrapping_mul(2_654_435_761) >> 8) as f32 % 255.0 / 255.0;
        let image = Image { width: 1600, height: 900, channels: 3, data: (0..1600 * 900 * 3).map(noise).collect() };
        let view = Comparison { name: "v".into(), caption: "v".into(), truth: image.clone(), drawn: image.clone() };
        let still = Still { caption: "t".into(), image };
        let report = Report { views: vec![view; 3], strip: vec![still; 4], ..Report::default() };
        let html = report.html().unwrap();
        assert!(html.len() < 2 << 20, "{} bytes", html.len());
    }

    #[test]
    fn a_run_without_samples_still_has_a_page() {
        let html = Report { title: "empty".into(), ..Report::default() }.html().unwrap();
        assert!(
            html.contains("empty") && !html.contains("<svg") && !html.contains("<section") && !html.contains("<script")
        );
    }
}
