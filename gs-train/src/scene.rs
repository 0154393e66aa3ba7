//! What a method is built from: the first points, the extent of the scene and the box around it.
//!
//! ```text
//! log_scales = ½ ln(max(d², 1e-7)) on every axis,  d² = mean squared distance to the 3 nearest neighbours
//! extent     = 1.1 max |c_i − mean c| over the training cameras, at least 0.1 × the diagonal of the points' box
//! ```
//! (3D Gaussian Splatting's reference code; the lower bound keeps scenes with a resting camera trainable.)

use crate::kernel::KernelConfig;
use crate::method::MethodError;
use glam::Vec3;
#[cfg(feature = "cloud")]
use gs_core::Cloud;
use gs_core::Rng;
#[cfg(feature = "cloud")]
use gs_core::neighbours::mean_squared_distances;
use gs_data::avatar::AvatarScene;
use gs_data::moments::{distinct, median_step};
use gs_data::{Dataset, PointCloud};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

#[cfg(feature = "cloud")]
/// Squared neighbour distances below this count as this.
const MIN_SQUARED_DISTANCE: f32 = 1e-7;

/// Least images of the first timestamp that tell its hull.
const FIRST_VIEWS: usize = 8;

/// Where the first points come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InitFrom {
    /// The data's points if there are any, else the visual hull of alpha or masks, else points in the box the layout knows,
    /// else random.
    Auto,
    /// The points of the data set.
    Points,
    /// Uniform in a cube around the origin, colours near grey (the published start for D-NeRF).
    Random,
}

/// Where the first points of a cloud come from, and how many.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitConfig {
    /// Source of the first points.
    pub from: InitFrom,
    /// At most so many (random: exactly so many).
    pub points: u32,
    /// Half side of the cube of random points, world units.
    pub bound: f32,
    /// Only images of the first timestamp carve the hull: for a cloud that is the scene of that timestamp and is deformed
    /// later. They must be several.
    #[serde(default)]
    pub first_moment: bool,
}

/// The cloud made of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloudConfig {
    /// SH degree stored, 0 to 3.
    pub sh_degree: u8,
    /// Opacity of the first Gaussians, between 0 and 1.
    pub opacity: f32,
    /// The neighbour distance is multiplied by this to give the first standard deviations (3DGS: 1).
    pub spread: f32,
    /// The fall-off of a splat.
    #[serde(default)]
    pub kernel: KernelConfig,
}

/// What a method is built from.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneInfo {
    /// Points a cloud begins with, world units; empty in a loaded checkpoint.
    pub points: PointCloud,
    /// Radius of the camera positions, world units: the length that learning rates and growth rules refer to.
    pub extent: f32,
    /// Lower and upper corner of a box around everything that moves, world units.
    pub bounds: [Vec3; 2],
    /// Number of views trained on.
    pub views: u32,
    /// Number of different training times.
    pub timestamps: u32,
    /// Last training time, normalised: 1, or less where `data.time_boundary` keeps later views out.
    pub last_time: f32,
    /// Median distance of successive training times, normalised; 0 where there is one timestamp.
    pub frame_interval: f32,
    /// [`Self::frame_interval`] of the data that the run began with: more views may come, the shape of a field stays.
    pub first_interval: f32,
    /// Median angle from a training camera to the nearest other, degrees ([`Dataset::view_spacing`]).
    pub view_spacing: f32,
    /// Seed of the run, for everything random.
    pub seed: u64,
    /// The filmed person, where the data bring one along; not kept in checkpoints.
    pub avatar: Option<Arc<AvatarScene>>,
    /// Parameters that networks and fields may have in all: [`MAX_PARAMETERS`], or as many as the checkpoint holds.
    pub max_parameters: u64,
}

/// Parameters that networks and fields may have in all: 1 GiB, and three times that for gradients and moments.
pub const MAX_PARAMETERS: u64 = 1 << 28;

impl SceneInfo {
    /// Fails if networks and fields have more parameters than are allowed. A method calls it before it builds them.
    ///
    /// # Errors
    /// [`MethodError::TooLarge`] with both numbers.
    pub fn admit(&self, method: &'static str, counts: &[u64]) -> Result<(), MethodError> {
        let count = counts.iter().fold(0u64, |sum, n| sum.saturating_add(*n));
        let limit = self.max_parameters;
        if count <= limit { Ok(()) } else { Err(MethodError::TooLarge { method, count, limit }) }
    }

    /// Moments of the training images that times 0 … 1 have room for, at their distance when the run began; 0 for one moment.
    pub fn moments(&self) -> f64 {
        if self.first_interval > 0.0 { 1.0 + 1.0 / f64::from(self.first_interval) } else { 0.0 }
    }

    /// Gathers what `init` asks for from a data set.
    ///
    /// # Errors
    /// If the points asked for are not there or cannot be used.
    pub fn of(dataset: &Dataset, init: &InitConfig, seed: u64) -> Result<Self, MethodError> {
        let points = first_points(dataset, init, seed)?;
        let none = || MethodError::Scene("there is no finite initial point".into());
        let mut bounds = bounds_of(&points).ok_or_else(none)?;
        if init.first_moment {
            // Where the scene goes after its first moment.
            let later = first_points(dataset, &InitConfig { first_moment: false, ..init.clone() }, seed)?;
            let [min, max] = bounds_of(&later).ok_or_else(none)?;
            bounds = [bounds[0].min(min), bounds[1].max(max)];
        }
        let extent = dataset.scene_extent().max(0.1 * bounds[0].distance(bounds[1]));
        if !(extent > 0.0 && extent.is_finite()) {
            return Err(MethodError::Scene(format!("its extent is {extent}; cameras and points coincide")));
        }
        let (views, timestamps, last_time, frame_interval) = Default::default();
        let first_interval = median_step(&distinct(&dataset.train));
        let view_spacing = dataset.view_spacing();
        let avatar = dataset.avatar.clone();
        let max_parameters = MAX_PARAMETERS;
        let scene = Self {
            points,
            extent,
            bounds,
            views,
            timestamps,
            last_time,
            frame_interval,
            first_interval,
            view_spacing,
            seed,
            avatar,
            max_parameters,
        };
        Ok(scene.seen_in(dataset))
    }

    /// The same scene as the training views of a data set show it, which may hold more than it was made from: its numbers of
    /// views and timestamps, its last time and the distance of timestamps.
    pub(crate) fn seen_in(self, dataset: &Dataset) -> Self {
        let moments = distinct(&dataset.train);
        let last = dataset.train.iter().map(|v| v.time.normalised).max_by(f32::total_cmp);
        let (views, last_time) = (dataset.train.len() as u32, last.unwrap_or(1.0));
        Self { views, timestamps: moments.len() as u32, last_time, frame_interval: median_step(&moments), ..self }
    }
}

fn first_points(dataset: &Dataset, init: &InitConfig, seed: u64) -> Result<PointCloud, MethodError> {
    match init.from {
        InitFrom::Points if dataset.points.is_none() => {
            Err(MethodError::Scene("the data set brings no points; use init.from = auto or random".into()))
        }
        InitFrom::Auto | InitFrom::Points if dataset.has_start() => {
            let n = init.points as usize;
            let first = init.first_moment.then(|| dataset.at_first_time());
            match first.as_ref().map(|d| d.train.len()) {
                Some(views @ ..FIRST_VIEWS) => Err(MethodError::Scene(format!(
                    "init.first_moment needs {FIRST_VIEWS} images of the first moment; there are {views}"
                ))),
                _ => Ok(first.as_ref().unwrap_or(dataset).initial_points(n, seed)?),
            }
        }
        _ => Ok(random_points(init, seed)),
    }
}

fn random_points(init: &InitConfig, seed: u64) -> PointCloud {
    let point = |i: u32| {
        let mut rng = Rng::new(seed, "init-random", 0, u64::from(i));
        let mut coordinate = || rng.range(-init.bound, init.bound);
        let position = Vec3::new(coordinate(), coordinate(), coordinate());
        // The reference draws SH coefficients U(0, 1) / 255 around grey.
        (position, std::array::from_fn(|_| 0.5 + rng.uniform() / 255.0 * gs_core::sh::C0 as f32))
    };
    let (positions, colors) = (0..init.points).map(point).unzip();
    PointCloud { positions, colors }
}

fn bounds_of(points: &PointCloud) -> Option<[Vec3; 2]> {
    let finite = points.positions.iter().filter(|p| p.is_finite());
    finite.fold(None, |b, &p| {
        let [lo, hi] = b.unwrap_or([p, p]);
        Some([lo.min(p), hi.max(p)])
    })
}

#[cfg(feature = "cloud")]
/// The first Gaussians: round, as large as the distance to their neighbours.
///
/// # Errors
/// If there is no point or a value is out of its domain.
pub fn cloud(points: &PointCloud, config: &CloudConfig) -> Result<Cloud, MethodError> {
    if let Some(row) = points.positions.iter().position(|p| !p.is_finite()) {
        return Err(gs_core::cloud::CloudError::Value { row, what: "position" }.into());
    }
    let distances = mean_squared_distances(&points.positions);
    let distances = distances.map_err(|e| MethodError::Scene(format!("initial points: {e}")))?;
    let sigmas: Vec<f32> = distances.iter().map(|d| config.spread * d.max(MIN_SQUARED_DISTANCE).sqrt()).collect();
    let cloud = Cloud::from_points(&points.positions, &points.colors, &sigmas, config.opacity, config.sh_degree)?;
    Ok(match config.kernel.init() {
        Some(init) => cloud.with_kernel(init)?,
        None => cloud,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> CloudConfig {
        CloudConfig { sh_degree: 0, opacity: 0.1, spread: 1.0, kernel: KernelConfig::default() }
    }

    #[test]
    fn few_points_still_make_a_cloud() {
        for n in 1..5usize {
            let positions: Vec<Vec3> = (0..n).map(|i| Vec3::X * i as f32).collect();
            let points = PointCloud { colors: vec![[0.5; 3]; n], positions };
            let cloud = cloud(&points, &config()).unwrap();
            assert_eq!(cloud.len(), n);
            assert!(cloud.log_scales.value.iter().all(|s| s.is_finite()));
        }
        assert!(cloud(&PointCloud::default(), &config()).is_err());
        let bad = PointCloud { positions: vec![Vec3::NAN], colors: vec![[0.5; 3]] };
        assert!(cloud(&bad, &config()).is_err());
    }

    #[test]
    fn random_points_depend_on_the_seed_only() {
        let init = InitConfig { from: InitFrom::Random, points: 50, bound: 1.3, first_moment: false };
        let points = random_points(&init, 1);
        assert_eq!(points, random_points(&init, 1));
        assert_ne!(points, random_points(&init, 2));
        assert!(points.positions.iter().all(|p| p.abs().max_element() <= 1.3));
    }
}
