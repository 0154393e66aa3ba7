//! Extent, bounds and digest of a data set.

use glam::{DVec3, Vec3};
use gs_core::Camera;
use gs_data::PointCloud;
use gs_data::geometry::{focus, near_axes};
use gs_data::{Dataset, View};
use gs_synth::{SynthOptions, generate};

fn scene() -> Dataset {
    let o = SynthOptions { val_views: 1, ..SynthOptions::of_views(8, 30, 1) };
    generate("static", &o).unwrap().dataset
}

#[test]
fn cameras_on_a_hemisphere_span_their_radius() {
    let d = scene();
    let extent = d.scene_extent();
    assert!(extent > 4.0 && extent < 6.0, "{extent}");
    assert!(focus(&d.train).length() < 1e-6, "all look at the origin");
    let one = Dataset { train: d.train[..1].to_vec(), ..d };
    assert_eq!(one.scene_extent(), 1.0);
    assert!(focus(&one.train).is_finite());
}

#[test]
fn nearly_parallel_axes_meet_nowhere() {
    let ahead = |x: f64, turn: f64| {
        let eye = DVec3::X * x;
        Camera::look_at(8, 8, 0.7, eye, eye + DVec3::new(turn, 0.0, 5.0), DVec3::Y).unwrap()
    };
    let cameras = [ahead(0.0, 0.0), ahead(1.0, -0.1)];
    let point = near_axes(&cameras, 1e-6).unwrap();
    assert!(point.distance(DVec3::Z * 50.0) < 1e-6, "{point}");
    assert_eq!(near_axes(&cameras, 1e-3), None);
    assert_eq!(near_axes([], 0.0), None);
    let right = [DVec3::X, DVec3::Z].map(|eye| Camera::look_at(8, 8, 0.7, eye, DVec3::ZERO, DVec3::Y).unwrap());
    assert!(near_axes(&right, 0.249).is_some() && near_axes(&right, 0.251).is_none());
}

#[test]
fn spacing_of_views_is_the_angle_between_neighbours() {
    let mut d = scene();
    let ring = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let eye = DVec3::new(2.0 + 5.0 * cos, 5.0 * sin, 1.0);
        let camera = Camera::look_at(8, 8, 0.7, eye, DVec3::new(2.0, 0.0, 1.0), DVec3::Z).unwrap();
        View { camera, ..d.train[0].clone() }
    };
    // Two cameras stand at one place, as in a rig that films many moments.
    let views: Vec<View> = [0.0, 7.0, 7.0, 14.0, 180.0].map(ring).to_vec();
    d.train = views;
    assert!((d.view_spacing() - 7.0).abs() < 1e-4, "{}", d.view_spacing());
    d.train.truncate(1);
    assert_eq!(d.view_spacing(), 0.0);
}

#[test]
fn bounds_come_from_the_layout_then_points_then_cameras() {
    let mut d = scene();
    assert_eq!(d.scene_bounds()[1], Vec3::splat(1.3));
    d.bounds = None;
    let [low, high] = d.scene_bounds();
    assert!(low.max_element() < -3.9 && high.min_element() > 3.9);
    let mut positions: Vec<Vec3> = (0..=200).map(|k| Vec3::splat(k as f32 / 100.0 - 1.0)).collect();
    positions[7] = Vec3::splat(1e6);
    d.points = Some(PointCloud { colors: vec![[0.0; 3]; positions.len()], positions });
    let [low, high] = d.scene_bounds();
    assert!(low.x > -1.3 && high.x < 1.3 && low.x < -1.0 && high.x > 1.0, "the stray is left out: {low} {high}");
}
