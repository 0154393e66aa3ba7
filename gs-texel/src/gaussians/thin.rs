//! Leaving out texel Gaussians that nobody sees.
//!
//! A splat whose opacity is below the rasteriser's smallest alpha (1/255) is skipped at every pixel, so dropping it changes no
//! bit of a picture. Dropping what is small on the screen (`3σ` below some pixels) changes the picture a little and is off
//! unless asked for.

use gs_core::{Camera, Color, Kernel, Splats};
use serde::{Deserialize, Serialize};

/// What may be left out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThinOptions {
    /// Opacities below this are dropped; 1/255 is exact, 0 keeps all.
    pub min_opacity: f32,
    /// Splats whose three largest standard deviations span fewer pixels of the camera are dropped; 0 keeps all, 0.3 is
    /// hardly visible.
    pub min_pixels: f32,
}

impl Default for ThinOptions {
    fn default() -> Self {
        Self { min_opacity: 1.0 / 255.0, min_pixels: 0.0 }
    }
}

/// The rows worth drawing, ascending. Sizes on the screen are judged at the splat's depth, if there is a camera; what lies
/// behind it is judged by its opacity alone.
pub fn worth_drawing(splats: &Splats, camera: Option<&Camera>, options: &ThinOptions) -> Vec<u32> {
    let small = |i: usize| {
        let Some(camera) = camera.filter(|_| options.min_pixels > 0.0) else { return false };
        let depth = camera.to_camera(splats.means[i].as_dvec3()).z;
        let sigma = f64::from(splats.scales[i].abs().max_element());
        depth > 0.0 && 3.0 * sigma * camera.fx.max(camera.fy) < f64::from(options.min_pixels) * depth
    };
    let rows = 0..splats.len();
    rows.filter(|&i| splats.opacities[i] >= options.min_opacity && !small(i)).map(|i| i as u32).collect()
}

/// The given rows of texel Gaussians (whose fall-off is plain) alone, in the given order.
///
/// # Panics
/// If a row is not there.
pub fn select(splats: &Splats, rows: &[u32]) -> Splats {
    fn pick<T: Copy>(column: &[T], rows: &[u32]) -> Vec<T> {
        rows.iter().map(|&r| column[r as usize]).collect()
    }
    let color = match &splats.color {
        Color::Rgb(rgb) => Color::Rgb(pick(rgb, rows)),
        Color::Sh { degree, coeffs } => {
            let width = splats.color.width();
            let coeffs = rows.iter().flat_map(|&r| &coeffs[r as usize * width..][..width]).copied().collect();
            Color::Sh { degree: *degree, coeffs }
        }
    };
    Splats {
        means: pick(&splats.means, rows),
        quats: pick(&splats.quats, rows),
        scales: pick(&splats.scales, rows),
        opacities: pick(&splats.opacities, rows),
        color,
        kernel: Kernel::Gaussian,
    }
}
