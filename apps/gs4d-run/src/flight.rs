//! A smooth camera path through given cameras.

use glam::{DMat3, DQuat, DVec3, DVec4};
use gs_core::{Camera, cast};
use gs_data::View;

/// Most cameras on a path through views.
const KEYS: usize = 8;
/// Least distance between two cameras of a path, as a share of the extent of all.
const MIN_DISTANCE: f64 = 1e-3;

/// A path through cameras, uniform in their index: a Catmull–Rom spline of positions and of quaternions (signs aligned, the
/// sum normalised), linear intrinsics, at the image size of the first camera.
#[derive(Clone, Debug)]
pub struct Flight {
    keys: Vec<Key>,
    first: Camera,
}

#[derive(Clone, Copy, Debug)]
struct Key {
    place: DVec3,
    quat: DVec4,
    /// `fx`, `fy`, `cx`, `cy` divided by the image's width or height.
    lens: DVec4,
}

impl Flight {
    /// Through these cameras in order; `None` for fewer than two.
    pub fn through(cameras: &[Camera]) -> Option<Self> {
        let [first, _, ..] = cameras else { return None };
        let mut keys: Vec<Key> = Vec::new();
        for c in cameras {
            let quat = DVec4::from(DQuat::from_mat3(&c.rotation));
            let turned = keys.last().is_some_and(|k| k.quat.dot(quat) < 0.0);
            let (w, h) = (f64::from(c.width), f64::from(c.height));
            let lens = DVec4::new(c.fx / w, c.fy / h, c.cx / w, c.cy / h);
            keys.push(Key { place: c.position(), quat: if turned { -quat } else { quat }, lens });
        }
        Some(Self { keys, first: first.clone() })
    }

    /// Through up to 8 views, evenly spaced in time: from the first one, always to the nearest of the rest. `None` if fewer
    /// than two views differ in position.
    pub fn of_views(views: &[View]) -> Option<Self> {
        let mut all: Vec<&View> = views.iter().collect();
        all.sort_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
        let places = || all.iter().map(|v| v.camera.position());
        let middle = places().sum::<DVec3>() / all.len().max(1) as f64;
        let extent = places().map(|p| p.distance(middle)).fold(0.0, f64::max);
        let mut apart: Vec<&Camera> = Vec::new();
        for v in &all {
            if apart.iter().all(|c| c.position().distance(v.camera.position()) > MIN_DISTANCE * extent) {
                apart.push(&v.camera);
            }
        }
        let mut left: Vec<&Camera> = gs_data::evenly(apart.len(), KEYS).map(|k| apart[k]).collect();
        let mut way: Vec<Camera> = Vec::new();
        while !left.is_empty() {
            let from = way.last().map_or(left[0].position(), Camera::position);
            let away = |c: &&Camera| c.position().distance(from);
            let next = (0..left.len()).min_by(|&a, &b| away(&left[a]).total_cmp(&away(&left[b])))?;
            way.push(left.remove(next).clone());
        }
        Self::through(&way)
    }

    /// The camera at a share of the path, clamped to 0..1.
    pub fn at(&self, share: f64) -> Camera {
        let last = self.keys.len() - 1;
        let way = share.clamp(0.0, 1.0) * last as f64;
        let i = cast::to_usize(way).min(last - 1);
        let u = way - i as f64;
        let key = |k: isize| self.keys[(i as isize + k).clamp(0, last as isize) as usize];
        let around = [key(-1), key(0), key(1), key(2)];
        // Catmull and Rom 1974, tension ½.
        let weights = [
            0.5 * u * (u * (2.0 - u) - 1.0),
            0.5 * (u * u * (3.0 * u - 5.0) + 2.0),
            0.5 * u * (u * (4.0 - 3.0 * u) + 1.0),
            0.5 * u * u * (u - 1.0),
        ];
        let place: DVec3 = around.iter().zip(weights).map(|(k, w)| k.place * w).sum();
        let quat: DVec4 = around.iter().zip(weights).map(|(k, w)| k.quat * w).sum();
        let lens = key(0).lens.lerp(key(1).lens, u);
        let rotation = DMat3::from_quat(DQuat::from_vec4(quat.try_normalize().unwrap_or(key(0).quat)));
        let (w, h) = (f64::from(self.first.width), f64::from(self.first.height));
        Camera {
            fx: lens.x * w,
            fy: lens.y * h,
            cx: lens.z * w,
            cy: lens.w * h,
            rotation,
            translation: -(rotation * place),
            ..self.first.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{self as synth, SynthOptions};

    fn ring(n: usize) -> Vec<Camera> {
        let at = |k: usize| {
            let a = k as f64 * 0.9;
            let eye = DVec3::new(4.0 * a.cos(), 4.0 * a.sin(), 1.0);
            Camera::look_at(40, 30, 0.5 + 0.05 * k as f64, eye, DVec3::ZERO, DVec3::Z).unwrap()
        };
        (0..n).map(at).collect()
    }

    #[test]
    fn it_passes_its_cameras_and_never_jumps() {
        let keys = ring(6);
        let flight = Flight::through(&keys).unwrap();
        for (k, want) in keys.iter().enumerate() {
            let got = flight.at(k as f64 / 5.0);
            assert!((got.position() - want.position()).length() < 1e-9 && (got.fx - want.fx).abs() < 1e-9);
            assert!((got.rotation - want.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-9));
        }
        let cameras: Vec<Camera> = (0..=500).map(|k| flight.at(f64::from(k) / 500.0)).collect();
        let whole = 4.0 * 0.9 * 5.0;
        for pair in cameras.windows(2) {
            assert!(pair[0].position().distance(pair[1].position()) < 2.0 * whole / 500.0);
            assert!((pair[0].forward() - pair[1].forward()).length() < 2.0 * 0.9 * 5.0 / 500.0);
            assert!((pair[1].rotation.determinant() - 1.0).abs() < 1e-9);
        }
        assert!(Flight::through(&keys[..1]).is_none());
    }

    #[test]
    fn views_are_passed_from_neighbour_to_neighbour() {
        let options = SynthOptions { size: 16, train_views: 40, test_views: 2, ..SynthOptions::default() };
        let data = synth::generate("sheet", &options).unwrap().dataset;
        let flight = Flight::of_views(&data.train).unwrap();
        assert_eq!(flight.keys.len(), KEYS);
        let step = |k: usize| flight.keys[k].place.distance(flight.keys[k + 1].place);
        let farther = (2..KEYS).map(|k| flight.keys[0].place.distance(flight.keys[k].place)).fold(f64::MAX, f64::min);
        assert!(step(0) <= farther, "the second is the nearest to the first");
        assert!(Flight::of_views(&data.train[..1]).is_none() && Flight::of_views(&[]).is_none());
    }
}
