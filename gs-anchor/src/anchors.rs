//! Anchors: the values a scene stores per anchor, as parameter blocks that are edited together.
//!
//! | block | per anchor | unit |
//! |---|---|---|
//! | `anchors.positions` | 3 | world; a lattice point, not trained |
//! | `anchors.offsets` | `k × 3`, offset by offset | dimensionless; multiplied by the first three scales |
//! | `anchors.features` | `C` | – |
//! | `anchors.log_scales` | 6 | ln of world units: three for the offsets, three for the extents of the Gaussians |
//! | `anchors.dynamics` | 0, 1 or 2 | logits of how much the anchor moves (global, local); one is shared by both |

use glam::Vec3;
use gs_core::param::{RowEdit, RowEditError};
use gs_core::{Param, Params};
use serde::{Deserialize, Serialize};

/// Sizes of an anchor's columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorShape {
    /// Gaussians per anchor, `k` (published: 10).
    pub offsets: usize,
    /// Width of the feature, `C` (published: 32).
    pub features: usize,
    /// Logits of motion: 0 (a static scene), 1 (shared), 2 (global, local).
    pub dynamics: usize,
}

/// The parameters of `V` anchors.
///
/// ```
/// use gs_anchor::{AnchorShape, Anchors};
/// use gs_core::RowEdit;
/// use glam::Vec3;
///
/// let shape = AnchorShape { offsets: 10, features: 32, dynamics: 2 };
/// let mut anchors = Anchors::new(shape, &[Vec3::ZERO, Vec3::X, Vec3::Y], &[-3.0; 3]);
/// anchors.edit(&RowEdit { keep: vec![2, 0], append_from: vec![1] })?;
/// assert_eq!([0, 1, 2].map(|v| anchors.position(v)), [Vec3::Y, Vec3::ZERO, Vec3::X]);
/// assert_eq!(anchors.offsets.len(), 3 * 10 * 3, "every block was edited");
/// # Ok::<(), gs_core::param::RowEditError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Anchors {
    shape: AnchorShape,
    /// `[V, 3]`, world units; lattice points, not trained.
    pub positions: Param,
    /// `[V, k, 3]`, in units of the first three scales.
    pub offsets: Param,
    /// `[V, C]`, inputs of the decoder's heads.
    pub features: Param,
    /// `[V, 6]`, ln of world units: three for the offsets, three for the Gaussians' extents.
    pub log_scales: Param,
    /// Logits of motion, `[V, 1 or 2]`; absent in a static scene.
    pub dynamics: Option<Param>,
}

impl Anchors {
    /// Anchors at `positions`, all six scales of each `exp(log_scale)`; offsets, features and logits are zero.
    ///
    /// # Panics
    /// If the two lists differ in length, or the shape has no offsets or no features.
    pub fn new(shape: AnchorShape, positions: &[Vec3], log_scales: &[f32]) -> Self {
        assert_eq!(positions.len(), log_scales.len(), "one scale per anchor");
        assert!(shape.offsets > 0 && shape.features > 0, "an anchor has Gaussians and a feature");
        let n = positions.len();
        let zeros = |name: &str, width: usize| Param::rows(name, width, vec![0.0; n * width]);
        Self {
            shape,
            positions: Param::rows("anchors.positions", 3, positions.iter().flat_map(|p| p.to_array()).collect()),
            offsets: zeros("anchors.offsets", 3 * shape.offsets),
            features: zeros("anchors.features", shape.features),
            log_scales: Param::rows("anchors.log_scales", 6, log_scales.iter().flat_map(|&s| [s; 6]).collect()),
            dynamics: (shape.dynamics > 0).then(|| zeros("anchors.dynamics", shape.dynamics)),
        }
    }

    /// Sizes of an anchor's columns.
    pub fn shape(&self) -> AnchorShape {
        self.shape
    }

    /// Number of anchors, `V`.
    pub fn len(&self) -> usize {
        self.positions.len() / 3
    }

    /// Whether [`Anchors::len`] is 0.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Position of anchor `v`, world units.
    pub fn position(&self, v: usize) -> Vec3 {
        Vec3::from_slice(&self.positions.value[3 * v..])
    }

    /// Logits of motion of anchor `v`: none, one (shared) or two.
    pub fn logits(&self, v: usize) -> &[f32] {
        self.dynamics.as_ref().map_or(&[], |p| &p.value[v * self.shape.dynamics..][..self.shape.dynamics])
    }

    /// Keeps, drops and copies whole anchors: in every block its values, gradient and optimizer moments.
    ///
    /// # Errors
    /// If the edit names an anchor that does not exist; nothing is changed then.
    pub fn edit(&mut self, edit: &RowEdit) -> Result<(), RowEditError> {
        let Self { positions, offsets, features, log_scales, dynamics, .. } = self;
        let mut blocks = vec![positions, offsets, features, log_scales];
        blocks.extend(dynamics.as_mut());
        edit.apply(&mut blocks)
    }
}

impl Params for Anchors {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        [&self.positions, &self.offsets, &self.features, &self.log_scales]
            .into_iter()
            .chain(&self.dynamics)
            .for_each(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        let Self { positions, offsets, features, log_scales, dynamics, .. } = self;
        [positions, offsets, features, log_scales].into_iter().chain(dynamics).for_each(f);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_blocks_are_edited_together() {
        let shape = AnchorShape { offsets: 2, features: 4, dynamics: 2 };
        let at = [Vec3::ZERO, Vec3::ONE, Vec3::splat(2.0)];
        let mut anchors = Anchors::new(shape, &at, &[0.0, 1.0, 2.0]);
        anchors.edit(&RowEdit { keep: vec![2, 0], append_from: vec![1] }).unwrap();
        assert_eq!((anchors.len(), anchors.position(0), anchors.position(2)), (3, at[2], at[1]));
        assert_eq!(anchors.log_scales.value[6 * 2..], [1.0; 6]);
        anchors.visit(&mut |p| assert_eq!(p.row_count(), Some(3), "{}", p.name));
        assert!(anchors.edit(&RowEdit { keep: vec![3], append_from: vec![] }).is_err());
        assert_eq!(anchors.param_count(), 3 * (3 + 6 + 4 + 6 + 2));
    }
}
