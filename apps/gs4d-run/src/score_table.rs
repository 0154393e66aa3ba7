//! The scores of a report: ranked views, conditions, and the table of metrics.

use super::RunError;
use super::summary::{ReportInput, color_name};
use gs_data::{Dataset, ImageCache, Split, View};
use gs_train::evaluate::{EvalReport, FittedScores, MaskedScores, RefinedCameras, ViewScores};
use gs_train::renderer::Renderer;
use gs4d_report::Comparison;
use std::cmp::Ordering;
use std::collections::BTreeSet;

/// Number of worst views shown.
const WORST_VIEWS: usize = 3;

/// The split of an evaluation.
pub(crate) fn split_of(scores: &EvalReport) -> Split {
    match scores.split.as_str() {
        "train" => Split::Train,
        "val" => Split::Val,
        "extrapolate" => Split::Extrapolate,
        _ => Split::Test,
    }
}

/// The scored views with their scores, lowest PSNR first.
pub(crate) fn ranked<'a>(dataset: &'a Dataset, scores: &'a EvalReport) -> Vec<(&'a View, &'a ViewScores)> {
    let mut ranked: Vec<_> = dataset.views(split_of(scores)).iter().zip(&scores.views).collect();
    let psnr = |s: &ViewScores| s.psnr.unwrap_or(f64::INFINITY);
    ranked.sort_by(|a, b| psnr(a.1).total_cmp(&psnr(b.1)));
    ranked
}

/// Renders of the median view and of the worst views beside ground truth.
pub(super) fn comparisons(
    m: &ReportInput,
    renderer: &mut Renderer,
    scores: &EvalReport,
) -> Result<Vec<Comparison>, RunError> {
    let ranked = ranked(m.dataset, scores);
    let mut out = Vec::new();
    for place in places(ranked.len()) {
        let (view, scores) = ranked[place];
        let shown = scores.camera.unwrap_or_default().corrected(view);
        let truth = m.images.get(view)?.over(m.scores.background);
        let psnr = scores.psnr.map_or("perfect".to_owned(), |p| format!("{p:.2} dB"));
        let time = view.time.normalised;
        let kind = kind(place, ranked.len());
        let caption = format!(
            "{kind}, rank {} of {} from the worst · {} · t = {time:.3} · PSNR {psnr} · SSIM {:.4}",
            place + 1,
            ranked.len(),
            view.name,
            scores.ssim
        );
        let name = format!("t{time:.3}_{}", view.name);
        out.push(Comparison {
            name,
            caption,
            truth,
            render: renderer.view(m.method, &shown, &m.images.camera(&shown))?,
        });
    }
    Ok(out)
}

/// What a view of a rank is called.
fn kind(place: usize, n: usize) -> &'static str {
    match place.cmp(&median(n)) {
        Ordering::Less => "worst",
        Ordering::Equal => "median",
        Ordering::Greater => "above the median",
    }
}

/// The rank of the median view, the lower one of two.
pub(super) fn median(n: usize) -> usize {
    n.saturating_sub(1) / 2
}

/// Ranks that are shown: the median one, then the worst.
pub(super) fn places(n: usize) -> Vec<usize> {
    let worst = (0..WORST_VIEWS.min(n)).filter(|p| *p != median(n));
    (0..n).skip(median(n)).take(1).chain(worst).collect()
}

/// Conditions of scores in words: split, number of views, size, background, mask.
pub(crate) fn conditions(dataset: &Dataset, images: &ImageCache, scores: &EvalReport) -> String {
    let masked = match &scores.mean.masked {
        Some(m) => format!("masks, {:.1} % of the pixels, for masked scores only", 100.0 * m.part),
        None => "no mask".to_owned(),
    };
    let views = dataset.views(split_of(scores));
    let background = color_name(scores.background);
    let refined = scores.cameras.as_ref().map_or(String::new(), |c| {
        let RefinedCameras { count, turn, shift, time, held_out, .. } = c;
        let clocks = if *time > 0.0 { format!(", {time:.4} of the time span") } else { String::new() };
        let sizes = format!("{turn:.3}° and {shift:.4} world units{clocks} (root mean squares)");
        format!(" Cameras: {count} corrections, {sizes}; {held_out}.")
    });
    let size = size_text(views, images);
    format!("{} {} views, {size}, over {background}, {masked}.{refined}", views.len(), scores.split)
}

/// Width and height of views, or the range of sizes.
pub(crate) fn size_text(views: &[View], images: &ImageCache) -> String {
    let size = |v: &View| images.camera(v);
    let sizes: BTreeSet<[u32; 2]> = views.iter().map(size).map(|c| [c.width, c.height]).collect();
    let text = |[w, h]: &[u32; 2]| format!("{w}×{h}");
    match (sizes.first(), sizes.last()) {
        (Some(first), Some(last)) if first != last => {
            format!("{} to {} in {} sizes", text(first), text(last), sizes.len())
        }
        (Some(one), _) => text(one),
        _ => "no size".to_owned(),
    }
}

/// Name, mean, median, worst value and its view, for every metric with a value; then the number of views without error, if any.
pub(crate) fn score_rows(scores: &EvalReport) -> Vec<[String; 5]> {
    let mut rows = metric_rows(scores, "");
    if let Some(future) = &scores.extrapolate {
        rows.extend(metric_rows(future, &format!(", {} views beyond the last training time", future.views.len())));
    }
    rows
}

/// A number with some decimal digits, or a dash.
pub(crate) fn number_or_dash(v: Option<f64>, digits: usize) -> String {
    v.map_or("–".to_owned(), |v| format!("{v:.digits$}"))
}

/// A metric: name, decimal digits, mean, value of a view, whether larger is better.
type Metric<'a> = (&'a str, usize, Option<f64>, fn(&ViewScores) -> Option<f64>, bool);

fn metric_rows(s: &EvalReport, of: &str) -> Vec<[String; 5]> {
    let (mean, masked) = (s.mean, s.mean.masked);
    let in_mask = |value: fn(&MaskedScores) -> Option<f64>| masked.as_ref().and_then(value);
    let fitted = |value: fn(&FittedScores) -> Option<f64>| mean.fitted.as_ref().and_then(value);
    let colors = mean.fitted.map_or("", |f| f.colors());
    let [fitted_psnr, fitted_ssim] = ["PSNR, dB", "SSIM"].map(|name| format!("{name}, {colors}"));
    let metrics: [Metric<'_>; 11] = [
        ("PSNR, dB: mean of views", 2, mean.psnr, |v| v.psnr, true),
        ("SSIM", 4, mean.ssim, |v| Some(v.ssim), true),
        ("MS-SSIM", 4, mean.ms_ssim, |v| v.ms_ssim, true),
        ("perceptual proxy (not LPIPS; less is better)", 4, mean.perceptual_proxy, |v| Some(v.perceptual_proxy), false),
        ("LPIPS (less is better)", 4, mean.lpips, |v| v.lpips, false),
        ("sharpness: Laplacian over that of the truth", 3, mean.laplacian_ratio, |v| v.laplacian_ratio, true),
        ("sharpness: high frequencies over those of the truth", 3, mean.high_band_ratio, |v| v.high_band_ratio, true),
        ("masked PSNR, dB", 2, in_mask(|m| m.psnr), |v| v.masked?.psnr, true),
        (fitted_psnr.as_str(), 2, fitted(|f| f.psnr), |v| v.fitted?.psnr, true),
        (fitted_ssim.as_str(), 4, fitted(|f| f.ssim), |v| v.fitted?.ssim, true),
        ("masked SSIM", 4, in_mask(|m| m.ssim), |v| v.masked?.ssim, true),
    ];
    let alone = |name: &str, value: String| {
        let [dash, empty] = ["–".to_owned(), String::new()];
        [format!("{name}{of}"), value, dash.clone(), dash, empty]
    };
    let mut rows = Vec::new();
    for (name, digits, mean, value, more) in metrics.into_iter().filter(|m| m.2.is_some()) {
        let mut all: Vec<(f64, &str)> = s.views.iter().filter_map(|v| Some((value(v)?, v.name.as_str()))).collect();
        all.sort_by(|a, b| if more { a.0.total_cmp(&b.0) } else { b.0.total_cmp(&a.0) });
        let median = all.get(all.len().saturating_sub(1) / 2).zip(all.get(all.len() / 2));
        let worst = all.first();
        rows.push([
            format!("{name}{of}"),
            number_or_dash(mean, digits),
            number_or_dash(median.map(|(a, b)| 0.5 * (a.0 + b.0)), digits),
            number_or_dash(worst.map(|w| w.0), digits),
            worst.map_or(String::new(), |w| w.1.to_owned()),
        ]);
        if rows.len() == 1 && s.psnr_of_mean_mse.is_some() {
            rows.push(alone("PSNR, dB: of the mean squared error", number_or_dash(s.psnr_of_mean_mse, 2)));
        }
    }
    if s.perfect_views > 0 {
        rows.push(alone("views without error (not in the mean of PSNR)", s.perfect_views.to_string()));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_train::evaluate::MeanScores;

    #[test]
    fn the_middle_and_the_worst_are_shown_once() {
        assert_eq!((places(0), places(1), places(2), places(3)), (vec![], vec![0], vec![0, 1], vec![1, 0, 2]));
        assert_eq!((places(20), places(21)), (vec![9, 0, 1, 2], vec![10, 0, 1, 2]));
        assert_eq!([0, 1].map(|place| kind(place, 2)), ["median", "above the median"]);
        assert_eq!([0, 1, 2].map(|place| kind(place, 3)), ["worst", "median", "above the median"]);
    }

    #[test]
    fn every_metric_has_mean_median_and_worst() {
        let view = |name: &str, psnr: f64, proxy: f64| ViewScores {
            name: name.into(),
            time: 0.0,
            psnr: Some(psnr),
            ssim: 0.5,
            ms_ssim: None,
            perceptual_proxy: proxy,
            lpips: None,
            fitted: None,
            laplacian_ratio: None,
            high_band_ratio: None,
            masked: None,
            camera: None,
        };
        let scores = EvalReport {
            method: "m".into(),
            split: "test".into(),
            background: [0.0; 3],
            scale: 1.0,
            protocol: String::new(),
            lpips_weights: None,
            mean: MeanScores {
                psnr: Some(24.0),
                ssim: Some(0.5),
                ms_ssim: None,
                perceptual_proxy: Some(0.2),
                lpips: None,
                fitted: None,
                laplacian_ratio: None,
                high_band_ratio: None,
                masked: None,
            },
            psnr_of_mean_mse: Some(23.5),
            perfect_views: 0,
            gaussians: 1,
            parameter_bytes: 4,
            train_seconds: None,
            views: vec![view("a", 20.0, 0.1), view("b", 30.0, 0.3), view("c", 22.0, 0.2)],
            cameras: None,
            extrapolate: None,
        };
        let rows = score_rows(&scores);
        assert_eq!(rows[0], ["PSNR, dB: mean of views", "24.00", "22.00", "20.00", "a"]);
        assert_eq!(rows[1], ["PSNR, dB: of the mean squared error", "23.50", "–", "–", ""]);
        assert_eq!(rows[3][1..], ["0.2000", "0.2000", "0.3000", "b"], "less is better");
        assert_eq!(rows.len(), 4, "no number, no row");
        let perfect = score_rows(&EvalReport { perfect_views: 2, ..scores.clone() });
        assert_eq!(perfect[4], ["views without error (not in the mean of PSNR)", "2", "–", "–", ""]);
        let both = EvalReport { extrapolate: Some(Box::new(scores.clone())), ..scores };
        assert_eq!(score_rows(&both).len(), 8);
    }
}
