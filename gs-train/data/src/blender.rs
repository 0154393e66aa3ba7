//! D-NeRF and Blender scenes: `transforms_{train,val,test}.json` (Mildenhall et al. 2020; Pumarola et al. 2021).
//!
//! Top level `camera_angle_x` (horizontal field of view, radians); per frame `file_path` (with or without extension),
//! `transform_matrix` (camera to world, OpenGL axes) and, for moving scenes, `time`, which D-NeRF keeps in 0..1. The
//! principal point is the centre, pixels are square: `f = W / (2 tan(angle / 2))`. Where the file or a frame states more, the
//! intrinsics and the lens are read as those of [`super::nerfstudio`]. `val` and `test` may be absent. Views of one pose are of
//! one camera.
//!
//! Folders whose test views are all later than the training views, or whose `scene.toml` states a boundary, are read by [`super::nvfi`].

use std::path::Path;

use glam::Vec3;
use gs_core::{Camera, Time, cast};

use super::error::{DataError, Place};
use super::files::{Root, read_text};
use super::frames::{Listed, locate, name_views, share_cameras, with_headers};
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, PartialIntrinsics};
use super::json::{Document, Fields, MAX_JSON_BYTES, quote_non_finite};
use super::lens::Lens;
use super::options::{DataOptions, TimeRange};
use super::pose::{Pose, from_opengl};
use super::times::{Draft, Drafts, settle};
use super::{Confidence, Dataset, ImageSource, Layout, View};

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "blender",
    about: "D-NeRF and Blender scenes: transforms_train.json, optional transforms_val.json and transforms_test.json",
    probe,
    open,
};

/// Half side of the scene box (Kerbl et al. 2023, random initialisation of Blender scenes).
const HALF_SIDE: f32 = 1.3;

fn probe(dir: &Path) -> Option<Confidence> {
    dir.join("transforms_train.json").is_file().then_some(Confidence::Certain)
}

/// Reads a scene.
///
/// # Errors
/// See [`DataError`]; every error names file and field.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    options.without_images(LAYOUT.name)?;
    options.without_fps(LAYOUT.name)?;
    let root = Root::new(dir)?;
    let mut notes = Vec::new();
    let train_file = dir.join("transforms_train.json");
    let train = read_split(&root, &train_file, options, &mut notes)?;
    if train.drafts.is_empty() {
        return Err(DataError::Empty { file: train_file });
    }
    let has_alpha = train.has_alpha;
    let mut other = |split: &str| {
        let file = dir.join(format!("transforms_{split}.json"));
        if file.exists() {
            read_split(&root, &file, options, &mut notes).map(|s| s.drafts)
        } else {
            notes.push(format!("there is no transforms_{split}.json: the {split} split is empty"));
            Ok(Vec::new())
        }
    };
    let (val, test) = (other("val")?, other("test")?);
    let mut drafts = Drafts { train: train.drafts, val, test };
    share_cameras(&mut drafts);
    let settled = settle(drafts, options, Some(TimeRange { start: 0.0, end: 1.0 }))?;
    Ok(Dataset {
        bounds: Some([Vec3::splat(-HALF_SIDE), Vec3::splat(HALF_SIDE)]),
        ..settled.dataset(dir, LAYOUT.name, has_alpha, notes)
    })
}

struct SplitRead {
    drafts: Vec<Draft>,
    has_alpha: bool,
}

/// Fields of a frame beside its image.
pub(super) struct Frame {
    pub(super) pose: Pose,
    pub(super) stated: PartialIntrinsics,
    pub(super) time: Option<f64>,
    pub(super) time_place: Place,
    pub(super) place: Place,
}

impl Frame {
    /// Camera and lens of the frame's image, counted.
    pub(super) fn camera(
        &self,
        header: &ImageHeader,
        file: &Path,
        options: &DataOptions,
        adjusted: &mut Adjusted,
    ) -> Result<(Camera, Option<Lens>), DataError> {
        let intrinsics = self.stated.complete(header, &self.place)?;
        adjusted.fit(&intrinsics, header, file, &self.pose, &self.place, options.undistort)
    }
}

fn read_split(
    root: &Root,
    file: &Path,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<SplitRead, DataError> {
    let text = read_text(file, MAX_JSON_BYTES)?;
    let text = quote_non_finite(&text);
    let document = Document::parse(file, &text)?;
    let shared = PartialIntrinsics::shared(&document.top())?;
    let frame = |i| read_frame(root, &document.frame(i)?, "file_path", &shared);
    let frames = (0..document.len()).map(frame).collect::<Result<Vec<_>, _>>()?;
    let frames = with_headers(file, frames, options, notes)?;
    let has_alpha = frames.iter().any(|(_, h)| h.has_alpha);
    let shown: Vec<_> = frames.iter().map(|(f, _)| f.shown.clone()).collect();
    let mut adjusted = Adjusted::default();
    let mut drafts = Vec::with_capacity(frames.len());
    for (k, (listed, header)) in frames.into_iter().enumerate() {
        let frame = listed.rest;
        let (camera, lens) = frame.camera(&header, &listed.path, options, &mut adjusted)?;
        let mut view = View::new("", camera, Time::default(), ImageSource::File(listed.path), cast::to_u32(k));
        view.lens = lens;
        drafts.push(Draft { view, stated: frame.time, place: frame.time_place });
    }
    notes.extend(adjusted.notes());
    name_views(&mut drafts, &shown);
    Ok(SplitRead { drafts, has_alpha })
}

/// Reads a frame whose image is named in the field `image`; `shared` are the intrinsics of all frames.
pub(super) fn read_frame(
    root: &Root,
    frame: &Fields,
    image: &str,
    shared: &PartialIntrinsics,
) -> Result<Listed<Frame>, DataError> {
    let (shown, path) = locate(root, frame.required_text(image)?, &frame.place(image))?;
    let rest = Frame {
        pose: from_opengl(&frame.matrix("transform_matrix")?, &frame.place("transform_matrix"))?,
        stated: PartialIntrinsics::of_frame(frame, shared)?,
        time: frame.number("time")?,
        time_place: frame.place("time"),
        place: frame.place(""),
    };
    Ok(Listed { shown, path, rest })
}
