//! Nerfies, HyperNeRF and DyCheck (iPhone) captures (Park et al. 2021a, 2021b; Gao et al. 2022): one moving camera, two on a
//! rig, or one that moves and two static ones.
//!
//! `dataset.json` lists `ids`, `train_ids`, `val_ids`; `metadata.json` gives each id its `time_id` (or `warp_id`) and
//! `camera_id`; `scene.json` holds `center` and `scale`; `camera/<id>.json` one camera; `rgb/<s>x/<id>.png` its image at
//! `1/s` of full size; `points.npy`, optional, `P × 3` points. DyCheck adds `splits/{train,val}.json`, `extra.json`,
//! `covisible/2x/val/<id>.png`, the masks of held-out images, and `depth/<s>x/<id>.npy` (metres along the optical axis).
//!
//! # Geometry
//! `orientation` is the rotation from world to camera with OpenCV axes, `position` the camera's centre. Cameras and points
//! are transformed to the normalised frame, `x ← (x − center) · scale`, unless `data.normalise` is false. With `(x', y')` the
//! distorted point of the plane `z = 1` ([`super::lens`]; the files write the tangential pair as `p1 p2`),
//! ```text
//! u = focal_length · x' + skew · y' + cx        v = focal_length · pixel_aspect_ratio · y' + cy
//! ```
//! with pixel centres at +½. Intrinsics scale with the exact ratio of the image's size to `image_size`.
//! `data.center_pp` uses the focal length alone, for comparison with 4DGaussians: principal point in the centre, square
//! pixels, no skew, no distortion.
//!
//! # Splits and times
//! `splits/` gives the split where it exists. Else, where `val_ids` is not empty (`vrig` and DyCheck captures), `train_ids` train and
//! `val_ids` are held out; else (`interp` captures) of `ids` numbers 0, 4, 8, … train and 2, 6, 10, … are held out, as far as one
//! that trains follows.
//! `t = time_id / max(time_id)` over all ids; the clock counts ids, or seconds where `data.fps` or `extra.json` gives a rate.
//!
//! Alpha, which DyCheck uses for pixels without depth, is ignored.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use gs_core::Time;

use super::error::{DataError, Place};
use super::files::Root;
use super::frames::{Listed, image_folder, locate, name_views, with_headers};
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, Intrinsics};
use super::json::{Fields, read_object};
use super::lens::Lens;
use super::options::{DataOptions, TimeFrom, TimeRange};
use super::pose::{Pose, from_axes};
use super::times::{Draft, Drafts, settle};
use super::{Confidence, Dataset, DepthMap, ImageSource, Layout, View, mask};

mod frame;
mod lists;

use frame::{Extra, Frame};
use lists::{Ids, Lists, Tag, Tags};

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "hypernerf",
    about: "Nerfies, HyperNeRF and DyCheck: dataset.json, metadata.json, scene.json, camera/ID.json and rgb/2x/ID.png",
    probe,
    open,
};

/// Image folders, the size of published results first.
const IMAGE_FOLDERS: [&str; 5] = ["rgb/2x", "rgb/1x", "rgb/4x", "rgb/8x", "rgb/16x"];
/// Largest `scene.json` and camera file; usual ones have under 1 kB.
const MAX_SMALL_BYTES: u64 = 64 << 10;
/// Folders of the masks of held-out views.
const MASK_FOLDERS: [&str; 3] = ["covisible/2x/val", "covisible/1x/val", "covisible/4x/val"];

fn probe(dir: &Path) -> Option<Confidence> {
    let files = ["dataset.json", "metadata.json"].iter().all(|name| dir.join(name).is_file());
    (files && dir.join("camera").is_dir()).then_some(Confidence::Certain)
}

/// Reads a capture.
///
/// # Errors
/// See [`DataError`]; every error names file and field.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    let root = Root::new(dir)?;
    let mut notes = Vec::new();
    let scene = dir.join("scene.json");
    let frame = Frame::read(&scene, options.normalise)?;
    let extra = Extra::read(&dir.join("extra.json"))?;
    let lists = Lists::read(dir, &mut notes)?;
    let tags = Tags::read(&dir.join("metadata.json"), &mut notes)?;
    let rate = options.fps.or(extra.as_ref().and_then(|e| e.fps)).unwrap_or(1.0);
    let last = lists.last_time(&tags)? / rate;
    let folder = image_folder(&root, options, &IMAGE_FOLDERS, "it is a HyperNeRF capture without images")?;
    notes.push(format!("images come from \"{folder}\""));
    if options.center_pp {
        notes.push("principal point, aspect, skew and distortion are left out, as data.center_pp asks".into());
    }
    let reader = Reader { root: &root, folder: &folder, frame: &frame, tags: &tags, options, rate };
    let train = reader.split(&lists.train, &mut notes)?;
    if train.is_empty() {
        return Err(DataError::Empty { file: lists.train.file.clone() });
    }
    let mut test = reader.split(&lists.test, &mut notes)?;
    reader.masks(&lists.test.file, &mut test, &mut notes)?;
    let by_tags = options.time_from == TimeFrom::File;
    let span = options.time_range.or((by_tags && last > 0.0).then_some(TimeRange { start: 0.0, end: last }));
    let timed = DataOptions { time_range: span, ..options.clone() };
    let mut settled = settle(Drafts { train, val: Vec::new(), test }, &timed, None)?;
    let points = frame.points(&root, &mut notes)?;
    let stated = extra.map(|e| e.bounds(&scene, options.normalise)).transpose()?.flatten();
    let bounds = if points.is_none() { stated.or_else(|| frame.bounds(&settled.train)) } else { None };
    if settled.dynamic && by_tags {
        settled.source = format!("{} of metadata.json", tags.key);
    }
    Ok(Dataset { points, bounds, ..settled.dataset(dir, LAYOUT.name, false, notes) })
}

/// Fields of an image beside its file.
struct ImageAt {
    pose: Pose,
    intrinsics: Intrinsics,
    depth: Option<DepthMap>,
    tag: Tag,
    place: Place,
    time_place: Place,
}

struct Reader<'a> {
    root: &'a Root,
    folder: &'a str,
    frame: &'a Frame,
    tags: &'a Tags,
    options: &'a DataOptions,
    /// Ids of time per unit of the clock.
    rate: f64,
}

impl Reader<'_> {
    /// The views of a list of ids.
    fn split(&self, list: &Ids, notes: &mut Vec<String>) -> Result<Vec<Draft>, DataError> {
        let listed = list.ids.iter().map(|id| self.image_at(&list.file, id)).collect::<Result<Vec<_>, _>>()?;
        let listed = with_headers(&list.file, listed, self.options, notes)?;
        if listed.iter().any(|(_, h)| h.has_alpha) {
            notes.push("images carry alpha, which is not used: it marks pixels without depth".into());
        }
        let shown: Vec<PathBuf> = listed.iter().map(|(l, _)| l.shown.clone()).collect();
        let mut adjusted = Adjusted::default();
        let mut drafts = Vec::with_capacity(listed.len());
        for (listed, header) in listed {
            drafts.push(self.draft(listed, &header, &mut adjusted)?);
        }
        notes.extend(adjusted.notes());
        name_views(&mut drafts, &shown);
        Ok(drafts)
    }

    /// Sets the masks of held-out views, which `listed_in` names, where files exist.
    fn masks(&self, listed_in: &Path, test: &mut [Draft], notes: &mut Vec<String>) -> Result<(), DataError> {
        let Some(folder) = MASK_FOLDERS.into_iter().find(|f| self.root.dir().join(f).is_dir()) else { return Ok(()) };
        let mut masked = 0;
        for draft in &mut *test {
            let name = format!("{folder}/{}.png", draft.view.name);
            let file = self.root.resolve(&name, &Place::new(listed_in, format!("id \"{}\"", draft.view.name)))?;
            if file.is_file() {
                mask::check(&file, draft.view.stored.unwrap_or([draft.view.camera.width, draft.view.camera.height]))?;
                draft.view.mask = Some(ImageSource::File(file));
                masked += 1;
            }
        }
        notes.push(format!("{masked} of {} held-out views have a mask in {folder}", test.len()));
        Ok(())
    }

    /// The depth file of an image, at its size, if it exists: metres of the raw frame.
    fn depth(&self, id: &str, listed_at: &Place) -> Result<Option<DepthMap>, DataError> {
        let Some(size) = self.folder.strip_prefix("rgb/") else { return Ok(None) };
        let file = self.root.resolve(&format!("depth/{size}/{id}.npy"), listed_at)?;
        Ok(file.is_file().then_some(DepthMap { file, unit: self.frame.scale }))
    }

    fn image_at(&self, listed_in: &Path, id: &str) -> Result<Listed<ImageAt>, DataError> {
        let listed_at = Place::new(listed_in, format!("id \"{id}\""));
        let (shown, path) = locate(self.root, &format!("{}/{id}", self.folder), &listed_at)?;
        let file = self.root.resolve(&format!("camera/{id}.json"), &listed_at)?;
        let map = read_object(&file, MAX_SMALL_BYTES)?;
        let fields = Fields::new(&file, "", &map);
        let rest = ImageAt {
            pose: self.pose(&fields)?,
            intrinsics: intrinsics(&fields, self.options.center_pp)?,
            depth: self.depth(id, &listed_at)?,
            tag: self.tags.of(id)?,
            place: fields.place(""),
            time_place: Place::new(&self.tags.file, format!("{id}.{}", self.tags.key)),
        };
        Ok(Listed { shown, path, rest })
    }

    fn pose(&self, camera: &Fields) -> Result<Pose, DataError> {
        let rows = camera.rows3("orientation")?.map(DVec3::from);
        let position = camera.numbers::<3>("position")?;
        let missing = || camera.fault("position", "missing", "it is the camera's centre", "export the cameras again");
        let centre = self.frame.place(position.ok_or_else(missing)?.into());
        // The rows of the rotation to the camera are the camera's axes in the world.
        let axes = DMat3::from_cols(rows[0], rows[1], rows[2]);
        from_axes(axes, centre, &camera.place("orientation"))
    }

    fn draft(
        &self,
        listed: Listed<ImageAt>,
        header: &ImageHeader,
        adjusted: &mut Adjusted,
    ) -> Result<Draft, DataError> {
        let shot = listed.rest;
        let undistort = self.options.undistort;
        let (camera, lens) =
            adjusted.fit(&shot.intrinsics, header, &listed.path, &shot.pose, &shot.place, undistort)?;
        let mut view = View::new("", camera, Time::default(), ImageSource::File(listed.path), shot.tag.camera);
        (view.lens, view.depth, view.opaque) = (lens, shot.depth, true);
        Ok(Draft { view, stated: Some(shot.tag.time / self.rate), place: shot.time_place })
    }
}

/// Intrinsics of a camera file at full size; with `centred` its focal length alone.
fn intrinsics(camera: &Fields, centred: bool) -> Result<Intrinsics, DataError> {
    let positive = |key: &str, value: f64| {
        let bad = || camera.fault(key, &value.to_string(), "it must be positive", "export the cameras again");
        if value > 0.0 { Ok(value) } else { Err(bad()) }
    };
    let pair = |key: &str| {
        let missing = || camera.fault(key, "missing", "it is part of the intrinsics", "export the cameras again");
        camera.numbers::<2>(key)?.ok_or_else(missing)
    };
    let size = pair("image_size")?;
    for side in size {
        positive("image_size", side)?;
    }
    let f = positive("focal_length", camera.required_number("focal_length")?)?;
    if centred {
        let size = DVec2::from(size);
        return Ok(Intrinsics { size, focal: DVec2::splat(f), principal: 0.5 * size, lens: Lens::default() });
    }
    let aspect = positive("pixel_aspect_ratio", camera.number("pixel_aspect_ratio")?.unwrap_or(1.0))?;
    let [k1, k2, k3] = camera.numbers("radial_distortion")?.unwrap_or_default();
    // Nerfies of 2021 wrote "tangential".
    let tangential = camera.numbers("tangential_distortion")?;
    let [p1, p2] = if tangential.is_some() { tangential } else { camera.numbers("tangential")? }.unwrap_or_default();
    let skew = camera.number("skew")?.unwrap_or(0.0) / f;
    Ok(Intrinsics {
        size: size.into(),
        focal: DVec2::new(f, f * aspect),
        principal: pair("principal_point")?.into(),
        lens: Lens { k1, k2, k3, p1, p2, skew, ..Lens::default() },
    })
}
