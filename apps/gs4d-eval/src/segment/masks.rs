//! Part masks of views (TRACE, as Gaussian Grouping).
//!
//! ```text
//! P_k(p) = Σ_i w_i(p) [label_i = k]      P_background = Π (1 − α)      label(p) = argmax P
//! ```
//! Splats are rendered in the one-hot colour of their label, three labels per pass.

use gs_core::{Camera, Color, Splats, cast};

use gs_raster::RasterOptions;
use gs_train::method::MethodError;
use gs_train::renderer::Renderer;

/// The part at each pixel: 0 is the background, `k + 1` the part `k`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mask {
    /// Width of the mask, pixels.
    pub width: usize,
    /// Height of the mask, pixels.
    pub height: usize,
    /// One id per pixel, row by row.
    pub ids: Vec<u32>,
    /// Blending weight of that part in the pixel, 0..1.
    pub confidence: Vec<f32>,
}

/// Renders masks one after the other, reusing memory.
pub struct Masker {
    renderer: Renderer,
}

impl Masker {
    /// Renders with `options`, over black whatever their background.
    pub fn new(options: RasterOptions) -> Self {
        Self { renderer: Renderer::new(RasterOptions { background: [0.0; 3], ..options }) }
    }

    /// Renders the mask of `splats` with one label `< k` each.
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn draw(&mut self, splats: &Splats, labels: &[u32], k: usize, camera: &Camera) -> Result<Mask, MethodError> {
        debug_assert_eq!(splats.len(), labels.len());
        let (width, height) = (camera.width as usize, camera.height as usize);
        let mut colored = splats.clone();
        let mut mask = Mask { width, height, ids: vec![0; width * height], confidence: vec![0.0; width * height] };
        for first in (0..cast::to_u32(k.max(1))).step_by(3) {
            let one_hot = |l: &u32| std::array::from_fn(|c| f32::from(*l == first + cast::to_u32(c)));
            colored.color = Color::Rgb(labels.iter().map(one_hot).collect());
            let frame = self.renderer.render(&colored, camera)?;
            if first == 0 {
                mask.confidence.iter_mut().zip(&frame.alpha).for_each(|(c, a)| *c = 1.0 - a);
            }
            let best = mask.ids.iter_mut().zip(&mut mask.confidence);
            for ((id, sure), parts) in best.zip(frame.rgb.data.chunks_exact(3)) {
                for (part, k) in parts.iter().zip(first + 1..) {
                    if *part > *sure {
                        (*id, *sure) = (k, *part);
                    }
                }
            }
        }
        Ok(mask)
    }
}
