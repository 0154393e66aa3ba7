//! Data sets of dynamic scenes: a folder in, views with cameras, timestamps and ground-truth images out.
//!
//! A [`View`] is a camera, a timestamp and an image. A [`Dataset`] is four lists of views (one per [`Split`]) and what else
//! the folder holds: points, a scene box, masks, depth. [`Dataset::open`] detects the layout of a folder, or takes the one named in
//! [`DataOptions`]; [`LAYOUTS`] lists the readers: `blender` (D-NeRF), `nvfi`, `nerfstudio`, `colmap`, `nvidia`, `hypernerf`
//! (Nerfies, DyCheck), `llff` (Neu3D), `panoptic` and, with the feature `avatar`, `avatar`. An [`ImageCache`] decodes images on demand.
//!
//! ```
//! use gs_data::{DataOptions, Dataset, ImageCache};
//!
//! # let dir = tempfile::tempdir()?;
//! # let folder = dir.path();
//! std::fs::write(
//!     folder.join("transforms_train.json"),
//!     r#"{"camera_angle_x": 1.5707963267948966, "frames": [{"file_path": "r_000", "time": 0.5,
//!         "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}]}"#,
//! )?;
//! image::RgbaImage::from_pixel(8, 8, image::Rgba([255, 0, 0, 128])).save(folder.join("r_000.png"))?;
//!
//! let data = Dataset::open(folder, &DataOptions::default())?;
//! let view = &data.train[0];
//! assert_eq!((data.layout, view.name.as_str(), view.camera.width), ("blender", "r_000", 8));
//! assert!((view.camera.fx - 4.0).abs() < 1e-12); // a horizontal field of view of 90 degrees
//! assert!((view.camera.position().z - 4.0).abs() < 1e-12);
//! let image = ImageCache::new(1 << 20, 1.0).get(view)?; // RGBA, straight alpha
//! assert_eq!(image.pixel(3, 5), [255, 0, 0, 128]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Conventions
//! * Cameras are those of [`gs_core`]: world to camera, OpenCV axes. Readers flip the y and z axes of OpenGL camera-to-world matrices.
//! * [`Time::normalised`](gs_core::Time) is 0 at the first training time that is read and 1 at the last, unless `data.time_range` sets
//!   the span or the layout has one of its own: rigs of `llff` put frame `k` of `n` at `k/n`, `nvidia` puts image `k` of `n` at `k/(n−1)`,
//!   `hypernerf` divides by the largest id of all lists, `nvfi` takes times as they stand. There `data.first_frame` and
//!   `data.frame_count` train on a slice of 0..1. With `data.time_boundary` 0 and 1 are the ends of the whole sequence that is read (of
//!   the range or the layout's span, where there is one), and training ends at the boundary. With `data.time_from=name` or `order`
//!   layouts but `llff` (`order`) have no span of their own. [`Time::seconds`](gs_core::Time) is the data's own clock.
//! * [`View::camera`] has the size of the image file, or that size times `data.scale`. An [`ImageCache`] with a scale of
//!   its own gives the smaller camera.
//! * Images are 8-bit RGBA with straight alpha, display-encoded, row-major, origin top left ([`ImageU8`]).
//! * [`View::mask`] says which pixels count in masked scores. Training uses all pixels, unless `data.cut_out`
//!   makes those outside the mask transparent (in films of people they always are) or `data.mask_loss` leaves them out of the loss.
//! * Paths inside the data stay inside the folder; no allocation trusts a size that only a header states.
//! * Every assumption a reader makes is a line in [`Dataset::notes`]. Every error names file, field, reason and remedy ([`DataError`]).
//!
//! # Options for every layout
//! * `data.time_boundary` keeps the end of the sequence out of training: [`Dataset::extrapolate`].
//! * `data.cameras`, `data.test_cameras`, `data.first_frame`, `data.frame_count` and `data.frame_step` choose views.
//! * A `scene.toml` in the folder may state the boundary, initial points and the scene box ([`write_start`] writes the last two):
//!   ```toml
//!   [time]
//!   boundary = 0.75      # data.time_boundary
//!   range = "0..4.67"    # data.time_range
//!   shift = "4:-2"       # data.time_shift
//!   [start]
//!   points = "start.ply" # instead of the layout's own points
//!   bounds = [[-1, -1, -1], [1, 1, 1]]
//!   ```
//!
//! # What it leaves out
//! EXR images, mask folders of other layouts, video files.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;

use crate::avatar::AvatarScene;

#[cfg(feature = "avatar")]
pub mod avatar;
/// Filmed people with a rigged template: empty without the feature `avatar`.
#[cfg(not(feature = "avatar"))]
pub mod avatar {
    /// A type without values: no reader makes one without the feature `avatar`.
    #[derive(Clone, Debug, PartialEq)]
    pub enum AvatarScene {}
}
mod advice;
mod blender;
mod boundary;
mod cache;
mod colmap;
pub mod decode;
mod depth;
mod error;
mod files;
mod frames;
mod frustum;
pub mod geometry;
mod header;
pub mod hull;
mod hypernerf;
mod initial;
mod intrinsics;
pub mod json;
pub mod lens;
mod llff;
pub mod mask;
pub mod moments;
mod nerfstudio;
mod nvfi;
mod options;
mod panoptic;
pub mod pixels;
pub mod ply;
mod pose;
mod scene_file;
mod select;
mod shift;
mod spread;
mod start;
mod table;
mod times;
mod view;

pub use advice::shell_quoted;
pub use cache::ImageCache;
pub use colmap::{Reconstruction, Registered};
pub use depth::DepthMap;
pub use error::{DataError, Place};
pub use files::Root;
pub use lens::Lens;
pub use options::{DataOptions, TimeFrom, TimeRange, TimeShift};
pub use pixels::ImageU8;
pub use scene_file::write_times;
pub use spread::{evenly, spread};
pub use start::{Start, StartFrom, cube, has_start_points, write_start};
pub use view::{ImageSource, PointCloud, Split, View};

/// A data set as a reader returns it, or made by hand.
///
/// All fields are public: a program may build or filter one with struct update syntax. Initial points come from [`Self::initial_points`] or [`Self::start`]; the extent and the box of the scene from
/// [`Self::scene_extent`] and [`Self::scene_bounds`].
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// The folder that was read; empty for data made in memory.
    pub root: PathBuf,
    /// Name of the reader in [`LAYOUTS`], or of the generator.
    pub layout: &'static str,
    /// Training views; a reader never returns an empty list.
    pub train: Vec<View>,
    /// Validation views, scored during training; may be empty.
    pub val: Vec<View>,
    /// Held-out views; may be empty.
    pub test: Vec<View>,
    /// Views of all cameras later than `data.time_boundary`, or that the layout holds out for extrapolation.
    pub extrapolate: Vec<View>,
    /// Points of the data: a sparse reconstruction or initial points.
    pub points: Option<PointCloud>,
    /// Whether the training images have an alpha channel that counts.
    pub has_alpha: bool,
    /// Whether training views have more than one timestamp.
    pub dynamic: bool,
    /// Where the timestamps come from, in words for people.
    pub time_source: String,
    /// Lower and upper corner of the scene box, world units, where the layout or `scene.toml` states it.
    pub bounds: Option<[Vec3; 2]>,
    /// Template, poses and inputs of a filmed person (layout `avatar`).
    pub avatar: Option<Arc<AvatarScene>>,
    /// Most memory for decoding one of its images, MiB ([`DataOptions::max_image_mib`]).
    pub max_image_mib: Option<u32>,
    /// Every assumption the reader made, one sentence each.
    pub notes: Vec<String>,
}

impl Dataset {
    /// Reads a folder with the layout named in the options, else with the one that [`detect`] finds. Options that are not set
    /// are taken from the folder's `scene.toml`, if it exists. No image is decoded: only headers are read.
    ///
    /// # Errors
    /// `data.path` if there is no folder, `data.layout` if no reader recognises it, `data.option` for an option out of its
    /// domain, `data.syntax` for a broken `scene.toml`, else the error of the reader.
    pub fn open(dir: &Path, options: &DataOptions) -> Result<Self, DataError> {
        Self::read(dir, options, true)
    }

    /// The same without the points and the box that `scene.toml` names in `[start]`: with those of the layout.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_without_start(dir: &Path, options: &DataOptions) -> Result<Self, DataError> {
        Self::read(dir, options, false)
    }

    fn read(dir: &Path, options: &DataOptions, with_start: bool) -> Result<Self, DataError> {
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
        data.note_later_points();
        data.max_image_mib = options.max_image_mib;
        if with_start {
            file.apply_start(&mut data)?;
        }
        if options.cut_out {
            data.cut_out()?;
        }
        if options.mask_loss {
            data.mask_loss()?;
        }
        if scale < 1.0 {
            data.shrink(scale);
        }
        Ok(data)
    }

    /// Marks every view for cutting out its mask and drops views without one.
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

    /// Marks views whose loss counts inside their masks alone: those of training, and held-out ones whose cameras are placed by it.
    fn mask_loss(&mut self) -> Result<(), DataError> {
        let masked = self.train.iter().filter(|v| v.mask.is_some()).count();
        let held_out = self.val.iter_mut().chain(&mut self.test).chain(&mut self.extrapolate);
        self.train.iter_mut().chain(held_out).for_each(|v| v.mask_loss = v.mask.is_some());
        if masked == 0 {
            let rule = "false where no training view has a mask".into();
            return Err(DataError::Option { name: "data.mask_loss", value: "true".into(), rule });
        }
        let of = self.train.len();
        self.notes.push(format!(
            "of {masked} of {of} training views only pixels inside the mask train, as data.mask_loss asks"
        ));
        Ok(())
    }

    /// Scales every camera; the [`ImageCache`] averages the images down to them.
    fn shrink(&mut self, scale: f64) {
        #[cfg(feature = "avatar")]
        let inputs = self.avatar.as_mut().map(|a| Arc::make_mut(a).inputs_mut()).into_iter().flatten();
        #[cfg(not(feature = "avatar"))]
        let inputs = std::iter::empty();
        let all = self.train.iter_mut().chain(&mut self.val).chain(&mut self.test).chain(&mut self.extrapolate);
        all.chain(inputs).for_each(|v| v.shrink(scale));
        self.notes.push(format!("images are shrunk to {scale} of their size, as data.scale asks"));
    }

    /// The same data with empty splits and without points: to be filled by struct update.
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
            max_image_mib: self.max_image_mib,
            notes: self.notes.clone(),
        }
    }

    /// The list of views of a split.
    pub fn views(&self, split: Split) -> &[View] {
        match split {
            Split::Train => &self.train,
            Split::Val => &self.val,
            Split::Test => &self.test,
            Split::Extrapolate => &self.extrapolate,
        }
    }
}

/// How surely a folder has a layout, ascending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Confidence {
    /// The folder could have this layout.
    Possible,
    /// The files have the right names.
    Likely,
    /// The files have the right names and no other layout uses them.
    Certain,
}

/// The reader of one layout: an entry in [`LAYOUTS`].
pub struct Layout {
    /// Short name: the value of `data.layout` and of [`Dataset::layout`].
    pub name: &'static str,
    /// The layout in one line, for help texts.
    pub about: &'static str,
    /// Whether a folder has this layout, and how surely; none if it has not. Looks at file names and, where these do not
    /// decide, at the keys of a JSON file.
    pub probe: fn(&Path) -> Option<Confidence>,
    /// Reads the folder; [`Dataset::open`] applies the options that all layouts share.
    pub open: fn(&Path, &DataOptions) -> Result<Dataset, DataError>,
}

/// All readers; of equally sure ones the first wins.
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

/// The reader with the highest [`Confidence`] in a folder, of equal ones the first in [`LAYOUTS`]; none if no reader recognises it.
pub fn detect(dir: &Path) -> Option<&'static Layout> {
    let sure = LAYOUTS.iter().filter_map(|l| (l.probe)(dir).map(|c| (c, l)));
    sure.reduce(|best, next| if next.0 > best.0 { next } else { best }).map(|(_, l)| l)
}
