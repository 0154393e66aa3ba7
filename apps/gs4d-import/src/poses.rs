//! From a reconstruction to the cameras of a data set: one pose of a camera that stands still, and an upright world of usual size.

use glam::{DMat3, DQuat, DVec3};
use gs_core::{Camera, cast::to_usize};
use gs_data::geometry::near_axes;
use gs_data::{Lens, PointCloud, Reconstruction, Registered};

/// Mean distance of the cameras from the middle of the scene, world units.
const RADIUS: f64 = 4.0;
/// Poses of one camera that lie farther than this multiple of the usual distance from the most central one are not averaged.
const FAR: f64 = 3.0;
/// Optical axes are taken for parallel up to this determinant ([`near_axes`]).
const PARALLEL: f64 = 1e-3;

/// A camera with its lens.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Posed {
    pub(crate) camera: Camera,
    pub(crate) lens: Lens,
}

impl From<&Registered> for Posed {
    fn from(image: &Registered) -> Self {
        Self { camera: image.camera.clone(), lens: image.lens }
    }
}

/// The cameras of a rig.
pub(crate) struct RigPoses {
    /// By number; none where no image of the camera was placed.
    pub(crate) cameras: Vec<Option<Posed>>,
    /// Largest distance of two images of one camera, as a share of the largest distance of two cameras.
    pub(crate) spread: f64,
    /// Placed images by camera.
    pub(crate) images: Vec<usize>,
}

/// One pose for each of `n` cameras, of which images in the folders `camNN` were placed.
pub(crate) fn rig(model: &Reconstruction, n: usize) -> RigPoses {
    let of = |camera: usize| {
        let folder = format!("{}/", crate::frames::camera_name(camera));
        model.images.iter().filter(|i| i.name.starts_with(&folder)).collect::<Vec<_>>()
    };
    let groups: Vec<Vec<&Registered>> = (0..n).map(of).collect();
    let cameras: Vec<Option<Posed>> = groups.iter().map(|g| mean_pose(g)).collect();
    let centres: Vec<DVec3> = cameras.iter().flatten().map(|p| p.camera.position()).collect();
    let width = widest(&centres);
    let own = |g: &Vec<&Registered>| widest(&g.iter().map(|i| i.camera.position()).collect::<Vec<_>>());
    let spread = groups.iter().map(own).fold(0.0, f64::max) / width.max(f64::MIN_POSITIVE);
    RigPoses { cameras, spread, images: groups.iter().map(Vec::len).collect() }
}

fn widest(points: &[DVec3]) -> f64 {
    let pairs = points.iter().enumerate().flat_map(|(k, a)| points[..k].iter().map(move |b| a.distance(*b)));
    pairs.fold(0.0, f64::max)
}

/// The mean of the poses of one camera; those that lie apart are left out.
fn mean_pose(images: &[&Registered]) -> Option<Posed> {
    let centres: Vec<DVec3> = images.iter().map(|i| i.camera.position()).collect();
    let away = |from: DVec3| {
        let mut all: Vec<f64> = centres.iter().map(|c| c.distance(from)).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let sum = |k: usize| away(centres[k]).iter().sum::<f64>();
    let central = (0..images.len()).min_by(|&a, &b| sum(a).total_cmp(&sum(b)))?;
    let usual = away(centres[central])[images.len() / 2];
    let near: Vec<usize> =
        (0..images.len()).filter(|&k| centres[k].distance(centres[central]) <= FAR * usual + 1e-12).collect();
    let share = 1.0 / near.len() as f64;
    let centre = near.iter().map(|&k| centres[k] * share).sum::<DVec3>();
    let turn = |k: usize| DQuat::from_mat3(&images[k].camera.rotation);
    let first = turn(central);
    let total = near
        .iter()
        .map(|&k| turn(k))
        .fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, q| if q.dot(first) < 0.0 { sum - q } else { sum + q });
    let rotation = DMat3::from_quat(total.normalize());
    let camera = Camera { rotation, translation: -(rotation * centre), ..images[central].camera.clone() };
    Some(Posed { camera, lens: images[central].lens })
}

/// A change of the world: `p` becomes `scale · rotation · p + shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Similarity {
    pub(crate) scale: f64,
    pub(crate) rotation: DMat3,
    pub(crate) shift: DVec3,
}

impl Similarity {
    pub(crate) fn point(&self, p: DVec3) -> DVec3 {
        self.scale * (self.rotation * p) + self.shift
    }

    /// The camera that sees in the new world what it saw in the old one.
    pub(crate) fn camera(&self, camera: &Camera) -> Camera {
        let rotation = camera.rotation * self.rotation.transpose();
        Camera { rotation, translation: self.scale * camera.translation - rotation * self.shift, ..camera.clone() }
    }
}

/// The change to a world with +z up, the point at which the cameras look at the origin, and the cameras at a mean distance of
/// [`RADIUS`] from it. Up is the mean of what is up in the images. Where the cameras look at nothing in common, the middle of the points
/// takes its place.
pub(crate) fn upright(cameras: &[&Camera], points: &PointCloud) -> Similarity {
    let up = cameras.iter().map(|c| c.rotation.transpose() * DVec3::NEG_Y).sum::<DVec3>().normalize_or(DVec3::Z);
    let rotation = DMat3::from_quat(DQuat::from_rotation_arc(up, DVec3::Z));
    let middle = focus(cameras).unwrap_or_else(|| median(points));
    let mean = cameras.iter().map(|c| c.position().distance(middle)).sum::<f64>() / cameras.len().max(1) as f64;
    let scale = if mean > 0.0 { RADIUS / mean } else { 1.0 };
    Similarity { scale, rotation, shift: -scale * (rotation * middle) }
}

/// The point nearest to all optical axes, if it lies before the cameras.
fn focus(cameras: &[&Camera]) -> Option<DVec3> {
    let point = near_axes(cameras.iter().copied(), PARALLEL)?;
    cameras.iter().all(|c| c.to_camera(point).z > 0.0).then_some(point)
}

fn median(points: &PointCloud) -> DVec3 {
    let axis = |k: usize| {
        let mut values: Vec<f64> = points.positions.iter().map(|p| f64::from(p[k])).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    DVec3::new(axis(0), axis(1), axis(2))
}

/// The camera that stands in the middle of the others: what it sees, they see best.
pub(crate) fn central(cameras: &[&Camera]) -> Option<usize> {
    let sum = |k: usize| cameras.iter().map(|c| c.position().distance(cameras[k].position())).sum::<f64>();
    (0..cameras.len()).min_by(|&a, &b| sum(a).total_cmp(&sum(b)))
}

/// Of `n` frames those at which a rig is reconstructed: `count` of them, evenly spread.
pub(crate) fn spread_over(n: usize, count: usize) -> Vec<usize> {
    let count = count.clamp(1, n.max(1));
    (0..count).map(|k| to_usize((k as f64 + 0.5) * n as f64 / count as f64)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(eye: DVec3) -> Camera {
        Camera::look_at(64, 48, 0.8, eye, DVec3::new(0.5, 0.0, 1.0), DVec3::Y).unwrap()
    }

    fn image(name: &str, camera: Camera) -> Registered {
        Registered { name: name.into(), camera_id: 1, camera, lens: Lens::default() }
    }

    #[test]
    fn a_camera_at_rest_has_one_pose() {
        let noise = [0.001, -0.001, 0.0, 0.9];
        let eye = DVec3::new(3.0, 1.0, 2.0);
        let mut images: Vec<Registered> = noise
            .iter()
            .enumerate()
            .map(|(k, n)| image(&format!("cam00/{k}.jpg"), camera(eye + DVec3::X * *n)))
            .collect();
        images.push(image("cam02/0.jpg", camera(-eye)));
        let model = Reconstruction { images, points: None };
        let rig = rig(&model, 3);
        assert_eq!((rig.images, rig.cameras[1].is_none()), (vec![4, 0, 1], true));
        let found = &rig.cameras[0].as_ref().unwrap().camera;
        assert!(found.position().distance(eye) < 1e-9, "the one that lies apart is left out: {}", found.position());
        found.check().unwrap();
        assert!((rig.spread - 0.901 / (2.0 * eye.length())).abs() < 1e-3, "{}", rig.spread);
    }

    #[test]
    fn the_world_stands_upright_and_all_is_seen_as_before() {
        let eyes = [[3.0, 0.5, 1.0], [0.0, 0.6, 4.0], [2.5, 0.4, 3.0]].map(DVec3::from);
        let cameras = eyes.map(camera);
        let all: Vec<&Camera> = cameras.iter().collect();
        let change = upright(&all, &PointCloud { positions: vec![], colors: vec![] });
        assert!(change.point(DVec3::new(0.5, 0.0, 1.0)).length() < 1e-9, "they look at the origin");
        let moved = cameras.each_ref().map(|c| change.camera(c));
        let mean = moved.iter().map(|c| c.position().length()).sum::<f64>() / 3.0;
        assert!((mean - RADIUS).abs() < 1e-9);
        assert!(moved.iter().all(|c| (c.rotation.transpose() * DVec3::NEG_Y).z > 0.9), "up is up");
        let p = DVec3::new(0.3, 0.4, 0.8);
        for (before, after) in cameras.iter().zip(&moved) {
            let [a, b] = [before.to_pixel(before.to_camera(p)), after.to_pixel(after.to_camera(change.point(p)))];
            assert!(a.distance(b) < 1e-9, "{a} {b}");
        }
        assert_eq!(central(&all), Some(2));
    }

    #[test]
    fn parallel_cameras_look_at_their_points() {
        let ahead = |x: f64| Camera::look_at(64, 48, 0.8, DVec3::X * x, DVec3::new(x, 0.0, 5.0), DVec3::NEG_Y).unwrap();
        let (a, b) = (ahead(0.0), ahead(1.0));
        let points = PointCloud { positions: vec![glam::Vec3::new(0.5, 0.0, 8.0); 3], colors: vec![[0.5; 3]; 3] };
        let change = upright(&[&a, &b], &points);
        assert!(change.point(DVec3::new(0.5, 0.0, 8.0)).length() < 1e-6);
    }

    #[test]
    fn moments_are_spread_evenly() {
        assert_eq!((spread_over(10, 1), spread_over(10, 3), spread_over(2, 5)), (vec![5], vec![1, 5, 8], vec![0, 1]));
    }
}
