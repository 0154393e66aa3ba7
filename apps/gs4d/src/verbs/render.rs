//! `gs4d render`: draws a splat file or a run from given cameras.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::progress::Progress;
use crate::{Global, parse};
use gs_core::io::cameras::{NamedCamera, load_cameras};
use gs_core::io::images::save_png;
use gs_core::io::{Limits, RawSplats, exr, load_splats, npy, write_file};
use gs_core::{Camera, Image, Splats};
use gs_raster::{Frame, RasterOptions};
use gs_train::run::OpenRun;
use gs_train::run::picture::{Painter, file_stem, moment};
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Draw a splat file or a run from given cameras, as PNG, EXR or NPY
#[derive(clap::Args)]
pub struct Render {
    /// A .ply, .splat or .spz file, a run folder, or a .gs4d file (a checkpoint of a run, or what gs4d compact made).
    #[arg(value_name = "SCENE|RUN")]
    scene: PathBuf,
    /// Cameras: INRIA cameras.json, a transforms file, or {width,height,fx,fy,cx,cy,world_to_camera} (name, time optional), one or a list.
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Normalised time, 0 first to 1 last training frame; beyond extrapolates [default: the camera's own, else 0].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::finite)]
    time: Option<f32>,
    /// Splats nearer than this are not drawn, world units [default: 0.01 for files, the recipe's for runs].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::not_negative)]
    near: Option<f64>,
    /// Colour behind the scene: black, white, one grey or r,g,b in 0..1 [default: black, or the run's].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::color)]
    background: Option<[f32; 3]>,
    /// Compensate opacities for the dilation of small splats (Mip-Splatting).
    #[arg(long)]
    antialias: bool,
    /// PNG: 8 bit RGB over the background. EXR, NPY: float32 RGB over the background, then alpha (premultiplied over black).
    #[arg(long, value_enum, default_value_t = Format::Png)]
    format: Format,
    /// Folder for the pictures; made if missing.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing pictures.
    #[arg(short, long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Png,
    Exr,
    Npy,
}

/// What is drawn.
enum Scene {
    File(Box<Splats>),
    Run(Box<OpenRun>),
}

impl Scene {
    fn open(path: &Path) -> Result<Self, Failure> {
        if path.is_dir() || path.extension().is_some_and(|e| e == "gs4d") {
            return Ok(Scene::Run(Box::new(OpenRun::open(path)?)));
        }
        let raw: RawSplats = load_splats(path, &Limits::default())?;
        let splats = raw.to_splats();
        let wrong = |e: gs_core::splats::SplatsError| Failure::new(Class::Data, "data.splats", e.to_string());
        Ok(Scene::File(Box::new(splats.map_err(|e| wrong(e).place(path.display()))?)))
    }

    fn options(&self) -> RasterOptions {
        match self {
            Scene::File(_) => RasterOptions::default(),
            Scene::Run(run) => run.loaded.method.schedule().raster_options(run.background()),
        }
    }

    fn draw<'a>(&self, painter: &'a mut Painter, camera: &Camera, time: f32) -> &'a Frame {
        match self {
            Scene::File(splats) => painter.draw(splats, camera),
            Scene::Run(run) => painter.draw(&run.loaded.method.splats(&moment(time), camera), camera),
        }
    }
}

impl Render {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let cameras = load_cameras(&self.camera, &Limits::default())?;
        let scene = Scene::open(&self.scene)?;
        let paths = self.paths(&cameras)?;
        std::fs::create_dir_all(&self.out).map_err(|e| Failure::io("create the folder", &self.out, &e))?;
        let mut painter = Painter::new(self.options(&scene));
        let mut progress = Progress::new(cameras.len() as u64, "pictures", global.quiet);
        for (done, (camera, path)) in cameras.iter().zip(&paths).enumerate() {
            let frame = scene.draw(&mut painter, &camera.camera, self.time.or(camera.time).unwrap_or(0.0));
            self.save(frame, path)?;
            progress.at(done as u64 + 1, || camera.name.clone());
        }
        progress.finish();
        let files: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        let text: String = files.iter().map(|f| format!("{f}\n")).collect();
        Ok(Answer::new(text, json!({"files": files, "background": painter.options.background})))
    }

    fn options(&self, scene: &Scene) -> RasterOptions {
        let mut options = scene.options();
        options.near = self.near.unwrap_or(options.near);
        options.background = self.background.unwrap_or(options.background);
        options.antialias |= self.antialias;
        options
    }

    /// A path per camera, all inside the output folder, all different, none taken (unless forced).
    fn paths(&self, cameras: &[NamedCamera]) -> Result<Vec<PathBuf>, Failure> {
        let extension = match self.format {
            Format::Png => "png",
            Format::Exr => "exr",
            Format::Npy => "npy",
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
        match paths.iter().find(|p| !self.force && p.exists()) {
            None => Ok(paths),
            Some(path) => Err(Failure::new(Class::Io, "io.exists", "the picture exists already")
                .place(path.display())
                .why("nothing is overwritten unless asked")
                .remedy("choose another folder with -o, or pass -f")),
        }
    }

    fn save(&self, frame: &Frame, path: &Path) -> Result<(), Failure> {
        match self.format {
            Format::Png => save_png(path, &rgb(frame), self.force)?,
            Format::Exr => exr::save(path, &rgba(frame), self.force)?,
            Format::Npy => write_file(path, self.force, |out| npy::write_image(&rgba(frame), out))?,
        }
        Ok(())
    }
}

fn rgb(frame: &Frame) -> Image {
    Image { width: frame.width, height: frame.height, channels: 3, data: frame.rgb.clone() }
}

fn rgba(frame: &Frame) -> Image {
    let pixels = frame.rgb.chunks_exact(3).zip(&frame.alpha);
    let data = pixels.flat_map(|(rgb, &a)| [rgb[0], rgb[1], rgb[2], a]).collect();
    Image { width: frame.width, height: frame.height, channels: 4, data }
}
