//! The pyramid of Farneback's method: frames, their expansions, and the flow from coarse to fine.

use gs_core::{Image, cast};

use super::Flow;
use super::expand::expand;
use super::grey::grey;
use super::resample::{Axis, resample};
use super::solve::{equations, solve};
use crate::error::MetricError;

/// Largest number of halvings of the frame.
const HALVINGS: u32 = 3;
/// Shortest side of the coarsest level, pixels.
const MIN_SIDE: f64 = 32.0;
/// Least-squares solutions at each level of the pyramid.
const ITERATIONS: usize = 3;

/// A frame prepared for [`Farneback::between`]: the quadratic around every pixel at every scale. [`Farneback::expand`] fills it.
#[derive(Clone, Debug, Default)]
pub struct Expansion {
    width: usize,
    height: usize,
    /// Coefficients `[H, 5, W]` of each level, finest first.
    levels: Vec<Vec<f32>>,
}

/// Estimates optical flow and keeps its buffers between calls. In a sequence, expand each frame once:
///
/// ```
/// use gs_core::Image;
/// use gs_metrics::flow::{Expansion, Farneback, Flow, farneback};
/// let frame = |seed: usize| {
///     let data = (0..1536).map(|i| (i * i % (97 + seed)) as f32 / 100.0).collect();
///     Image { width: 48, height: 32, channels: 1, data }
/// };
/// let (mut estimate, mut flow) = (Farneback::default(), Flow::default());
/// let mut expansions = [Expansion::default(), Expansion::default()];
/// estimate.expand(&frame(0), &mut expansions[0])?;
/// estimate.expand(&frame(1), &mut expansions[1])?;
/// estimate.between(&expansions[0], &expansions[1], &mut flow)?;
/// assert_eq!(flow, farneback(&frame(0), &frame(1))?);
/// # Ok::<(), gs_metrics::MetricError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Farneback {
    plane: Vec<f32>,
    level: Vec<f32>,
    equations: Vec<f32>,
    coarse: Flow,
    frames: [Expansion; 2],
}

/// Flow from `first` to `second`, images `[H, W, 1 or 3]` in `[0, 1]`, which are rounded to 8 bits first ([`grey`](fn@grey)).
///
/// # Errors
/// Different shapes, 2 or 4 channels, or a value that is not finite.
///
/// ```
/// use gs_core::Image;
/// let wave = |x: f32, y: f32| 0.5 + 0.2 * (0.3 * x).sin() + 0.2 * (0.25 * y).cos();
/// let frame = |dx: f32| {
///     let data = (0..64 * 48).map(|i| wave((i % 64) as f32 - dx, (i / 64) as f32)).collect();
///     Image { width: 64, height: 48, channels: 1, data }
/// };
/// let flow = gs_metrics::flow::farneback(&frame(0.0), &frame(1.5))?;
/// let [u, v] = flow.at(32, 24);
/// assert!((u - 1.5).abs() < 0.05 && v.abs() < 0.05);
/// # Ok::<(), gs_metrics::MetricError>(())
/// ```
pub fn farneback(first: &Image, second: &Image) -> Result<Flow, MetricError> {
    let mut out = Flow::default();
    Farneback::default().flow(first, second, &mut out)?;
    Ok(out)
}

impl Farneback {
    /// Flow from `first` to `second`, into `out`; see [`farneback`].
    ///
    /// # Errors
    /// Those of [`farneback`].
    pub fn flow(&mut self, first: &Image, second: &Image, out: &mut Flow) -> Result<(), MetricError> {
        let mut frames = std::mem::take(&mut self.frames);
        let result = self.expand(first, &mut frames[0]).and_then(|()| self.expand(second, &mut frames[1]));
        let result = result.and_then(|()| self.between(&frames[0], &frames[1], out));
        self.frames = frames;
        result
    }

    /// Expands a frame `[H, W, 1 or 3]` in `[0, 1]` into `out`, for all pairs it belongs to.
    ///
    /// # Errors
    /// A malformed image, 2 or 4 channels, or a value that is not finite.
    pub fn expand(&mut self, frame: &Image, out: &mut Expansion) -> Result<(), MetricError> {
        let grey = grey(frame)?;
        self.plane.clear();
        self.plane.extend(grey.iter().map(|v| f32::from(*v)));
        let (w, h) = (frame.width, frame.height);
        (out.width, out.height) = (w, h);
        out.levels.resize_with(halvings(w, h) as usize + 1, Vec::new);
        for (k, fit) in out.levels.iter_mut().enumerate() {
            let (level_w, level_h) = level_size(w, h, k);
            let kernel = blur_kernel(k);
            self.level.resize(level_w * level_h, 0.0);
            let (columns, rows) = (Axis::new(w, level_w, &kernel), Axis::new(h, level_h, &kernel));
            resample(&self.plane, &columns, &rows, 1.0, &mut self.level);
            expand(&self.level, level_w, fit);
        }
        Ok(())
    }

    /// Flow from the first expanded frame to the second, into `out`.
    ///
    /// # Errors
    /// If the frames have different sizes, or one was never expanded.
    pub fn between(&mut self, first: &Expansion, second: &Expansion, out: &mut Flow) -> Result<(), MetricError> {
        let shape = |e: &Expansion| (e.width, e.height, 1);
        if shape(first) != shape(second) || first.levels.is_empty() {
            let what = "frames of a flow";
            return Err(MetricError::Shape { what, first: shape(first), second: shape(second) });
        }
        let (w, h) = (first.width, first.height);
        for k in (0..first.levels.len()).rev() {
            let (level_w, level_h) = level_size(w, h, k);
            std::mem::swap(out, &mut self.coarse);
            out.reset(level_w, level_h);
            if k + 1 < first.levels.len() {
                let columns = Axis::new(self.coarse.width, level_w, &[1.0]);
                let rows = Axis::new(self.coarse.height, level_h, &[1.0]);
                resample(&self.coarse.u, &columns, &rows, 2.0, &mut out.u);
                resample(&self.coarse.v, &columns, &rows, 2.0, &mut out.v);
            }
            for _ in 0..ITERATIONS {
                equations(&first.levels[k], &second.levels[k], out, &mut self.equations);
                solve(&self.equations, out);
            }
        }
        Ok(())
    }
}

/// Number of halvings of a frame.
fn halvings(w: usize, h: usize) -> u32 {
    let side = w.min(h) as f64;
    (1..=HALVINGS).take_while(|k| side * 0.5f64.powi(*k as i32) >= MIN_SIDE).last().unwrap_or(0)
}

/// Width and height in pixels after `k` halvings.
fn level_size(w: usize, h: usize, k: usize) -> (usize, usize) {
    let scaled = |n: usize| cast::to_usize((n as f64 / f64::from(1u32 << k)).round_ties_even());
    (scaled(w), scaled(h))
}

/// The blur before a frame is halved `k` times: a Gaussian of `σ = (2ᵏ − 1)/2`; `[¼, ½, ¼]` for none.
fn blur_kernel(k: usize) -> Vec<f32> {
    let sigma = ((1u32 << k) - 1) as f64 * 0.5;
    if k == 0 {
        return vec![0.25, 0.5, 0.25];
    }
    let taps = (cast::to_usize((5.0 * sigma).round_ties_even()) | 1).max(3);
    let centre = (taps / 2) as f64;
    let g: Vec<f64> = (0..taps).map(|i| (-(i as f64 - centre).powi(2) / (2.0 * sigma * sigma)).exp()).collect();
    let total: f64 = g.iter().sum();
    g.iter().map(|v| cast::to_f32(v / total)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_and_kernels_agree_with_the_description() {
        assert_eq!([31, 63, 64, 127, 128, 255, 256, 4000].map(|n| halvings(n, 4000)), [0, 0, 1, 1, 2, 2, 3, 3]);
        assert_eq!(level_size(741, 499, 1), (370, 250));
        assert_eq!([0, 1, 2, 3].map(|k| blur_kernel(k).len()), [3, 3, 9, 19]);
        for k in 0..4 {
            assert!((blur_kernel(k).iter().sum::<f32>() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn frames_must_have_one_size() {
        let mut estimate = Farneback::default();
        let (a, b) = (Image::zeros(20, 30, 3), Image::zeros(30, 20, 3));
        let mut out = Flow::default();
        let e = estimate.flow(&a, &b, &mut out).unwrap_err();
        assert!(e.to_string().contains("(20, 30, 1) and (30, 20, 1)"), "{e}");
        assert!(estimate.between(&Expansion::default(), &Expansion::default(), &mut out).is_err());
        assert!(matches!(farneback(&Image::zeros(0, 0, 3), &a), Err(MetricError::TooSmall { .. })));
    }
}
