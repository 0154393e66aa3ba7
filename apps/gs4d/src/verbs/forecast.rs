//! `gs4d forecast`: frames after the last training time, scores where ground truth exists, statistics of the learnt motion.

use crate::answer::{Answer, number};
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::{RunData, note_extrapolated};
use crate::output::{check_free, create_folder};
use crate::parse;
use crate::progress::Progress;
use gs_core::Camera;
use gs_core::io::images::save_png;
use gs_core::io::{Limits, cameras::load_cameras, write_file};
use gs_data::{Dataset, View};
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs4d_eval::forecast::page::page;
use gs4d_eval::forecast::physics::{MOST_GROWTH, Steps};
use gs4d_eval::forecast::{
    CameraPath, Clock, MAX_FRAMES, Physics, Spacing, TimedBody, TimestampScores, Truth, draw, times,
};
use gs4d_eval::particles::Particles;
use gs4d_eval::track::{Track, TrackError, TrackReport, follow};
use gs4d_report::{IMAGE_SIDE, Still, within};
use gs4d_run::OpenRun;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Files beside the frames.
const FILE: &str = "forecast.json";
const PAGE: &str = "forecast.html";
/// Frames shown on the page.
const PAGE_FRAMES: usize = 8;

/// Render what comes after the last training time
///
/// Times are normalised: with data.time_boundary the whole sequence is 0 to 1, without it training ends at 1. Where the
/// data hold views of the future, they are scored up to the last time asked for.
#[derive(clap::Args)]
pub struct ForecastVerb {
    /// Folder of the run, or a .gs4d file.
    #[arg(value_name = "RUN|FILE")]
    run: PathBuf,
    /// Last time, for example 1.5: half a sequence beyond its end.
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = parse::finite)]
    until: f32,
    /// Frames come after this time [default: the last training time].
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = parse::finite)]
    from: Option<f32>,
    /// Frames per unit of the data's clock [default: as far apart as training frames].
    #[arg(long, value_name = "N", value_parser = parse::not_negative, conflicts_with = "frames")]
    fps: Option<f64>,
    /// So many frames.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_FRAMES as i64))]
    frames: Option<u32>,
    /// Where the camera is: view:NAME (a view of the data), orbit (one turn around the scene), or a file of cameras as for
    /// render, spread evenly over the frames [default: the first view of the future, else of the test views].
    #[arg(long, value_name = "FILE|view:NAME|orbit")]
    camera: Option<String>,
    /// Measured places of a body, lines frame,x,y,z from the first time of the data on: how far the forecast is off.
    #[arg(long, value_name = "FILE")]
    track: Option<PathBuf>,
    /// Splats this near the track at the last training time are the body, world units.
    #[arg(long, value_name = "R", default_value_t = 0.15, requires = "track", value_parser = parse::not_negative)]
    track_radius: f64,
    /// Do not score the views of the future.
    #[arg(long)]
    no_scores: bool,
    /// Folder for the frames, forecast.json and forecast.html; made if missing.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing files.
    #[arg(short, long)]
    force: bool,
    #[command(flatten)]
    place: RunData,
}

impl ForecastVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let run = self.place.open(&self.run, global)?;
        let dataset = run.open_data()?;
        let clock = Clock::of(&dataset);
        let path = self.path(&run, &dataset)?;
        let (last, interval) = (f64::from(run.loaded.scene.last_time), f64::from(run.loaded.scene.frame_interval));
        let from = self.from.map_or(last, f64::from);
        let times = times(from, f64::from(self.until), self.spacing(clock, interval))?;
        if run.loaded.model.capabilities().particles.is_none() {
            note_extrapolated(times.iter().map(|t| gs_core::cast::to_f32(*t)), &run, global);
        }
        let files: Vec<PathBuf> = times.iter().enumerate().map(|(k, t)| self.out.join(file_name(k, *t))).collect();
        let beside = [FILE, PAGE].map(|name| self.out.join(name));
        check_free(self.force, "frame", "folder", &files)?;
        check_free(self.force, "file", "folder", &beside)?;
        // A track that cannot be followed is told before anything is scored.
        let followed = self.follow(&run.loaded.model, &path.at(0, 1), &dataset, run.loaded.scene.last_time)?;
        create_folder(&self.out)?;
        let (truth, background) = (self.truth(&run, &dataset)?, run.background());
        let method = &run.loaded.model;
        let mut renderer = Renderer::new(method.raster_options(background));
        let mut progress = Progress::new(times.len() as u64, "frames", global.quiet);
        let (mut frames, mut strip) = (Vec::with_capacity(times.len()), Vec::new());
        for (k, (&t, file)) in times.iter().zip(&files).enumerate() {
            let (camera, time) = (path.at(k, times.len()), Clock::time(clock, t));
            let frame = draw(method, &mut renderer, &camera, time)?;
            save_png(file, &frame.image, self.force)?;
            let scores = truth.as_ref().and_then(|truth| truth.frame(&camera, t, interval.max(1e-6)));
            frames.push(FrameInfo {
                file,
                time: t,
                seconds: time.seconds,
                ms: [frame.motion_ms, frame.render_ms],
                scores,
            });
            if strip.len() * times.len() <= k * PAGE_FRAMES {
                strip.push(Still { caption: format!("t = {t:.3}"), image: within(frame.image, IMAGE_SIDE) });
            }
            progress.at(k as u64 + 1, || format!("t = {t:.3}"));
        }
        progress.finish();
        let found = method.capabilities().particles.map_or_else(Vec::new, |p| p.bodies(&times));
        let bodies: Vec<TimedBody> = found.into_iter().map(|body| TimedBody::of(body, clock)).collect();
        let particles = Particles::of(method);
        let config = run.resolved.registry.find(method.name())?.effective(&run.loaded.config)?;
        let steps = Steps::of(&config, run.loaded.scene.frame_interval);
        let physics = particles.map(|p| Physics::of(&p, clock, steps));
        let moments = truth.as_ref().map(|t| t.moments(last));
        let report = Report {
            from,
            last,
            clock,
            frames: &frames,
            truth: truth.as_ref(),
            moments: moments.as_deref(),
            physics,
            bodies: &bodies,
            followed,
        };
        let json = report.json(&self.run);
        write_file(&beside[0], self.force, |out| writeln!(out, "{json:#}"))?;
        let html = page(
            &title(&self.run),
            [from, last],
            report.moments.unwrap_or_default(),
            &strip,
            report.physics.as_ref(),
            &bodies,
        );
        let html = html.map_err(gs4d_run::RunError::from)?;
        write_file(&beside[1], self.force, |out| out.write_all(html.as_bytes()))?;
        Ok(Answer::new(report.text(&self.out), json))
    }

    fn path(&self, run: &OpenRun, dataset: &Dataset) -> Result<CameraPath, Failure> {
        let (images, placed) = (run.images(), run.placed());
        let placed = |view: &View| placed.held_out(view);
        Ok(match self.camera.as_deref() {
            None => CameraPath::of_view(dataset, None, &images, &placed)?,
            Some("orbit") => CameraPath::orbit(dataset, &images, &placed)?,
            Some(text) => match text.strip_prefix("view:") {
                Some(name) => CameraPath::of_view(dataset, Some(name), &images, &placed)?,
                None => {
                    let cameras = load_cameras(Path::new(text), &Limits::default())?;
                    if cameras.is_empty() {
                        return Err(Failure::new(Class::Data, "data.cameras", "the file lists no camera").place(text));
                    }
                    CameraPath::List(cameras.into_iter().map(|c| c.camera).collect())
                }
            },
        })
    }

    fn spacing(&self, clock: Option<Clock>, interval: f64) -> Spacing {
        match (self.frames, self.fps) {
            (Some(n), _) => Spacing::Count(n as usize),
            (None, Some(fps)) => Spacing::Interval(1.0 / (fps * clock.map_or(1.0, |c| c.rate))),
            (None, None) if interval > 0.0 => Spacing::Interval(interval),
            (None, None) => Spacing::Count(1),
        }
    }

    fn follow(
        &self,
        method: &Model,
        camera: &Camera,
        dataset: &Dataset,
        last: f32,
    ) -> Result<Option<TrackReport>, Failure> {
        let wrong = |e: TrackError| Failure::new(Class::Data, "data.track", e.to_string());
        let Some(file) = &self.track else { return Ok(None) };
        let track = Track::read(file, dataset).map_err(wrong)?;
        follow(method, camera, &track, last, self.track_radius).map(Some).map_err(wrong)
    }

    fn truth(&self, run: &OpenRun, dataset: &Dataset) -> Result<Option<Truth>, Failure> {
        if self.no_scores {
            return Ok(None);
        }
        let (method, until, placed) = (&run.loaded.model, f64::from(self.until), run.placed());
        Ok(Truth::of(method, dataset, until, run.background(), &run.images(), &|view| placed.held_out(view))?)
    }
}

fn title(run: &Path) -> String {
    let name = run.file_name().map_or_else(|| run.display().to_string(), |n| n.to_string_lossy().into_owned());
    format!("Forecast of {name}")
}

/// File name of the `k`-th frame; names sort by time.
fn file_name(k: usize, t: f64) -> String {
    format!("frame-{:04}_t{t:.4}.png", k + 1)
}

/// A rendered frame.
struct FrameInfo<'a> {
    file: &'a Path,
    time: f64,
    seconds: f64,
    /// Milliseconds of motion and of rendering.
    ms: [f64; 2],
    scores: Option<&'a gs_train::evaluate::ViewScores>,
}

/// Everything the forecast reports.
struct Report<'a> {
    from: f64,
    last: f64,
    clock: Option<Clock>,
    frames: &'a [FrameInfo<'a>],
    truth: Option<&'a Truth>,
    moments: Option<&'a [TimestampScores]>,
    physics: Option<Physics>,
    bodies: &'a [TimedBody],
    followed: Option<TrackReport>,
}

impl Report<'_> {
    /// Median milliseconds of motion and of rendering. The first frame is left out if there are others: it also fills the
    /// extrapolation cache.
    fn medians(&self) -> [f64; 2] {
        [0, 1].map(|i| {
            let mut all: Vec<f64> =
                self.frames.iter().skip(usize::from(self.frames.len() > 1)).map(|f| f.ms[i]).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or(0.0)
        })
    }

    fn json(&self, run: &Path) -> Value {
        let frame = |f: &FrameInfo| {
            let name = f.file.file_name().map(|n| n.to_string_lossy().into_owned());
            json!({
                "file": name, "time": f.time, "beyond": f.time - self.last, "seconds": f.seconds,
                "motion_ms": f.ms[0], "render_ms": f.ms[1],
                "view": f.scores.map(|s| &s.name), "psnr": f.scores.and_then(|s| s.psnr), "ssim": f.scores.map(|s| s.ssim),
            })
        };
        let [motion, render] = self.medians();
        json!({
            "run": run.display().to_string(),
            "from": self.from,
            "last_training_time": self.last,
            "clock": self.clock,
            "frames": self.frames.iter().map(frame).collect::<Vec<_>>(),
            "ms": {"motion": motion, "render": render, "first_motion": self.frames.first().map(|f| f.ms[0])},
            "truth": self.truth.map(|t| json!({
                "views": t.report.views.len(), "mean": t.report.mean, "moments": self.moments, "protocol": t.report.protocol,
            })),
            "physics": self.physics,
            "bodies": self.bodies,
            "track": self.followed,
        })
    }

    fn text(&self, out: &Path) -> String {
        let ([motion, render], n) = (self.medians(), self.frames.len());
        let first = self.frames.first().map_or(0.0, |f| f.ms[0]);
        let mut text = format!(
            "{n} frames after {:.4}{} -> {}\nper frame: motion {motion:.2} ms, render {render:.2} ms (medians; motion of the first \
             {first:.2} ms)\n",
            self.from,
            if self.from == self.last { String::new() } else { format!(" (training ends at {:.4})", self.last) },
            out.display()
        );
        if let (Some(truth), Some(moments)) = (self.truth, self.moments) {
            text.push_str(&scores_table(truth, moments));
        }
        if let Some(followed) = &self.followed {
            text.push_str(&followed.text());
        }
        if let Some(physics) = &self.physics {
            text.push_str(&physics_table(physics));
        }
        text.push_str(&bodies_table(self.bodies));
        text
    }
}

fn scores_table(truth: &Truth, moments: &[TimestampScores]) -> String {
    let masked = moments.iter().any(|m| m.masked_psnr.is_some());
    let mut text = format!("{:>8}  {:>8}  {:>6}  {:>7}  {:>7}", "time", "beyond", "views", "PSNR", "SSIM");
    text.push_str(if masked { "   m-PSNR\n" } else { "\n" });
    for m in moments {
        let (psnr, ssim) = (number(m.psnr, 2), m.ssim);
        text.push_str(&format!("{:>8.4}  {:>8.4}  {:>6}  {psnr:>7}  {ssim:>7.4}", m.time, m.beyond, m.views));
        text.push_str(&if masked { format!("  {:>7}\n", number(m.masked_psnr, 2)) } else { "\n".to_owned() });
    }
    let mean = &truth.report.mean;
    text.push_str(&format!("mean of {} views: {} dB\n", truth.report.views.len(), number(mean.psnr, 2)));
    text
}

/// Rigid bodies with the standard deviation of their place in the first and the last frame.
fn bodies_table(bodies: &[TimedBody]) -> String {
    let mut text = String::new();
    for (k, TimedBody { body: b, .. }) in bodies.iter().enumerate() {
        let ends = [b.deviations.first(), b.deviations.last()].map(|d| d.copied().unwrap_or_default());
        text.push_str(&format!(
            "body {}: {} splats, path {} through {} frames, off by {:.4} in the first frame, {:.4} in the last (1 sigma)\n",
            k + 1,
            b.splats,
            b.path,
            b.frames,
            ends[0],
            ends[1]
        ));
    }
    text
}

fn physics_table(p: &Physics) -> String {
    let mut text = format!("learnt motion of {} splats at t = {:.4}\n", p.splats, p.at);
    text.push_str(&format!("{:16}  {:>10}  {:>10}  {:>10}  {:>10}\n", "", "median", "90 %", "99 %", "largest"));
    for s in &p.spreads {
        text.push_str(&format!("{:16}", s.name));
        [s.median, s.p90, s.p99, s.max].iter().for_each(|v| text.push_str(&format!("  {v:>10.4}")));
        text.push_str(&format!("  {}\n", s.unit));
    }
    if let Some(fast) = &p.fast {
        text.push_str(&format!(
            "warning: {} splats turn too fast for steps of {:.4} (at most {:.2} rad in one): each changes their distance from \
             the axis by more than {} % (at most {:+.2} %); use {}\n",
            fast.splats,
            fast.step,
            fast.turn,
            100.0 * MOST_GROWTH,
            100.0 * fast.growth,
            fast.remedy
        ));
    }
    text
}
