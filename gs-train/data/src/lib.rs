//! Data sets of moving scenes: folders in, views with cameras, timestamps and images out.
//!
//! A [`View`] is a camera, a moment and an image; a [`Dataset`] is three lists of them plus what else the folder holds.
//! One file or folder per layout (`blender`, `nvfi`, `nerfstudio`, `colmap`, `hypernerf`, `llff`, `panoptic`,
//! `avatar`), one line each in
//! [`LAYOUTS`].
//!
//! # Conventions
//! * Readers turn every camera into OpenCV axes; OpenGL camera-to-world matrices have their y and z axes flipped.
//! * [`Time::normalised`] is 0 at the first training time and 1 at the last; with `data.time_boundary` 0 at the first and 1 at
//!   the last time of the whole sequence, and training ends at the boundary. [`Time::seconds`] is the data's own clock.
//! * [`View::camera`] has the size of the image file, or that size times `data.scale`. An [`ImageCache`] with a scale of
//!   its own gives the smaller camera.
//! * [`View::mask`] says which pixels count in masked scores; training sees all of them, unless `data.cut_out`
//!   makes the others transparent. [`ImageCache::mask`] gives it at the
//!   size of the image.
//! * `data.time_boundary`, or the `scene.toml` of a folder (`scene_file.rs`), keeps the end of the sequence out of training:
//!   [`Dataset::extrapolate`], for every layout.
//! * `data.cameras`, `data.test_cameras`, `data.first_frame`, `data.frame_count` and `data.frame_step` choose views of any
//!   layout.
//! * The same file may name points to begin with and the box of the scene ([`write_start`] writes them).
//! * Every assumption a reader makes is a line in [`Dataset::notes`].
//! * Paths inside the data stay inside the folder; nothing is allocated on the word of a header alone.
//!
//! # What it leaves out
//! EXR images, mask folders of other layouts, fisheye lenses, video files.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use gs_core::{Camera, Time};

use crate::avatar::AvatarScene;

#[cfg(feature = "avatar")]
pub mod avatar;
/// Films of people need the feature `avatar`.
#[cfg(not(feature = "avatar"))]
pub mod avatar {
    /// There is none without the feature `avatar`.
    #[derive(Clone, Debug, PartialEq)]
    pub enum AvatarScene {}
}
mod blender;
mod boundary;
pub mod cache;
mod cloud;
mod colmap;
pub mod decode;
pub mod error;
mod files;
mod frames;
pub mod geometry;
pub mod header;
pub mod hull;
mod hypernerf;
mod initial;
mod intrinsics;
pub mod json;
pub mod lens;
mod llff;
pub mod mask;
mod nerfstudio;
mod npz;
mod nvfi;
pub mod options;
mod panoptic;
pub mod pixels;
pub mod ply;
mod pose;
mod scene_file;
mod select;
mod sight;
mod start;
mod times;

pub use cache::ImageCache;
pub use error::{DataError, Place};
pub use files::Root;
pub use lens::Lens;
pub use options::{DataOptions, TimeFrom, TimeRange};
pub use pixels::ImageU8;
pub use start::{Start, StartFrom, cube, write_start};

/// Where the pixels of a view are.
#[derive(Clone, Debug, PartialEq)]
pub enum ImageSource {
    /// A PNG or JPEG file.
    File(PathBuf),
    /// An image made in memory.
    Memory(Arc<ImageU8>),
}

/// One picture: who took it, when, and where it is.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Name within its split, for example `r_017`.
    pub name: String,
    /// The pinhole camera, of the size of the image that is used.
    pub camera: Camera,
    /// Width and height of the image as it is stored, where it is shrunk to the camera's (`data.scale`).
    pub stored: Option<[u32; 2]>,
    /// Distortion of the photograph; the [`ImageCache`] removes it. None for a pinhole.
    pub lens: Option<Lens>,
    /// The moment.
    pub time: Time,
    /// The pixels.
    pub image: ImageSource,
    /// The physical camera where the data name one, else the index of the view in its split.
    pub camera_id: u32,
    /// Which pixels count in masked scores (`mask.rs`): one channel, 255 counts.
    pub mask: Option<ImageSource>,
    /// Whether alpha in the image's file means nothing, as in photographs.
    pub opaque: bool,
    /// Whether pixels outside the mask are transparent (`data.cut_out`).
    pub cut_out: bool,
    /// Depth of the view, an `.npy` file, where the data bring one along.
    pub depth: Option<PathBuf>,
    /// Labels of the view's pixels, an `.npy` file of whole numbers, where the data bring them along.
    pub labels: Option<PathBuf>,
}

impl View {
    /// A view without distortion, mask, depth and labels.
    pub fn new(name: impl Into<String>, camera: Camera, time: Time, image: ImageSource, camera_id: u32) -> Self {
        Self {
            name: name.into(),
            camera,
            stored: None,
            lens: None,
            time,
            image,
            camera_id,
            mask: None,
            opaque: false,
            cut_out: false,
            depth: None,
            labels: None,
        }
    }
}

/// The three lists of views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Views to learn from.
    Train,
    /// Views to watch during training.
    Val,
    /// Held-out views.
    Test,
    /// Views later than anything learnt from.
    Extrapolate,
}

impl Split {
    /// Every list of views.
    pub const ALL: [Self; 4] = [Self::Train, Self::Val, Self::Test, Self::Extrapolate];
}

/// Coloured points.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct PointCloud {
    /// World units.
    pub positions: Vec<Vec3>,
    /// Display-encoded RGB in 0..1, one per position.
    pub colors: Vec<[f32; 3]>,
}

/// A data set after its reader.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// The folder; empty for data made in memory.
    pub root: PathBuf,
    /// Name of the layout.
    pub layout: &'static str,
    /// Views to learn from, never empty.
    pub train: Vec<View>,
    /// Views to watch during training.
    pub val: Vec<View>,
    /// Held-out views.
    pub test: Vec<View>,
    /// Views of all cameras beyond `data.time_boundary`, or that the layout keeps for this: the future.
    pub extrapolate: Vec<View>,
    /// Points the data bring along.
    pub points: Option<PointCloud>,
    /// Whether the training images carry alpha.
    pub has_alpha: bool,
    /// Whether training views have more than one time.
    pub dynamic: bool,
    /// Where the times come from, in words.
    pub time_source: String,
    /// Lower and upper corner of the box that holds the scene, where the layout or its maker knows it.
    pub bounds: Option<[Vec3; 2]>,
    /// The person that was filmed: template, poses and inputs, where the data bring them along.
    pub avatar: Option<Arc<AvatarScene>>,
    /// Assumptions made while reading.
    pub notes: Vec<String>,
}

impl Dataset {
    /// Reads a folder: with the layout named in the options, else with the one that is surest of it. What the options leave
    /// open the folder's `scene.toml` may say.
    ///
    /// # Errors
    /// `data.path` if there is no folder, `data.layout` if no reader knows it, `data.syntax` for a `scene.toml` that is not
    /// understood, else what the reader finds.
    pub fn open(dir: &Path, options: &DataOptions) -> Result<Self, DataError> {
        if !dir.is_dir() {
            return Err(DataError::NotFound { path: dir.to_path_buf() });
        }
        let names = || LAYOUTS.iter().map(|l| l.name).collect::<Vec<_>>().join(", ");
        let unknown = |looked_for| DataError::Layout { path: dir.to_path_buf(), looked_for };
        let layout = match &options.layout {
            Some(name) => LAYOUTS
                .iter()
                .find(|l| l.name == name)
                .ok_or_else(|| unknown(format!("\"{name}\" was asked for, known are {}", names())))?,
            None => detect(dir).ok_or_else(|| unknown(format!("looked for {}", names())))?,
        };
        let scale = options.scale;
        if !(scale > 0.0 && scale <= 1.0) {
            let rule = "above 0, at most 1".into();
            return Err(DataError::Option { name: "data.scale", value: scale.to_string(), rule });
        }
        let file = scene_file::read(dir)?;
        let options = &file.under(options);
        let mut data = (layout.open)(dir, options)?;
        file.begin(&mut data)?;
        if options.cut_out {
            data.cut_out()?;
        }
        if scale < 1.0 {
            data.shrink(scale);
        }
        Ok(data)
    }

    /// Leaves only what masks show.
    fn cut_out(&mut self) -> Result<(), DataError> {
        let mut left = 0;
        for views in [&mut self.train, &mut self.val, &mut self.test, &mut self.extrapolate] {
            left += views.len();
            views.retain(|v| v.mask.is_some());
            left -= views.len();
            views.iter_mut().for_each(|v| v.cut_out = true);
        }
        if self.train.is_empty() {
            let rule = "false where no training view has a mask".into();
            return Err(DataError::Option { name: "data.cut_out", value: "true".into(), rule });
        }
        let without = if left > 0 { format!("; {left} views without a mask are left out") } else { String::new() };
        self.notes.push(format!("pixels outside masks are transparent, as data.cut_out asks{without}"));
        Ok(())
    }

    /// Makes every view smaller; the [`ImageCache`] averages the images down to their cameras.
    fn shrink(&mut self, scale: f64) {
        #[cfg(feature = "avatar")]
        let inputs = self.avatar.as_mut().map(|a| Arc::make_mut(a).inputs_mut()).into_iter().flatten();
        #[cfg(not(feature = "avatar"))]
        let inputs = std::iter::empty();
        let all = self.train.iter_mut().chain(&mut self.val).chain(&mut self.test).chain(&mut self.extrapolate);
        for v in all.chain(inputs) {
            v.stored = Some([v.camera.width, v.camera.height]);
            v.camera = v.camera.scaled(scale);
        }
        self.notes.push(format!("images are shrunk to {scale} of their size, as data.scale asks"));
    }

    /// The same data without any view and without points.
    pub fn without_views(&self) -> Self {
        Self {
            root: self.root.clone(),
            layout: self.layout,
            train: Vec::new(),
            val: Vec::new(),
            test: Vec::new(),
            extrapolate: Vec::new(),
            points: None,
            has_alpha: self.has_alpha,
            dynamic: self.dynamic,
            time_source: self.time_source.clone(),
            bounds: self.bounds,
            avatar: self.avatar.clone(),
            notes: self.notes.clone(),
        }
    }

    /// The views of a split.
    pub fn views(&self, split: Split) -> &[View] {
        match split {
            Split::Train => &self.train,
            Split::Val => &self.val,
            Split::Test => &self.test,
            Split::Extrapolate => &self.extrapolate,
        }
    }
}

/// How sure a reader is that a folder is its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Confidence {
    /// Could be.
    Possible,
    /// The files have the right names.
    Likely,
    /// The files have the right names and no other layout uses them.
    Certain,
}

/// A reader.
pub struct Layout {
    /// Short name, as in `--layout`.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Whether a folder looks like this layout; reads names only.
    pub probe: fn(&Path) -> Option<Confidence>,
    /// Reads the folder.
    pub open: fn(&Path, &DataOptions) -> Result<Dataset, DataError>,
}

/// Every reader.
pub const LAYOUTS: &[Layout] = &[
    nvfi::LAYOUT,
    blender::LAYOUT,
    nerfstudio::LAYOUT,
    colmap::LAYOUT,
    colmap::NVIDIA,
    hypernerf::LAYOUT,
    llff::LAYOUT,
    panoptic::LAYOUT,
    #[cfg(feature = "avatar")]
    avatar::layout::LAYOUT,
];

/// The reader that is surest of a folder; of equally sure ones the first.
pub fn detect(dir: &Path) -> Option<&'static Layout> {
    let sure = LAYOUTS.iter().filter_map(|l| (l.probe)(dir).map(|c| (c, l)));
    sure.reduce(|best, next| if next.0 > best.0 { next } else { best }).map(|(_, l)| l)
}
