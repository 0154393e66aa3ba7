//! People filmed by calibrated cameras, with a rigged template: `scene.json` (specification: `manifest.rs`), `cameras.json`,
//! `images/CAMERA/FRAME.png`, and optionally `masks/`, `poses.json` or `poses.bin`, `crops.json`, `points/FRAME.ply`
//! (or `.obj`, or `.bin`: `x y z` as little-endian `f32`).
//!
//! ```text
//! scene.json    frames, splits, template, motion         cameras.json  [{id, w, h, K, E, dist, role, pixel_center}]
//! crops.json    {frame: {camera: [x0, y0]}}: the image is a part of the sensor that begins at this pixel
//! poses.json    {frame: {nodes: {NAME: {translation, rotation, scale}}, morphs: […]}}: replaces values of the motion's pose
//! poses.bin     the same in binary (`poses_bin.rs`)
//! ```
//! Camera ids are three digits or more in names of folders, frame numbers six. `E` is world to camera with OpenCV axes, row by
//! row; `K` and `E` are lists of 9 and 16 numbers. With `pixel_center: "integer"` the first pixel's centre is at 0 in `K`.
//!
//! # Roles and lists
//! See `film.rs`. Conditioning cameras are inputs of their frames, whichever views the options select for training.
//!
//! # Alpha
//! The alpha of an image is its mask; without alpha `masks/CAMERA/FRAME.png` is [`View::mask`], by which the view is cut out, so that
//! it is the view's alpha. Images of conditioning cameras need one of the two.

use std::path::Path;

use gs_core::Time;

use crate::error::{DataError, Place};
use crate::files::Root;
use crate::frames::{Listed, locate};
use crate::header;
use crate::mask;
use crate::options::DataOptions;
use crate::{Confidence, Dataset, ImageSource, Layout, View};

mod arrivals;
mod cameras;
mod film;
mod manifest;
pub(crate) mod points;
mod poses;
mod poses_bin;

pub use arrivals::{Arrivals, ArrivedFrame, PosesFrom};
pub use film::{Film, FilmFrame, FrameUse, Role, Shot, shot_name};

use cameras::{Crops, FilmCamera};
use manifest::Manifest;

/// The entry in [`crate::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "avatar",
    about: "a filmed person with a rigged template: scene.json, cameras.json, images/CAMERA/FRAME.png",
    probe,
    open,
};

/// Most missing images listed before the reader gives up.
const MAX_MISSING: usize = 4096;

fn probe(dir: &Path) -> Option<Confidence> {
    let both = dir.join("scene.json").is_file() && dir.join("cameras.json").is_file();
    both.then_some(Confidence::Certain)
}

/// Reads a film.
///
/// # Errors
/// See [`DataError`]; every error names file and field.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    options.without_images(LAYOUT.name)?;
    let root = Root::new(dir)?;
    let manifest = Manifest::read(&dir.join("scene.json"))?;
    let cameras = cameras::read(&dir.join("cameras.json"))?;
    let crops = Crops::read(&dir.join("crops.json"))?;
    let character = manifest.character(&root)?;
    let poses = poses::read(dir, &manifest, &character)?;
    let mut notes: Vec<String> =
        character.fallbacks.list().into_iter().map(|(what, n)| format!("template: {n} {what}")).collect();
    let mut shots = Shots::new(&root, options, &crops);
    let shots_of = shots.all(&manifest, &cameras)?;
    notes.append(&mut shots.notes);
    let has_alpha = shots.opaque == 0;
    notes.push(format!("{} of {} images have a mask in masks/, which is their alpha", shots.masked, shots_of.len()));
    let mut frames = Vec::with_capacity(manifest.lists.len());
    for ((&number, &list), (pose, true_morphs)) in manifest.lists.iter().zip(poses) {
        let points = points::find(&root, number)?;
        frames.push(FilmFrame { number, list, pose, true_morphs, points });
    }
    let film = Film {
        root: dir.to_path_buf(),
        layout: LAYOUT.name,
        place: Place::new(&manifest.file, "splits.train"),
        character,
        skinning: manifest.skinning,
        fps: manifest.fps,
        frames,
        shots: shots_of,
        has_alpha,
        notes,
    };
    film.into_dataset(options)
}

/// State of listing the images.
struct Shots<'a> {
    root: &'a Root,
    options: &'a DataOptions,
    crops: &'a Crops,
    notes: Vec<String>,
    opaque: usize,
    masked: usize,
}

impl<'a> Shots<'a> {
    fn new(root: &'a Root, options: &'a DataOptions, crops: &'a Crops) -> Self {
        Self { root, options, crops, notes: Vec::new(), opaque: 0, masked: 0 }
    }

    /// Every image of the frames in `manifest.lists`, camera after camera.
    fn all(&mut self, manifest: &Manifest, cameras: &[FilmCamera]) -> Result<Vec<Shot>, DataError> {
        let mut missing = Vec::new();
        let mut shots = Vec::new();
        let total = cameras.len() * manifest.lists.len();
        for camera in cameras {
            for &number in manifest.lists.keys() {
                let listed = self.locate(camera.id, number)?;
                if listed.path.is_file() {
                    shots.push(self.shot(camera, number, listed)?);
                    continue;
                }
                missing.push(listed.shown);
                if missing.len() > MAX_MISSING {
                    return Err(DataError::Missing { listed_in: manifest.file.clone(), missing, total });
                }
            }
        }
        if !missing.is_empty() {
            let error = DataError::Missing { listed_in: manifest.file.clone(), missing, total };
            if !self.options.allow_missing {
                return Err(error);
            }
            self.notes.push(format!("{error} (left out, as data.allow_missing asks)"));
        }
        Ok(shots)
    }

    fn locate(&self, camera: u32, number: u32) -> Result<Listed<()>, DataError> {
        let written = format!("images/{camera:03}/{number:06}");
        let (shown, path) = locate(self.root, &written, &Place::new(self.root.dir(), written.as_str()))?;
        Ok(Listed { shown, path, rest: () })
    }

    fn shot(&mut self, camera: &FilmCamera, number: u32, listed: Listed<()>) -> Result<Shot, DataError> {
        let header = header::read(&listed.path)?;
        let (pinhole, lens) = camera.of_image(&header, &listed.path, self.crops.at(number, camera.id), self.options)?;
        let image = ImageSource::File(listed.path);
        let mut view = View::new(shot_name(camera.id, number), pinhole, Time::default(), image, camera.id);
        view.lens = lens;
        if !header.has_alpha {
            let written = format!("masks/{:03}/{number:06}.png", camera.id);
            let file = self.root.resolve(&written, &Place::new(self.root.dir(), written.as_str()))?;
            if file.is_file() {
                mask::check(&file, [view.camera.width, view.camera.height])?;
                (view.mask, view.cut_out) = (Some(ImageSource::File(file)), true);
                self.masked += 1;
            } else if camera.role == Role::Cond {
                return Err(DataError::Field {
                    place: Place::new(&file, ""),
                    value: format!("missing, and {} has no alpha", listed.shown.display()),
                    why: "an input says by alpha or mask where the person is",
                    fix: "write images of conditioning cameras with alpha, or add the mask",
                });
            }
            self.opaque += 1;
        }
        Ok(Shot { number, role: camera.role, view })
    }
}
