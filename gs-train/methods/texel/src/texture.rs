//! Colours stay on the surface: what a camera sees at a texel should be the texel's mean colour over the recording.
//!
//! ```text
//! L = Σ_k Σ_i v_ki |I_i(π_i(x_k)) − T̄_k|² / Σ_k Σ_i v_ki        x_k = Σ b p, the texel on the deformed posed surface
//! dL/dx = 2 v (I − T̄)ᵀ ∇I J_π / Σ v
//! ```
//! Points say nothing of how a surface slides along itself; its texture does. Ours, not the paper's: it wants a person whose
//! light hardly changes. Which texels are seen is held still; only those count whose four pixels are all covered.

use super::actor::{Actor, FrameError};
use glam::{DMat3, DVec2, DVec3, Vec3};
use gs_core::{Camera, Image, cast};
use gs_texel::surface::Mesh;
use gs_texel::surface_loss::SurfaceLoss;
use gs_texel::unproject::{self, FuseWeight, UnprojectConfig, unproject};

/// Least coverage of the pixels that are compared, and least share of a footprint that shows the texel's own surface.
const COVERED: f32 = 0.99;

/// The loss of a posed surface, `N` world positions, in images, against mean colours of GauNet's texels; texels without one do not
/// count.
///
/// Texels weigh `cos⁴` of the angle between normal and camera, whatever `unproject.fuse` is: a pixel of a slanted surface is the mean over
/// `1/cos` as much of it, so its colour errs by a multiple of `1/cos²`, and weights go with the inverse variance.
///
/// # Errors
/// If positions are not finite or images do not fit.
pub(crate) fn texture_loss(
    actor: &Actor,
    surface: &[Vec3],
    images: &[(Camera, Image)],
    mean: &[Option<[f32; 3]>],
) -> Result<SurfaceLoss, FrameError> {
    let (table, faces) = (&actor.gau, &actor.scene.character.template.faces);
    let normals = actor.topology.normals(surface, faces);
    let mesh = Mesh { vertices: surface, normals: &normals, faces };
    let views: Vec<_> = images.iter().map(|(camera, image)| unproject::View { camera, image, mask: None }).collect();
    let config = UnprojectConfig { keep_views: true, fuse: FuseWeight::Mask, ..actor.unproject };
    let seen = unproject(&mesh, table, &views, &config)?.by_view;
    let mut loss = SurfaceLoss { value: 0.0, grad: vec![DVec3::ZERO; surface.len()] };
    let mut total = 0.0f64;
    for (k, weights) in seen.chunks_exact(images.len().max(1)).enumerate() {
        let Some(wanted) = mean[k] else { continue };
        let corners = faces[table.tri[k] as usize];
        let bary = table.weights(k).map(f64::from);
        let x: DVec3 = corners.iter().zip(bary).map(|(v, b)| b * surface[*v as usize].as_dvec3()).sum();
        for (weight, (camera, image)) in weights.iter().zip(images).filter(|(w, _)| **w >= COVERED) {
            let Some((value, d)) = compare(camera, image, x, wanted) else { continue };
            let n: DVec3 = corners.iter().zip(bary).map(|(v, b)| b * normals[*v as usize].as_dvec3()).sum();
            let cos = n.normalize_or_zero().dot((camera.position() - x).normalize_or_zero()).max(0.0);
            let weight = f64::from(*weight) * cos.powi(4);
            total += weight;
            loss.value += weight * value;
            corners.iter().zip(bary).for_each(|(v, b)| loss.grad[*v as usize] += weight * b * d);
        }
    }
    if total > 0.0 {
        loss.value /= total;
        loss.grad.iter_mut().for_each(|g| *g /= total);
    }
    Ok(loss)
}

/// `|I(π(x)) − wanted|²` and its gradient, where the whole footprint is covered.
fn compare(camera: &Camera, image: &Image, x: DVec3, wanted: [f32; 3]) -> Option<(f64, DVec3)> {
    let q = camera.to_camera(x);
    let at = camera.to_pixel(q) - DVec2::splat(0.5);
    let inside = |v: f64, side: usize| v >= 0.0 && v + 1.0 < side as f64;
    if !(q.z > 0.0 && inside(at.x, image.width) && inside(at.y, image.height)) {
        return None;
    }
    let (column, row) = (cast::to_usize(at.x), cast::to_usize(at.y));
    let taps = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| image.pixel(column + i, row + j));
    if taps.iter().any(|t| t[3] < COVERED) {
        return None;
    }
    let (s, t) = (at.x - column as f64, at.y - row as f64);
    let (mut value, mut slope) = (0.0f64, DVec2::ZERO);
    for c in 0..3 {
        let [a, b, d, e] = taps.map(|tap| f64::from(tap[c]));
        let away = (1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * d + s * e) - f64::from(wanted[c]);
        value += away * away;
        slope += 2.0 * away * DVec2::new((1.0 - t) * (b - a) + t * (e - d), (1.0 - s) * (d - a) + s * (e - b));
    }
    // Rows of the projection's Jacobian in camera space.
    let (u, v) = (slope.x * camera.fx / q.z, slope.y * camera.fy / q.z);
    let d = DVec3::new(u, v, -(u * q.x + v * q.y) / q.z);
    let back: DMat3 = camera.rotation.transpose();
    Some((value, back * d))
}

#[cfg(test)]
mod tests {
    use super::super::Config;
    use super::*;
    use glam::Mat3;
    use gs_synth::avatar::{AvatarOptions, generate};
    use gs_texel::skin::skin;
    use gs_train::registry::own_settings;

    /// A turn about the axis slides a cylinder along itself: no point says so.
    #[test]
    fn texture_says_how_far_a_surface_slid() {
        let film =
            AvatarOptions { template: "builtin:cylinder".into(), size: 128, frames: 2, ..AvatarOptions::default() };
        let scene = generate(&film).unwrap().avatar.unwrap();
        let config = gs_methods::registry().find("dut").unwrap().config("tiny").unwrap();
        let actor = Actor::new(scene.clone(), &own_settings(config).try_into::<Config>().unwrap()).unwrap();
        let (frame, mean) = (&scene.frames[0], actor.mean.seen().collect::<Vec<_>>());
        let (posed, images) = (actor.pose(&frame.pose), actor.images(frame).unwrap());
        let still = skin(&posed.canonical, &posed.transforms);
        let turned = |angle: f32| -> Vec<Vec3> { still.iter().map(|p| Mat3::from_rotation_y(angle) * *p).collect() };
        let loss = |angle: f32| texture_loss(&actor, &turned(angle), &images, &mean).unwrap();
        let slope = |angle: f32| -> f64 {
            let along = turned(angle).into_iter().map(|p| Vec3::Y.cross(p).as_dvec3());
            loss(angle).grad.iter().zip(along).map(|(g, a)| g.dot(a)).sum()
        };
        for angle in [-0.1, 0.1] {
            assert!(loss(angle).value > 4.0 * loss(0.0).value, "{angle}: {} {}", loss(angle).value, loss(0.0).value);
            assert!(slope(angle) * f64::from(angle) > 0.0, "{angle}: {}", slope(angle));
            let difference = (loss(angle + 0.01).value - loss(angle - 0.01).value) / 0.02;
            assert!((slope(angle) / difference - 1.0).abs() < 0.15, "{angle}: {} {difference}", slope(angle));
        }
    }

    #[test]
    fn gradient_matches_differences() {
        let camera = Camera::look_at(32, 24, 0.7, DVec3::new(0.4, 0.3, 2.0), DVec3::ZERO, DVec3::Y).unwrap();
        let mut image = Image::zeros(32, 24, 4);
        for (y, x) in (0..24).flat_map(|y| (0..32).map(move |x| (y, x))) {
            let wave = |f: f32| 0.5 + 0.3 * (f * x as f32 + 0.2 * y as f32).sin();
            image.pixel_mut(x, y).copy_from_slice(&[wave(0.5), wave(0.3), wave(0.8), 1.0]);
        }
        let wanted = [0.4, 0.6, 0.5];
        let value = |x: DVec3| compare(&camera, &image, x, wanted).unwrap().0;
        for x in [DVec3::ZERO, DVec3::new(0.1, -0.07, 0.2), DVec3::new(-0.13, 0.11, -0.3)] {
            let (_, d) = compare(&camera, &image, x, wanted).unwrap();
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let want = (value(x + 1e-6 * axis) - value(x - 1e-6 * axis)) / 2e-6;
                assert!((d.dot(axis) - want).abs() < 1e-6 * d.length(), "{x} {axis}: {} {want}", d.dot(axis));
            }
        }
        image.pixel_mut(16, 12)[3] = 0.5;
        assert_eq!(compare(&camera, &image, DVec3::ZERO, wanted), None, "not covered");
        assert_eq!(compare(&camera, &image, DVec3::new(0.0, 9.0, 0.0), wanted), None, "beyond the frame");
    }
}
