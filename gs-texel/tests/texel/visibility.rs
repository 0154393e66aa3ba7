//! Visibility rules against geometry with exact answers.

use crate::scenes::{TexturedMesh, plate, render, ring, sphere, two_spheres, views, waves};
use glam::{DVec3, Vec2, Vec3};
use gs_core::Camera;
use gs_texel::unproject::{UnprojectConfig, unproject};
use gs_texel::visibility::{Rates, Rule};

fn rule(rule: Rule) -> UnprojectConfig {
    UnprojectConfig { rule, keep_views: true, ..UnprojectConfig::default() }
}

/// Weights per texel and view.
fn seen(figure: &TexturedMesh, cameras: &[Camera], size: usize, config: &UnprojectConfig) -> Vec<f32> {
    let images: Vec<_> = cameras.iter().map(|c| render(figure, c, &waves(4.0))).collect();
    unproject(&figure.mesh(), &figure.table(size), &views(cameras, &images), config).unwrap().by_view
}

#[test]
fn a_sphere_shows_its_analytic_share() {
    let figure = sphere(Vec3::ZERO, 1.0, 192, 128, Vec2::ZERO, Vec2::ONE);
    let cameras = [ring(1, 768)[0].scaled(0.9)];
    let table = figure.table(256);
    let (d, delta) = (3.0f64, 0.17f64);
    let sin2 = 1.0 - delta * delta;
    let want = 0.5 * (1.0 - (sin2 + delta * (d * d - sin2).sqrt()) / d);
    assert!((want - 0.2579).abs() < 1e-4);
    for r in [Rule::Bilinear, Rule::FourTap, Rule::Ray, Rule::RayFootprint] {
        let by_view = seen(&figure, &cameras, 256, &rule(r));
        let (mut got, mut all) = (0.0, 0.0);
        for (k, w) in by_view.iter().enumerate() {
            // A texel of longitude and latitude has an area as its distance from the axis.
            let p = table.at(&figure.faces, &figure.vertices, k).as_dvec3();
            let area = p.x.hypot(p.z);
            all += area;
            got += if *w > 0.0 { area } else { 0.0 };
        }
        assert!((got / all - want).abs() < 0.005, "{}: {} of {want}", r.name(), got / all);
    }
}

/// A wall, a small plate `gap` before its middle, and a camera in front.
fn wall(gap: f32) -> (TexturedMesh, Vec<Camera>) {
    let back = plate(Vec3::ZERO, Vec3::X * 0.9, Vec3::Y * 0.9, 6, Vec2::ZERO, Vec2::new(0.7, 1.0));
    let front = plate(Vec3::Z * gap, Vec3::X * 0.25, Vec3::Y * 0.25, 2, Vec2::new(0.75, 0.0), Vec2::new(1.0, 0.3));
    let eye = DVec3::new(0.2, 0.1, 3.0);
    (back.join(&front), vec![Camera::look_at(600, 600, 0.8, eye, DVec3::ZERO, DVec3::Y).unwrap()])
}

#[test]
fn depth_tests_are_fooled_within_their_tolerance_and_rays_are_not() {
    let rates = |gap: f32, r: Rule| {
        let (figure, cameras) = wall(gap);
        let oracle = seen(&figure, &cameras, 192, &rule(Rule::Ray));
        Rates::of(&seen(&figure, &cameras, 192, &rule(r)), &oracle)
    };
    for r in [Rule::Bilinear, Rule::FourTap] {
        assert!(rates(0.01, r).false_visible > 0.03, "a plate at half the tolerance hides nothing from a depth map");
        assert_eq!(rates(0.03, r).false_visible, 0.0, "one beyond it does");
    }
    for gap in [0.001, 0.01, 0.03] {
        let own = rates(gap, Rule::Neighbours);
        assert!(own.false_visible < 5e-4 && own.false_hidden < 3e-3, "no gap is too narrow: {gap} {own:?}");
    }
    for gap in [0.01, 0.03] {
        let guarded = rates(gap, Rule::RayFootprint);
        assert_eq!(guarded.false_visible, 0.0);
        assert!(guarded.false_hidden < 0.05, "{guarded:?}");
        assert_eq!(rates(gap, Rule::Ray), Rates { visible: rates(gap, Rule::Ray).visible, ..Rates::default() });
    }
    // Faces partly behind the plate own pixels, so all of their texels count.
    assert!(rates(0.03, Rule::FaceTag).false_visible > 0.01);
}

#[test]
fn rules_err_as_little_as_they_should() {
    let figure = two_spheres();
    let cameras = ring(4, 512);
    let oracle = seen(&figure, &cameras, 256, &rule(Rule::Ray));
    for (r, hidden) in [(Rule::Bilinear, 0.002), (Rule::FourTap, 0.008), (Rule::RayFootprint, 0.008)] {
        let rates = Rates::of(&seen(&figure, &cameras, 256, &rule(r)), &oracle);
        assert!(rates.visible > 40_000 && rates.false_visible == 0.0, "{} {rates:?}", r.name());
        assert!(rates.false_hidden < hidden, "{} {rates:?}", r.name());
    }
    let tags = Rates::of(&seen(&figure, &cameras, 256, &rule(Rule::FaceTag)), &oracle);
    assert!(tags.false_visible > 0.001, "{tags:?}");
}

#[test]
fn few_pixels_hide_slanted_surfaces_from_a_tolerance_and_not_from_neighbours() {
    let figure = two_spheres();
    // Most hidden by neighbours, least by depths.
    for (side, own, taps) in [(48, 0.04, 0.7), (96, 0.03, 0.5), (192, 1e-3, 0.2), (512, 1e-3, 4e-3)] {
        let cameras = ring(4, side);
        let oracle = seen(&figure, &cameras, 256, &rule(Rule::Ray));
        let rates = |r| Rates::of(&seen(&figure, &cameras, 256, &rule(r)), &oracle);
        let [near, depth] = [Rule::Neighbours, Rule::FourTap].map(rates);
        assert!(near.false_hidden < own && near.false_visible < 1e-3, "{side} {near:?}");
        assert!(depth.false_hidden > taps, "{side} {depth:?}");
    }
}
