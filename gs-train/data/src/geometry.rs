//! Extent of the cameras and bounds of the scene.

use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, cast};
use rayon::prelude::*;

use super::{Dataset, View};

/// Share of the points that may lie outside the bounds on each side: reconstructions have outliers.
const OUTLIERS: f64 = 0.01;
/// A box around points is widened by this share of its size on each side.
const MARGIN: f32 = 0.1;

impl Dataset {
    /// Extent of the training cameras, world units: `1.1 · max |camera − mean camera|` (Kerbl et al. 2023). 1 for a single
    /// camera, or several at one position. Learning rates and thresholds of densification are in this unit.
    pub fn scene_extent(&self) -> f32 {
        let centres: Vec<DVec3> = self.train.iter().map(|v| v.camera.position()).collect();
        let mean = centres.iter().sum::<DVec3>() / centres.len().max(1) as f64;
        let radius = 1.1 * centres.iter().map(|c| (*c - mean).length()).fold(0.0, f64::max);
        if radius > 1e-6 { cast::to_f32(radius) } else { 1.0 }
    }

    /// Median angle from a training camera to the nearest other, seen from the [`focus`], degrees: how far a held-out view may lie
    /// from what was seen. Cameras at one place count once; 0 where there is one place.
    pub fn view_spacing(&self) -> f32 {
        let centre = focus(&self.train);
        let mut eyes: Vec<DVec3> = self.train.iter().map(|v| v.camera.position() - centre).collect();
        eyes.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
        eyes.dedup_by(|a, b| a.distance(*b) <= 1e-6 * b.length());
        let nearest = |i: usize| {
            let others = eyes.iter().enumerate().filter(|(k, _)| *k != i);
            others.map(|(_, e)| eyes[i].angle_between(*e)).filter(|a| a.is_finite()).min_by(f64::total_cmp)
        };
        let mut angles: Vec<f64> = (0..eyes.len()).into_par_iter().filter_map(nearest).collect();
        angles.sort_by(f64::total_cmp);
        angles.get(angles.len() / 2).map_or(0.0, |a| cast::to_f32(a.to_degrees()))
    }

    /// Lower and upper corner of the scene box, world units: [`Self::bounds`]; else the box of the points without the outer
    /// 1 % on each side, widened by a tenth; else the cube of half side [`Self::scene_extent`] around the [`focus`] of the
    /// training views.
    pub fn scene_bounds(&self) -> [Vec3; 2] {
        if let Some(bounds) = self.bounds {
            return bounds;
        }
        match &self.points {
            Some(p) if !p.positions.is_empty() => around_points(&p.positions),
            _ => {
                let half = Vec3::splat(self.scene_extent());
                let centre = focus(&self.train).as_vec3();
                [centre - half, centre + half]
            }
        }
    }
}

fn around_points(points: &[Vec3]) -> [Vec3; 2] {
    let drop = cast::to_usize(points.len() as f64 * OUTLIERS);
    let mut corners = [Vec3::ZERO; 2];
    for axis in 0..3 {
        let mut values: Vec<f32> = points.iter().map(|p| p[axis]).collect();
        values.sort_by(f32::total_cmp);
        let (low, high) = (values[drop], values[values.len() - 1 - drop]);
        let margin = MARGIN * (high - low).max(f32::MIN_POSITIVE);
        corners[0][axis] = low - margin;
        corners[1][axis] = high + margin;
    }
    corners
}

/// The point `x` nearest to the optical axes of all views in least squares, `Σ (I − d dᵀ)(x − c) = 0` with camera centres `c`
/// and unit axes `d`. Parallel axes give the mean camera centre.
///
/// ```
/// use gs_core::{Camera, Time};
/// use gs_data::{ImageSource, View, geometry::focus};
/// use glam::DVec3;
///
/// let target = DVec3::new(0.3, -0.2, 0.1);
/// let views = [DVec3::X * 4.0, DVec3::Y * 3.0].map(|eye| {
///     let camera = Camera::look_at(8, 8, 0.7, eye, target, DVec3::Z).unwrap();
///     View::new("", camera, Time::default(), ImageSource::Memory(Default::default()), 0)
/// });
/// assert!(focus(&views).abs_diff_eq(target, 1e-12));
/// ```
pub fn focus(views: &[View]) -> DVec3 {
    let mean = || views.iter().map(|v| v.camera.position()).sum::<DVec3>() / views.len().max(1) as f64;
    near_axes(views.iter().map(|v| &v.camera), 1e-6).unwrap_or_else(mean)
}

/// The point nearest to the optical axes of cameras, as [`focus`]. None where these are nearly parallel: `det(Σ (I − d dᵀ) / n)`, 0 for
/// parallel axes and 0.25 for two at right angles, is at most `least`.
pub fn near_axes<'a>(cameras: impl IntoIterator<Item = &'a Camera>, least: f64) -> Option<DVec3> {
    let (mut a, mut b, mut n) = (DMat3::ZERO, DVec3::ZERO, 0.0f64);
    for camera in cameras {
        let (c, d) = (camera.position(), camera.forward());
        let p = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += p;
        b += p * c;
        n += 1.0;
    }
    (a.determinant().abs() > least * n.max(1.0).powi(3)).then(|| a.inverse() * b)
}
