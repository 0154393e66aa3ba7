//! Textures unprojected from renders of textured meshes.

use crate::scenes::{TexturedMesh, plate, psnr, render, ring, sphere, two_spheres, views, waves};
use glam::{DVec3, Vec2, Vec3};
use gs_core::{Camera, Image};
use gs_texel::surface::Mesh;
use gs_texel::texels::TexelTable;
use gs_texel::unproject::{Compat, FuseWeight, MaskUse, Texture, UnprojectConfig, UnprojectError, View, unproject};
use gs_texel::visibility::Rule;

struct Capture {
    figure: TexturedMesh,
    table: TexelTable,
    cameras: Vec<Camera>,
    images: Vec<Image>,
}

impl Capture {
    fn new(figure: TexturedMesh, size: usize, side: u32, color: &(impl Fn(DVec3) -> [f32; 3] + Sync)) -> Self {
        let cameras = ring(4, side);
        let images = cameras.iter().map(|c| render(&figure, c, color)).collect();
        Self { table: figure.table(size), figure, cameras, images }
    }

    fn views(&self) -> Vec<View<'_>> {
        views(&self.cameras, &self.images)
    }

    fn texture(&self, config: &UnprojectConfig) -> Texture {
        unproject(&self.figure.mesh(), &self.table, &self.views(), config).unwrap()
    }
}

fn rule(rule: Rule) -> UnprojectConfig {
    UnprojectConfig { rule, ..UnprojectConfig::default() }
}

#[test]
fn a_painted_sphere_comes_back() {
    let color = waves(12.0);
    let capture = Capture::new(two_spheres(), 512, 1024, &color);
    let db = |config: &UnprojectConfig| psnr(&capture.texture(config), &capture.figure, &capture.table, &color);
    let four_tap = capture.texture(&rule(Rule::FourTap));
    assert!((four_tap.coverage() - 0.66).abs() < 0.01, "{}", four_tap.coverage());
    let taps = psnr(&four_tap, &capture.figure, &capture.table, &color);
    assert!(taps >= 70.0, "{taps}");
    let bilinear = db(&rule(Rule::Bilinear));
    let aligned =
        db(&UnprojectConfig { compat: Compat { align_corners: true, ..Compat::default() }, ..rule(Rule::Bilinear) });
    assert!(bilinear >= aligned + 5.0, "{bilinear} against {aligned}");
    let ray = db(&rule(Rule::Ray));
    assert!(ray + 5.0 < taps, "a visible point with a foreign footprint: {ray} against {taps}");
    let guarded = db(&rule(Rule::RayFootprint));
    assert!((guarded - taps).abs() < 1.0, "{guarded} against {taps}");
    for config in
        [UnprojectConfig::dut_code(), UnprojectConfig::holochar(), UnprojectConfig::dva(), UnprojectConfig::ghg()]
    {
        let other = db(&config);
        assert!(other > 20.0 && other + 5.0 < taps, "{config:?}: {other}");
    }
}

#[test]
fn one_colour_stays_one_colour_whatever_the_weights() {
    let capture = Capture::new(two_spheres(), 128, 256, &|_| [0.3, 0.6, 0.9]);
    for fuse in [FuseWeight::Mask, FuseWeight::CosPow(4.0), FuseWeight::BestView] {
        for r in Rule::ALL {
            let texture = capture.texture(&UnprojectConfig { fuse, ..rule(r) });
            let seen = (0..capture.table.len()).filter(|&k| texture.seen[k] > 0);
            assert!(texture.colors.iter().flatten().all(|v| v.is_finite()));
            let worst = seen
                .flat_map(|k| texture.colors[k].into_iter().zip([0.3, 0.6, 0.9]))
                .fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
            let limit = if matches!(r, Rule::Ray | Rule::FaceTag) { 1e-4 } else { 1e-6 };
            assert!(texture.coverage() > 0.5 && worst < limit, "{fuse:?} {}: {worst}", r.name());
        }
    }
}

#[test]
fn views_in_any_order_and_any_number_of_threads_give_the_same_bits() {
    let capture = Capture::new(two_spheres(), 128, 200, &waves(9.0));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for fuse in [FuseWeight::Mask, FuseWeight::CosPow(2.0), FuseWeight::BestView] {
        let config = UnprojectConfig { fuse, keep_views: true, ..rule(Rule::FourTap) };
        let texture = capture.texture(&config);
        assert_eq!(one.install(|| capture.texture(&config)), texture);
        for order in [[3, 1, 0, 2], [1, 2, 3, 0]] {
            let all = capture.views();
            let turned: Vec<View<'_>> = order.iter().map(|&i| all[i]).collect();
            let other = unproject(&capture.figure.mesh(), &capture.table, &turned, &config).unwrap();
            assert_eq!((&other.colors, &other.weight, &other.seen), (&texture.colors, &texture.weight, &texture.seen));
        }
    }
}

#[test]
fn silhouettes_are_not_darkened() {
    // Opacity falls over three pixels at the outline; behind it black.
    let mut capture = Capture::new(sphere(Vec3::ZERO, 0.9, 64, 48, Vec2::ZERO, Vec2::ONE), 128, 160, &|_| [0.8; 3]);
    for image in &mut capture.images {
        let hard = image.clone();
        for y in 1..159 {
            for x in 1..159 {
                let around = (0..9).map(|i| hard.pixel(x + i % 3 - 1, y + i / 3 - 1)[3]).sum::<f32>();
                image.pixel_mut(x, y)[3] = around / 9.0;
            }
        }
    }
    let darkest = |config: &UnprojectConfig| {
        let texture = capture.texture(config);
        let seen = texture.colors.iter().zip(&texture.seen).filter(|s| *s.1 > 0);
        seen.map(|s| s.0[0]).fold(1.0f32, f32::min)
    };
    let lax = UnprojectConfig { min_cos: 0.0, depth_tolerance: 0.5, ..rule(Rule::Ray) };
    // Opaque colours of the foreground alone; its own pixels beyond the outline are black, so weigh them by opacity.
    let soft = darkest(&lax);
    let plain = darkest(&UnprojectConfig { mask: MaskUse::Binary, ..lax });
    assert!(soft > plain, "{soft} {plain}");
    let texture = capture.texture(&rule(Rule::FourTap));
    let seen = texture.colors.iter().zip(&texture.seen).filter(|s| *s.1 > 0);
    assert!(seen.clone().count() > 5000 && seen.into_iter().all(|s| (s.0[0] - 0.8).abs() < 1e-6));
}

#[test]
fn hostile_input_is_refused_or_sees_nothing() {
    let capture = Capture::new(two_spheres(), 64, 64, &waves(4.0));
    let (figure, table, config) = (&capture.figure, &capture.table, UnprojectConfig::default());
    let none = unproject(&figure.mesh(), table, &[], &config).unwrap();
    assert_eq!(none.coverage(), 0.0);
    assert!(none.map(table, -1.0).data.iter().all(|&v| v == -1.0));
    for r in Rule::ALL {
        let camera = ring(1, 1);
        let image = Image::zeros(1, 1, 3);
        let view = View { camera: &camera[0], image: &image, mask: None };
        assert_eq!(unproject(&figure.mesh(), table, &[view], &rule(r)).unwrap().coverage(), 0.0);
        // A camera inside, and one that looks away.
        let look = |eye: DVec3, at: DVec3| Camera::look_at(64, 64, 0.8, eye, at, DVec3::Y).unwrap();
        let images = Image::zeros(64, 64, 3);
        let inside = look(DVec3::ZERO, DVec3::X);
        let away = look(DVec3::Z * 3.0, DVec3::Z * 9.0);
        let texture = unproject(
            &figure.mesh(),
            table,
            &[&inside, &away].map(|camera| View { camera, image: &images, mask: None }),
            &rule(r),
        )
        .unwrap();
        assert_eq!((texture.coverage(), texture.used[1]), (0.0, false), "{}", r.name());
    }
    let mut broken = figure.vertices.clone();
    broken[17].y = f32::NAN;
    let mesh = Mesh { vertices: &broken, ..figure.mesh() };
    let error = unproject(&mesh, table, &capture.views(), &config).unwrap_err().to_string();
    assert!(error.contains("vertex 17"), "{error}");
    let mut camera = capture.cameras[0].clone();
    camera.cx = f64::NAN;
    let view = View { camera: &camera, image: &capture.images[0], mask: None };
    let error = unproject(&figure.mesh(), table, &[view], &config).unwrap_err().to_string();
    assert!(error.starts_with("view 0: camera cx"), "{error}");
    let small = Image::zeros(10, 64, 3);
    let view = View { camera: &capture.cameras[0], image: &small, mask: None };
    assert!(matches!(unproject(&figure.mesh(), table, &[view], &config), Err(UnprojectError::Shape { view: 0, .. })));
    for wrong in [f32::NAN, -2.0] {
        let config = UnprojectConfig { min_cos: wrong, ..config };
        let error = unproject(&figure.mesh(), table, &[], &config).unwrap_err().to_string();
        assert!(error.contains("min_cos"), "{error}");
    }
    let few = Mesh { faces: &figure.faces[..100], ..figure.mesh() };
    assert!(matches!(unproject(&few, table, &[], &config), Err(UnprojectError::Mesh(_))));
}

#[test]
fn settings_are_read_by_name_and_the_authors_depth_is_theirs() {
    let config: UnprojectConfig =
        serde_json::from_str(r#"{"rule": "ray_footprint", "fuse": {"cos_pow": 2.0}}"#).unwrap();
    assert_eq!((config.rule, config.fuse, config.min_cos), (Rule::RayFootprint, FuseWeight::CosPow(2.0), 0.17));
    assert!(serde_json::from_str::<UnprojectConfig>(r#"{"rules": "ray"}"#).is_err());
    // Two millimetres less than the truth: with a tolerance below that, all is hidden.
    let wall = plate(Vec3::ZERO, Vec3::X * 0.5, Vec3::Y * 0.5, 4, Vec2::ZERO, Vec2::ONE);
    let capture = Capture::new(wall, 64, 128, &waves(4.0));
    let tight = UnprojectConfig { depth_tolerance: 1e-3, ..rule(Rule::FourTap) };
    assert!(capture.texture(&tight).coverage() > 0.9);
    let clip = UnprojectConfig { compat: Compat { clip_depth: true, ..Compat::default() }, ..tight };
    assert_eq!(capture.texture(&clip).coverage(), 0.0);
}

#[test]
fn the_second_unprojection_pays() {
    // The images show a body with a bulge of 4 cm at most that its first geometry lacks.
    let plain = sphere(Vec3::ZERO, 0.9, 96, 64, Vec2::ZERO, Vec2::ONE);
    let mut bulged = plain.clone();
    bulged.vertices.iter_mut().for_each(|v| *v *= 1.0 + 0.045 * (3.0 * v.y).cos() * (2.0 * v.x).sin());
    bulged.update_normals();
    let color = waves(12.0);
    let capture = Capture::new(bulged, 256, 512, &color);
    let config = rule(Rule::FourTap);
    let db = |mesh: &TexturedMesh| {
        let texture = unproject(&mesh.mesh(), &capture.table, &capture.views(), &config).unwrap();
        psnr(&texture, &capture.figure, &capture.table, &color)
    };
    let (first, second) = (db(&plain), db(&capture.figure));
    assert!(second >= first + 6.0, "{first} dB, then {second} dB");
}
