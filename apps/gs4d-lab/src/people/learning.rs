//! Unseen motion, unseen light, and ablations.

use super::trained::{SCORES, scores};
use super::{Cell, Findings, LabError, Log, Setup, Subject, Trained};
use gs_data::{Dataset, Split, View};
use gs_metrics::Mean;
use gs_synth::avatar::{AvatarOptions, Light, generate, options_of};
use gs_train::evaluate::EvalReport;
use std::collections::BTreeMap;

/// Training light of a film without one.
const FIRST_LIGHT: Light = Light { direction: [0.5, 1.0, 0.8], ambient: 0.35, shadows: true };

/// Scores on the motion of the film and on another motion.
pub(super) fn unseen_motion(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let subject = Subject::new(setup, log)?;
    let trained = trained(setup, &subject.full_film, log)?;
    let options = film_options(setup, &subject.full_film)?;
    let other = other_clip(setup, &subject, &options)?;
    log(&format!("filming {other}"));
    // Only test views are scored, at all frames.
    let frames = options.frames.min(setup.frames as u32).max(1);
    let film = generate(&AvatarOptions { clip: Some(other.clone()), frames, fps: None, test_every: 0, ..options })?;
    let heads =
        [("motion", 0), ("frames", 0), ("PSNR", 2), ("±", 2), ("in-mask PSNR", 2), ("± in mask", 2), ("worst", 2)];
    let remark = "Test cameras. Means over frames of their mean PSNR, standard deviation over frames (n - 1; none of one frame), and \
                  the worst frame in the mask.";
    let mut out = Findings::new("ood", remark, &heads);
    let learnt: Vec<f32> = subject.full_film.train.iter().map(|v| v.time.normalised).collect();
    let own = trained.scores(&subject.film, &[])?;
    let beyond = trained.scores(&film, &[])?;
    out.rows.push(spread("learnt, frames learnt from", &own, |t| learnt.contains(&t)));
    out.rows.push(spread("learnt, other frames", &own, |t| !learnt.contains(&t)));
    out.rows.push(spread(&format!("not learnt: {other}"), &beyond, |_| true));
    out.rows.retain(|row| row[1] != Cell::from(0.0));
    Ok(out)
}

/// Mean, deviation and worst PSNR over the frames whose time satisfies `included`.
fn spread(name: &str, report: &EvalReport, included: impl Fn(f32) -> bool) -> Vec<Cell> {
    let mut frames: BTreeMap<u32, Vec<[Option<f64>; 2]>> = BTreeMap::new();
    for v in report.views.iter().filter(|v| included(v.time)) {
        // The bits of non-negative floats sort like their values.
        let scores = [v.psnr, v.masked.and_then(|m| m.psnr)];
        frames.entry(v.time.to_bits()).or_default().push(scores);
    }
    let of = |k: usize| -> Vec<f64> {
        frames.values().filter_map(|views| Mean::of(views.iter().filter_map(|s| s[k])).value).collect()
    };
    let figures = |values: &[f64]| {
        let mean = Mean::of(values.iter().copied()).value?;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        // NaN of one value, which a cell leaves out.
        Some([mean, (squares / (values.len() as f64 - 1.0)).sqrt()])
    };
    let (whole, masked) = (of(0), of(1));
    let mut row: Vec<Cell> = vec![name.into(), (frames.len() as f64).into()];
    for values in [&whole, &masked] {
        let figures = figures(values);
        row.extend((0..2).map(|k| Cell::from(figures.map(|f| f[k]))));
    }
    row.push(masked.into_iter().min_by(f64::total_cmp).into());
    row
}

/// Scores under the light of the film and under another light.
pub(super) fn other_light(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let lit = Setup {
        film: AvatarOptions { light: Some(setup.film.light.unwrap_or(FIRST_LIGHT)), ..setup.film.clone() },
        ..setup.clone()
    };
    let subject = Subject::new(&lit, log)?;
    let trained = trained(setup, &subject.full_film, log)?;
    let mut options = film_options(&lit, &subject.full_film)?;
    // Some frames are held out from fine-tuning under the other light.
    options.test_every = if options.test_every == 0 { 2 } else { options.test_every };
    log("filming under the other light");
    let film = generate(&AvatarOptions { light: Some(setup.other_light), ..options.clone() })?;
    let first = generate(&options)?;
    let [first, other] = [first, film].map(held_out);
    let remark = "Test cameras at frames that the steps under the other light do not see; these learn from the conditioning \
                  cameras alone.";
    let mut out = Findings::new("light", remark, &[&[("light", 0), ("steps under it", 0)][..], &SCORES].concat());
    let mut add = |light: &str, steps: u32, report: &EvalReport| {
        let mut row: Vec<Cell> = vec![light.into(), f64::from(steps).into()];
        row.extend(scores(Some(report)).map(Cell::from));
        out.rows.push(row);
    };
    add("learnt", 0, &trained.scores(&first, &[])?);
    add("other", 0, &trained.scores(&other, &[])?);
    if let (None, Some(recipe)) = (&setup.run, &setup.recipe) {
        for (name, settings) in LIGHT_SETTINGS {
            let varied = Trained::learn(&subject.full_film, recipe, settings, log)?;
            add(&format!("learnt, {name}"), 0, &varied.scores(&first, &[])?);
            add(&format!("other, {name}"), 0, &varied.scores(&other, &[])?);
        }
    }
    if setup.tuning > 0 {
        let tuned = trained.fine_tune(&only_inputs(&other), setup.tuning, setup.film.seed, log)?;
        add("other", setup.tuning, &tuned.scores(&other, &[])?);
    }
    Ok(out)
}

/// What prepares a method for another light: colours of textures and images scaled at random in every step, and networks that
/// see every frame in the mean light of the recording.
const LIGHT_SETTINGS: [(&str, &[&str]); 3] = [
    ("colours varied in training", &["jitter=0.3"]),
    ("colours of textures alone varied", &["jitter=0.3", "jitter_image=false"]),
    ("light followed", &["follow_light=true"]),
];

/// Drops test views at the times of training views.
fn held_out(mut film: Dataset) -> Dataset {
    let learnt: Vec<f32> = film.train.iter().map(|v| v.time.normalised).collect();
    film.test.retain(|v| !learnt.contains(&v.time.normalised));
    film
}

/// Keeps only the training views of the conditioning cameras.
fn only_inputs(film: &Dataset) -> Dataset {
    let is_input = |v: &View| {
        film.avatar
            .as_ref()
            .is_some_and(|a| a.frames.iter().any(|f| f.inputs.iter().any(|i| i.camera_id == v.camera_id)))
    };
    let train = film.views(Split::Train).iter().filter(|v| is_input(v)).cloned().collect();
    Dataset { train, ..film.clone() }
}

/// Ablations: name, settings at render time, settings in training.
const ABLATIONS: [(&str, &[&str], &[&str]); 7] = [
    ("nothing", &[], &[]),
    ("second unprojection", SINGLE_UNPROJECTION, SINGLE_UNPROJECTION),
    ("colours", &["rgb=false"], &["rgb=false"]),
    ("normals", &["normals=false"], &["normals=false"]),
    ("kappa", &["kappa=false"], &["kappa=false"]),
    ("orthonormal turns of joints", RAW_COVARIANCE, RAW_COVARIANCE),
    ("directions (SH)", &["gaussians.decode.sh_active=0"], &["gaussians.sh_degree=0", "gaussians.decode.sh_active=0"]),
];
/// One unprojection, on the template surface.
pub(super) const SINGLE_UNPROJECTION: &[&str] = &["input=\"single\"", "schedule.stages.geometry.steps=0"];

/// Joint matrices applied as published, without orthonormalisation.
const RAW_COVARIANCE: &[&str] = &["gaussians.decode.covariance=\"raw\""];

/// Ablates parts of a run at render time; without a run, in training.
pub(super) fn parts(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let subject = Subject::new(setup, log)?;
    let how = if setup.run.is_some() { "at render time, from a method trained with it" } else { "in training" };
    let heads = [&[("without", 0)][..], &SCORES, &[("dB", 2)]].concat();
    let remark = format!("Test views; the part is left out {how}. dB: in-mask PSNR against nothing left out.");
    let mut out = Findings::new("ablate", remark, &heads);
    let whole = Trained::of(setup, &subject.full_film, log)?;
    let mut base = None;
    for (name, at_render, in_training) in ABLATIONS {
        let retrained = Trained::varied(setup, &subject.full_film, in_training, log)?;
        let report = match (&retrained, &whole) {
            (Some(trained), _) => trained.scores(&subject.film, &[])?,
            (None, Some(trained)) => trained.scores(&subject.film, at_render)?,
            (None, None) => return Err(LabError::NeedsTraining("ablate")),
        };
        let scores = scores(Some(&report));
        base = base.or(scores[1]);
        let mut row: Vec<Cell> = vec![name.into()];
        row.extend(scores.map(Cell::from));
        row.push(scores[1].zip(base).map(|(p, b)| p - b).into());
        out.rows.push(row);
    }
    Ok(out)
}

fn trained(setup: &Setup, film: &Dataset, log: &mut Log<'_>) -> Result<Trained, LabError> {
    Trained::of(setup, film, log)?.ok_or(LabError::NeedsTraining("asked for"))
}

/// Options the film was generated with: of the setup, or as recorded in the data of the run.
fn film_options(setup: &Setup, film: &Dataset) -> Result<AvatarOptions, LabError> {
    if setup.run.is_none() {
        return Ok(setup.film.clone());
    }
    options_of(&film.root)?.ok_or_else(|| {
        let what = "the run's film was not generated, so no other can be made like it; choose a run on a film of gs4d synth avatar";
        LabError::Unfit(what.into())
    })
}

/// Name of the motion clip to test on.
fn other_clip(setup: &Setup, subject: &Subject, options: &AvatarOptions) -> Result<String, LabError> {
    let clips = &subject.scene.character.clips;
    let own = options.clip.as_deref().or(clips.first().map(|c| c.name.as_str()));
    let known = || clips.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
    let asked = setup.other_clip.as_deref();
    let found = clips.iter().find(|c| asked.map_or(Some(c.name.as_str()) != own, |name| name == c.name));
    found.map(|c| c.name.clone()).ok_or_else(|| LabError::Unknown {
        what: "the motion",
        asked: asked.unwrap_or("another than the film's").to_owned(),
        known: known(),
    })
}
