//! `cameras.json` and `crops.json`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::{DMat4, DVec2};
use gs_core::Camera;
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::Role;
use crate::error::{DataError, Place};
use crate::files::read_text;
use crate::header::ImageHeader;
use crate::intrinsics::Intrinsics;
use crate::json::{Fields, quote_non_finite, read_object, whole};
use crate::lens::Lens;
use crate::options::DataOptions;
use crate::pose::{Pose, from_world_to_camera};

/// Largest list of cameras, and largest camera; a usual one has 700 bytes.
const MAX_BYTES: u64 = 8 << 20;
const MAX_CAMERA_BYTES: usize = 64 << 10;
/// Largest table of crops; it is parsed at once.
const MAX_CROPS_BYTES: u64 = 8 << 20;

/// A camera of the film, at the size of its sensor.
pub(super) struct FilmCamera {
    pub(super) id: u32,
    pub(super) role: Role,
    intrinsics: Intrinsics,
    pose: Pose,
    place: Place,
}

/// Reads all cameras, ascending in id.
pub(super) fn read(file: &Path) -> Result<Vec<FilmCamera>, DataError> {
    let text = read_text(file, MAX_BYTES)?;
    let text = quote_non_finite(&text);
    let broken = |e: serde_json::Error| {
        DataError::syntax(file, format!("line {}, column {}", e.line(), e.column()), e.to_string())
    };
    let list: Vec<&RawValue> = serde_json::from_str(&text).map_err(broken)?;
    let mut cameras = Vec::with_capacity(list.len());
    let mut ids = BTreeSet::new();
    for (i, raw) in list.into_iter().enumerate() {
        let at = format!("[{i}]");
        if raw.get().len() > MAX_CAMERA_BYTES {
            let place = Place::new(file, at);
            return Err(DataError::TooLarge { place, bytes: raw.get().len() as u64, limit: MAX_CAMERA_BYTES as u64 });
        }
        let map: Map<String, Value> = serde_json::from_str(raw.get())
            .map_err(|e| DataError::syntax(file, at.clone(), format!("a camera is an object: {e}")))?;
        let fields = Fields::new(file, at, &map);
        let camera = camera(&fields, map.get("dist"))?;
        if !ids.insert(camera.id) {
            return Err(fields.fault("id", &camera.id.to_string(), "two cameras have it", "give each camera its own"));
        }
        cameras.push(camera);
    }
    cameras.sort_by_key(|c| c.id);
    if cameras.is_empty() {
        return Err(DataError::Empty { file: file.to_path_buf() });
    }
    if !cameras.iter().any(|c| c.role == Role::Cond) {
        return Err(DataError::Field {
            place: Place::new(file, "role"),
            value: "\"cond\" for no camera".into(),
            why: "a film of a person needs conditioning cameras, the inputs of every frame",
            fix: "give some cameras the role cond; they train, too",
        });
    }
    Ok(cameras)
}

fn camera(fields: &Fields, dist: Option<&Value>) -> Result<FilmCamera, DataError> {
    let id = number(fields, "id", u32::MAX)?;
    let [w, h] = ["w", "h"].map(|key| number(fields, key, gs_core::camera::MAX_SIDE));
    let (w, h) = (w?, h?);
    let size = DVec2::new(f64::from(w), f64::from(h));
    let missing = |key, what| fields.fault(key, "missing", what, "add the field");
    let k: [f64; 9] =
        fields.numbers("K")?.ok_or_else(|| missing("K", "it is the list of 9 of a calibration matrix"))?;
    if [k[3], k[6], k[7], k[8]] != [0.0, 0.0, 0.0, 1.0] || k[0] <= 0.0 || k[4] <= 0.0 {
        let why = "a calibration matrix is [fx, s, cx, 0, fy, cy, 0, 0, 1] with positive focal lengths";
        return Err(fields.fault("K", &format!("{k:?}"), why, "export the calibration again"));
    }
    let e: [f64; 16] = fields.numbers("E")?.ok_or_else(|| missing("E", "it is the list of 16 of world to camera"))?;
    if e[12..] != [0.0, 0.0, 0.0, 1.0] {
        let why = "a rigid transform has 4 rows of 4 numbers, the last 0 0 0 1";
        return Err(fields.fault("E", &format!("{:?}", &e[12..]), why, "export the matrix again"));
    }
    let rows = [0, 4, 8].map(|r| [e[r], e[r + 1], e[r + 2], e[r + 3]]);
    let pose = from_world_to_camera(&rows, &fields.place("E"))?;
    let centre = match fields.text("pixel_center")?.unwrap_or("half") {
        "half" => 0.0,
        "integer" => 0.5,
        other => return Err(fields.fault("pixel_center", other, "it is \"half\" or \"integer\"", "correct the text")),
    };
    let role = fields.required_text("role")?;
    let role = Role::NAMES.iter().find(|(name, _)| *name == role).map(|(_, role)| *role);
    let role = role.ok_or_else(|| {
        let value = fields.text("role").ok().flatten().unwrap_or_default();
        fields.fault("role", value, "a camera is for \"train\", \"cond\" or \"test\"", "correct the text")
    })?;
    let lens = Lens { skew: k[1] / k[0], ..lens(fields, dist)? };
    let principal = DVec2::new(k[2], k[5]) + centre;
    let intrinsics = Intrinsics { size, focal: DVec2::new(k[0], k[4]), principal, lens };
    Ok(FilmCamera { id, role, intrinsics, pose, place: fields.place("K") })
}

/// A whole number from 0 to `most`, which must be there.
fn number(fields: &Fields, key: &str, most: u32) -> Result<u32, DataError> {
    let value = fields.required_number(key)?;
    let why = "it is a whole number, not too large";
    whole(value, 0..=most).ok_or_else(|| fields.fault(key, &value.to_string(), why, "correct the number"))
}

/// OpenCV's `[k1, k2, p1, p2]` with or without `k3`.
fn lens(fields: &Fields, dist: Option<&Value>) -> Result<Lens, DataError> {
    let [k1, k2, p1, p2, k3] = match dist {
        None | Some(Value::Null) => return Ok(Lens::default()),
        Some(Value::Array(list)) if list.len() == 5 => fields.numbers::<5>("dist")?.unwrap_or_default(),
        Some(Value::Array(list)) if list.len() == 4 => {
            let [k1, k2, p1, p2] = fields.numbers::<4>("dist")?.unwrap_or_default();
            [k1, k2, p1, p2, 0.0]
        }
        Some(Value::Array(list)) => {
            let model = format!("with {} distortion coefficients", list.len());
            return Err(DataError::CameraModel { place: fields.place("dist"), model });
        }
        Some(other) => {
            return Err(DataError::CameraModel { place: fields.place("dist"), model: format!("with dist {other}") });
        }
    };
    Ok(Lens { k1, k2, k3, p1, p2, ..Lens::default() })
}

impl FilmCamera {
    /// The camera of an image and its lens. An image of a part of the sensor begins at the pixel `crop`.
    ///
    /// # Errors
    /// `data.image_size`, `data.field`, `data.camera_model` as for every layout.
    pub(super) fn of_image(
        &self,
        header: &ImageHeader,
        file: &Path,
        crop: Option<[f64; 2]>,
        options: &DataOptions,
    ) -> Result<(Camera, Option<Lens>), DataError> {
        let lens = self.intrinsics.lens(options.undistort, &self.place)?;
        let Some(corner) = crop else {
            return Ok((self.intrinsics.camera(header, file, &self.pose, &self.place)?.0, lens));
        };
        let mut viewmat = DMat4::from_mat3(self.pose.rotation);
        viewmat.w_axis = self.pose.translation.extend(1.0);
        let principal = self.intrinsics.principal - DVec2::from_array(corner);
        let camera = Camera::from_viewmat(header.width, header.height, self.intrinsics.focal, principal, viewmat);
        Ok((camera.map_err(|e| DataError::camera(&self.place, &e))?, lens))
    }
}

/// First pixels `[x0, y0]` of images that are parts of their sensors, by frame and camera.
#[derive(Default)]
pub(super) struct Crops(BTreeMap<(u32, u32), [f64; 2]>);

impl Crops {
    /// Reads the table; empty if the file is absent.
    pub(super) fn read(file: &Path) -> Result<Self, DataError> {
        let mut crops = Self::default();
        if !file.is_file() {
            return Ok(crops);
        }
        let frames = read_object(file, MAX_CROPS_BYTES)?;
        let all = Fields::new(file, "", &frames);
        for (frame, cameras) in &frames {
            let number = key(&all, frame)?;
            let why = "a frame is an object of cameras";
            let of_frame =
                cameras.as_object().ok_or_else(|| all.fault(frame, &cameras.to_string(), why, "correct it"))?;
            let fields = Fields::new(file, frame, of_frame);
            for camera in of_frame.keys() {
                if let Some(corner) = fields.numbers::<2>(camera)? {
                    crops.0.insert((number, key(&fields, camera)?), corner);
                }
            }
        }
        Ok(crops)
    }

    /// The first pixel of an image that is a part of its sensor.
    pub(super) fn at(&self, frame: u32, camera: u32) -> Option<[f64; 2]> {
        self.0.get(&(frame, camera)).copied()
    }
}

/// A key that is a whole number.
pub(super) fn key(fields: &Fields, text: &str) -> Result<u32, DataError> {
    text.parse().map_err(|_| fields.fault(text, "a key", "keys are whole numbers, of frames or cameras", "correct it"))
}
