//! Intrinsics as files state them, rescaled to the size of the image file.

use glam::{DMat4, DVec2, swizzles::Vec2Swizzles};
use gs_core::{Camera, cast};

use super::decode::quarter_turn;
use super::error::{DataError, Place};
use super::header::ImageHeader;
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
    /// Counts one view.
    pub(crate) fn count(&mut self, intrinsics: &Intrinsics, camera: &Camera, fitted: Fitted, lens: Option<&Lens>) {
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
