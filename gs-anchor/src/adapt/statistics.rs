//! Densification statistics of anchors and their Gaussians since the last pass.
//!
//! ```text
//! opacity[v] += Σ_j max(a_vj, 0),  visits[v] += 1                        every visible anchor
//! grad[v,j]  += |(u_x W/2, u_y H/2)| · weight,  rendered[v,j] += 1       every Gaussian on the screen (radius > 0)
//! ```
//! with `a` the `tanh` of the opacity head and `u = dL/d means2d` per pixel, so that the statistic does not depend on
//! the image size; `weight` undoes a mean over the views of a batch. Values that are not finite count as zero.

use crate::anchors::Anchors;
use gs_core::cast;
use gs_core::{RowEdit, param::RowEditError};

/// One rendered view: outputs of the decoder and of the rasteriser.
#[derive(Clone, Copy, Debug)]
pub struct AnchorView<'a> {
    /// Indices of the decoded anchors ([`DecodeTape::visible`](crate::DecodeTape::visible)).
    pub visible: &'a [u32],
    /// `tanh` of their opacity head, `[visible, k]` ([`DecodeTape::activations`](crate::DecodeTape::activations)).
    pub activations: &'a [f32],
    /// `[splats]`: anchor · k + offset of each ([`DecodeTape::rows`](crate::DecodeTape::rows)).
    pub rows: &'a [u32],
    /// `[splats]`: `dL/d means2d`, per pixel.
    pub grad_means2d: &'a [[f32; 2]],
    /// `[splats]`: radius on screen, pixels; 0 if the splat was not rendered.
    pub radii: &'a [f32],
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Factor on the gradients: the number of views of the batch if the loss is their mean.
    pub weight: f32,
}

/// Densification statistics, one row per anchor, and the passes that use them ([`AnchorDensify::adapt`]).
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorDensify {
    offsets: usize,
    /// Sum over views and Gaussians of the positive opacities, `[V]`.
    pub opacity: Vec<f32>,
    /// Number of views in which the anchor was visible, `[V]`.
    pub visits: Vec<f32>,
    /// Sum over views of the norm of the screen gradient, half-image units, `[V, k]`.
    pub grad: Vec<f32>,
    /// Number of views in which the Gaussian was rendered, `[V, k]`.
    pub rendered: Vec<f32>,
}

/// A buffer of the statistics: name, values per anchor, values.
pub type AnchorColumn<T> = (&'static str, usize, T);

impl AnchorDensify {
    /// Statistics of zero with one row per anchor.
    pub fn new(anchors: &Anchors) -> Self {
        let k = anchors.shape().offsets;
        let mut adapt = Self { offsets: k, opacity: vec![], visits: vec![], grad: vec![], rendered: vec![] };
        adapt.clear(anchors.len());
        adapt
    }

    /// Sets everything to zero, with `anchors` rows.
    pub fn clear(&mut self, anchors: usize) {
        for (_, width, column) in self.columns_mut() {
            column.clear();
            column.resize(anchors * width, 0.0);
        }
    }

    /// The four buffers, each with name and values per anchor, for checkpoints.
    pub fn columns(&self) -> [AnchorColumn<&Vec<f32>>; 4] {
        let k = self.offsets;
        [
            ("adapt.opacity", 1, &self.opacity),
            ("adapt.visits", 1, &self.visits),
            ("adapt.grad", k, &self.grad),
            ("adapt.drawn", k, &self.rendered),
        ]
    }

    /// The buffers of [`AnchorDensify::columns`], to be restored.
    pub fn columns_mut(&mut self) -> [AnchorColumn<&mut Vec<f32>>; 4] {
        let k = self.offsets;
        [
            ("adapt.opacity", 1, &mut self.opacity),
            ("adapt.visits", 1, &mut self.visits),
            ("adapt.grad", k, &mut self.grad),
            ("adapt.drawn", k, &mut self.rendered),
        ]
    }

    /// Adds the statistics of one rendered view.
    pub fn observe(&mut self, view: &AnchorView) {
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        for (&v, activations) in view.visible.iter().zip(view.activations.chunks_exact(self.offsets)) {
            let opacity: f32 = activations.iter().map(|a| a.max(0.0)).sum();
            self.opacity[v as usize] += finite(opacity);
            self.visits[v as usize] += 1.0;
        }
        let (half_w, half_h) = (0.5 * view.width as f32, 0.5 * view.height as f32);
        let splats = view.rows.iter().zip(view.grad_means2d).zip(view.radii);
        for ((&row, g), _) in splats.filter(|(_, radius)| **radius > 0.0) {
            self.grad[row as usize] += finite((g[0] * half_w).hypot(g[1] * half_h) * view.weight);
            self.rendered[row as usize] += 1.0;
        }
    }

    /// Mean screen gradient of a Gaussian; 0 if it was never rendered.
    pub(super) fn mean_grad(&self, row: usize) -> f32 {
        if self.rendered[row] > 0.0 { self.grad[row] / self.rendered[row] } else { 0.0 }
    }

    /// Number of Gaussians per anchor, `k`.
    pub(super) fn offsets(&self) -> usize {
        self.offsets
    }

    pub(super) fn check_rows(&self, anchors: &Anchors) -> Result<(), RowEditError> {
        for (name, width, column) in self.columns() {
            if column.len() != anchors.len() * width {
                let (row, rows) = (cast::to_u32(anchors.len()), column.len() / width);
                return Err(RowEditError::OutOfRange { name: name.to_owned(), row, rows });
            }
        }
        Ok(())
    }

    /// Sets the rows of `judged` anchors and of Gaussians that were rendered in more than `views` views to zero.
    pub(super) fn reset_judged(&mut self, judged: &[u32], views: f32) {
        for &v in judged {
            self.opacity[v as usize] = 0.0;
            self.visits[v as usize] = 0.0;
        }
        for (grad, n) in self.grad.iter_mut().zip(&mut self.rendered).filter(|(_, n)| **n > views) {
            (*grad, *n) = (0.0, 0.0);
        }
    }

    pub(super) fn edit(&mut self, edit: &RowEdit) {
        for (_, width, column) in self.columns_mut() {
            *column = edit.apply_to_column(column, width);
        }
    }
}
