//! What is known of anchors and their Gaussians since the last pass.
//!
//! ```text
//! opacity[v] += Σ_j max(a_vj, 0),  visits[v] += 1                        every visible anchor
//! grad[v,j]  += |(u_x W/2, u_y H/2)| · weight,  drawn[v,j] += 1          every Gaussian on the screen (radius > 0)
//! ```
//! with `a` the opacities before the gate and `u = dL/d means2d` per pixel, so that the statistic does not depend on the
//! image size; `weight` undoes a mean over the views of a batch. What is not finite counts as zero.

use crate::anchors::Anchors;
use gs_core::{RowEdit, param::RowEditError};

/// One view, as seen by the decoder and the rasteriser.
#[derive(Clone, Copy, Debug)]
pub struct AnchorView<'a> {
    /// Anchors decoded.
    pub visible: &'a [u32],
    /// Opacities of their Gaussians before the gate, `[visible, k]`.
    pub activations: &'a [f32],
    /// Of each splat: anchor · k + offset.
    pub rows: &'a [u32],
    /// Of each splat: `dL/d means2d`, per pixel.
    pub grad_means2d: &'a [[f32; 2]],
    /// Of each splat: radius on the screen, pixels; 0 where it was not drawn.
    pub radii: &'a [f32],
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Gradients are multiplied by this: the number of views of the batch where the loss is their mean.
    pub weight: f32,
}

/// The statistics, a row per anchor.
#[derive(Clone, Debug, PartialEq)]
pub struct Adapt {
    offsets: usize,
    /// Sum of opacities, `[V]`.
    pub opacity: Vec<f32>,
    /// Views in which the anchor was visible, `[V]`.
    pub visits: Vec<f32>,
    /// Sum of screen gradients, half-image units, `[V, k]`.
    pub grad: Vec<f32>,
    /// Views in which the Gaussian was drawn, `[V, k]`.
    pub drawn: Vec<f32>,
}

/// A column of the statistics: its name, values per anchor, the values.
pub type AnchorColumn<T> = (&'static str, usize, T);

impl Adapt {
    /// Empty statistics of `anchors`.
    pub fn new(anchors: &Anchors) -> Self {
        let k = anchors.shape().offsets;
        let mut adapt = Self { offsets: k, opacity: vec![], visits: vec![], grad: vec![], drawn: vec![] };
        adapt.clear(anchors.len());
        adapt
    }

    /// Forgets everything; `anchors` rows.
    pub fn clear(&mut self, anchors: usize) {
        for (_, width, column) in self.columns_mut() {
            column.clear();
            column.resize(anchors * width, 0.0);
        }
    }

    /// The columns, for checkpoints.
    pub fn columns(&self) -> [AnchorColumn<&Vec<f32>>; 4] {
        let k = self.offsets;
        [
            ("adapt.opacity", 1, &self.opacity),
            ("adapt.visits", 1, &self.visits),
            ("adapt.grad", k, &self.grad),
            ("adapt.drawn", k, &self.drawn),
        ]
    }

    /// The columns, to restore them.
    pub fn columns_mut(&mut self) -> [AnchorColumn<&mut Vec<f32>>; 4] {
        let k = self.offsets;
        [
            ("adapt.opacity", 1, &mut self.opacity),
            ("adapt.visits", 1, &mut self.visits),
            ("adapt.grad", k, &mut self.grad),
            ("adapt.drawn", k, &mut self.drawn),
        ]
    }

    /// Adds one view.
    pub fn observe(&mut self, seen: &AnchorView) {
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        for (&v, activations) in seen.visible.iter().zip(seen.activations.chunks_exact(self.offsets)) {
            let opacity: f32 = activations.iter().map(|a| a.max(0.0)).sum();
            self.opacity[v as usize] += finite(opacity);
            self.visits[v as usize] += 1.0;
        }
        let (half_w, half_h) = (0.5 * seen.width as f32, 0.5 * seen.height as f32);
        let splats = seen.rows.iter().zip(seen.grad_means2d).zip(seen.radii);
        for ((&row, g), _) in splats.filter(|(_, radius)| **radius > 0.0) {
            self.grad[row as usize] += finite((g[0] * half_w).hypot(g[1] * half_h) * seen.weight);
            self.drawn[row as usize] += 1.0;
        }
    }

    /// Mean screen gradient of a Gaussian; 0 where it was never drawn.
    pub(super) fn mean_grad(&self, row: usize) -> f32 {
        if self.drawn[row] > 0.0 { self.grad[row] / self.drawn[row] } else { 0.0 }
    }

    /// Gaussians per anchor.
    pub(super) fn offsets(&self) -> usize {
        self.offsets
    }

    pub(super) fn check_rows(&self, anchors: &Anchors) -> Result<(), RowEditError> {
        for (name, width, column) in self.columns() {
            if column.len() != anchors.len() * width {
                let (row, rows) = (anchors.len() as u32, column.len() / width);
                return Err(RowEditError::OutOfRange { name: name.to_owned(), row, rows });
            }
        }
        Ok(())
    }

    /// Sets to zero what a pass has judged: anchors of `judged`, Gaussians drawn in more than `drawn` views.
    pub(super) fn forget(&mut self, judged: &[u32], drawn: f32) {
        for &v in judged {
            self.opacity[v as usize] = 0.0;
            self.visits[v as usize] = 0.0;
        }
        for (grad, n) in self.grad.iter_mut().zip(&mut self.drawn).filter(|(_, n)| **n > drawn) {
            (*grad, *n) = (0.0, 0.0);
        }
    }

    pub(super) fn edit(&mut self, edit: &RowEdit) {
        for (_, width, column) in self.columns_mut() {
            *column = edit.apply_to_column(column, width);
        }
    }
}
