//! `gs4d train`: trains a scene on a dataset, into a run folder.

use super::view::{Watch, Watched};
use crate::answer::{Answer, number};
use crate::device::DeviceFlag;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::say_skipped;
use crate::progress::{Progress, Waiting};
use crate::{interrupt, parse};
use gs_data::Dataset;
use gs_train::checkpoint;
use gs_train::evaluate::EvalReport;
use gs4d_run::config::Source;
use gs4d_run::folder::REPORT;
use gs4d_run::opened::metrics_json;
use gs4d_run::settings::{Request, resolve};
use gs4d_run::summary::color_name;
use gs4d_run::training::is_numeric;
use gs4d_run::{Outcome, RunError, RunFolder, Scored, Stage, Training};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Learn a scene from a data set
#[derive(clap::Args)]
pub struct Train {
    /// Folder of the data.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// Name of the method; gs4d methods lists them.
    #[arg(short, long)]
    method: String,
    /// Preset: fast (minutes), paper (as published), tiny (seconds; of dut minutes), or another of the method; gs4d methods lists them.
    #[arg(long, default_value = "fast")]
    preset: String,
    /// A TOML file of settings, laid over the preset.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One setting, over presets and files, for example schedule.density.until=5000 (repeatable); gs4d config METHOD lists them.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Compress or stretch the schedule to so many steps.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// Stop with a checkpoint after so much training, for example 90s, 10m, 1.5h, wherever the schedule is then (the flag of gs4d compare
    /// stretches schedules to fill the time).
    #[arg(long, value_name = "TIME", value_parser = parse::duration)]
    time_budget: Option<Duration>,
    /// Seed of every random number [default: 0].
    #[arg(long)]
    seed: Option<u64>,
    #[command(flatten)]
    images: ImageCacheSize,
    /// Folder of the run; made if missing.
    #[arg(short, long, value_name = "RUN")]
    out: PathBuf,
    /// Overwrite an older run in that folder.
    #[arg(short, long)]
    force: bool,
    /// Go on with a run of the same settings in that folder, begin it if there is none, do nothing if it is finished: the
    /// same command line can be repeated until it exits with 0.
    #[arg(long = "continue", conflicts_with = "force")]
    go_on: bool,
    #[command(flatten)]
    device: DeviceFlag,
    #[command(flatten)]
    watch: Watch,
}

/// How much of the data set is kept in memory.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct ImageCacheSize {
    /// Decoded images kept in memory, MiB (4 bytes a pixel); the others are decoded again whenever they are drawn. Results are
    /// the same for any number [default: 512].
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u32).range(0..=1_048_576))]
    pub image_cache: Option<u32>,
}

impl Train {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let request = Request {
            method: self.method,
            preset: self.preset,
            data: Some(self.data),
            file: self.config,
            steps: self.steps,
            time_budget: self.time_budget.map(|d| d.as_secs_f64()),
            seed: self.seed,
            sets: self.sets,
        };
        let mut resolved = resolve(gs_methods::registry(), &request)?;
        if let Some(mib) = self.images.image_cache {
            resolved = resolved.with_image_cache(mib)?;
        }
        // Without its report it was killed after its scores: they are made again.
        if self.go_on
            && self.out.join(REPORT).exists()
            && let Stage::Finished(scored) = Stage::of(&self.out, &resolved)?
        {
            // Scores stand without checkpoints, but then nothing can be looked at or gone on with.
            checkpoint::load_newest(&RunFolder::open(&self.out)?.checkpoints())?;
            let (Scored { scores, step }, out) = (*scored, self.out.display());
            let finished = u64::from(step) >= resolved.steps();
            global.say(match finished {
                true => format!("nothing is left to train in {out}"),
                false => format!(
                    "the time budget of {out} was spent at step {step} of {}; go on: {}",
                    resolved.steps(),
                    resume_command(&self.out)
                ),
            });
            return Ok(Answer::new(all_scores_text(&scores, step), result_json(&scores, step, &self.out, finished)));
        }
        let (stop, device) = (interrupt::flag()?, self.device.open_to_train(global)?);
        let ranks = global.ranks.clone();
        let training = match self.go_on {
            true => Training::go_on(&self.out, resolved)?.with_ranks(ranks)?,
            false => Training::begin_with_ranks(&self.out, self.force, resolved, ranks)?,
        };
        let mut training = training.on(&device)?;
        carry_on(&mut training, &self.watch, &stop, global)
    }
}

/// Trains to the end of the schedule, scores and writes the report; the error of an interruption says how to resume.
pub fn carry_on(training: &mut Training, watch: &Watch, stop: &AtomicBool, global: &Global) -> Result<Answer, Failure> {
    let mut watched = watch.start(training, global);
    let outcome = drive(training, stop, global, watched.as_mut())?;
    let root = training.folder().root().to_owned();
    if let Outcome::Interrupted(saved) = outcome {
        let what = format!("interrupted at step {}; saved {}", training.trainer().steps_done(), saved.display());
        return Err(Failure::new(Class::Interrupted, "interrupted", what).remedy(resume_command(&root)));
    }
    let data = training.trainer().dataset();
    let views = data.test.len() + data.extrapolate.len();
    let waiting = Waiting::new(format!("scoring {views} views"), global.quiet);
    let scores = training.score().map_err(|e| unscored(training, e))?;
    drop(waiting);
    training.report(&scores).map_err(|e| unscored(training, e))?;
    let step = training.trainer().steps_done();
    let json = result_json(&scores, step, &root, outcome == Outcome::Finished);
    let mut text = all_scores_text(&scores, step);
    text.push_str(&format!("report  {}\n", root.join("report.html").display()));
    text.push_str(&format!("look at it: {}\n", command_of("view", &root)));
    if let Outcome::BudgetSpent(_) = outcome {
        text.push_str(&format!("the time budget is spent; go on: {}\n", resume_command(&root)));
    }
    Ok(Answer::new(text, json))
}

/// The failure of scores or report of a run that is trained and saved: how to go on.
fn unscored(training: &Training, e: RunError) -> Failure {
    let failure = Failure::from(e);
    // Data that are repaired are not those that the run began with.
    let accept = if failure.class == Class::Data { " --accept-changed-data" } else { "" };
    let (step, resume) = (training.trainer().steps_done(), resume_command(training.folder().root()));
    failure.then(format!("the run is saved at step {step}: {resume}{accept} makes its scores and its report"))
}

/// The scores of a run with its folder, and whether its schedule is done.
fn result_json(scores: &EvalReport, step: u32, root: &Path, finished: bool) -> Value {
    let mut json = metrics_json(scores, step);
    json["run"] = json!(root.display().to_string());
    json["finished"] = json!(finished);
    json
}

/// Trains with a progress line, and feeds the viewer if there is one.
pub fn drive(
    training: &mut Training,
    stop: &AtomicBool,
    global: &Global,
    mut watched: Option<&mut Watched>,
) -> Result<Outcome, Failure> {
    describe(training, global);
    let mut progress = Progress::new(u64::from(training.trainer().steps()), "steps", global.quiet);
    let outcome = training.train(stop, &mut |p, trainer| {
        if let Some(watched) = &mut watched {
            watched.feed.offer(p, trainer);
            watched.feed.wait_while_paused(stop);
        }
        progress.at(u64::from(p.step), || {
            let quarantined =
                if p.quarantined > 0 { format!("  quarantined {}", p.quarantined) } else { String::new() };
            let left = p.seconds / f64::from(p.step.max(1)) * f64::from(p.steps - p.step);
            format!("loss {:.4}  {:.2} dB  {} splats{quarantined}  eta {}", p.loss, p.psnr, p.splats, time_text(left))
        });
    });
    progress.finish();
    outcome.map_err(|e| {
        let numeric = is_numeric(&e);
        let failure = Failure::from(e);
        let run = training.folder().root().display();
        let saved = checkpoint::steps_in(&training.folder().checkpoints()).ok().and_then(|steps| steps.first().copied());
        match saved {
            _ if !numeric => failure,
            Some(step) => failure.remedy(format!(
                "the checkpoint of step {step} is good: gs4d inspect {run}; lower the learning rates"
            )),
            None => failure.remedy(
                "no checkpoint was saved before it: lower the learning rates, or save earlier with --set run.checkpoint_every=N",
            ),
        }
    })
}

fn describe(training: &Training, global: &Global) {
    let data = training.trainer().dataset();
    say_skipped(training.folder().root(), training.skipped(), global);
    training.warnings().iter().for_each(|w| global.say(format!("warning: {w}")));
    let run = &training.resolved().run;
    global.say(format!(
        "{} with preset {} on {} ({}): {} training, {} test views; {} steps",
        run.method,
        run.preset,
        data.root.display(),
        data.layout,
        data.train.len(),
        data.test.len(),
        training.trainer().steps()
    ));
    global.say(format!("times: {}", times_text(data)));
    for note in &data.notes {
        global.say(format!("note: {note}"));
    }
    points_left_out(training).into_iter().for_each(|note| global.say(note));
    for warning in training.trainer().model().capabilities().inspect.map_or_else(Vec::new, |i| i.warnings()) {
        global.say(format!("warning: {warning}"));
    }
    let device = training.trainer().device();
    if !device.is_cpu() {
        let whole = training.trainer().device_lacks();
        global.say(match whole {
            None => format!("training on {}", device.name()),
            Some(why) => format!("rendering on {}; the rest of a step runs on the CPU: {why}", device.name()),
        });
    }
    global.detail(format!("threads: {}", rayon::current_num_threads()));
    if global.ranks.size() > 1 {
        global.say(format!("{} ranks", global.ranks.size()));
    }
}

/// Says how many of the points that `gs4d init` wrote do not fit.
fn points_left_out(training: &Training) -> Option<String> {
    let config = &training.resolved().config;
    let (used, source) = config.get("init.points").map(|s| (s.value.as_integer(), &s.source))?;
    let used = used.and_then(|n| usize::try_from(n).ok()).filter(|_| matches!(source, Source::File(_)))?;
    let have = training.trainer().dataset().points.as_ref()?.positions.len();
    let text =
        format!("note: training begins with {used} of the {have} points: schedule.density.max_splats allows no more");
    (used < have && config.get("schedule.density.max_splats")?.value.as_integer() == i64::try_from(used).ok())
        .then_some(text)
}

/// Where the times of a data set come from, and how many of them train.
pub fn times_text(data: &Dataset) -> String {
    let mut times: Vec<f64> = data.train.iter().map(|v| v.time.seconds).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    match times.as_slice() {
        [first, .., last] => format!("{} training times from {first} to {last}: {}", times.len(), data.time_source),
        _ => data.time_source.clone(),
    }
}

/// The command that goes on with a run.
pub fn resume_command(root: &Path) -> String {
    command_of("resume", root)
}

/// The command of a verb for a run.
fn command_of(verb: &str, root: &Path) -> String {
    format!("gs4d {verb} {}", gs4d_run::shell_quoted(root.display().to_string()))
}

/// The scores of a split, then those beyond the last training time where there are any.
pub fn all_scores_text(s: &EvalReport, step: u32) -> String {
    let future = s.extrapolate.as_ref().map_or(String::new(), |f| scores_text(f, step));
    scores_text(s, step) + &future
}

/// The scores of a split in three lines, and one more each where colours were fitted and where views have masks.
pub fn scores_text(s: &EvalReport, step: u32) -> String {
    let masked = s.mean.masked.map_or(String::new(), |m| {
        let [psnr, ssim, seen] = [number(m.psnr, 2), number(m.ssim, 4), number(m.ssim_seen, 4)];
        let (percent, proxy) = (100.0 * m.part, m.perceptual_proxy);
        format!("where masks count ({percent:.1} % of the pixels)   psnr {psnr}   ssim {ssim} ({seen} where seen)   perceptual-proxy {proxy:.4}\n")
    });
    let fitted = s.mean.fitted.map_or(String::new(), |f| {
        format!("{}   psnr {}   ssim {}\n", f.colors(), number(f.psnr, 2), number(f.ssim, 4))
    });
    let weights = s.lpips_weights.as_deref().unwrap_or_default();
    let lpips = s.mean.lpips.map_or(String::new(), |v| format!("lpips {v:.4} ({weights})   "));
    let seconds = s.train_seconds.map_or(String::new(), |t| format!(" · {} of training", time_text(t)));
    format!(
        "{} · {} views · background {} · step {step} · {} splats{seconds}\n\
         psnr {} (mean of views; {} from mean error)   ssim {}   ms-ssim {}   perceptual-proxy {}\n\
         {lpips}sharpness against the ground truth   laplacian {}   high band {}\n{fitted}{masked}",
        s.split,
        s.views.len(),
        color_name(s.background),
        s.gaussians,
        number(s.mean.psnr, 2),
        number(s.psnr_of_mean_mse, 2),
        number(s.mean.ssim, 4),
        s.mean.ms_ssim.map_or("- (the images are too small)".to_owned(), |v| format!("{v:.4}")),
        number(s.mean.perceptual_proxy, 4),
        number(s.mean.laplacian_ratio, 3),
        number(s.mean.high_band_ratio, 3)
    )
}

/// A duration as text, for example `90 s`.
pub fn time_text(seconds: f64) -> String {
    match seconds {
        s if s < 10.0 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} m", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
