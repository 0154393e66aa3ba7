//! A sparse model by itself: the cameras of its images and its points, without the images.

use std::path::Path;

use glam::{DMat4, DVec2};
use gs_core::{Camera, cast};

use super::super::error::{DataError, Place};
use super::super::lens::Lens;
use super::super::view::PointCloud;
use super::{Model, pose};

/// An image of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Registered {
    /// Path of the image, as the model states it.
    pub name: String,
    /// Number of its camera in the model: images of one camera share intrinsics.
    pub camera_id: u32,
    /// Pinhole camera in the model's world, whose units are arbitrary.
    pub camera: Camera,
    /// Distortion of its lens.
    pub lens: Lens,
}

/// A sparse model of COLMAP.
#[derive(Clone, Debug, PartialEq)]
pub struct Reconstruction {
    /// Its images, in the order of the file.
    pub images: Vec<Registered>,
    /// Its points; none where the file is missing.
    pub points: Option<PointCloud>,
}

impl Reconstruction {
    /// Reads the model in a folder: `cameras`, `images` and `points3D`, `.bin` or `.txt`.
    ///
    /// ```
    /// # let dir = tempfile::tempdir()?;
    /// # let folder = dir.path();
    /// std::fs::write(folder.join("cameras.txt"), "1 SIMPLE_RADIAL 64 48 50 32 24 -0.1\n")?;
    /// std::fs::write(folder.join("images.txt"), "7 1 0 0 0 0 0 4 1 cam00/00000.jpg\n\n")?;
    /// let model = gs_data::Reconstruction::read(folder)?;
    /// let image = &model.images[0];
    /// assert_eq!((image.name.as_str(), image.camera.position().z, image.lens.k1), ("cam00/00000.jpg", -4.0, -0.1));
    /// assert!(model.points.is_none());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// `data.layout` if there is no model, `data.camera_model` for a lens other than those of [`Lens`], else that of the file.
    pub fn read(folder: &Path) -> Result<Self, DataError> {
        let model = Model::read(folder, &["."])?;
        let image = |row: &super::ImageRow| {
            let at = |field: &str| Place::new(&model.images_file, format!("images[{}].{field}", row.row));
            let (pose, intrinsics) = (pose(row, &at)?, model.intrinsics(row, &at)?);
            let [width, height] = [intrinsics.size.x, intrinsics.size.y].map(|side| cast::to_u32(cast::to_usize(side)));
            let mut viewmat = DMat4::from_mat3(pose.rotation);
            viewmat.w_axis = pose.translation.extend(1.0);
            let (focal, principal): (DVec2, DVec2) = (intrinsics.focal, intrinsics.principal);
            let camera = Camera::from_viewmat(width, height, focal, principal, viewmat)
                .map_err(|e| DataError::camera(&at("camera"), &e))?;
            Ok(Registered { name: row.name.clone(), camera_id: row.camera, camera, lens: intrinsics.lens })
        };
        let images = model.rows.iter().map(image).collect::<Result<_, DataError>>()?;
        Ok(Self { images, points: model.points.map(|points| points.cloud) })
    }
}
