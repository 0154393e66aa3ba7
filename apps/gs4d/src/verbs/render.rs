//! `gs4d render`: renders a splat file or a run from given cameras or on an orbit, as images or video.

mod mode;
mod scene;

use crate::answer::Answer;
use crate::device::DeviceFlag;
use crate::encoder::Encoder;
use crate::failure::Failure;
use crate::global::Global;
use crate::opening::{RunData, note_extrapolated};
use crate::output::{check_free, create_folder};
use crate::parse;
use crate::progress::Progress;
use gs_core::io::cameras::{NamedCamera, load_cameras};
use gs_core::io::images::save_png;
use gs_core::io::{Limits, exr, npy, write_file, y4m};
use gs_core::{Camera, Image, cast};
use gs_data::View;
use gs_raster::RasterOptions;
use gs_train::capabilities::{FreezeOptions, FreezeReport};
use gs_train::ranks::Share;
use gs_train::renderer::{Renderer, file_stem};
use gs4d_run::flight::Flight;
use mode::{Kind, Mode};
use scene::Scene;
pub use scene::load_splat_file;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Render a splat file or a run from given cameras or around it, as PNG, EXR, NPY or video (MP4 where ffmpeg is)
#[derive(clap::Args)]
pub struct Render {
    /// A .ply, .splat, .spz, .glb or .sog file, a run folder, or a .gs4d file (a checkpoint of a run, or what gs4d export made).
    #[arg(value_name = "SCENE|RUN")]
    scene: PathBuf,
    /// Cameras: INRIA cameras.json, a transforms file, or {width,height,fx,fy,cx,cy,world_to_camera} (name, time optional), one or a list;
    /// or `dataset:N`, the N-th test view of a run's data, or training view where there are none; `orbit`, once around the scene; `path`, smoothly through a few training
    /// cameras of a run's data; `path:FILE`, through those of a file. Without --time or --times, orbit and path are 60 images over the training span, `path:FILE` over the times
    /// of its cameras where all have one. A time in a file is normalised, whatever clock the data have.
    #[arg(long, value_name = "FILE|dataset:N|orbit|path|path:FILE", default_value = "orbit")]
    camera: PathBuf,
    /// Normalised time of all images: 0 is the first training image, 1 the last, or the end of the sequence where data.time_boundary keeps that out of training
    /// [default: the camera's own, else 0].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::finite, conflicts_with = "times")]
    time: Option<f32>,
    /// Times of a sequence, A..B:N: one camera at all of them, or a camera each.
    #[arg(long, value_name = "A..B:N", allow_hyphen_values = true, value_parser = parse::times)]
    times: Option<parse::Times>,
    /// Size of the images, pixels; cameras keep their vertical field of view [default: the cameras' own].
    #[arg(long, value_name = "WxH", value_parser = parse::size)]
    size: Option<[u32; 2]>,
    /// Horizontal field of view, degrees [default: the cameras' own].
    #[arg(long, value_name = "DEGREES", value_parser = parse::field_of_view)]
    fov: Option<f64>,
    /// Splats nearer than this are not rendered, world units [default: 0.01 for files, the run's for runs].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::not_negative)]
    near: Option<f64>,
    /// Colour behind the scene: black, white, one grey or r,g,b in 0..1 [default: black, or the run's].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::color)]
    background: Option<[f32; 3]>,
    /// Compensate opacities for the dilation of small splats (Mip-Splatting).
    #[arg(long)]
    antialias: bool,
    /// Leave splats of a run at rest that move less than this on the rendered cameras over times 0 to 1, pixels; faster, not exact.
    #[arg(long, value_name = "PIXELS", allow_hyphen_values = true, value_parser = parse::not_negative)]
    static_within: Option<f64>,
    /// What is rendered: color; depth, the mean of what covers a pixel by more than half, world units, 0 elsewhere; alpha; count, of the splats
    /// that are blended; or a layer of the run's method, as the viewer shows it: segment (rigid parts), motion, velocity, gate, ... A wrong name is
    /// answered with those there are. PNG and videos show depth, counts and scalars from dark (near, least) to bright, each image over its own
    /// span unless the scalar has one.
    #[arg(long, value_name = "LAYER", default_value = "color")]
    mode: String,
    /// PNG: 8 bit RGB over the background. EXR, NPY: float32 RGB over the background, then alpha (premultiplied over black).
    /// Depth, alpha and counts are one channel of float32 there; layers are colours.
    /// Y4M: one uncompressed video, video.y4m. MP4: video.mp4 (H.264), by ffmpeg, which must be installed.
    #[arg(long, value_enum, default_value_t = Format::Png)]
    format: Format,
    /// Frames per second of a video, for example 25 or 29.97.
    #[arg(long, default_value_t = 30.0, value_parser = parse::frame_rate)]
    fps: f64,
    /// Folder for the images; made if missing.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing images.
    #[arg(short, long)]
    force: bool,
    #[command(flatten)]
    device: DeviceFlag,
    #[command(flatten)]
    place: RunData,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Png,
    Exr,
    Npy,
    Y4m,
    Mp4,
}

/// What `--camera` takes.
const CAMERAS: &str = "give a file of cameras, dataset:N, orbit, path or path:FILE";

/// Images of an orbit or path without `--times`.
const DEFAULT_FRAMES: usize = 60;

/// Times of keys that are evenly spaced over a path; `None` unless all have one.
fn key_times(keys: &[NamedCamera]) -> Option<Vec<f32>> {
    keys.iter().map(|k| k.time).collect()
}

/// Linear between evenly spaced values at a share of 0..1; there are two or more.
fn between(values: &[f32], share: f32) -> f32 {
    let way = share * (values.len() - 1) as f32;
    let k = cast::to_usize(f64::from(way)).min(values.len() - 2);
    let w = way - k as f32;
    (1.0 - w) * values[k] + w * values[k + 1]
}

impl Render {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        self.check_folder()?;
        if self.format == Format::Mp4 {
            Encoder::find()?;
        }
        let device = self.device.open(global)?;
        let mut scene = self.open(global)?;
        let cameras = self.cameras(&scene, global)?;
        let cameras = self.sequence(cameras)?.into_iter().map(|c| self.framed(c)).collect::<Vec<_>>();
        if let Scene::Run(run) = &scene {
            note_extrapolated(cameras.iter().map(|c| self.time_of(c.time)), run, global);
        }
        if let Some(pixels) = self.static_within {
            global.say(self.leave_at_rest(&mut scene, &cameras, pixels)?);
        }
        let memory = global.memory();
        cameras
            .iter()
            .try_for_each(|c| memory.admit_picture([c.camera.width, c.camera.height], scene.splat_count()))?;
        let mut renderer = Renderer::on(&device, self.options(&scene)?)?;
        let (mode, layer) = self.mode(&scene, self.time_of(cameras.first().and_then(|c| c.time)), global)?;
        let share = &global.share;
        let mut progress = Progress::new(share.run(cameras.len()).len() as u64, "images", global.quiet);
        let mut done = 0;
        let mut render = |k: usize| {
            let NamedCamera { name, camera, time } = &cameras[k];
            let image = mode.image(&scene, &mut renderer, (camera, self.time_of(*time)), self.format.kind())?;
            done += 1;
            progress.at(done, || name.clone());
            Ok(image)
        };
        let paths = if matches!(self.format, Format::Y4m | Format::Mp4) {
            vec![self.video(&cameras, share, &mut render)?]
        } else {
            let paths = self.paths(&cameras)?;
            // Every rank finds its outputs free before one writes.
            share.barrier()?;
            create_folder(&self.out)?;
            share.each(cameras.len(), |k| self.save(&render(k)?, &paths[k]))?;
            paths
        };
        progress.finish();
        let files: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        let text = match files.as_slice() {
            [one] => format!("{one}\n"),
            many => format!("{} images -> {}\n", many.len(), self.out.display()),
        };
        Ok(Answer::new(text, json!({"files": files, "background": renderer.options.background, "layer": layer})))
    }

    /// What is drawn, and what the colours of a layer say, as JSON; `time` is that of the first image.
    fn mode<'a>(&self, scene: &'a Scene, time: f32, global: &Global) -> Result<(Mode<'a>, Option<Value>), Failure> {
        let mode = Mode::of(&self.mode, scene, time)?;
        let Some((text, json)) = mode.legend(time)? else { return Ok((mode, None)) };
        global.say(text);
        Ok((mode, Some(json)))
    }

    /// A camera with the size and field of view that were asked for; the principal point keeps its place in the image.
    fn framed(&self, named: NamedCamera) -> NamedCamera {
        let c = &named.camera;
        let [width, height] = self.size.unwrap_or([c.width, c.height]);
        let [across, down] = [f64::from(width) / f64::from(c.width), f64::from(height) / f64::from(c.height)];
        let focal = self.fov.map(|f| 0.5 * f64::from(width) / (0.5 * f.to_radians()).tan());
        let (fx, fy) = focal.map_or((c.fx * down, c.fy * down), |f| (f, f * c.fy / c.fx));
        let camera = Camera { width, height, fx, fy, cx: c.cx * across, cy: c.cy * down, ..c.clone() };
        NamedCamera { camera, ..named }
    }

    /// The time to render at; `own` is the camera's.
    fn time_of(&self, own: Option<f32>) -> f32 {
        self.time.or(own).unwrap_or(0.0)
    }

    /// Freezes static splats for the cameras; what was found, in words.
    fn leave_at_rest(&self, scene: &mut Scene, cameras: &[NamedCamera], pixels: f64) -> Result<String, Failure> {
        const FLAG: &str = "--static-within";
        let Scene::Run(run) = scene else { return Err(Failure::usage(format!("{FLAG} needs a run"))) };
        if let Some(t) = cameras.iter().map(|c| self.time_of(c.time)).find(|t| !(0.0..=1.0).contains(t)) {
            return Err(Failure::usage(format!("{FLAG} says nothing about time {t}: motion is probed from 0 to 1")));
        }
        let views: Vec<Camera> = cameras.iter().map(|c| c.camera.clone()).collect();
        let options = FreezeOptions { pixels: pixels as f32, ..FreezeOptions::usual(&views) };
        let Some((resting, report)) = run.loaded.model.freeze_static(&options) else {
            return Ok(
                "nothing is left at rest: every splat moves further than that, or this run's method leaves none \
                       (modec with lgd.encoder=hash)"
                    .to_owned(),
            );
        };
        run.loaded.model = resting;
        let FreezeReport { still, splats, bound_pixels, probes, .. } = report;
        Ok(format!("{still} of {splats} splats rest, at most {bound_pixels:.3} pixels off at {probes} times"))
    }

    fn open(&self, global: &Global) -> Result<Scene, Failure> {
        let path = &self.scene;
        if path.is_dir() || path.extension().is_some_and(|e| e == "gs4d") {
            return Ok(Scene::Run(Box::new(self.place.open(path, global)?)));
        }
        let (splats, antialiased) = load_splat_file(path, global)?;
        Ok(Scene::File(Box::new(splats), antialiased))
    }

    /// Fails if the folder is named like a file of pictures.
    fn check_folder(&self) -> Result<(), Failure> {
        let extension = self.out.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let format = match extension.as_str() {
            "mp4" | "m4v" | "mov" | "mkv" | "webm" | "avi" | "gif" => "mp4",
            "y4m" | "exr" | "npy" | "png" => extension.as_str(),
            "jpg" | "jpeg" | "webp" | "bmp" | "tif" | "tiff" => "png",
            _ => return Ok(()),
        };
        if self.out.is_dir() {
            return Ok(());
        }
        let folder = gs4d_run::shell_quoted(self.out.with_extension("").display().to_string());
        Err(Failure::usage(format!("-o names a folder, and {} is named like a file", self.out.display()))
            .remedy(format!("-o {folder} --format {format}")))
    }

    /// The cameras that were asked for.
    fn cameras(&self, scene: &Scene, global: &Global) -> Result<Vec<NamedCamera>, Failure> {
        let name = self.camera.to_string_lossy();
        if name == "orbit" {
            let orbit = scene.orbit()?.ok_or_else(|| {
                Failure::usage("there is nothing to go around: the cameras look in one direction, or there is no splat")
            })?;
            let times = [0.0, scene.last_time()];
            return Ok(self.series("orbit", &times, |k, n| orbit.at(k as f64 / n as f64)));
        }
        if name == "path" || name.starts_with("path:") {
            let (flight, times) = match name.strip_prefix("path:") {
                Some(file) => {
                    let keys = load_cameras(Path::new(file), &Limits::default())?;
                    let times = key_times(&keys);
                    (Flight::through(&keys.into_iter().map(|k| k.camera).collect::<Vec<_>>()), times)
                }
                None => (Flight::of_views(&scene.training_views("--camera path")?), None),
            };
            let flight = flight.ok_or_else(|| Failure::usage("a path leads through two cameras or more"))?;
            let times = times.unwrap_or_else(|| vec![0.0, scene.last_time()]);
            return Ok(self.series("path", &times, |k, n| Some(flight.at(k as f64 / (n.max(2) - 1) as f64))));
        }
        let Some(number) = name.strip_prefix("dataset:") else {
            let missing = !self.camera.exists();
            return load_cameras(&self.camera, &Limits::default()).map_err(|e| {
                let failure = Failure::from(e);
                if missing { failure.remedy(CAMERAS) } else { failure }
            });
        };
        let dataset = scene.data("--camera dataset:N")?;
        let trains = dataset.test.is_empty();
        let views = if trains { &dataset.train } else { &dataset.test };
        let view = number.parse::<usize>().ok().and_then(|n| views.get(n));
        let view =
            view.ok_or_else(|| Failure::usage(format!("--camera dataset:N: N from 0 to {}", views.len() - 1)))?;
        if trains {
            global.say(format!("note: the data have no test views: {name} is the training view {}", view.name));
        }
        let View { name, camera, time, .. } = scene.placed().held_out(view);
        Ok(vec![NamedCamera { name, camera, time: Some(time.normalised) }])
    }

    /// As many cameras as `--times` has, else [`DEFAULT_FRAMES`]; `at(k, n)` is the `k`-th of `n`. Time passes through `times`, evenly spaced over the series.
    fn series(&self, name: &str, times: &[f32], at: impl Fn(usize, usize) -> Option<Camera>) -> Vec<NamedCamera> {
        let n = self.times.as_ref().map_or(DEFAULT_FRAMES, |t| t.0.len());
        let named = |k: usize| {
            let time = between(times, k as f32 / (n.max(2) - 1) as f32);
            Some(NamedCamera { name: format!("{name}-{k:04}"), camera: at(k, n)?, time: Some(time) })
        };
        (0..n).filter_map(named).collect()
    }

    /// Cameras with the times of `--times`.
    fn sequence(&self, cameras: Vec<NamedCamera>) -> Result<Vec<NamedCamera>, Failure> {
        let Some(times) = &self.times else { return Ok(cameras) };
        let n = times.0.len();
        if cameras.len() != 1 && cameras.len() != n {
            return Err(Failure::usage(format!(
                "--times gives {n} times for {} cameras: one, or as many",
                cameras.len()
            )));
        }
        let at = |(k, &t): (usize, &f32)| {
            let camera = &cameras[k.min(cameras.len() - 1)];
            let name = if cameras.len() == 1 { format!("{}-{k:04}", camera.name) } else { camera.name.clone() };
            NamedCamera { name, time: Some(t), camera: camera.camera.clone() }
        };
        Ok(times.0.iter().enumerate().map(at).collect())
    }

    /// All cameras as one video, which the first rank writes.
    fn video(
        &self,
        cameras: &[NamedCamera],
        share: &Share,
        render: &mut dyn FnMut(usize) -> Result<Image, Failure>,
    ) -> Result<PathBuf, Failure> {
        let size = |c: &NamedCamera| (c.camera.width, c.camera.height);
        let Some(first) = cameras.first().map(size) else { return Err(Failure::usage("there is no camera")) };
        if let Some(other) = cameras.iter().find(|c| size(c) != first) {
            let what = format!("camera {} has another size than the first; a video has one", other.name);
            return Err(Failure::usage(what));
        }
        create_folder(&self.out)?;
        let path = self.out.join(if self.format == Format::Mp4 { "video.mp4" } else { "video.y4m" });
        check_free(self.force, "video", "folder", [&path])?;
        if !share.leads() {
            self.frames(cameras.len(), share, render, &mut |_| Ok(()))?;
            return Ok(path);
        }
        if self.format == Format::Mp4 {
            let mut encoder = Encoder::start(&path)?;
            encoder.write(|out| y4m::write_header(first.0 as usize, first.1 as usize, self.fps, out))?;
            self.frames(cameras.len(), share, render, &mut |frame| encoder.write(|out| out.write_all(frame)))?;
            encoder.finish()?;
            return Ok(path);
        }
        let mut failed = None;
        let written = write_file(&path, self.force, |out| {
            y4m::write_header(first.0 as usize, first.1 as usize, self.fps, out)?;
            let failure = |e: std::io::Error| Failure::io("write the video", &path, &e);
            let frames = self.frames(cameras.len(), share, render, &mut |frame| out.write_all(frame).map_err(failure));
            frames.map_err(|e| {
                let stop = std::io::Error::other(e.message());
                failed = Some(e);
                stop
            })
        });
        failed.map_or(Ok(()), Err)?;
        written?;
        Ok(path)
    }

    /// Renders the frames of a video, each rank one of a round; `write` has the bytes of all, in their order, on the first.
    fn frames(
        &self,
        count: usize,
        share: &Share,
        render: &mut dyn FnMut(usize) -> Result<Image, Failure>,
        write: &mut dyn FnMut(&[u8]) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        for round in (0..count).step_by(share.size()) {
            let mut bytes = Vec::new();
            if let Some(k) = (round..count).nth(share.rank()) {
                y4m::write_frame(&render(k)?, &mut bytes).map_err(|e| Failure::io("write a frame", &self.out, &e))?;
            }
            share.gather(bytes)?.iter().try_for_each(|frame| write(frame))?;
        }
        Ok(())
    }

    fn options(&self, scene: &Scene) -> Result<RasterOptions, Failure> {
        let mut options = scene.options();
        options.near = self.near.unwrap_or(options.near);
        options.background = self.background.unwrap_or(options.background);
        options.antialias |= self.antialias;
        options.check().map_err(|e| Failure::usage(e.to_string()))?;
        Ok(options)
    }

    /// A distinct path in the output folder per camera; fails if one exists, unless forced.
    fn paths(&self, cameras: &[NamedCamera]) -> Result<Vec<PathBuf>, Failure> {
        let extension = match self.format {
            Format::Png => "png",
            Format::Exr => "exr",
            Format::Npy => "npy",
            Format::Y4m => "y4m",
            Format::Mp4 => "mp4",
        };
        let mut taken = BTreeSet::new();
        let mut paths = Vec::with_capacity(cameras.len());
        for (i, camera) in cameras.iter().enumerate() {
            let mut name = file_stem(&camera.name);
            if !taken.insert(name.to_lowercase()) {
                name = format!("{name}-{i}");
                taken.insert(name.to_lowercase());
            }
            paths.push(self.out.join(format!("{name}.{extension}")));
        }
        check_free(self.force, "image", "folder", &paths)?;
        Ok(paths)
    }

    fn save(&self, image: &Image, path: &Path) -> Result<(), Failure> {
        match self.format {
            Format::Png => save_png(path, image, self.force)?,
            Format::Exr => exr::save(path, image, self.force)?,
            Format::Npy => write_file(path, self.force, |out| npy::write_image(image, out))?,
            Format::Y4m | Format::Mp4 => write_file(path, self.force, |out| {
                y4m::write_header(image.width, image.height, self.fps, out)?;
                y4m::write_frame(image, out)
            })?,
        }
        Ok(())
    }
}

impl Format {
    /// Which image its files hold.
    fn kind(self) -> Kind {
        match self {
            Format::Exr | Format::Npy => Kind::Values,
            Format::Png | Format::Y4m | Format::Mp4 => Kind::Shown,
        }
    }
}
