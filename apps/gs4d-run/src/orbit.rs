//! A camera path around a scene.

use glam::{DMat3, DQuat, DVec3, Vec3};
use gs_core::Camera;
use gs_data::View;

/// A circle around a centre, with the image size and field of view of a camera.
///
/// ```
/// use gs4d_run::orbit::Orbit;
///
/// let orbit = Orbit::of_splats(&[glam::Vec3::ZERO, glam::Vec3::X]).unwrap();
/// let [start, end] = [0.0, 1.0].map(|share| orbit.at(share).unwrap().position());
/// assert!(start.distance(end) < 1e-9);
/// ```
#[derive(Clone, Debug)]
pub struct Orbit {
    centre: DVec3,
    up: DVec3,
    start: DVec3,
    camera: Camera,
}

/// Component-wise median of means, and the radius around it that contains three quarters of them; `None` without means.
pub fn middle(means: &[Vec3]) -> Option<(Vec3, f32)> {
    let share = |mut values: Vec<f32>, quarters: usize| {
        values.sort_by(f32::total_cmp);
        values.get((values.len().saturating_sub(1)) * quarters / 4).copied()
    };
    let axis = |k: usize| share(means.iter().map(|m| m[k]).collect(), 2);
    let centre = Vec3::new(axis(0)?, axis(1)?, axis(2)?);
    let away = share(means.iter().map(|m| m.distance(centre)).collect(), 3)?;
    Some((centre, away.max(1e-3)))
}

impl Orbit {
    /// Around the point nearest to the optical axes of all views, from the first view's position, about the mean of their up
    /// directions. `None` without views, or if all axes are parallel.
    pub fn of_views(views: &[View]) -> Option<Self> {
        let first = &views.first()?.camera;
        let (mut a, mut b, mut up) = (DMat3::ZERO, DVec3::ZERO, DVec3::ZERO);
        for camera in views.iter().map(|v| &v.camera) {
            let (p, d) = (camera.position(), camera.forward());
            let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
            a += across;
            b += across * p;
            up -= camera.rotation.row(1);
        }
        let n = views.len() as f64;
        // Nearly parallel axes have no nearest point.
        let centre = if (a * (1.0 / n)).determinant() > 1e-4 { a.inverse() * b } else { return None };
        let up = up.try_normalize()?;
        Some(Self { centre, up, start: first.position(), camera: first.clone() })
    }

    /// Around splats, with y down, at a distance that shows three quarters of them; `None` without splats.
    pub fn of_splats(means: &[Vec3]) -> Option<Self> {
        let (centre, radius) = middle(means)?;
        let (centre, far) = (centre.as_dvec3(), 3.5 * f64::from(radius));
        let start = centre + DVec3::new(0.0, -0.3, -1.0).normalize() * far;
        let camera = Camera::look_at(800, 600, 0.9, start, centre, DVec3::NEG_Y).ok()?;
        Some(Self { centre, up: DVec3::NEG_Y, start, camera })
    }

    /// The camera after a share of a turn (0..1); `None` where it would look along its own up direction.
    pub fn at(&self, share: f64) -> Option<Camera> {
        let turn = DQuat::from_axis_angle(self.up, share * std::f64::consts::TAU);
        let eye = self.centre + turn * (self.start - self.centre);
        let c = &self.camera;
        let fov = 2.0 * (0.5 * f64::from(c.width) / c.fx).atan();
        Camera::look_at(c.width, c.height, fov, eye, self.centre, self.up).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{self as synth, SynthOptions};

    #[test]
    fn a_ring_of_cameras_is_followed() {
        let options = SynthOptions { size: 16, train_views: 12, test_views: 2, ..SynthOptions::default() };
        let data = synth::generate("sheet", &options).unwrap().dataset;
        let orbit = Orbit::of_views(&data.train).unwrap();
        assert!(orbit.centre.length() < 0.1, "they look at the origin: {}", orbit.centre);
        let first = &data.train[0].camera;
        for share in [0.0, 0.25, 0.7] {
            let camera = orbit.at(share).unwrap();
            assert!((camera.position().length() - first.position().length()).abs() < 0.1);
            assert!(camera.to_camera(orbit.centre).truncate().length() < 1e-9, "looks at the centre");
        }
        assert!(orbit.at(0.0).unwrap().position().distance(first.position()) < 1e-9);
        assert!(Orbit::of_views(&data.train[..1]).is_none() && Orbit::of_views(&[]).is_none());
    }

    #[test]
    fn outliers_do_not_move_the_middle() {
        let mut means = vec![Vec3::ONE; 20];
        means.push(Vec3::splat(1e6));
        assert_eq!(middle(&means), Some((Vec3::ONE, 1e-3)));
        assert!(Orbit::of_splats(&means).unwrap().at(0.5).is_some() && Orbit::of_splats(&[]).is_none());
    }
}
