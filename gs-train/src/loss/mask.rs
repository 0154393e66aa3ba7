//! Pixels that do not count: the ground truth there is what is rendered, and no gradient goes back.

use gs_core::Image;
use gs_raster::FrameGrad;

/// `target ← m target + (1 − m) rendered`, the mask `m` being `[H, W, 1]`, the images `[H, W, 3]`.
pub(super) fn keep_outside(mask: &Image, rendered: &Image, target: &mut Image) {
    let pixels = target.data.chunks_exact_mut(3).zip(rendered.data.chunks_exact(3));
    for ((target, rendered), m) in pixels.zip(&mask.data) {
        target.iter_mut().zip(rendered).for_each(|(y, x)| *y = m * *y + (1.0 - m) * x);
    }
}

/// `grad ← m grad`; gives the mean of `m`.
pub(super) fn apply(mask: &Image, grad: &mut FrameGrad) -> f64 {
    for (grad, m) in grad.rgb.chunks_exact_mut(3).zip(&mask.data) {
        grad.iter_mut().for_each(|g| *g *= m);
    }
    grad.alpha.iter_mut().zip(&mask.data).for_each(|(g, m)| *g *= m);
    mask.data.iter().map(|m| f64::from(*m)).sum::<f64>() / mask.data.len().max(1) as f64
}
