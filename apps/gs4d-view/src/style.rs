//! How splats are drawn: as they are, as opaque ellipsoids, or as points.

use gs_core::{Camera, Kernel, Splats, cast};
use serde::Deserialize;

/// Splats with a lower opacity are left out of ellipsoids and points.
const MIN_OPACITY: f32 = 0.05;
/// Opacity of ellipsoids and points: the rasteriser's largest.
const OPAQUE: f32 = 0.99;
/// Acutance of ellipsoids and points: a hard edge where the Gaussian is ½.
const HARD: f32 = 0.9;
/// Distance of that edge from the centre, in standard deviations: √(2 ln 2).
const EDGE: f32 = 1.177_41;
/// Distance of the surface of an ellipsoid from its centre, in standard deviations of the splat.
const SURFACE: f32 = 1.5;
/// Largest points, pixels.
pub(crate) const MAX_POINT: f32 = 32.0;

/// How the splats of an image are drawn.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub enum Style {
    /// As they are.
    #[default]
    Splats,
    /// As opaque ellipsoids of one and a half standard deviations.
    Ellipsoids,
    /// As opaque points of this diameter in pixels, up to 32.
    Points(f32),
}

impl Style {
    /// The splats as they are drawn for a camera.
    pub(crate) fn of(self, mut splats: Splats, camera: &Camera) -> Splats {
        let n = splats.len();
        match self {
            Self::Splats => return splats,
            Self::Ellipsoids => splats.scales.iter_mut().for_each(|s| *s *= SURFACE / EDGE),
            Self::Points(diameter) => {
                let pixel = |i: usize| camera.to_camera(splats.means[i].as_dvec3()).z / camera.fx;
                let scale = |i: usize| glam::Vec3::splat(0.5 * diameter / EDGE * cast::to_f32(pixel(i).max(0.0)));
                splats.scales = (0..n).map(scale).collect();
                splats.quats = vec![[1.0, 0.0, 0.0, 0.0]; n];
            }
        }
        splats.opacities.iter_mut().for_each(|o| *o = if *o < MIN_OPACITY { 0.0 } else { OPAQUE });
        splats.kernel = Kernel::Acutance { acutances: vec![HARD; n] };
        splats
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Color;
    use gs_raster::{RasterOptions, Workspace, measure, render};

    fn alpha(style: Style, scale: f32) -> (f32, f32) {
        let splats = Splats {
            means: vec![glam::Vec3::ZERO],
            quats: vec![[1.0, 0.0, 0.0, 0.0]],
            scales: vec![glam::Vec3::splat(scale)],
            opacities: vec![0.3],
            color: Color::Rgb(vec![[1.0; 3]]),
            kernel: Kernel::Gaussian,
        };
        let camera = measure::camera(128);
        let drawn = style.of(splats, &camera);
        let frame = render(&drawn, &camera, &RasterOptions::default(), &mut Workspace::new());
        let most = frame.alpha.iter().copied().fold(0.0, f32::max);
        let covered = frame.alpha.iter().filter(|a| **a > 0.5).count() as f32;
        (most, 2.0 * (covered / std::f32::consts::PI).sqrt())
    }

    #[test]
    fn points_have_their_size_and_ellipsoids_that_of_the_splat() {
        let (most, diameter) = alpha(Style::Points(9.0), 1e-4);
        assert!(most > 0.98 && (diameter - 9.0).abs() < 1.0, "{most} {diameter}");
        let camera = measure::camera(128);
        let pixel = camera.to_camera(glam::DVec3::ZERO).z / camera.fx;
        let (most, diameter) = alpha(Style::Ellipsoids, 8.0 * cast::to_f32(pixel));
        assert!(most > 0.98 && (diameter - 24.0).abs() < 1.5, "{most} {diameter}");
        assert!((alpha(Style::Splats, 8.0 * cast::to_f32(pixel)).0 - 0.3).abs() < 0.01);
    }
}
