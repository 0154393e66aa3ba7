//! The world frame of a capture: `scene.json`, `extra.json` and the points.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::super::error::{DataError, Place};
use super::super::files::Root;
use super::super::json::{Fields, read_object};
use super::super::{PointCloud, View, frustum, ply, table};
use super::MAX_SMALL_BYTES;

/// Dense initial points, as 4DGaussians prepares them.
const DENSE: &str = "points3D_downsample2.ply";

/// `scene.json`: the frame in which the scene is trained, normalised or raw.
pub(super) struct Frame {
    centre: DVec3,
    /// Units of this frame per metre of the raw one.
    pub(super) scale: f64,
    depths: Option<[f64; 2]>,
}

impl Frame {
    /// Reads the file; where `normalise` is false the frame is the raw one, that of the camera files.
    ///
    /// # Errors
    /// `data.field` if a number is missing or the scale not positive; `io.read`, `data.syntax`, `limits.file`.
    pub(super) fn read(file: &Path, normalise: bool) -> Result<Self, DataError> {
        let map = read_object(file, MAX_SMALL_BYTES)?;
        let fields = Fields::new(file, "", &map);
        let centre = fields.numbers::<3>("center")?;
        let missing = |key| fields.fault(key, "missing", "cameras are normalised by it", "copy scene.json again");
        let scale = fields.required_number("scale")?;
        if scale <= 0.0 {
            return Err(fields.fault("scale", &scale.to_string(), "it must be positive", "correct the number"));
        }
        let centre = DVec3::from(centre.ok_or_else(|| missing("center"))?);
        let depths = fields.number("near")?.zip(fields.number("far")?).map(<[f64; 2]>::from);
        let normalised = Self { centre, scale, depths };
        Ok(if normalise { normalised } else { normalised.raw() })
    }

    /// The raw frame; depths, which files give in the normalised one, are divided by the scale.
    fn raw(self) -> Self {
        Self { centre: DVec3::ZERO, scale: 1.0, depths: self.depths.map(|d| d.map(|z| z / self.scale)) }
    }

    /// A point of the raw frame, in this frame.
    pub(super) fn place(&self, p: DVec3) -> DVec3 {
        (p - self.centre) * self.scale
    }

    /// The box around the view frusta of the training cameras between `near` and `far`.
    pub(super) fn bounds(&self, train: &[View]) -> Option<[Vec3; 2]> {
        self.depths.and_then(|d| frustum::bounds(train.iter().map(|v| (&v.camera, d))))
    }

    /// The points of the capture: the dense cloud (`points3D_downsample2.ply`, as 4DGaussians prepares
    /// it) before the sparse `points.npy`, which has no colours. Both are in the raw frame.
    ///
    /// # Errors
    /// Those of reading the file.
    pub(super) fn points(&self, root: &Root, notes: &mut Vec<String>) -> Result<Option<PointCloud>, DataError> {
        let there = |name: &str| root.resolve(name, &Place::new(root.dir(), name)).map(|f| (f.is_file(), f));
        if let (true, file) = there(DENSE)? {
            let mut cloud = ply::read_points(&file)?;
            cloud.positions.iter_mut().for_each(|p| *p = self.place(p.as_dvec3()).as_vec3());
            notes.push(format!("initial points come from {DENSE}: {}", cloud.positions.len()));
            return Ok(Some(cloud));
        }
        let (true, file) = there("points.npy")? else {
            notes.push("there is no points.npy: training starts from other points".into());
            return Ok(None);
        };
        let positions = table::read_triples(&file, |p| self.place(p))?;
        notes.push(format!("points.npy: {} points without colours", positions.len()));
        Ok(Some(PointCloud { colors: vec![[0.5; 3]; positions.len()], positions }))
    }
}

/// `extra.json` of a DyCheck capture.
pub(super) struct Extra {
    /// Frames per second.
    pub(super) fps: Option<f64>,
    /// Lower and upper corner of the scene, normalised frame.
    bbox: Option<[[f64; 3]; 2]>,
}

impl Extra {
    /// Reads the file, if it is there.
    ///
    /// # Errors
    /// `data.field` for a rate that is not positive, or a box that is none; `io.read`, `data.syntax`, `limits.file`.
    pub(super) fn read(file: &Path) -> Result<Option<Self>, DataError> {
        if !file.is_file() {
            return Ok(None);
        }
        let map = read_object(file, MAX_SMALL_BYTES)?;
        let fields = Fields::new(file, "", &map);
        let fps = fields.number("fps")?;
        if let Some(rate) = fps.filter(|r| *r <= 0.0) {
            return Err(fields.fault("fps", &rate.to_string(), "it is a rate", "correct the number"));
        }
        Ok(Some(Self { fps, bbox: fields.rows("bbox")? }))
    }

    /// The box of the scene in a frame: that of the file is normalised by `scene`, the frame of `scene.json`.
    pub(super) fn bounds(&self, scene: &Path, normalise: bool) -> Result<Option<[Vec3; 2]>, DataError> {
        let Some([low, high]) = self.bbox.map(|b| b.map(DVec3::from)) else { return Ok(None) };
        if normalise {
            return Ok(Some([low, high].map(|p| p.as_vec3())));
        }
        let frame = Frame::read(scene, true)?;
        Ok(Some([low, high].map(|p| (p / frame.scale + frame.centre).as_vec3())))
    }
}
