//! Comparison of runs on the same data, view by view: the same ground truth, times and conditions.
//!
//! Runs on different data are an error: layout, number of views, their size, the background and the digest of the data must
//! agree. Differences are paired: each view of one run against the same view of the first.

pub mod page;
mod sides;

pub use sides::{CompareError, Side};

use crate::OpenRun;
use crate::compare::sides::{names, same_data};
use crate::provenance::DataOrigin;
use crate::score_table::{conditions, number_or_dash};
use gs_core::Image;
use gs_data::{Dataset, ImageCache, Split, View};
use gs_metrics::{mse, psnr_from_mse};
use gs_train::cameras::Correction;
use gs_train::evaluate::{EvalError, EvalReport, evaluate_with, evaluate_with_future};
use gs_train::method::MethodError;
use gs_train::renderer::Renderer;
use gs4d_eval::spread::{SCORES, Spread};
use serde::Serialize;
use std::collections::BTreeMap;

/// Settings that do not change the result of a recipe, apart from the seed.
const NOT_RECIPE: [&str; 8] = [
    "run.data",
    "run.seed",
    "run.log_every",
    "run.checkpoint_every",
    "run.histogram_every",
    "run.eval_every",
    "run.eval_views",
    "run.image_mib",
];

/// What is compared: the views of a split over a background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// The split whose views are compared.
    pub split: Split,
    /// The background colour; `None`: that of the recipes, which must agree.
    pub background: Option<[f32; 3]>,
    /// Number of views shown with renders.
    pub shown: usize,
}

/// Scores and facts of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Short name, unique among the runs.
    pub name: String,
    /// Where it was read from.
    pub path: String,
    /// Name of the run's method.
    pub method: String,
    /// Name of the run's preset.
    pub preset: String,
    /// Seed of its random numbers.
    pub seed: u64,
    /// Optimizer steps made in the run.
    pub step: u32,
    /// Milliseconds of a frame on this machine: field and rasterisation, the median of five.
    pub ms_per_frame: f64,
    /// Scores of the views of the split.
    pub scores: EvalReport,
    /// PSNR of its renders against those of the first run, from the mean error over all views, dB; absent if equal.
    pub psnr_to_first: Option<f64>,
    /// Processor and threads of its training, where known.
    pub trained_on: Option<String>,
}

/// PSNR of a run minus that of the first run, view by view, dB.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Paired {
    /// Short name of the run.
    pub name: String,
    /// Mean over views and their standard deviation (views, not seeds).
    pub over_views: Option<Spread>,
    /// Smallest and largest difference over views, dB.
    pub range: Option<[f64; 2]>,
    /// Number of views with a higher PSNR than in the first run.
    pub better: usize,
    /// Number of views with a finite PSNR in both runs.
    pub of: usize,
}

/// A view in all runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewRow {
    /// Name of the view in the data set.
    pub name: String,
    /// Normalised time of the view.
    pub time: f32,
    /// PSNR of each run, dB; absent for a perfect view.
    pub psnr: Vec<Option<f64>>,
    /// Largest root mean square difference between the renders of two runs.
    pub disagreement: f64,
}

/// A setting whose values differ between runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DifferingSetting {
    /// Dotted key of the setting, such as `schedule.batch`.
    pub key: String,
    /// Its value in each run; absent where the run has no such setting.
    pub values: Vec<Option<String>>,
}

/// A comparison without its images.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Compared {
    /// Split, number of views, size, background, mask, in words.
    pub conditions: String,
    /// Digest of the data set.
    pub data_digest: String,
    /// The runs in the given order.
    pub runs: Vec<Row>,
    /// Each later run against the first.
    pub differences: Vec<Paired>,
    /// Spread over seeds, as far as known, in words.
    pub seeds: String,
    /// The views, in the order of the split.
    pub views: Vec<ViewRow>,
    /// Settings that differ, those of the methods included.
    pub settings: Vec<DifferingSetting>,
}

/// A view rendered by all runs.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewRenders {
    /// Name, time and PSNR of each run.
    pub caption: String,
    /// Ground truth, `[H, W, 3]`.
    pub truth: Image,
    /// The render of each run.
    pub renders: Vec<Image>,
}

/// Scores the runs on the same views, and renders those they disagree about most.
///
/// # Errors
/// If they are not on the same data, or a view cannot be rendered.
pub fn compare(sides: &[Side], options: &Options) -> Result<(Compared, Vec<ViewRenders>), CompareError> {
    let Some(first) = sides.first() else { return Ok(Default::default()) };
    sides.iter().skip(1).try_for_each(|other| same_data(first, other, options))?;
    let background = options.background.unwrap_or_else(|| first.run.background());
    let (dataset, images) = (&first.dataset, first.run.images());
    let views = dataset.views(options.split);
    let mut renderers: Vec<Renderer> = sides.iter().map(|s| renderer(s, background)).collect();
    let mut runs = Vec::new();
    for ((side, name), renderer) in sides.iter().zip(names(sides)).zip(&mut renderers) {
        runs.push(row(side, name, renderer, (dataset, &images), options.split, background)?);
    }
    let corrections: Vec<Vec<Correction>> = runs.iter().map(corrections).collect();
    let mut render = |k: usize| {
        let one = |((side, renderer), corrections): ((&Side, &mut Renderer), &Vec<Correction>)| {
            let shown = corrections[k].corrected(&views[k]);
            renderer.view(&side.run.loaded.model, &shown, &images.camera(&shown))
        };
        sides.iter().zip(&mut renderers).zip(&corrections).map(one).collect()
    };
    let rows = disagreements(&mut runs, views, &mut render)?;
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|a, b| rows[*b].disagreement.total_cmp(&rows[*a].disagreement).then(a.cmp(b)));
    let mut pictures = Vec::new();
    for &k in order.iter().take(options.shown) {
        let truth = images.get(&views[k]).map_err(EvalError::from)?.over(background);
        pictures.push(ViewRenders { caption: caption(&rows[k], &runs), truth, renders: render(k)? });
    }
    let compared = Compared {
        conditions: conditions(dataset, &images, &runs[0].scores),
        data_digest: DataOrigin::of(dataset).digest,
        differences: runs.iter().skip(1).map(|r| paired(&runs[0], r)).collect(),
        seeds: seeds(sides, &runs),
        settings: differing_settings(sides),
        runs,
        views: rows,
    };
    Ok((compared, pictures))
}

/// The disagreement of each view; sets each run's PSNR against the first one.
fn disagreements(
    runs: &mut [Row],
    views: &[View],
    render: &mut impl FnMut(usize) -> Result<Vec<Image>, MethodError>,
) -> Result<Vec<ViewRow>, CompareError> {
    let mut rows = Vec::with_capacity(views.len());
    let mut to_first = vec![0.0; runs.len()];
    for (k, view) in views.iter().enumerate() {
        let renders = render(k)?;
        let between =
            |a: &Image, b: &Image| mse(a, b).map_err(|source| EvalError::Metric { view: view.name.clone(), source });
        let mut largest = 0.0f64;
        for (i, a) in renders.iter().enumerate() {
            to_first[i] += between(a, &renders[0])?;
            for b in &renders[..i] {
                largest = largest.max(between(a, b)?);
            }
        }
        let psnr = runs.iter().map(|r| r.scores.views[k].psnr).collect();
        rows.push(ViewRow { name: view.name.clone(), time: view.time.normalised, psnr, disagreement: largest.sqrt() });
    }
    for (run, sum) in runs.iter_mut().zip(to_first) {
        run.psnr_to_first = Some(psnr_from_mse(sum / views.len() as f64)).filter(|p| p.is_finite());
    }
    Ok(rows)
}

fn renderer(side: &Side, background: [f32; 3]) -> Renderer {
    Renderer::new(side.run.loaded.model.raster_options(background))
}

fn row(
    side: &Side,
    name: String,
    renderer: &mut Renderer,
    (dataset, images): (&Dataset, &ImageCache),
    split: Split,
    background: [f32; 3],
) -> Result<Row, CompareError> {
    let OpenRun { loaded, resolved, .. } = &side.run;
    let method = &loaded.model;
    let scoring = side.run.scoring(background, images);
    let mut scores = match split {
        Split::Extrapolate => evaluate_with(method, dataset, split, &scoring)?,
        _ => evaluate_with_future(method, dataset, split, &scoring)?,
    };
    scores.train_seconds = Some(loaded.train_seconds);
    let view = dataset.views(split).first();
    let seconds = view.map(|v| renderer.seconds(method, v, &images.camera(v))).transpose()?.unwrap_or(0.0);
    Ok(Row {
        name,
        path: side.path.display().to_string(),
        method: method.name().to_owned(),
        preset: resolved.run.preset.clone(),
        seed: resolved.run.seed,
        step: loaded.step,
        ms_per_frame: 1e3 * seconds,
        scores,
        psnr_to_first: None,
        trained_on: side.trained_on(),
    })
}

/// What the cameras of the scored views were corrected by.
fn corrections(run: &Row) -> Vec<Correction> {
    run.scores.views.iter().map(|view| view.camera.unwrap_or_default()).collect()
}

fn caption(view: &ViewRow, runs: &[Row]) -> String {
    let psnr = |(run, p): (&Row, &Option<f64>)| {
        format!("{} {}", run.name, p.map_or("perfect".to_owned(), |p| format!("{p:.2} dB")))
    };
    let each: Vec<String> = runs.iter().zip(&view.psnr).map(psnr).collect();
    format!(
        "{} · t = {:.3} · {} · renders differ by {:.4} (root mean square)",
        view.name,
        view.time,
        each.join(" · "),
        view.disagreement
    )
}

fn paired(first: &Row, run: &Row) -> Paired {
    let pairs = first.scores.views.iter().zip(&run.scores.views);
    let differences: Vec<f64> = pairs.filter_map(|(a, b)| Some(b.psnr? - a.psnr?)).collect();
    let low = differences.iter().copied().reduce(f64::min);
    let high = differences.iter().copied().reduce(f64::max);
    Paired {
        name: run.name.clone(),
        over_views: Spread::of(&differences),
        range: low.zip(high).map(|(a, b)| [a, b]),
        better: differences.iter().filter(|d| **d > 0.0).count(),
        of: differences.len(),
    }
}

/// Settings of a run that determine its result, by key.
fn recipe(side: &Side) -> BTreeMap<&str, String> {
    let settings = side.run.resolved.config.iter().filter(|(key, _)| !NOT_RECIPE.contains(key));
    settings.map(|(key, setting)| (key, setting.value.to_string())).collect()
}

/// The spread over seeds of recipes with several runs, in words.
fn seeds(sides: &[Side], runs: &[Row]) -> String {
    type Recipe<'a> = (BTreeMap<&'a str, String>, u32);
    let mut recipes: Vec<(Recipe<'_>, Vec<usize>)> = Vec::new();
    for (k, side) in sides.iter().enumerate() {
        // Runs of one budget of time may end at different steps.
        let steps = if side.run.resolved.run.time_budget > 0.0 { 0 } else { runs[k].step };
        let values = (recipe(side), steps);
        match recipes.iter_mut().find(|r| r.0 == values) {
            Some((_, of)) => of.push(k),
            None => recipes.push((values, vec![k])),
        }
    }
    let several_seeds = |of: &[usize]| of.iter().any(|k| runs[*k].seed != runs[of[0]].seed);
    let spread = |(_, of): &(Recipe<'_>, Vec<usize>)| {
        // One run for each seed: a repeated one says nothing of the spread.
        let by_seed: BTreeMap<u64, Option<f64>> =
            of.iter().rev().map(|k| (runs[*k].seed, runs[*k].scores.mean.psnr)).collect();
        let psnr: Vec<f64> = by_seed.into_values().flatten().collect();
        let Spread { mean, deviation } = Spread::of(&psnr).filter(|_| several_seeds(of))?;
        let names: Vec<String> = of.iter().map(|k| format!("{} (seed {})", runs[*k].name, runs[*k].seed)).collect();
        Some(format!("{} are one recipe: {mean:.2} ± {deviation:.2} dB over {} seeds.", names.join(", "), psnr.len()))
    };
    let known: Vec<String> = recipes.iter().filter_map(spread).collect();
    if known.is_empty() {
        "One seed for each recipe: which differences are within the spread of seeds is not known.".to_owned()
    } else {
        known.join(" ") + " Of recipes with one seed the spread is not known."
    }
}

fn differing_settings(sides: &[Side]) -> Vec<DifferingSetting> {
    let all: Vec<BTreeMap<&str, String>> = sides.iter().map(recipe).collect();
    let mut keys: Vec<&str> = all.iter().flat_map(|v| v.keys().copied()).collect();
    keys.sort_unstable();
    keys.dedup();
    let row =
        |key: &str| DifferingSetting { key: key.to_owned(), values: all.iter().map(|v| v.get(key).cloned()).collect() };
    keys.into_iter().map(row).filter(|u| u.values.iter().any(|v| *v != u.values[0])).collect()
}

/// Name, digits and value of a column of a table of runs.
pub type Column = (&'static str, usize, fn(&Row) -> Option<f64>);

/// Columns in addition to [`SCORES`].
const RUN_COLUMNS: [Column; 8] = [
    ("views without error", 0, |r| (r.scores.perfect_views > 0).then_some(r.scores.perfect_views as f64)),
    ("dB of mean error", 2, |r| r.scores.psnr_of_mean_mse),
    ("worst dB", 2, |r| r.scores.views.iter().filter_map(|v| v.psnr).reduce(f64::min)),
    ("worst ssim", 4, |r| r.scores.views.iter().map(|v| v.ssim).reduce(f64::min)),
    ("ms-ssim", 4, |r| r.scores.mean.ms_ssim),
    ("masked dB", 2, |r| r.scores.mean.masked?.psnr),
    ("steps", 0, |r| Some(f64::from(r.step))),
    ("ms/frame", 2, |r| Some(r.ms_per_frame)),
];

/// The columns with any value: name, and a text for each run.
pub fn columns(runs: &[Row]) -> Vec<(&'static str, Vec<String>)> {
    let of_contest = SCORES
        .iter()
        .map(|(name, digits, score)| (*name, *digits, runs.iter().map(|r| score(&r.scores)).collect::<Vec<_>>()));
    let more =
        RUN_COLUMNS.iter().map(|(name, digits, value)| (*name, *digits, runs.iter().map(value).collect::<Vec<_>>()));
    let known = of_contest.chain(more).filter(|(.., values)| values.iter().any(Option::is_some));
    known
        .map(|(name, digits, values)| (name, values.into_iter().map(|v| number_or_dash(v, digits)).collect()))
        .collect()
}

#[cfg(test)]
mod tests;
