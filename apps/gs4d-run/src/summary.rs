//! The report of a run: scores, median and worst views, scores over time, curves of the log, cost, statistics, commands.

use super::folder::{self, RunFolder};
use super::overlays::overlay_figures;
use super::provenance::COMMIT;
use super::work::{drawing_rows, peak_memory_mib, resting_rows, step_phases, training_rows};
use super::{Resolved, RunError, commands, per_view, score_table};
use gs_core::{Camera, Time, cast};
use gs_data::{Dataset, ImageCache, View};
use gs_raster::RasterOptions;
use gs_train::device::Device;
use gs_train::evaluate::{EvalReport, clamped};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::scene::SceneInfo;
use gs_train::timestamp::Timestamp;
use gs4d_report::analysis::AnalysisError;
use gs4d_report::analysis::paths::{painted, sample_count, second_difference_overlay};
use gs4d_report::analysis::{Analysis, Histogram, RenderCost, Snapshot};
use gs4d_report::inspect::bytes_text;
use gs4d_report::needs::needs;
use gs4d_report::storage::Storage;
use gs4d_report::{Figure, HeatMap, IMAGE_SIDE, Report, ReportRow, STRIP_SIDE, Sample, Still, within};
use serde::Deserialize;
use serde_json::Value;
use std::path::Path;

/// Number of views rendered to count the work of rendering.
const WORK_VIEWS: usize = 5;
/// Number of images of the strip.
const STRIP_FRAMES: usize = 8;

/// The data of a report.
pub(crate) struct ReportInput<'a> {
    /// The run folder, for log and provenance.
    pub(crate) folder: &'a RunFolder,
    /// The run's settings.
    pub(crate) resolved: &'a Resolved,
    /// The trained model.
    pub(crate) method: &'a Model,
    /// The run's data set.
    pub(crate) dataset: &'a Dataset,
    /// Images of the data set.
    pub(crate) images: &'a ImageCache,
    /// The device that frames are rendered on.
    pub(crate) device: &'a Device,
    /// Scores of a split.
    pub(crate) scores: &'a EvalReport,
    /// What the method was made for.
    pub(crate) scene: &'a SceneInfo,
    /// Optimizer steps made.
    pub(crate) step: u32,
}

/// Builds the report.
///
/// # Errors
/// If the log or an image cannot be read.
pub(crate) fn build_report(m: &ReportInput) -> Result<Report, RunError> {
    let log = m.folder.log_lines(folder::LOG)?;
    let options = m.method.raster_options(m.scores.background);
    let mut renderer = Renderer::on(m.device, options.clone())?;
    let ranked = score_table::ranked(m.dataset, m.scores).into_iter();
    let ranked: Vec<View> = ranked.map(|(view, s)| s.camera.unwrap_or_default().corrected(view)).collect();
    let future = m.scores.extrapolate.as_deref();
    let mut report = Report {
        title: format!("{} · {}", data_name(m), m.method.name()),
        subtitle: subtitle(m),
        figures: score_figures(m),
        conditions: score_table::conditions(m.dataset, m.images, m.scores),
        future_conditions: future.map_or(String::new(), |f| score_table::conditions(m.dataset, m.images, f)),
        views: score_table::comparisons(m, &mut renderer, m.scores)?,
        future: future.map_or(Ok(Vec::new()), |f| score_table::comparisons(m, &mut renderer, f))?,
        over_time: per_view::curves(m.dataset, m.scores),
        training_times: per_view::training_times(m.dataset),
        cameras: per_view::cameras(m.dataset, m.scores),
        psnr: psnr_curves(&log),
        loss: samples(&log, |line| line["loss"].as_f64()),
        splats: samples(&log, |line| line["splats"].as_f64()),
        phases: step_phases(&log),
        heat_maps: heat_maps(&m.folder.log_lines(folder::HISTOGRAMS)?),
        method: m.method.report_section(&m.folder.log_lines(folder::JOURNAL)?)?,
        scores: score_table::score_rows(m.scores),
        storage: Some(Storage::of(m.method, m.method.capabilities().inspect.and_then(|i| i.paper_storage()))),
        settings: settings(m.resolved),
        provenance: provenance(m.folder)?,
        commands: commands::commands(&commands::Subject {
            root: m.folder.root(),
            split: &m.scores.split,
            dynamic: m.dataset.dynamic,
            step: m.step,
            steps: m.resolved.steps(),
            rounds: m.folder.rounds().and_then(|r| r["command"].as_str().map(str::to_owned)),
        }),
        ..Report::default()
    };
    let typical = ranked.get(score_table::median(ranked.len()));
    if let Some(view) = typical.or(m.dataset.train.first()) {
        let camera = m.images.camera(view);
        if m.dataset.dynamic {
            report.strip = strip(m.method, &mut renderer, &camera)?;
            report.jerk = jerk(m, view, &camera)?;
        }
        report.overlays = overlay_figures(m.method, view, &camera, m.scene.last_time)?;
        report.overlay_view =
            format!("{} at t = {:.3}, a view of median PSNR, over black.", view.name, view.time.normalised);
        let seen: Vec<_> = ranked.iter().take(WORK_VIEWS).map(|v| (m.images.camera(v), v.time)).collect();
        report.needs = needs(m.method, &camera, m.scene.extent)?;
        report.needs.extend(analysis(m, &seen, &options)?);
        report.work = drawing_rows(m.method, &seen, &options)?;
        report.work.extend(resting_rows(m.method, &seen));
        report.cost = cost_figures(m, peak_memory_mib(&log), renderer.seconds(m.method, view, &camera)?, &camera);
    }
    report.work.extend(training_rows(&log));
    Ok(report)
}

/// Numbers of images, `[H, W, 3]` in `f32`, that the report of a run holds at once, at most: whole ones of compared views, and those
/// reduced to [`IMAGE_SIDE`] at most, the strip over time and overlays. An estimate of its memory counts them.
///
/// # Errors
/// If the method cannot give its overlays.
pub fn images_held(method: &Model, dataset: &Dataset) -> Result<[usize; 2], MethodError> {
    let scored = if dataset.test.is_empty() { &dataset.train } else { &dataset.test };
    let compared = [scored, &dataset.extrapolate].map(|views| 2 * score_table::places(views.len()).len());
    let moving = if dataset.dynamic { STRIP_FRAMES + 1 } else { 0 };
    let at = Timestamp::normalised(0.0);
    let parts = usize::from(method.capabilities().particles.is_some());
    let overlays = method.quantities(&at)?.len() + method.overlays(&at)?.len() + parts;
    Ok([compared.iter().sum(), moving + overlays])
}

fn data_name(m: &ReportInput) -> String {
    let path = Path::new(&m.resolved.run.data);
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
    name.unwrap_or_else(|| m.dataset.layout.to_owned())
}

/// What was trained, in a line.
fn subtitle(m: &ReportInput) -> String {
    let (run, data) = (&m.resolved.run, m.dataset);
    let kind = if data.dynamic { "moving" } else { "still" };
    let commit = COMMIT.map_or(String::new(), |c| format!(", commit {c}"));
    format!(
        "{}, preset {}, on {} ({}): a {kind} scene from {} training views; step {} of {}, seed {}; gs4d {}{commit}",
        m.method.name(),
        run.preset,
        run.data,
        data.layout,
        data.train.len(),
        m.step,
        m.resolved.steps(),
        run.seed,
        env!("CARGO_PKG_VERSION"),
    )
}

fn figure(value: String, name: &str, remark: impl Into<String>) -> Figure {
    Figure { value, name: name.to_owned(), remark: remark.into() }
}

fn score_figures(m: &ReportInput) -> Vec<Figure> {
    let s = m.scores;
    let number = score_table::number_or_dash;
    let over = |s: &EvalReport| format!("{} {} views over {}", s.views.len(), s.split, color_name(s.background));
    let of = over(s);
    let mean = |s: &EvalReport| match s.perfect_views {
        0 => format!("mean of {}", over(s)),
        n => format!("mean of {} of {}; {n} are without error", s.views.len().saturating_sub(n), over(s)),
    };
    let mut figures = vec![figure(format!("{} dB", number(s.mean.psnr, 2)), "PSNR", mean(s))];
    figures.extend(
        s.psnr_of_mean_mse
            .map(|p| figure(format!("{p:.2} dB"), "PSNR of the mean error", format!("one mean square over {of}"))),
    );
    figures.extend(
        s.extrapolate.as_ref().map(|f| figure(format!("{} dB", number(f.mean.psnr, 2)), "PSNR, extrapolated", mean(f))),
    );
    let proxy = format!("not LPIPS, less is better; mean of {of}");
    figures.push(figure(number(s.mean.ssim, 4), "SSIM", format!("11×11 window, zeros outside; mean of {of}")));
    figures.push(figure(number(s.mean.perceptual_proxy, 4), "perceptual proxy", proxy));
    figures
}

fn cost_figures(m: &ReportInput, peak_mib: Option<f64>, seconds: f64, camera: &Camera) -> Vec<Figure> {
    let s = m.scores;
    let bytes = bytes_text(s.parameter_bytes.try_into().unwrap_or(usize::MAX));
    let trained = s.train_seconds.unwrap_or(0.0);
    let per_step = format!("{} steps, {:.1} ms each", m.step, 1e3 * trained / f64::from(m.step.max(1)));
    let (threads, on) = (rayon::current_num_threads(), m.device.name());
    let size = format!("{}×{}, field and rendering on {on}, threads: {threads}", camera.width, camera.height);
    let mut figures = vec![figure(format!("{trained:.1} s"), "training", per_step)];
    figures.extend(peak_mib.map(|p| figure(format!("{p:.0} MiB"), "peak memory", "of the process, while training")));
    figures.extend([
        figure(s.gaussians.to_string(), "splats", "in the canonical cloud"),
        figure(bytes, "scene", "parameters as f32"),
        figure(format!("{:.2} ms", 1e3 * seconds), "per frame", size),
    ]);
    figures
}

fn settings(resolved: &Resolved) -> Vec<[String; 3]> {
    resolved.config.iter().map(|(k, s)| [k.to_owned(), s.value.to_string(), s.source.to_string()]).collect()
}

/// `black`, `white`, or the three values of an RGB colour.
pub fn color_name(c: [f32; 3]) -> String {
    match c {
        [0.0, 0.0, 0.0] => "black".to_owned(),
        [1.0, 1.0, 1.0] => "white".to_owned(),
        [r, g, b] => format!("({r}, {g}, {b})"),
    }
}

/// The curve of a value over the log's lines that have one.
pub(crate) fn samples(log: &[Value], value: impl Fn(&Value) -> Option<f64>) -> Vec<Sample> {
    let sample = |line: &Value| {
        Some(Sample { step: line["step"].as_f64()?, seconds: line["seconds"].as_f64()?, value: value(line)? })
    };
    log.iter().filter_map(sample).collect()
}

/// PSNR of training batches, and of the views scored while training, where the log has any.
fn psnr_curves(log: &[Value]) -> Vec<(String, Vec<Sample>)> {
    let batches = samples(log, |line| line["psnr"].as_f64());
    let scored = samples(log, |line| line["eval"]["mean"]["psnr"].as_f64());
    let split = log.iter().find_map(|l| l["eval"]["split"].as_str()).unwrap_or("val");
    let kind = if split == "train" { "rendered anew" } else { "held out" };
    let curves = [("training batches".to_owned(), batches), (format!("{split} views, {kind}"), scored)];
    curves.into_iter().filter(|(_, s)| !s.is_empty()).collect()
}

fn strip(method: &Model, renderer: &mut Renderer, camera: &Camera) -> Result<Vec<Still>, MethodError> {
    let time = |k: usize| k as f32 / (STRIP_FRAMES - 1) as f32;
    let still = |k: usize| {
        let image = within(renderer.at(method, time(k), camera)?, STRIP_SIDE);
        Ok(Still { caption: format!("t = {:.2}", time(k)), image })
    };
    (0..STRIP_FRAMES).map(still).collect()
}

/// Spacing of the training times, normalised; half the span of a single one.
fn interval(scene: &SceneInfo) -> f32 {
    if scene.frame_interval > 0.0 { scene.frame_interval } else { 0.5 }
}

/// A render coloured by second differences of motion at the time of a view, over black.
fn jerk(m: &ReportInput, view: &View, camera: &Camera) -> Result<Vec<Still>, MethodError> {
    let mut renderer = Renderer::new(m.method.raster_options([0.0; 3]));
    let (time, interval) = (view.time.normalised, interval(m.scene));
    let overlay = match second_difference_overlay(m.method, time, interval, camera) {
        Ok(overlay) => overlay,
        Err(AnalysisError::Trajectory(_)) => return Ok(Vec::new()),
        Err(AnalysisError::Method(e)) => return Err(e),
    };
    let splats = painted(m.method.all_splats(&Timestamp::normalised(time), camera)?, overlay);
    let caption = format!("second differences at t = {time:.2}: black at rest, white at the largest");
    Ok(vec![Still { caption, image: within(clamped(renderer.render(&splats, camera)?), IMAGE_SIDE) }])
}

fn analysis(m: &ReportInput, seen: &[(Camera, Time)], options: &RasterOptions) -> Result<Vec<ReportRow>, MethodError> {
    let moments = if m.dataset.dynamic { sample_count(m.scene.timestamps as usize) } else { 0 };
    let mut rows = Analysis::of(m.method, moments, None)?.rows();
    rows.extend(RenderCost::of(m.method, seen, options, m.scores.mean.psnr)?.iter().flat_map(RenderCost::rows));
    Ok(rows)
}

/// Heat maps of the attributes pooled over times, from the lines of the histogram log.
fn heat_maps(lines: &[Value]) -> Vec<HeatMap> {
    let mut names: Vec<String> = Vec::new();
    let mut columns: Vec<Vec<(u64, Histogram)>> = Vec::new();
    for line in lines {
        let (Some(step), Ok(snapshot)) = (line["step"].as_u64(), Snapshot::deserialize(line)) else { continue };
        for h in snapshot.histograms.into_iter().filter(|h| h.time.is_none()) {
            let at = names.iter().position(|name| *name == h.name).unwrap_or_else(|| {
                names.push(h.name.clone());
                columns.push(Vec::new());
                names.len() - 1
            });
            columns[at].push((step, h));
        }
    }
    names.into_iter().zip(columns).map(|(name, columns)| heat_map(name, &columns)).collect()
}

/// Histograms of one attribute over the range of them all: each has its own where the attribute has none.
fn heat_map(name: String, columns: &[(u64, Histogram)]) -> HeatMap {
    let low = columns.iter().map(|(_, h)| h.span[0]).fold(f32::INFINITY, f32::min);
    let high = columns.iter().map(|(_, h)| h.span[1]).fold(f32::NEG_INFINITY, f32::max);
    let (steps, counts) = columns.iter().map(|(step, h)| (*step, rebinned(h, [low, high]))).unzip();
    HeatMap { name, span: [low, high], steps, counts }
}

/// The counts of a histogram in as many bins of a range that holds its own; each bin goes where its middle is.
fn rebinned(h: &Histogram, span: [f32; 2]) -> Vec<u32> {
    if h.span == span {
        return h.counts.clone();
    }
    let ([from, to], [low, high]) = (h.span.map(f64::from), span.map(f64::from));
    let (bins, mut counts) = (h.counts.len(), vec![0; h.counts.len()]);
    for (k, count) in h.counts.iter().enumerate() {
        let middle = from + (to - from) * (k as f64 + 0.5) / bins as f64;
        let place = cast::to_usize(((middle - low) / (high - low) * bins as f64).max(0.0));
        counts[place.min(bins - 1)] += count;
    }
    counts
}

/// Provenance as rows `section.name`, value.
fn provenance(folder: &RunFolder) -> Result<Vec<[String; 2]>, RunError> {
    let text = folder.read(folder::PROVENANCE)?;
    let value: Value = serde_json::from_str(&text).unwrap_or_default();
    let mut rows = Vec::new();
    for (key, entry) in value.as_object().into_iter().flatten() {
        match entry.as_object() {
            Some(inner) => rows.extend(inner.iter().map(|(k, v)| [format!("{key}.{k}"), plain(v)])),
            None => rows.push([key.clone(), plain(entry)]),
        }
    }
    Ok(rows)
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(s) => s.clone(),
        Value::Array(list) => list.iter().map(plain).collect::<Vec<_>>().join(", "),
        Value::Null => "–".to_owned(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histograms_of_different_ranges_share_an_axis() {
        let of = |span, values: &[f32]| Histogram::of("speed", None, span, values);
        let columns = [(1, of([0.0, 1.0], &[0.1, 0.9, 0.9])), (2, of([0.0, 4.0], &[0.1, 3.9]))];
        let map = heat_map("speed".to_owned(), &columns);
        assert_eq!((map.span, &map.steps[..]), ([0.0, 4.0], &[1, 2][..]));
        let places =
            |column: &[u32]| -> Vec<usize> { (0..column.len()).flat_map(|k| vec![k; column[k] as usize]).collect() };
        // Bins of the shared axis are 1/16 wide.
        assert_eq!(places(&map.counts[0]), [1, 14, 14]);
        assert_eq!(places(&map.counts[1]), [1, 62]);
    }
}
