//! Camera paths of a forecast: fixed, along a list, or around the scene.

use super::ForecastError;
use crate::Placing;
use glam::{DMat3, DVec3};
use gs_core::Camera;
use gs_data::{Dataset, ImageCache, View, geometry::focus};
use std::f64::consts::TAU;

/// The camera as a function of the frame.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraPath {
    /// These cameras in order, evenly over the frames. Not empty.
    List(Vec<Camera>),
    /// One turn of a camera about the axis through a point.
    Orbit {
        /// The camera at the first frame.
        start: Camera,
        /// A point of the axis, world units.
        centre: DVec3,
        /// Direction of the axis, unit length.
        axis: DVec3,
    },
}

impl CameraPath {
    /// The fixed camera of a view, by name; without a name of the first extrapolation view, else test, validation or training
    /// view. `placed` gives a view as it is rendered: where its camera was refined.
    ///
    /// # Errors
    /// If no view has that name, or there are none.
    pub fn of_view(
        dataset: &Dataset,
        name: Option<&str>,
        images: &ImageCache,
        placed: &Placing<'_>,
    ) -> Result<Self, ForecastError> {
        Ok(Self::List(vec![images.camera(&placed(view(dataset, name)?))]))
    }

    /// One turn around the focus of the training cameras, about the mean of their up directions, from the camera of
    /// [`CameraPath::of_view`] without a name.
    ///
    /// # Errors
    /// If there are no views.
    pub fn orbit(dataset: &Dataset, images: &ImageCache, placed: &Placing<'_>) -> Result<Self, ForecastError> {
        let start = images.camera(&placed(view(dataset, None)?));
        let up: DVec3 = dataset.train.iter().map(|v| -v.camera.rotation.transpose().y_axis).sum();
        let axis = up.try_normalize().unwrap_or(-start.rotation.transpose().y_axis);
        Ok(Self::Orbit { start, centre: focus(&dataset.train), axis })
    }

    /// The camera of frame `k` of `count`, `k` from 0.
    pub fn at(&self, k: usize, count: usize) -> Camera {
        match self {
            Self::List(cameras) => cameras[(k * cameras.len() / count.max(1)).min(cameras.len() - 1)].clone(),
            Self::Orbit { start, centre, axis } => {
                let turn = DMat3::from_axis_angle(*axis, TAU * k as f64 / count.max(1) as f64);
                let rotation = start.rotation * turn.transpose();
                let eye = *centre + turn * (start.position() - *centre);
                Camera { rotation, translation: -(rotation * eye), ..start.clone() }
            }
        }
    }
}

fn view<'a>(dataset: &'a Dataset, name: Option<&str>) -> Result<&'a View, ForecastError> {
    let mut all = dataset.extrapolate.iter().chain(&dataset.test).chain(&dataset.val).chain(&dataset.train);
    let some = || all.clone().take(3).map(|v| v.name.as_str()).collect::<Vec<_>>().join(", ");
    let missing = ForecastError::NoView { name: name.unwrap_or_default().to_owned(), some: some() };
    match name {
        Some(name) => all.find(|v| v.name == name),
        None => all.next(),
    }
    .ok_or(missing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{SynthOptions, generate};

    #[test]
    fn an_orbit_looks_at_its_centre_and_comes_back() {
        let options = SynthOptions::of_views(8, 12, 2);
        let data = generate("balls", &options).unwrap().dataset;
        let cache = ImageCache::new(0, 1.0);
        let path = CameraPath::orbit(&data, &cache, &View::clone).unwrap();
        let CameraPath::Orbit { start, centre, axis } = &path else { panic!("an orbit") };
        let place = |c: &Camera| {
            let p = c.to_camera(*centre);
            (c.to_pixel(p), p.z)
        };
        let (pixel, depth) = place(start);
        let height = |c: &Camera| axis.dot(c.position() - *centre);
        for k in 0..8 {
            let c = path.at(k, 8);
            assert_eq!(c.check(), Ok(()));
            let (p, z) = place(&c);
            assert!((p - pixel).length() < 1e-9 && (z - depth).abs() < 1e-9);
            assert!((height(&c) - height(start)).abs() < 1e-9);
        }
        assert!((path.at(4, 8).position() - start.position()).length() > depth, "half a turn is the other side");
        assert!((path.at(8, 8).position() - start.position()).length() < 1e-9);
        assert_eq!(
            CameraPath::of_view(&data, None, &cache, &View::clone).unwrap().at(3, 5),
            cache.camera(&data.test[0])
        );
        let e = CameraPath::of_view(&data, Some("none"), &cache, &View::clone).unwrap_err();
        assert!(e.to_string().contains("no view is named \"none\"; there are r_000"), "{e}");
    }

    #[test]
    fn lists_are_followed_evenly() {
        let camera = |w: u32| Camera::look_at(w, 2, 0.7, DVec3::X, DVec3::ZERO, DVec3::Z).unwrap();
        let path = CameraPath::List(vec![camera(2), camera(3), camera(4)]);
        let widths: Vec<u32> = (0..6).map(|k| path.at(k, 6).width).collect();
        assert_eq!(widths, [2, 2, 3, 3, 4, 4]);
        assert_eq!(path.at(0, 1).width, 2);
    }
}
