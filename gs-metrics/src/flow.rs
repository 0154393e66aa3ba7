//! Dense optical flow between two images by Farneback's polynomial expansion, and statistics of flows.
//!
//! Near a pixel a grey image is a quadratic, `f(d) = c + bᵀd + dᵀAd`, fitted in a Gaussian window. If the second image is
//! the first moved by `d`, then `A` is unchanged and `b' = b − 2Ad`, so every pixel gives two equations
//! ```text
//! A d = ½ (b − b'(x + d₀)) + A d₀,   A = ½ (A₁ + A₂(x + d₀))
//! ```
//! around an estimate `d₀`. They are solved by least squares over a 15 × 15 box, three times at each of up to four scales,
//! from coarse to fine. `1e-3` is added to the determinant, so a flat image has the flow 0 and not NaN. That constant has the
//! unit of grey values to the fourth power: grey values are 0 to 255, not 0 to 1.
//!
//! Windows, borders, the order of pyramid and blur, and every constant are those of OpenCV 4.10's
//! `calcOpticalFlowFarneback(pyr_scale .5, levels 3, winsize 15, iterations 3, poly_n 5, poly_sigma 1.2, flags 0)`, the basis
//! of published temporal scores; the tests require agreement with OpenCV within 1e-3 pixels. Values are `f32`, except that
//! the box sums and the solution are `f64`, because determinants cancel along straight edges.
//!
//! | item | content |
//! |---|---|
//! | [`grey`](fn@grey) | 8-bit grey values by OpenCV's integer formula |
//! | [`Farneback`], [`farneback`] | the flow of a pair, or of a sequence with each frame expanded once |
//! | [`wheel`], [`arrows`] | a flow as colours, or as arrows on a grid over an image |
//! | [`Flow::warp`], [`end_point_error`], [`circular_variance`], [`mask_contrast`] | warping and statistics |
//!
//! Farneback, *Two-frame motion estimation based on polynomial expansion*, SCIA 2003.

mod draw;
mod expand;
mod farneback;
mod grey;
mod measure;
mod resample;
mod solve;

use gs_core::Image;

use crate::error::MetricError;

pub use draw::{arrows, wheel};
pub use farneback::{Expansion, Farneback, farneback};
pub use grey::grey;
pub use measure::{MaskContrast, Reference, circular_variance, end_point_error, mask_contrast};

/// One displacement in pixels per pixel: the content of the first image at `(x, y)` is at `(x + u, y + v)` in the second.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flow {
    /// Width of both columns, pixels.
    pub width: usize,
    /// Height of both columns, pixels.
    pub height: usize,
    /// Displacements along x (right), pixels, `[H, W]` row-major.
    pub u: Vec<f32>,
    /// Displacements along y (down), pixels, `[H, W]` row-major.
    pub v: Vec<f32>,
}

impl Flow {
    /// A flow of `width × height` pixels without motion.
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, u: vec![0.0; width * height], v: vec![0.0; width * height] }
    }

    /// Sets this flow to zeros of another size and keeps its memory.
    pub(crate) fn reset(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        for plane in [&mut self.u, &mut self.v] {
            plane.clear();
            plane.resize(width * height, 0.0);
        }
    }

    /// The displacement `[u, v]` of pixel `(x, y)`, pixels.
    pub fn at(&self, x: usize, y: usize) -> [f32; 2] {
        let i = y * self.width + x;
        [self.u[i], self.v[i]]
    }

    /// The flow of a rectangle of the image.
    pub(crate) fn crop(&self, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> Self {
        let cut = |plane: &[f32]| {
            let lines = rows.clone().map(|y| y * self.width);
            lines.flat_map(|at| &plane[at + columns.start..at + columns.end]).copied().collect()
        };
        Self { width: columns.len(), height: rows.len(), u: cut(&self.u), v: cut(&self.v) }
    }

    /// The length of every displacement in pixels, `[H, W]`.
    pub fn magnitudes(&self) -> Vec<f32> {
        self.u.iter().zip(&self.v).map(|(u, v)| u.hypot(*v)).collect()
    }

    /// Backward warping: resamples the second image into the first, `out(x) = image(x + flow)`, bilinear, with the nearest pixel
    /// outside. `image` is `[H, W, C]`.
    ///
    /// ```
    /// use gs_core::Image;
    /// use gs_metrics::Flow;
    /// let flow = Flow { u: vec![0.5; 3], ..Flow::zeros(3, 1) };
    /// let second = Image { width: 3, height: 1, channels: 1, data: vec![0.0, 1.0, 4.0] };
    /// assert_eq!(flow.warp(&second)?.data, [0.5, 2.5, 4.0]);
    /// # Ok::<(), gs_metrics::MetricError>(())
    /// ```
    ///
    /// # Errors
    /// If the image has another size, or the flow is malformed or not finite.
    pub fn warp(&self, image: &Image) -> Result<Image, MetricError> {
        measure::warp(self, image)
    }

    /// Returns an error for a flow with planes of the wrong length, or with a NaN or an infinity.
    pub(crate) fn check(&self, which: &'static str) -> Result<(), MetricError> {
        let (w, h) = (self.width, self.height);
        for plane in [&self.u, &self.v] {
            if w.checked_mul(h) != Some(plane.len()) || plane.is_empty() {
                return Err(MetricError::Malformed { which, shape: (w, h, 1), len: plane.len() });
            }
        }
        let bad = |channel: usize, plane: &[f32]| {
            let at = plane.iter().position(|v| !v.is_finite())?;
            Some(MetricError::NotFinite { which, x: at % w, y: at / w, channel })
        };
        bad(0, &self.u).or_else(|| bad(1, &self.v)).map_or(Ok(()), Err)
    }
}
