//! Initial points: those of the data, else in the visual hull, else random in the scene box.
//!
//! The hull ([`super::hull`]) is carved by the alpha of the images or, where they have none, by masks ([`View::mask`](super::View::mask)).
//! Masks usually select what moves, so half of the points are sampled in that hull and the others in the whole box, unless
//! `data.cut_out` leaves nothing there.
//!
//! The points are a function of data set, count and seed.

use glam::Vec3;
use gs_core::Rng;

use super::error::DataError;
use super::hull::{Hull, has_silhouettes};
use super::{Dataset, PointCloud};

impl Dataset {
    /// Initial points: those of the data, or a random `n` of them where there are more; else `n` points of the visual hull
    /// of alpha or masks, coloured; else `n` grey points uniform in [`Dataset::scene_bounds`].
    ///
    /// # Errors
    /// Those of decoding the training images.
    pub fn initial_points(&self, n: usize, seed: u64) -> Result<PointCloud, DataError> {
        if let Some(points) = self.points.as_ref().filter(|p| !p.positions.is_empty()) {
            return Ok(subset(points, n, seed));
        }
        let whole = self.has_alpha || self.train.iter().all(|v| v.cut_out);
        let Some(mut cloud) = self.hull_points(if whole { n } else { n / 2 }, seed)? else {
            return Ok(uniform(self.scene_bounds(), n, seed));
        };
        if !whole {
            let rest = uniform(self.scene_bounds(), n - n / 2, seed);
            cloud.positions.extend(rest.positions);
            cloud.colors.extend(rest.colors);
        }
        Ok(cloud)
    }

    /// `n` points of the visual hull; none if no cell is kept.
    ///
    /// # Errors
    /// As [`Self::initial_points`].
    pub(super) fn hull_points(&self, n: usize, seed: u64) -> Result<Option<PointCloud>, DataError> {
        if !has_silhouettes(self) {
            return Ok(None);
        }
        let hull = Hull::carve(self)?;
        Ok((!hull.cells.is_empty()).then(|| hull.sample(n, seed)))
    }

    /// The training views of the first [moment](crate::moments), as a static data set without held-out views. Points and box stay.
    pub fn at_first_time(&self) -> Self {
        let moments = crate::moments::of_views(&self.train);
        let first = moments.iter().copied().fold(f32::INFINITY, f32::min);
        let train = self.train.iter().zip(moments).filter(|(_, t)| *t == first).map(|(v, _)| v.clone()).collect();
        let (points, bounds) = (self.points.clone(), Some(self.scene_bounds()));
        Self { train, points, bounds, dynamic: false, ..self.without_views() }
    }

    /// Notes that points may be of images after `data.time_boundary`. COLMAP's are known by the images that saw them.
    pub(crate) fn note_later_points(&mut self) {
        if self.points.is_some() && !self.extrapolate.is_empty() && !matches!(self.layout, "colmap" | "nvidia") {
            let note = "the points of the data do not say which images saw them: those of images after data.time_boundary may be among them";
            self.notes.push(note.to_owned());
        }
    }

    /// Whether the data say where the scene is: by points, alpha, a box or masks. Without these, initial points fill a cube
    /// as large as the camera rig.
    pub fn has_start(&self) -> bool {
        let masked = || self.train.iter().any(|v| v.mask.is_some());
        self.points.is_some() || self.has_alpha || self.bounds.is_some() || masked()
    }
}

pub(super) fn subset(points: &PointCloud, n: usize, seed: u64) -> PointCloud {
    if points.positions.len() <= n {
        return points.clone();
    }
    let mut rows = Rng::new(seed, "data.subset", 0, 0).permutation(points.positions.len());
    rows.truncate(n);
    rows.sort_unstable();
    PointCloud {
        positions: rows.iter().map(|&r| points.positions[r as usize]).collect(),
        colors: rows.iter().map(|&r| points.colors[r as usize]).collect(),
    }
}

pub(super) fn uniform([low, high]: [Vec3; 2], n: usize, seed: u64) -> PointCloud {
    let position = |i| {
        let mut r = Rng::new(seed, "data.uniform", 0, i as u64);
        low + (high - low) * Vec3::new(r.uniform(), r.uniform(), r.uniform())
    };
    PointCloud { positions: (0..n).map(position).collect(), colors: vec![[0.5; 3]; n] }
}
