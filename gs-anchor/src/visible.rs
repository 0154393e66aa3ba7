//! Which anchors a camera may see: decoding only those gives the same image.
//!
//! An anchor's Gaussians have their means within `ρ = maxᵢ ‖O'ᵢ ⊙ l'[0:3]‖` of `x'` and extents of at most
//! `s = max |l'[3:6]|`; a field behind the decoder moves and grows them by at most a margin. With `w = √(2 ln 255)`,
//! the support of an opaque Gaussian down to α = 1/255 in standard deviations, all of them lie in a sphere
//!
//! ```text
//! R = ρ + w s + margin          around X = R_v x' + T
//! ```
//! A splat with its mean at `p` (`p_z > 0`) reaches past the right edge of the frame only if
//! `f p_x/p_z + c − w √Σ'ₓₓ ≤ W`; its screen extent obeys `√Σ'ₓₓ ≤ (f/p_z) h s + √dilation` with `h = √(1 + x̃²)` and
//! `x̃` the largest slope the projection's Jacobian takes (it is clamped). Times `p_z / f` this is a half-space, and it
//! must hold somewhere in the sphere:
//!
//! ```text
//! X − κ Z ≤ R max(√(1 + κ²), h)     κ = (W − c + w √dilation) / f          likewise for the other three edges
//! Z + R > 0
//! ```
//! This is **conservative**, for any principal point: no Gaussian that touches the frame is lost. The affine footprint
//! of a splat is wider than the sphere's projection, hence `h`.
//!
//! [`published()`] is the published filter: the anchor's own canonical Gaussian (mean `x`, scales `l[0:3]`, no
//! rotation) has a screen rectangle that touches a tile. That Gaussian is not one that is rendered, and it is not
//! deformed, so anchors that move into view are lost; it is here for comparison.
//!
//! ```
//! use gs_anchor::{AnchorShape, Anchors, LocalAnchors, VisibilityOptions, visible};
//! use gs_core::Camera;
//! use glam::{DVec3, Vec3};
//!
//! let shape = AnchorShape { offsets: 10, features: 32, dynamics: 0 };
//! let anchors = Anchors::new(shape, &[Vec3::Z, Vec3::NEG_Z, 9.0 * Vec3::X], &[-5.0; 3]);
//! let camera = Camera::look_at(64, 64, 0.8, DVec3::ZERO, DVec3::Z, DVec3::Y)?;
//! let (mut local, mut listed) = (LocalAnchors::default(), Vec::new());
//! anchors.activate(&mut local);
//! visible::conservative(&local, &camera, &VisibilityOptions::default(), &mut listed);
//! assert_eq!(listed, [0], "one is behind the camera and one beside the frame");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::{Anchors, LocalAnchors};
use glam::{DVec3, Vec3};
use gs_core::{Camera, cast};
use rayon::prelude::*;

/// `√(2 ln 255)`: standard deviations from the centre of an opaque Gaussian to where its alpha falls below 1/255.
pub const SUPPORT: f64 = 3.329_043;
/// Slopes are clamped this fraction of half the image beyond its border in the projection's Jacobian (3DGS: 1.3 tan).
const SLOPE_MARGIN: f64 = 0.3;
/// Bound on the relative error of `f32` positions.
const POSITION_ERROR: f64 = 1e-6;
/// Anchors per parallel task.
const CHUNK: usize = 2048;

/// Render settings that visibility depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibilityOptions {
    /// Added to the radius of an anchor's sphere, world units: at least `‖Δμ‖ + SUPPORT max |Δs|` of any field behind
    /// the decoder.
    pub margin: f64,
    /// Added to the diagonal of the projected covariance, pixels² (3DGS: 0.3).
    pub dilation: f64,
}

impl Default for VisibilityOptions {
    fn default() -> Self {
        Self { margin: 0.0, dilation: 0.3 }
    }
}

/// Lists the anchors whose Gaussians may touch the frame, in increasing order; conservative.
pub fn conservative(local: &LocalAnchors, camera: &Camera, reach: &VisibilityOptions, out: &mut Vec<u32>) {
    let edges = Edges::new(camera, reach.dilation);
    let k3 = local.offsets.len() / local.len().max(1);
    list(local.len(), out, |v| {
        let radius = radius(&local.offsets[k3 * v..][..k3], &local.scales[6 * v..][..6]) + reach.margin;
        let world = local.positions[v].as_dvec3();
        edges.touch(camera.to_camera(world), radius + POSITION_ERROR * (world.abs().max_element() + radius))
    });
}

/// `ρ + w s`: radius of a sphere around `x'` that holds an anchor's Gaussians.
fn radius(offsets: &[f32], scales: &[f32]) -> f64 {
    let (spread, extent) = (Vec3::from_slice(scales), Vec3::from_slice(&scales[3..]));
    let farthest =
        offsets.as_chunks().0.iter().fold(0.0f32, |m, o| m.max((Vec3::from_array(*o) * spread).length_squared()));
    f64::from(farthest).sqrt() + SUPPORT * f64::from(extent.abs().max_element())
}

/// The four half-spaces of a frame.
struct Edges {
    /// `κ` of the left, right, top and bottom edges, and the factor on the radius.
    edges: [(f64, f64); 4],
}

impl Edges {
    fn new(camera: &Camera, dilation: f64) -> Self {
        let along = |side: u32, f: f64, c: f64| {
            let (side, blur) = (f64::from(side), SUPPORT * dilation.sqrt());
            let slope = (c.max(side - c) + SLOPE_MARGIN * 0.5 * side) / f;
            let edge = |pixels: f64| {
                let kappa = (pixels + blur) / f;
                (kappa, kappa.hypot(1.0).max(slope.hypot(1.0)))
            };
            [edge(c), edge(side - c)]
        };
        let ([left, right], [top, bottom]) =
            (along(camera.width, camera.fx, camera.cx), along(camera.height, camera.fy, camera.cy));
        Self { edges: [left, right, top, bottom] }
    }

    fn touch(&self, p: DVec3, radius: f64) -> bool {
        let outward = [-p.x, p.x, -p.y, p.y];
        p.z + radius > 0.0
            && self.edges.iter().zip(outward).all(|((kappa, factor), out)| out - kappa * p.z <= radius * factor)
    }
}

/// Nearest depth of the published filter.
const NEAR: f64 = 0.2;
/// Added to the diagonal of the projected covariance by the published filter, pixels².
const DILATION: f64 = 0.3;
/// Side of the published filter's tiles, pixels.
const TILE: f64 = 16.0;

/// Lists the anchors that the published filter keeps, in increasing order.
pub fn published(anchors: &Anchors, camera: &Camera, out: &mut Vec<u32>) {
    list(anchors.len(), out, |v| {
        let log = &anchors.log_scales.value[6 * v..][..3];
        let scale = DVec3::new(log[0].exp().into(), log[1].exp().into(), log[2].exp().into());
        rectangle_touches(camera, camera.to_camera(anchors.position(v).as_dvec3()), scale)
    });
}

/// Whether the three-sigma rectangle of an unrotated Gaussian at a camera-space point touches a tile.
fn rectangle_touches(camera: &Camera, p: DVec3, scale: DVec3) -> bool {
    if p.z <= NEAR {
        return false;
    }
    let clamped = |ratio: f64, side: u32, f: f64, c: f64| {
        let (side, beyond) = (f64::from(side), SLOPE_MARGIN * 0.5 * f64::from(side));
        ratio.clamp(-(c + beyond) / f, (side - c + beyond) / f)
    };
    let x = clamped(p.x / p.z, camera.width, camera.fx, camera.cx);
    let y = clamped(p.y / p.z, camera.height, camera.fy, camera.cy);
    let axes = camera.rotation.transpose();
    // Rows of J R_v diag(s).
    let u = (axes.x_axis - x * axes.z_axis) * scale * (camera.fx / p.z);
    let v = (axes.y_axis - y * axes.z_axis) * scale * (camera.fy / p.z);
    let (xx, xy, yy) = (u.length_squared() + DILATION, u.dot(v), v.length_squared() + DILATION);
    let (det, mid) = (xx * yy - xy * xy, 0.5 * (xx + yy));
    if det == 0.0 {
        return false;
    }
    let radius = (3.0 * (mid + (mid * mid - det).max(0.1).sqrt()).sqrt()).ceil();
    let pixel = camera.to_pixel(p) - 0.5;
    let tiles = |at: f64, side: u32| {
        let count = (f64::from(side) / TILE).ceil();
        let tile = |t: f64| (t / TILE).trunc().clamp(0.0, count);
        tile(at + radius + TILE - 1.0) > tile(at - radius)
    };
    tiles(pixel.x, camera.width) && tiles(pixel.y, camera.height)
}

/// The indices below `n` that pass, in increasing order, found in parallel.
fn list(n: usize, out: &mut Vec<u32>, passes: impl Fn(usize) -> bool + Sync) {
    let chunk = |p: usize| -> Vec<u32> {
        (p * CHUNK..n.min((p + 1) * CHUNK)).filter(|&v| passes(v)).map(cast::to_u32).collect()
    };
    let chunks: Vec<Vec<u32>> = (0..n.div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
    out.clear();
    chunks.iter().for_each(|p| out.extend_from_slice(p));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AnchorShape;
    use glam::{DMat3, DQuat};
    use gs_core::Rng;

    fn camera(rng: &mut Rng) -> Camera {
        let mut u = |lo: f32, hi: f32| f64::from(rng.range(lo, hi));
        let (width, height) = (u(8.0, 200.0) as u32, u(8.0, 200.0) as u32);
        let (w, h) = (f64::from(width), f64::from(height));
        let turn = DQuat::from_xyzw(u(-1.0, 1.0), u(-1.0, 1.0), u(-1.0, 1.0), u(-1.0, 1.0)).normalize();
        Camera {
            width,
            height,
            fx: w * u(0.2, 3.0),
            fy: h * u(0.2, 3.0),
            // Inside the frame and far outside of it.
            cx: w * u(-0.8, 1.8),
            cy: h * u(-0.8, 1.8),
            rotation: DMat3::from_quat(turn),
            translation: DVec3::new(u(-1.0, 1.0), u(-1.0, 1.0), u(-1.0, 3.0)),
        }
    }

    /// Whether a splat's ellipse at α = 1/255 touches the frame, by the rasteriser's own formulas.
    fn touches(camera: &Camera, mean: DVec3, axes: DMat3, scale: DVec3) -> bool {
        let p = camera.to_camera(mean);
        if p.z <= 0.0 {
            return false;
        }
        let turned = (camera.rotation * axes).transpose();
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let reach = |ratio: f64, row: DVec3, side: f64, f: f64, c: f64| {
            let beyond = 0.15 * side / f;
            let slope = ratio.clamp(-c / f - beyond, (side - c) / f + beyond);
            SUPPORT * (((row - slope * turned.z_axis) * scale * (f / p.z)).length_squared() + 0.3).sqrt()
        };
        let at = camera.to_pixel(p);
        let x = reach(p.x / p.z, turned.x_axis, w, camera.fx, camera.cx);
        let y = reach(p.y / p.z, turned.y_axis, h, camera.fy, camera.cy);
        at.x + x >= 0.0 && at.x - x <= w && at.y + y >= 0.0 && at.y - y <= h
    }

    /// Twenty thousand anchors of four Gaussians seen by random cameras, moved within the margin: nothing that touches
    /// the frame is lost, and the filter does leave out.
    #[test]
    fn clean_loses_nothing_that_touches_the_frame() {
        let (mut left_out, mut needed, mut listed) = (0, 0, 0);
        for case in 0..400 {
            let mut rng = Rng::new(3, "visible", 0, case);
            let camera = camera(&mut rng);
            camera.check().unwrap();
            let reach =
                VisibilityOptions { margin: if case % 2 == 0 { 0.0 } else { 0.2 }, ..VisibilityOptions::default() };
            let mut local = LocalAnchors::default();
            for _ in 0..50 {
                let mut v = |scale: f32| scale * rng.normal();
                local.positions.push(Vec3::new(v(2.0), v(2.0), v(2.0)));
                local.offsets.extend((0..12).map(|_| v(1.0)));
                local.scales.extend((0..6).map(|_| 0.2 * v(1.0) * (0.5 * v(1.0)).exp()));
            }
            let mut seen = Vec::new();
            conservative(&local, &camera, &reach, &mut seen);
            assert!(seen.is_sorted_by(|a, b| a < b));
            listed += seen.len();
            left_out += 50 - seen.len();
            for v in 0..50 {
                let (spread, extent) = (&local.scales[6 * v..][..3], &local.scales[6 * v + 3..][..3]);
                let touched = (0..4).any(|j| {
                    let mut n = || f64::from(rng.normal());
                    let axes = DMat3::from_quat(DQuat::from_xyzw(n(), n(), n(), n()).normalize());
                    let moved = DVec3::new(n(), n(), n()).normalize() * 0.4 * reach.margin;
                    let offset = Vec3::from_slice(&local.offsets[12 * v + 3 * j..]) * Vec3::from_slice(spread);
                    let grown = Vec3::from_slice(extent).abs().as_dvec3() + 0.6 * reach.margin / SUPPORT;
                    touches(&camera, (local.positions[v] + offset).as_dvec3() + moved, axes, grown)
                });
                needed += usize::from(touched);
                assert!(
                    !touched || seen.contains(&(v as u32)),
                    "case {case}: anchor {v} touches the frame but is not listed"
                );
            }
        }
        assert!(left_out > 5_000 && needed > 3_000, "{left_out} left out, {needed} needed");
        assert!(3 * needed > listed, "{listed} listed for {needed} that touch the frame");
    }

    fn looking_down_z() -> Camera {
        let (rotation, translation) = (DMat3::IDENTITY, DVec3::ZERO);
        Camera { width: 64, height: 64, fx: 64.0, fy: 64.0, cx: 32.0, cy: 32.0, rotation, translation }
    }

    /// Anchors on the optical axis, at the near plane, and to the right and left until the rectangle, three pixels
    /// each way, leaves the last tile and the first.
    #[test]
    fn the_published_filter_follows_its_rectangle() {
        let shape = AnchorShape { offsets: 1, features: 1, dynamics: 0 };
        // σ on screen ≪ the dilation: λ = 0.3 + √0.1, 3√λ = 2.36, radius 3.
        let x = |pixel: f64| ((pixel + 0.5 - 32.0) / 64.0) as f32;
        let at = [
            (Vec3::new(0.0, 0.0, 1.0), true),
            (Vec3::new(0.0, 0.0, 0.19), false),
            (Vec3::new(0.0, 0.0, -1.0), false),
            (Vec3::new(x(66.9), 0.0, 1.0), true),
            (Vec3::new(x(67.1), 0.0, 1.0), false),
            (Vec3::new(x(-1.9), 0.0, 1.0), true),
            (Vec3::new(x(-2.1), 0.0, 1.0), false),
            (Vec3::new(0.0, x(66.9), 1.0), true),
            (Vec3::new(0.0, x(67.1), 1.0), false),
        ];
        let anchors = Anchors::new(shape, &at.map(|a| a.0), &[-20.0; 9]);
        let mut seen = Vec::new();
        published(&anchors, &looking_down_z(), &mut seen);
        let want: Vec<u32> = (0..9).filter(|&v| at[v as usize].1).collect();
        assert_eq!(seen, want);
    }

    /// What the published filter loses and the clean one keeps: an anchor out of view whose Gaussians are in it.
    #[test]
    fn offsets_count_for_clean_only() {
        let shape = AnchorShape { offsets: 1, features: 1, dynamics: 0 };
        let mut anchors = Anchors::new(shape, &[Vec3::new(3.0, 0.0, 1.0)], &[0.01f32.ln()]);
        anchors.offsets.value[0] = -300.0;
        let (mut local, mut seen) = (LocalAnchors::default(), Vec::new());
        anchors.activate(&mut local);
        conservative(&local, &looking_down_z(), &VisibilityOptions::default(), &mut seen);
        assert_eq!(seen, [0]);
        published(&anchors, &looking_down_z(), &mut seen);
        assert!(seen.is_empty());
        local.offsets[0] = 0.0;
        conservative(&local, &looking_down_z(), &VisibilityOptions::default(), &mut seen);
        assert!(seen.is_empty());
        conservative(
            &local,
            &looking_down_z(),
            &VisibilityOptions { margin: 3.0, ..VisibilityOptions::default() },
            &mut seen,
        );
        assert_eq!(seen, [0]);
        conservative(&LocalAnchors::default(), &looking_down_z(), &VisibilityOptions::default(), &mut seen);
        assert!(seen.is_empty());
    }
}
