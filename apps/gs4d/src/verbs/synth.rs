//! `gs4d synth`: writes a generated scene with exact ground truth as a data set.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use gs_synth::blur::{Exposure, blur_training_views};
use gs_synth::gains::{self, spread_exposures};
use gs_synth::{self as synth, SCENES, SynthOptions};
use serde_json::json;
use std::path::{Path, PathBuf};

pub mod avatar;

use avatar::{AvatarFlags, Shared};

/// Default image side of fixed cameras, which take many images.
const FIXED_CAMERA_SIZE: u32 = 100;

/// Flags of scenes with a camera for each view.
const OF_ONE_CAMERA: [&str; 3] = ["train_views", "val_views", "test_views"];

/// Layout of the data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Layout {
    /// D-NeRF: transforms_*.json, images with alpha.
    Dnerf,
    /// Nerfies and HyperNeRF: one camera file per image, images over white.
    Nerfies,
}

/// Generate a scene with exact ground truth, as a data set of D-NeRF's or Nerfies' layout
#[derive(clap::Args)]
pub struct Synth {
    /// Name of the scene; without it, the scenes are listed.
    name: Option<String>,
    /// Folder to write to.
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Layout of the folder.
    #[arg(long, value_enum, default_value = "dnerf")]
    layout: Layout,
    /// Render through a distorting lens, with skew and an off-centre principal point (layout nerfies).
    #[arg(long)]
    lens: bool,
    /// Side of the images, pixels [default: 200, with --cameras 100, of the scene avatar 256].
    #[arg(long)]
    size: Option<u32>,
    /// Training views, evenly spaced in time.
    #[arg(long, default_value_t = SynthOptions::default().train_views, conflicts_with = "cameras")]
    train_views: u32,
    /// Validation views.
    #[arg(long, default_value_t = SynthOptions::default().val_views, conflicts_with = "cameras")]
    val_views: u32,
    /// Test views.
    #[arg(long, default_value_t = SynthOptions::default().test_views, conflicts_with = "cameras")]
    test_views: u32,
    /// Fixed training cameras with an image at every time, in place of a camera for each view (8, say).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    cameras: Option<u32>,
    /// Further fixed cameras, whose images are held out for tests.
    #[arg(long, value_name = "N", default_value_t = SynthOptions::default().held_out, requires = "cameras", conflicts_with_all = OF_ONE_CAMERA, value_parser = clap::value_parser!(u32).range(..=1000))]
    held_out: u32,
    /// Times of the images of fixed cameras, evenly spaced.
    #[arg(long, value_name = "N", default_value_t = SynthOptions::default().moments, requires = "cameras", conflicts_with_all = OF_ONE_CAMERA)]
    moments: u32,
    /// Part of the time that is trained on: later images, of every camera, are for extrapolation (0..1).
    #[arg(long, value_name = "TIME", default_value_t = SynthOptions::default().boundary, requires = "cameras", conflicts_with_all = OF_ONE_CAMERA)]
    boundary: f64,
    /// Seed of the cameras.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Variant of the scene: 0 as designed; others turned, at another pace, most in other colours and patterns.
    #[arg(long, value_name = "N", default_value_t = 0)]
    variant: u64,
    /// Give the training views motion blur: how long the shutter is open, normalised time (0..1).
    #[arg(long, value_name = "TIME")]
    exposure: Option<f64>,
    /// Images averaged for motion blur.
    #[arg(long, default_value_t = 17, requires = "exposure")]
    exposure_samples: u32,
    /// Average linear light, not display-encoded values.
    #[arg(long, requires = "exposure")]
    linear: bool,
    /// Radians the camera turns by while the shutter is open.
    #[arg(long, default_value_t = 0.0, requires = "exposure")]
    shake: f64,
    /// Give every training view an exposure and a white balance of its own: standard deviation of the logarithm of its gains (0..1).
    #[arg(long, value_name = "SPREAD")]
    gains: Option<f64>,
    /// Write depth, masks and labels of every view, and the flow of a camera that stands still, to DIR/maps (.npy and .png;
    /// labels for `gs4d segment` in DIR/maps/labels); of the scene avatar depth, normals and positions to DIR/gt (.exr).
    #[arg(long)]
    truth: bool,
    /// Times of the camera that stands still.
    #[arg(long, default_value_t = 25, requires = "truth", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    truth_times: u32,
    /// Write into a folder that is not empty.
    #[arg(short, long)]
    force: bool,
    #[command(flatten)]
    avatar: AvatarFlags,
}

impl Synth {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let Some(name) = &self.name else { return Ok(list()) };
        let Some(out) = &self.out else {
            return Err(Failure::usage("no folder to write to").remedy(format!("gs4d synth {name} -o DIR")));
        };
        if name == avatar::NAME {
            let usual = SynthOptions::default();
            let views = [self.train_views, self.val_views, self.test_views];
            let of_scenes = views != [usual.train_views, usual.val_views, usual.test_views]
                || self.cameras.is_some()
                || self.exposure.is_some()
                || self.gains.is_some()
                || self.variant != 0;
            if of_scenes || self.lens || self.layout != Layout::Dnerf {
                let what = "--train-views, --val-views, --test-views, --cameras, --lens, --exposure, --gains, --variant and --layout are \
                    not for the scene avatar";
                return Err(Failure::usage(what).remedy(
                    "choose its cameras with --cams, for example --cams 8x2, and its images in time with --frames and --test-every",
                ));
            }
            self.check_left(out, &["scene.json", "cameras.json", if self.truth { "gt" } else { "" }])?;
            let Self { size, seed, truth, force, .. } = self;
            return self.avatar.run(out, Shared { size, seed, truth, force }, global);
        }
        if let Some(flag) = self.avatar.given() {
            return Err(
                Failure::usage(format!("{flag} is for the scene avatar, not for {name}")).remedy("leave it out")
            );
        }
        let options = self.options();
        let exposure = self.exposure.map(|length| {
            let (samples, linear, shake) = (self.exposure_samples, self.linear, self.shake);
            Exposure { length, samples, linear, shake, seed: self.seed }
        });
        exposure.iter().try_for_each(Exposure::check)?;
        self.gains.map_or(Ok(()), gains::check)?;
        self.check_left(out, &self.writes())?;
        let mut data = match self.layout {
            Layout::Nerfies if self.gains.is_some() => {
                return Err(Failure::usage("gains are for the layout dnerf").remedy("leave out --gains"));
            }
            Layout::Nerfies if exposure.is_some() => {
                return Err(Failure::usage("motion blur is for the layout dnerf").remedy("leave out --exposure"));
            }
            Layout::Nerfies if self.truth => {
                return Err(Failure::usage("maps are for the layout dnerf").remedy("leave out --truth"));
            }
            Layout::Nerfies => synth::write_nerfies(out, name, &options, self.force)?,
            Layout::Dnerf => synth::write(out, name, &options, self.force)?,
        };
        if let Some(exposure) = &exposure {
            blur_training_views(out, &mut data, exposure)?;
        }
        if let Some(spread) = self.gains {
            spread_exposures(out, &mut data, spread, self.seed)?;
        }
        if self.truth {
            synth::write_maps(out, &data, self.truth_times, self.force)?;
        }
        let data = data.dataset;
        let (train, test, future) = (data.train.len(), data.test.len(), data.extrapolate.len());
        let (layout, val) = match self.layout {
            Layout::Nerfies => ("nerfies", 0),
            Layout::Dnerf => ("dnerf", data.val.len()),
        };
        let size = options.size;
        let later = if future > 0 { format!(", {future} extrapolation") } else { String::new() };
        let text = format!(
            "{}  {name}: {train} training, {val} validation, {test} test{later} views of {size}x{size}; truth.json{} beside them\n",
            out.display(),
            if self.truth { " and maps" } else { "" }
        );
        let json = json!({"path": out.display().to_string(), "scene": name, "layout": layout, "options": options, "views": [train, val, test], "extrapolation_views": future, "exposure": exposure, "gains": self.gains});
        Ok(Answer::new(text, json))
    }

    /// The files among [`KNOWN`] that this call writes.
    fn writes(&self) -> Vec<&'static str> {
        if self.layout == Layout::Nerfies {
            return vec!["truth.json", "dataset.json", "metadata.json", "scene.json", "points.npy", "extra.json"];
        }
        let moves = SCENES.iter().any(|s| self.name.as_deref() == Some(s.name) && s.dynamic);
        let also = [
            (self.cameras.is_none(), "transforms_val.json"),
            (self.cameras.is_some() && moves, "scene.toml"),
            (self.exposure.is_some(), "exposure.json"),
            (self.gains.is_some(), "gains.json"),
            (self.truth, "maps"),
        ];
        let also = also.into_iter().filter(|(written, _)| *written).map(|(_, file)| file);
        ["truth.json", "transforms_train.json", "transforms_test.json"].into_iter().chain(also).collect()
    }

    /// Fails where a file of an earlier data set would stay beside those that are written, and be read with them.
    fn check_left(&self, out: &Path, writes: &[&str]) -> Result<(), Failure> {
        let stays = KNOWN.iter().filter(|file| self.force && !writes.contains(file)).map(|file| out.join(file));
        match stays.into_iter().find(|file| file.exists()) {
            None => Ok(()),
            Some(file) => Err(Failure::new(Class::Io, "io.exists", "a file of an earlier data set would stay")
                .place(file.display())
                .why("it would be read with the new one")
                .remedy("choose another folder with -o, or remove it")),
        }
    }

    fn options(&self) -> SynthOptions {
        let default = SynthOptions::default();
        SynthOptions {
            size: self.size.unwrap_or(if self.cameras.is_some() { FIXED_CAMERA_SIZE } else { default.size }),
            train_views: self.train_views,
            val_views: self.val_views,
            test_views: self.test_views,
            cameras: self.cameras.unwrap_or(0),
            held_out: self.held_out,
            moments: self.moments,
            boundary: self.boundary,
            seed: self.seed,
            variant: self.variant,
            lens: self.lens,
            ..default
        }
    }
}

/// Files by which a data set or its truth is known.
const KNOWN: [&str; 15] = [
    "truth.json",
    "transforms_train.json",
    "transforms_val.json",
    "transforms_test.json",
    "scene.toml",
    "dataset.json",
    "metadata.json",
    "scene.json",
    "cameras.json",
    "points.npy",
    "extra.json",
    "exposure.json",
    "gains.json",
    "maps",
    "gt",
];

fn list() -> Answer {
    let scenes = SCENES.iter().map(|s| (s.name, s.about, s.dynamic)).chain([(avatar::NAME, avatar::ABOUT, true)]);
    let text: String = scenes.clone().map(|(name, about, _)| format!("{name:10} {about}\n")).collect();
    let json: Vec<_> =
        scenes.map(|(name, about, dynamic)| json!({"name": name, "about": about, "dynamic": dynamic})).collect();
    Answer::new(text, json!(json))
}
