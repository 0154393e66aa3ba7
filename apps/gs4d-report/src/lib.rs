//! HTML reports: figures, curves, images, histograms, tables, each page one self-contained file.
//!
//! Everything is inline (SVG, base64 images, one style sheet, one short script), so a page opens offline and years later; its
//! content policy forbids to load anything. Text from outside (names, settings) is escaped. Images are reduced, so the size
//! of a page is bounded. Without scripts, and in print, images to compare stand side by side.
//!
//! ```
//! use gs4d_report::{Figure, Report};
//!
//! let figure = Figure { value: "31.42 dB".into(), name: "PSNR".into(), remark: "<black>".into() };
//! let html = Report { title: "bouncing".into(), figures: vec![figure], ..Report::default() }.html()?;
//! assert!(html.starts_with("<!doctype html>") && html.contains("31.42 dB") && html.contains("&lt;black&gt;"));
//! # Ok::<(), gs4d_report::ReportError>(())
//! ```
#![warn(unreachable_pub)]

pub mod analysis;
pub mod chart;
mod details;
mod embed;
pub mod error_map;
mod heat;
pub mod html;
pub mod inspect;
mod method_section;
pub mod needs;
pub mod over_time;
mod overlay;
pub mod page;
mod ramp;
pub mod storage;
pub mod views;

pub use chart::{Curve, Scale};
pub use embed::{IMAGE_SIDE, png, within};
pub use gs_train::report::ReportRow;
pub use heat::HeatMap;
pub use overlay::{Legend, OVERLAY_SIDE, OverlayFigure};
pub use page::STRIP_SIDE;
pub use ramp::Ramp;

use crate::storage::Storage;
use gs_core::Image;
use gs_train::report::Section;

/// The content of a report. Empty parts are left out of the page.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Heading, for example `bouncing · fourdgs`.
    pub title: String,
    /// What was trained, below the heading: method, preset, data, steps, seed, program.
    pub subtitle: String,
    /// Scores shown on cards below the heading.
    pub figures: Vec<Figure>,
    /// Conditions of the scores: split, number of views, size, background, mask.
    pub conditions: String,
    /// Conditions of the scores beyond the last training time.
    pub future_conditions: String,
    /// Renders beside ground truth: a view of median score first, then the worst ones.
    pub views: Vec<Comparison>,
    /// The same for views beyond the last training time.
    pub future: Vec<Comparison>,
    /// PSNR of every scored view against normalised time, dB.
    pub over_time: Vec<Curve>,
    /// First and last training time, normalised.
    pub training_times: Option<[f64; 2]>,
    /// Per camera, if there are several: its number, number of views, mean and worst PSNR.
    pub cameras: Vec<[String; 4]>,
    /// The scene from one camera over time.
    pub strip: Vec<Still>,
    /// PSNR over steps and seconds, dB: of training batches, and of the views scored while training. The names say which.
    pub psnr: Vec<(String, Vec<Sample>)>,
    /// Training loss over steps and seconds.
    pub loss: Vec<Sample>,
    /// What training and rendering cost, on cards.
    pub cost: Vec<Figure>,
    /// Number of splats over steps and seconds.
    pub splats: Vec<Sample>,
    /// Parts of a training step with their milliseconds, the longest first.
    pub phases: Vec<(String, f64)>,
    /// Renders of the splats coloured by their attributes.
    pub overlays: Vec<OverlayFigure>,
    /// View, time and background of the overlays, in words.
    pub overlay_view: String,
    /// Histograms of scalar attributes of the splats over training steps.
    pub heat_maps: Vec<HeatMap>,
    /// Renders coloured by second differences of motion.
    pub jerk: Vec<Still>,
    /// What the method itself reports.
    pub method: Option<Section>,
    /// Per metric: its name, mean, median, worst value, and the name of the worst view.
    pub scores: Vec<[String; 5]>,
    /// Statistics of the trained scene: moving, rotating, invisible splats, motion, kernel shapes.
    pub needs: Vec<ReportRow>,
    /// Work of rendering and training, and work skipped.
    pub work: Vec<ReportRow>,
    /// Bytes of the parameters by block.
    pub storage: Option<Storage>,
    /// Per setting: key, value, source.
    pub settings: Vec<[String; 3]>,
    /// Provenance as name and value: version, machine, data.
    pub provenance: Vec<[String; 2]>,
    /// What can be done with the run: in words, and as a command line.
    pub commands: Vec<[String; 2]>,
}

/// A headline figure on a card.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Value with its unit, for example `31.42 dB`.
    pub value: String,
    /// Name of the value, for example `PSNR`.
    pub name: String,
    /// For example `mean of 20 test views over black`.
    pub remark: String,
}

/// A sample of a training curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of the optimizer step, from 1.
    pub step: f64,
    /// Seconds of training up to this step.
    pub seconds: f64,
    /// Value of the curve at this step.
    pub value: f64,
}

impl Sample {
    /// The number of the step.
    pub(crate) fn at_step(&self) -> f64 {
        self.step
    }
}

/// A render beside its ground truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Time and name of the view, unique in the report.
    pub name: String,
    /// Name of the view, time, metrics.
    pub caption: String,
    /// Ground truth, `[H, W, 3]`.
    pub truth: Image,
    /// Rendered image, `[H, W, 3]`, values in `[0, 1]`.
    pub render: Image,
}

/// An image with a caption.
#[derive(Clone, Debug, PartialEq)]
pub struct Still {
    /// For example `t = 0.25`.
    pub caption: String,
    /// The image, `[H, W, 3]`; [`within`] the size at which it is shown, where it is held for long.
    pub image: Image,
}

/// An image or chart of a report that cannot be encoded.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// An image has no pixels, too many, or an unsupported number of channels.
    #[error("cannot encode an image for the report: {0}")]
    Png(String),
    /// The plotting library refused a chart.
    #[error("cannot draw a chart for the report: {0}")]
    Chart(String),
}

impl Report {
    /// Renders the report as one HTML page.
    ///
    /// # Errors
    /// If an image or chart cannot be encoded (an image without pixels).
    pub fn html(&self) -> Result<String, ReportError> {
        page::page(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_train::report::{Chart, Matrix, Table};

    const HOSTILE: &str = "<script>alert(1)</script><img src=http://x.y onerror=\"a()\"> & 'b'";

    fn method_section() -> Section {
        let text = || HOSTILE.to_owned();
        let curve = |name: &str| Curve { name: name.into(), points: vec![(0.0, 0.25), (9.0, 0.25), (9.0, 0.5)] };
        let curves = vec![curve(HOSTILE), curve("b")];
        Section {
            title: text(),
            remark: text(),
            charts: vec![Chart { title: text(), x: text(), scale: Scale::Linear, curves }],
            matrices: vec![Matrix { caption: text(), columns: vec![vec![0, 7], vec![3, 1]] }],
            rows: vec![ReportRow::new(HOSTILE, text(), HOSTILE)],
            tables: vec![Table { summary: text(), head: vec![text()], numeric: vec![0], rows: vec![vec![text()]] }],
            json: serde_json::Value::Null,
        }
    }

    fn full() -> Report {
        let samples: Vec<Sample> = (1..50)
            .map(|i| Sample { step: f64::from(i), seconds: f64::from(i) * 0.1, value: 1.0 / f64::from(i) })
            .collect();
        let image = Image { width: 2, height: 1, channels: 3, data: vec![0.0, 0.5, 1.0, 2.0, -1.0, 0.25] };
        let text = || HOSTILE.to_owned();
        let need = || ReportRow { name: text(), value: "7 < 9".into(), meaning: text() };
        let still = || Still { caption: text(), image: image.clone() };
        let card = || Figure { value: "31.4 dB".into(), name: text(), remark: "a & b".into() };
        let view = || Comparison { name: text(), caption: text(), truth: image.clone(), render: image.clone() };
        Report {
            title: text(),
            subtitle: text(),
            figures: vec![card()],
            conditions: text(),
            future_conditions: text(),
            views: vec![view()],
            future: vec![view()],
            over_time: vec![Curve { name: text(), points: vec![(0.0, 20.0), (1.5, 21.0)] }],
            training_times: Some([0.0, 1.0]),
            cameras: vec![[text(), "1".into(), "20".into(), "20".into()]],
            strip: vec![still()],
            psnr: vec![(text(), samples.clone()), ("val".into(), samples.clone())],
            loss: samples,
            cost: vec![card()],
            splats: Vec::new(),
            phases: vec![(text(), 3.0), ("field".into(), 1.0)],
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
            jerk: vec![still()],
            method: Some(method_section()),
            scores: vec![[text(), "1".into(), "1".into(), "1".into(), text()]],
            needs: vec![need()],
            work: vec![need()],
            storage: None,
            settings: vec![[text(), text(), text()]],
            provenance: vec![[text(), text()]],
            commands: vec![[text(), format!("gs4d view '{HOSTILE}'")]],
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
        assert_eq!(pictures, 2 * 3 + 5, "truth, drawn and error twice; still, heat map, overlay, jerk, the method's");
        assert_eq!(html.matches("src=\"").count(), pictures, "no other source");
        assert_eq!(html.matches("<svg").count(), 4, "PSNR over time, PSNR and loss of training, the method's");
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
        assert_eq!(html.matches("<img ").count(), html.matches("<img alt=\"").count(), "every image has a text");
        assert_eq!(html.matches("<svg").count(), html.matches("<svg role=\"img\" aria-label=\"").count());
        assert_eq!(full().html().unwrap(), html, "the same report is the same page");
    }

    #[test]
    fn what_a_reader_wants_first_comes_first() {
        let html = full().html().unwrap();
        let order = [
            "class=\"cards\"",
            "Ground truth beside render",
            "Extrapolated views",
            "Over time",
            "Course of training",
            "Cost",
            "What the method knows of its splats",
            "Details",
            "Commands",
        ];
        let heading = |part: &&str| if part.contains('=') { (*part).to_owned() } else { format!("<h2>{part}</h2>") };
        let places: Vec<_> = order.iter().map(|part| html.find(&heading(part)).ok_or(part).unwrap()).collect();
        assert!(places.is_sorted(), "{places:?}");
        assert_eq!(html.matches("<details>").count(), 6, "scores, splats, work, settings, machine, the method's");
    }

    #[test]
    fn the_course_says_what_it_is_of_and_one_step_is_no_curve() {
        let sample = |step: f64| Sample { step, seconds: 0.1 * step, value: 20.0 + step };
        let page = |steps: &[f64]| {
            let psnr = vec![("training batches".to_owned(), steps.iter().copied().map(sample).collect())];
            Report { psnr, ..Report::default() }.html().unwrap()
        };
        let html = page(&[1.0, 2.0]);
        assert!(html.contains("aria-label=\"PSNR of training batches, dB, against step\""), "{html}");
        assert!(!page(&[1.0]).contains("<svg"));
        let with_val = |split: &str| {
            let curves =
                [("training batches".to_owned(), vec![sample(1.0), sample(2.0)]), (split.into(), vec![sample(1.0)])];
            Report { psnr: curves.into(), ..Report::default() }.html().unwrap()
        };
        let html = with_val("val views, held out");
        assert!(html.contains("aria-label=\"PSNR of training batches and of val views, held out, dB, against step\""));
    }

    #[test]
    fn the_page_stays_small_however_large_the_pictures() {
        let noise = |k: usize| (k.wrapping_mul(2_654_435_761) >> 8) as f32 % 255.0 / 255.0;
        let image = Image { width: 1600, height: 900, channels: 3, data: (0..1600 * 900 * 3).map(noise).collect() };
        let view = Comparison { name: "v".into(), caption: "v".into(), truth: image.clone(), render: image.clone() };
        let still = Still { caption: "t".into(), image };
        let report = Report { views: vec![view; 3], strip: vec![still; 4], ..Report::default() };
        let html = report.html().unwrap();
        assert!(html.len() < 2 << 20, "{} bytes", html.len());
    }

    #[test]
    fn a_method_has_a_section_of_its_own() {
        let page = |method| Report { method: Some(method), ..Report::default() }.html().unwrap();
        let rows = vec![ReportRow::new("gates", "3 of 5".into(), "are open")];
        let long = Table {
            summary: "2 gates".into(),
            head: vec!["gate".into(), "opened".into()],
            numeric: vec![1],
            rows: [["left", "7"], ["right", "9"]].map(|r| r.map(str::to_owned).to_vec()).to_vec(),
        };
        let html = page(Section { title: "Gates".into(), rows, tables: vec![long], ..Section::default() });
        for part in
            ["<h2>Gates</h2>", "<td>3 of 5</td>", "<details><summary>2 gates</summary>", "<td class=\"n\">9</td>"]
        {
            assert!(html.contains(part), "{part} is not in {html}");
        }
        assert!(!html.contains("<svg") && !html.contains("<img"), "no empty parts");
        assert!(!page(Section { title: "Gates".into(), ..Section::default() }).contains("Gates"), "no empty section");
    }

    #[test]
    fn a_run_without_samples_still_has_a_page() {
        let html = Report { title: "empty".into(), ..Report::default() }.html().unwrap();
        assert!(
            html.contains("empty") && !html.contains("<svg") && !html.contains("<section") && !html.contains("<script")
        );
    }
}
