//! Intrinsics as files state them, rescaled to the size of the image file.

use glam::{DMat4, DVec2, swizzles::Vec2Swizzles};
use gs_core::{Camera, cast};

use super::decode::quarter_turn;
use super::error::{DataError, Place};
use super::header::ImageHeader;
use super::json::Fields;
use super::lens::Lens;
use super::pose::Pose;

/// Intrinsics and the image size that they refer to, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Intrinsics {
    pub(crate) size: DVec2,
    pub(crate) focal: DVec2,
    pub(crate) principal: DVec2,
    pub(crate) lens: Lens,
}

/// The factors on width and height may differ by this share: sizes are whole pixels.
const ASPECT_SLACK: f64 = 0.01;

/// Whether two sizes have one aspect ratio.
pub(crate) fn same_shape(a: DVec2, b: DVec2) -> bool {
    let scale = a / b;
    (scale.x / scale.y - 1.0).abs() <= ASPECT_SLACK
}

/// What was done to fit a camera and its image to each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Fitted {
    /// The intrinsics were rescaled.
    pub(crate) rescaled: bool,
    /// The image is turned as its EXIF orientation says.
    pub(crate) turned: bool,
}

impl Intrinsics {
    /// The camera of an image, and what was done to fit them: intrinsics are rescaled, each axis by the exact ratio of
    /// sizes; an image whose sides have the wrong order is turned if its EXIF orientation says so. The lens acts on the plane
    /// `z = 1` and does not change.
    ///
    /// # Errors
    /// `data.image_size` if the image has another shape, `data.field` if the camera is out of its domain.
    pub(crate) fn camera(
        &self,
        header: &ImageHeader,
        file: &std::path::Path,
        pose: &Pose,
        place: &Place,
    ) -> Result<(Camera, Fitted), DataError> {
        let stored = DVec2::new(f64::from(header.width), f64::from(header.height));
        // Some programs pose the pixels as they are stored, others the upright image: the size of the camera tells.
        let turned =
            !same_shape(stored, self.size) && same_shape(stored.yx(), self.size) && quarter_turn(file).is_some();
        let (size, [width, height]) = match turned {
            true => (stored.yx(), [header.height, header.width]),
            false => (stored, [header.width, header.height]),
        };
        let scale = size / self.size;
        if !same_shape(size, self.size) {
            let want = [self.size.x, self.size.y].map(|side| u32::try_from(cast::to_usize(side)).unwrap_or(u32::MAX));
            return Err(DataError::ImageSize { file: file.to_path_buf(), got: [header.width, header.height], want });
        }
        let mut viewmat = DMat4::from_mat3(pose.rotation);
        viewmat.w_axis = pose.translation.extend(1.0);
        let (focal, principal) = (self.focal * scale, self.principal * scale);
        let camera =
            Camera::from_viewmat(width, height, focal, principal, viewmat).map_err(|e| DataError::camera(place, &e))?;
        Ok((camera, Fitted { rescaled: scale != DVec2::ONE, turned }))
    }

    /// The lens to remove, or none for a pinhole.
    ///
    /// # Errors
    /// `data.camera_model` if it distorts and undistortion is switched off.
    pub(crate) fn lens(&self, undistort: bool, place: &Place) -> Result<Option<Lens>, DataError> {
        if self.lens.is_pinhole() {
            return Ok(None);
        }
        if !undistort {
            let Lens { fisheye, k1, k2, k3, k4, p1, p2, skew } = self.lens;
            let kind = if fisheye { "fisheye" } else { "distortion" };
            let model = format!(
                "with {kind} k1 {k1}, k2 {k2}, k3 {k3}, k4 {k4}, p1 {p1}, p2 {p2}, skew {skew} (data.undistort is false)"
            );
            return Err(DataError::CameraModel { place: place.clone(), model });
        }
        Ok(Some(self.lens))
    }
}

/// The intrinsics that an object of a `transforms*.json` states, each optional.
#[derive(Clone, Copy, Default)]
pub(crate) struct PartialIntrinsics {
    fl: [Option<f64>; 2],
    angle: [Option<f64>; 2],
    principal: [Option<f64>; 2],
    size: [Option<f64>; 2],
    /// `k1 k2 k3 p1 p2 k4`.
    lens: [Option<f64>; 6],
    fisheye: bool,
}

impl PartialIntrinsics {
    /// Those of all frames. Camera models other than pinhole, OpenCV's and its fisheye are refused.
    ///
    /// # Errors
    /// `data.camera_model`, `data.field`.
    pub(crate) fn shared(top: &Fields) -> Result<Self, DataError> {
        let fisheye = match top.text("camera_model")? {
            None | Some("OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "PERSPECTIVE") => false,
            Some("OPENCV_FISHEYE") => true,
            Some(other) => {
                return Err(DataError::CameraModel { place: top.place("camera_model"), model: other.into() });
            }
        };
        Self::read(top, fisheye)
    }

    /// Those of a frame, else the shared ones.
    ///
    /// # Errors
    /// `data.camera_model`, `data.field`.
    pub(crate) fn of_frame(frame: &Fields, shared: &Self) -> Result<Self, DataError> {
        fn first<const N: usize>(own: [Option<f64>; N], shared: [Option<f64>; N]) -> [Option<f64>; N] {
            std::array::from_fn(|k| own[k].or(shared[k]))
        }
        let own = Self::read(frame, shared.fisheye)?;
        Ok(Self {
            fl: first(own.fl, shared.fl),
            angle: first(own.angle, shared.angle),
            principal: first(own.principal, shared.principal),
            size: first(own.size, shared.size),
            lens: first(own.lens, shared.lens),
            fisheye: own.fisheye,
        })
    }

    fn read(o: &Fields, fisheye: bool) -> Result<Self, DataError> {
        // What instant-ngp's scripts write beside the model.
        let fisheye = fisheye || o.flag("is_fisheye")?;
        let n = |key| o.number(key);
        let pair = |a, b| Ok::<_, DataError>([n(a)?, n(b)?]);
        let foreign: &[&'static str] = if fisheye { &["k5", "k6", "p1", "p2"] } else { &["k4", "k5", "k6"] };
        for key in foreign {
            if let Some(v) = o.number(key)?.filter(|&v| v != 0.0) {
                return Err(DataError::CameraModel { place: o.place(key), model: format!("with {key} = {v}") });
            }
        }
        let stated = Self {
            fl: pair("fl_x", "fl_y")?,
            angle: pair("camera_angle_x", "camera_angle_y")?,
            principal: pair("cx", "cy")?,
            size: pair("w", "h")?,
            lens: [n("k1")?, n("k2")?, n("k3")?, n("p1")?, n("p2")?, n("k4")?],
            fisheye,
        };
        let positive = "it must be positive";
        for (value, key) in stated.size.iter().chain(&stated.fl).zip(["w", "h", "fl_x", "fl_y"]) {
            if let Some(v) = value.filter(|&v| v <= 0.0) {
                return Err(o.fault(key, &v.to_string(), positive, "correct the number"));
            }
        }
        for (value, key) in stated.angle.iter().zip(["camera_angle_x", "camera_angle_y"]) {
            if let Some(v) = value.filter(|v| !(*v > 0.0 && *v < std::f64::consts::PI)) {
                return Err(o.fault(
                    key,
                    &v.to_string(),
                    "a field of view lies between 0 and pi",
                    "correct the number",
                ));
            }
        }
        Ok(stated)
    }

    /// Whether the focal length or the principal point is in pixels of an image whose size is not stated.
    pub(crate) fn counts_pixels_of_no_size(&self) -> bool {
        self.size.contains(&None) && self.fl.iter().chain(&self.principal).any(Option::is_some)
    }

    /// Missing sizes are the image's, a missing principal point is the centre, a missing focal length comes from the field
    /// of view, a missing second one equals the first.
    ///
    /// # Errors
    /// `data.field` if there is neither a focal length nor a field of view.
    pub(crate) fn complete(&self, header: &ImageHeader, place: &Place) -> Result<Intrinsics, DataError> {
        let image = [f64::from(header.width), f64::from(header.height)];
        let size = [0, 1].map(|k| self.size[k].unwrap_or(image[k]));
        let from_angle = |k: usize| self.angle[k].map(|a: f64| 0.5 * size[k] / (0.5 * a).tan());
        let focal = [0, 1].map(|k| self.fl[k].or(from_angle(k)));
        let (Some(fx), Some(fy)) = (focal[0].or(focal[1]), focal[1].or(focal[0])) else {
            return Err(DataError::Field {
                place: place.clone(),
                value: "without focal length".into(),
                why: "neither fl_x nor camera_angle_x is given, for all frames or for this one",
                fix: "add fl_x, fl_y, cx, cy, w and h",
            });
        };
        let principal = [0, 1].map(|k| self.principal[k].unwrap_or(0.5 * size[k]));
        let [k1, k2, k3, p1, p2, k4] = self.lens.map(Option::unwrap_or_default);
        Ok(Intrinsics {
            size: size.into(),
            focal: DVec2::new(fx, fy),
            principal: principal.into(),
            lens: Lens { fisheye: self.fisheye, k1, k2, k3, k4, p1, p2, skew: 0.0 },
        })
    }
}

/// Counts of rescaled and undistorted views, for the notes of a data set.
#[derive(Default)]
pub(crate) struct Adjusted {
    rescaled: usize,
    example: Option<(DVec2, [u32; 2])>,
    turned: usize,
    undistorted: usize,
    worst_outside: f64,
}

impl Adjusted {
    /// Camera and lens of an image, counted.
    ///
    /// # Errors
    /// Those of [`Intrinsics::camera`] and [`Intrinsics::lens`].
    pub(crate) fn fit(
        &mut self,
        intrinsics: &Intrinsics,
        header: &ImageHeader,
        file: &std::path::Path,
        pose: &Pose,
        place: &Place,
        undistort: bool,
    ) -> Result<(Camera, Option<Lens>), DataError> {
        let (camera, fitted) = intrinsics.camera(header, file, pose, place)?;
        let lens = intrinsics.lens(undistort, place)?;
        self.count(intrinsics, &camera, fitted, lens.as_ref());
        Ok((camera, lens))
    }

    fn count(&mut self, intrinsics: &Intrinsics, camera: &Camera, fitted: Fitted, lens: Option<&Lens>) {
        self.turned += usize::from(fitted.turned);
        if fitted.rescaled {
            self.rescaled += 1;
            self.example.get_or_insert((intrinsics.size, [camera.width, camera.height]));
        }
        if let Some(lens) = lens {
            self.undistorted += 1;
            // Views of one camera have the same share; a few of them are enough.
            if self.undistorted <= 8 {
                self.worst_outside = self.worst_outside.max(lens.outside_fraction(camera));
            }
        }
    }

    /// The sentences for [`super::Dataset::notes`].
    pub(crate) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some((from, to)) = self.example {
            let (w, h) = (from.x, from.y);
            let n = self.rescaled;
            notes.push(format!(
                "{n} images differ in size from their camera ({w}x{h} against {}x{}): intrinsics rescaled",
                to[0], to[1]
            ));
        }
        if self.turned > 0 {
            notes.push(format!(
                "{} images lie on their side and are turned as their EXIF orientation says: their cameras are upright",
                self.turned
            ));
        }
        if self.undistorted > 0 {
            let percent = 100.0 * self.worst_outside;
            let n = self.undistorted;
            notes.push(format!("{n} views are resampled to a pinhole; up to {percent:.1} % of their pixels lie outside the distorted image and repeat its edge"));
        }
        notes
    }
}

/// Splits indices into training and held-out views: every `hold_out`-th in order of names, starting with the first, is
/// held out, as in Mip-NeRF 360 and Kerbl et al. 2023. 0 holds out none; a single view is never held out.
pub(crate) fn hold_out(names: &[String], every: u32) -> (Vec<usize>, Vec<usize>) {
    let mut order: Vec<usize> = (0..names.len()).collect();
    order.sort_by(|&a, &b| names[a].cmp(&names[b]).then(a.cmp(&b)));
    let held = |rank: usize| every > 0 && names.len() > 1 && rank.is_multiple_of(every as usize);
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (rank, index) in order.into_iter().enumerate() {
        if held(rank) { test.push(index) } else { train.push(index) }
    }
    (train, test)
}

/// The note for [`hold_out`].
pub(crate) fn hold_out_note(every: u32, held: usize) -> String {
    if every == 0 {
        "the data give no split and data.hold_out is 0: all views train".into()
    } else {
        format!("the data give no split: every {every}th view in order of names is held out ({held} test views)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_eighth_name_is_held_out() {
        let names: Vec<String> = (0..20).rev().map(|k| format!("{k:02}")).collect();
        let (train, test) = hold_out(&names, 8);
        assert_eq!(test.iter().map(|&i| names[i].as_str()).collect::<Vec<_>>(), ["00", "08", "16"]);
        assert_eq!((train.len(), names[train[0]].as_str()), (17, "01"));
        assert_eq!(hold_out(&names, 0).1.len(), 0);
        assert_eq!(hold_out(&names[..1], 8).0.len(), 1);
        assert_eq!(hold_out(&names, 1).0.len(), 0, "the caller reports that no training view is left");
    }
}
