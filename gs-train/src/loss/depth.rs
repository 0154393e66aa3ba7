//! Depth as ground truth: how far what is rendered lies before or behind what was measured.
//!
//! ```text
//! L = 1/n Σ_p m_p |D_p / z_p − A_p|        D = Σ w z,  A = Σ w        dL/dD = m sign / (n z)    dL/dA = −m sign / n
//! ```
//! over the `n = H · W` pixels of a frame of depth `D` and alpha `A`; `z` was measured, `m` is the mask. Since `D / z − A = Σ w (z_i / z − 1)`, it
//! is the relative distance of the splats to the surface, each as much as it is seen. Pixels without measurement add nothing.

use super::sign;
use gs_core::Image;
use gs_raster::{Frame, FrameGrad};

/// The value for a frame; `weight` times its gradient is written to `grad.depth`, and added to `grad.alpha`.
pub(super) fn evaluate(
    frame: &Frame,
    measured: &Image,
    mask: Option<&Image>,
    weight: f32,
    grad: &mut FrameGrad,
) -> f64 {
    let n = frame.depth.len();
    grad.depth.resize(n, 0.0);
    grad.alpha.resize(n, 0.0);
    let step = weight / n as f32;
    let mut sum = 0.0;
    for (p, &z) in measured.data.iter().enumerate() {
        let m = mask.map_or(1.0, |mask| mask.data[p]);
        if z > 0.0 {
            let off = frame.depth[p] / z - frame.alpha[p];
            sum += f64::from(m * off.abs());
            let d = m * step * sign(off);
            grad.depth[p] = d / z;
            grad.alpha[p] -= d;
        }
    }
    sum / n as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        let (width, height) = (7, 5);
        let mut rng = Rng::new(2, "loss.depth", 0, 0);
        let mut values = |low: f32, high: f32| (0..width * height).map(|_| rng.range(low, high)).collect::<Vec<f32>>();
        let mut frame = Frame { alpha: values(0.2, 1.0), depth: values(0.5, 3.0), ..Frame::default() };
        let image = |data| Image { width, height, channels: 1, data };
        let (mut measured, mask) = (image(values(1.0, 4.0)), image(values(0.0, 1.0)));
        measured.data[11] = 0.0;
        let mut grad = FrameGrad::default();
        let at = evaluate(&frame, &measured, Some(&mask), 0.5, &mut grad);
        let by_hand = (0..width * height).filter(|p| *p != 11).map(|p| {
            let off = f64::from(frame.depth[p]) / f64::from(measured.data[p]) - f64::from(frame.alpha[p]);
            f64::from(mask.data[p]) * off.abs() / (width * height) as f64
        });
        assert!((at - by_hand.sum::<f64>()).abs() < 1e-6);
        let h = 1e-3;
        for p in 0..width * height {
            let mut slope = |value: &dyn Fn(&mut Frame) -> &mut f32| {
                let mut at = |by: f32| {
                    *value(&mut frame) += by;
                    let loss = evaluate(&frame, &measured, Some(&mask), 0.5, &mut FrameGrad::default());
                    *value(&mut frame) -= by;
                    0.5 * loss
                };
                (at(h) - at(-h)) / f64::from(2.0 * h)
            };
            let want = [slope(&|f| &mut f.depth[p]), slope(&|f| &mut f.alpha[p])];
            for (got, want) in [grad.depth[p], grad.alpha[p]].into_iter().zip(want) {
                assert!((f64::from(got) - want).abs() < 1e-5, "pixel {p}: {got} {want}");
            }
        }
        assert_eq!((grad.depth[11], grad.alpha[11]), (0.0, 0.0), "nothing was measured there");
    }
}
