//! The points of a model, and which images saw each of them.

use std::collections::BTreeSet;
use std::path::Path;

use glam::DVec3;

use super::super::error::{DataError, Place};
use super::super::{ImageSource, PointCloud, View};

/// Points with their tracks.
#[derive(Default)]
pub(super) struct SparsePoints {
    pub cloud: PointCloud,
    /// Numbers of the images of all tracks, point after point.
    images: Vec<u32>,
    /// Where the track of each point ends in them.
    ends: Vec<usize>,
}

impl SparsePoints {
    pub(super) fn with_capacity(count: usize) -> Self {
        let (positions, colors) = (Vec::with_capacity(count), Vec::with_capacity(count));
        Self { cloud: PointCloud { positions, colors }, images: Vec::new(), ends: Vec::with_capacity(count) }
    }

    /// Adds a point of `file`, which [`Self::seen`] says the images of.
    ///
    /// # Errors
    /// `data.field` if its place is not finite.
    pub(super) fn push(&mut self, p: [f64; 3], rgb: [u8; 3], file: &Path) -> Result<(), DataError> {
        if let Some(k) = p.iter().position(|v| !v.is_finite() || v.abs() > f64::from(f32::MAX)) {
            return Err(DataError::Field {
                place: Place::new(file, format!("points3D[{}].{}", self.ends.len(), ["x", "y", "z"][k])),
                value: p[k].to_string(),
                why: "it must be a finite number",
                fix: "remove the point from the model",
            });
        }
        self.cloud.positions.push(DVec3::from(p).as_vec3());
        self.cloud.colors.push(rgb.map(|c| f32::from(c) / 255.0));
        self.ends.push(self.images.len());
        Ok(())
    }

    /// An image saw the point added last.
    pub(super) fn seen(&mut self, image: u32) {
        self.images.push(image);
        if let Some(end) = self.ends.last_mut() {
            *end = self.images.len();
        }
    }

    /// The points that one of the images of these views saw, whose numbers `id` gives by their files: of a sequence whose end is held
    /// out, since a model is made of all images. All points where the model says of none who saw it, or knows none of the images.
    pub(super) fn known_to(self, views: &[View], id: impl Fn(&Path) -> Option<u32>) -> PointCloud {
        let file = |view: &View| match &view.image {
            ImageSource::File(path) => id(path),
            ImageSource::Memory(_) => None,
        };
        let images: BTreeSet<u32> = views.iter().filter_map(file).collect();
        if self.images.is_empty() || images.is_empty() { self.cloud } else { self.seen_by(&images) }
    }

    /// Whether the model says of any point which images saw it.
    pub(super) fn has_tracks(&self) -> bool {
        !self.images.is_empty()
    }

    fn seen_by(&self, images: &BTreeSet<u32>) -> PointCloud {
        let mut kept = PointCloud::default();
        let mut begin = 0;
        for ((position, color), end) in self.cloud.positions.iter().zip(&self.cloud.colors).zip(&self.ends) {
            let track = self.images.get(begin..*end).unwrap_or_default();
            if track.iter().any(|image| images.contains(image)) {
                kept.positions.push(*position);
                kept.colors.push(*color);
            }
            begin = *end;
        }
        kept
    }
}
