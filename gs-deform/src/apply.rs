//! Applies offsets to splats, forward and backward: the last step of every field.
//!
//! With raw quaternion `q`, its unit form `q̂`, scale `s` and offsets `δx, δs, δr`:
//!
//! ```text
//! means   μ + δx
//! scales  Log: s · exp(δs)     Add: s + δs        with a limit: min(|·|, limit)
//! quats   Raw: q + δr          Unit: q + |q| δr          Compose: normalise(1 + δr) ⊗ q
//! ```
//! `Raw` and `Log` are 4D Gaussian Splatting's sums on raw parameters; `Unit` is the rotation of `q̂ + δr`, as in
//! Deformable 3D Gaussians, written so that the norm of `q` is kept; `Compose` rotates in the world frame (GVFi,
//! TRACE). Quaternions are normalised where they are used. With offsets of zero every rule returns the splat bit for
//! bit (a negative zero may become positive).
//!
//! ```
//! use glam::Vec3;
//! use gs_core::{GeometryMut, GeometryRef};
//! use gs_deform::apply::{Apply, OffsetColumns, QuatRule, ScaleRule};
//!
//! let rule = Apply { scale: ScaleRule::Add, quat: QuatRule::Raw, scale_limit: Some(2.0) };
//! let from = GeometryRef { means: &[Vec3::X], quats: &[[1.0, 0.0, 0.0, 0.0]], scales: &[Vec3::new(0.5, 1.0, 1.5)] };
//! let by = OffsetColumns { means: vec![0.0, 1.0, 0.0], scales: vec![-0.75, 0.5, 1.0], quats: vec![] };
//! let (mut m, mut q, mut s) = ([Vec3::ZERO], [[0.0; 4]], [Vec3::ZERO]);
//! rule.forward(from, by.view(), &mut GeometryMut { means: &mut m, quats: &mut q, scales: &mut s });
//! assert_eq!(m[0], Vec3::new(1.0, 1.0, 0.0));
//! assert_eq!(s[0], Vec3::new(0.25, 1.5, 2.0), "the sign is dropped and the limit held");
//! assert_eq!(q[0], from.quats[0], "an empty column leaves rotations as they are");
//! ```

use glam::Vec3;
use gs_core::{GeometryMut, GeometryRef, rot};
use serde::{Deserialize, Serialize};

/// How an offset `δs` changes a scale `s`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScaleRule {
    /// `s · exp(δs)`: a sum on logarithms; scales stay positive.
    Log,
    /// `s + δs`, world units; the sign is not constrained, since only squares of scales matter.
    Add,
}

/// How an offset `δr` changes a quaternion `q`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QuatRule {
    /// `q + δr` on the raw quaternion.
    Raw,
    /// The rotation of `q/|q| + δr`.
    Unit,
    /// `normalise((1,0,0,0) + δr) ⊗ q`.
    Compose,
}

/// The rules by which a field applies its offsets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Apply {
    /// Rule for the scales' offsets.
    pub scale: ScaleRule,
    /// Rule for the quaternions' offsets.
    pub quat: QuatRule,
    /// If given, a scale with an offset is written as `min(|s'|, limit)`, world units. The gradient carries the sign of
    /// `s'` and is zero at zero and beyond the limit.
    pub scale_limit: Option<f32>,
}

/// Offsets for some rows of splats, row-major; an empty column stands for zero offsets.
#[derive(Clone, Copy, Debug, Default)]
pub struct Offsets<'a> {
    /// `δx`, `[rows, 3]`, world units.
    pub means: &'a [f32],
    /// `δs`, `[rows, 3]`; unit by [`ScaleRule`].
    pub scales: &'a [f32],
    /// `δr`, `[rows, 4]`, `(w, x, y, z)`.
    pub quats: &'a [f32],
}

/// Owned columns shaped like [`Offsets`]: offsets, or their cotangents.
#[derive(Clone, Debug, Default)]
pub struct OffsetColumns {
    /// `δx` or its cotangent, `[rows, 3]`.
    pub means: Vec<f32>,
    /// `δs` or its cotangent, `[rows, 3]`.
    pub scales: Vec<f32>,
    /// `δr` or its cotangent, `[rows, 4]`.
    pub quats: Vec<f32>,
}

impl OffsetColumns {
    /// Borrows all three columns.
    pub fn view(&self) -> Offsets<'_> {
        Offsets { means: &self.means, scales: &self.scales, quats: &self.quats }
    }
}

impl Apply {
    /// Writes the rows `from`, moved by the offsets `by`, to `to`. All have the same number of rows.
    pub fn forward(&self, from: GeometryRef<'_>, by: Offsets<'_>, to: &mut GeometryMut<'_>) {
        to.copy_from(from);
        for (to, d) in to.means.iter_mut().zip(by.means.as_chunks().0) {
            *to += Vec3::from_array(*d);
        }
        for (to, d) in to.scales.iter_mut().zip(by.scales.as_chunks().0) {
            *to = self.scaled(*to, *d);
            if let Some(limit) = self.scale_limit {
                *to = to.abs().min(Vec3::splat(limit));
            }
        }
        for (to, d) in to.quats.iter_mut().zip(by.quats.as_chunks().0) {
            *to = self.rotated(*to, *d);
        }
    }

    /// The scale before any limit.
    fn scaled(&self, s: Vec3, d: [f32; 3]) -> Vec3 {
        match self.scale {
            ScaleRule::Log => s * Vec3::from_array(d.map(f32::exp)),
            ScaleRule::Add => s + Vec3::from_array(d),
        }
    }

    fn rotated(&self, q: [f32; 4], d: [f32; 4]) -> [f32; 4] {
        match self.quat {
            QuatRule::Raw => std::array::from_fn(|k| q[k] + d[k]),
            QuatRule::Unit => {
                let norm = rot::normalise(q).inv_norm.recip();
                std::array::from_fn(|k| q[k] + norm * d[k])
            }
            QuatRule::Compose => rot::hamilton(rot::normalise(from_identity(d)).wxyz, q),
        }
    }

    /// Backward of [`Apply::forward`] with the same `from` and `by`: adds to the cotangents `d_from`, sets those of the
    /// offsets, `d_by`. A column without offsets passes its cotangent through and leaves an empty column in `d_by`.
    pub fn backward(
        &self,
        from: GeometryRef<'_>,
        by: Offsets<'_>,
        d_moved: GeometryRef<'_>,
        d_from: &mut GeometryMut<'_>,
        d_by: &mut OffsetColumns,
    ) {
        d_from.means.iter_mut().zip(d_moved.means).for_each(|(d, m)| *d += *m);
        fill(&mut d_by.means, by.means.len(), d_moved.means.iter().flat_map(|d| d.to_array()));
        self.backward_scales(from, by, d_moved, d_from, d_by);
        self.backward_quats(from, by, d_moved, d_from, d_by);
    }

    fn backward_scales(
        &self,
        from: GeometryRef<'_>,
        by: Offsets<'_>,
        d_moved: GeometryRef<'_>,
        d_from: &mut GeometryMut<'_>,
        d_by: &mut OffsetColumns,
    ) {
        d_by.scales.clear();
        if by.scales.is_empty() {
            d_from.scales.iter_mut().zip(d_moved.scales).for_each(|(d, m)| *d += *m);
            return;
        }
        let rows = from.scales.iter().zip(by.scales.as_chunks().0).zip(d_moved.scales).zip(d_from.scales.iter_mut());
        for (((s, d), d_moved), d_from) in rows {
            let d_scaled = *d_moved * self.slope(*s, *d);
            let (d_s, d_offset) = match self.scale {
                ScaleRule::Log => {
                    let factor = Vec3::from_array(d.map(f32::exp));
                    (factor * d_scaled, factor * d_scaled * *s)
                }
                ScaleRule::Add => (d_scaled, d_scaled),
            };
            *d_from += d_s;
            d_by.scales.extend(d_offset.to_array());
        }
    }

    /// Derivative of the written scale with respect to [`Apply::scaled`].
    fn slope(&self, s: Vec3, d: [f32; 3]) -> Vec3 {
        let Some(limit) = self.scale_limit else { return Vec3::ONE };
        let slope = |v: f32| if v == 0.0 || v.abs() > limit { 0.0 } else { v.signum() };
        Vec3::from_array(self.scaled(s, d).to_array().map(slope))
    }

    fn backward_quats(
        &self,
        from: GeometryRef<'_>,
        by: Offsets<'_>,
        d_moved: GeometryRef<'_>,
        d_from: &mut GeometryMut<'_>,
        d_by: &mut OffsetColumns,
    ) {
        d_by.quats.clear();
        if by.quats.is_empty() {
            d_from.quats.iter_mut().zip(d_moved.quats).for_each(|(d, m)| add4(d, *m));
            return;
        }
        let rows = from.quats.iter().zip(by.quats.as_chunks().0).zip(d_moved.quats).zip(d_from.quats.iter_mut());
        for (((q, d), g), d_from) in rows {
            let (d_q, d_offset) = self.rotated_backward(*q, *d, *g);
            add4(d_from, d_q);
            d_by.quats.extend(d_offset);
        }
    }

    /// Cotangents of the quaternion and of its offset from the cotangent `g` of [`Apply::rotated`].
    fn rotated_backward(&self, q: [f32; 4], d: [f32; 4], g: [f32; 4]) -> ([f32; 4], [f32; 4]) {
        match self.quat {
            QuatRule::Raw => (g, g),
            QuatRule::Unit => {
                let unit = rot::normalise(q);
                let norm = unit.inv_norm.recip();
                let radial = unit.free * (0..4).map(|k| g[k] * d[k]).sum::<f32>();
                (std::array::from_fn(|k| g[k] + radial * unit.wxyz[k]), g.map(|v| v * norm))
            }
            QuatRule::Compose => {
                let rotation = rot::normalise(from_identity(d));
                let d_rotation = rot::hamilton(g, rot::conjugate(q));
                (rot::hamilton(rot::conjugate(rotation.wxyz), g), rot::normalise_backward(&rotation, d_rotation))
            }
        }
    }
}

fn from_identity(d: [f32; 4]) -> [f32; 4] {
    [1.0 + d[0], d[1], d[2], d[3]]
}

fn add4(to: &mut [f32; 4], v: [f32; 4]) {
    to.iter_mut().zip(v).for_each(|(t, v)| *t += v);
}

fn fill(column: &mut Vec<f32>, wanted: usize, values: impl Iterator<Item = f32>) {
    column.clear();
    if wanted > 0 {
        column.extend(values);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_rule_rotates_like_the_sum_of_unit_quaternions_and_survives_zero() {
        let unit = Apply { scale: ScaleRule::Add, quat: QuatRule::Unit, scale_limit: None };
        let (q, d) = ([3.0, 0.0, 4.0, 0.0], [0.1, -0.2, 0.3, 0.05]);
        let got = rot::normalise(unit.rotated(q, d)).wxyz;
        let want = rot::normalise([0.7, -0.2, 1.1, 0.05]).wxyz;
        assert!((0..4).all(|k| (got[k] - want[k]).abs() < 1e-6), "{got:?} {want:?}");
        let (d_q, d_offset) = unit.rotated_backward([0.0; 4], d, [1.0; 4]);
        assert!(d_q.iter().chain(&d_offset).all(|v| v.is_finite()));
    }

    #[test]
    fn a_limit_writes_magnitudes_and_carries_the_sign_backward() {
        let apply = Apply { scale: ScaleRule::Add, quat: QuatRule::Raw, scale_limit: Some(2.0) };
        let (means, quats) = ([Vec3::ZERO; 2], [[1.0, 0.0, 0.0, 0.0]; 2]);
        let scales = [Vec3::new(0.5, 0.5, 0.5), Vec3::new(-0.25, 1.5, 2.0)];
        let by = Offsets { scales: &[0.25, -0.5, -1.5, 0.0, 1.0, 0.0], ..Offsets::default() };
        let from = GeometryRef { means: &means, quats: &quats, scales: &scales };
        let (mut m, mut q, mut s) = (means, quats, [Vec3::ZERO; 2]);
        apply.forward(from, by, &mut GeometryMut { means: &mut m, quats: &mut q, scales: &mut s });
        assert_eq!(s, [Vec3::new(0.75, 0.0, 1.0), Vec3::new(0.25, 2.0, 2.0)]);
        let d_moved = [Vec3::new(3.0, 5.0, 7.0); 2];
        let (mut d_m, mut d_q, mut d_s) = ([Vec3::ZERO; 2], [[0.0; 4]; 2], [Vec3::ONE; 2]);
        let mut d_by = OffsetColumns::default();
        let mut d_from = GeometryMut { means: &mut d_m, quats: &mut d_q, scales: &mut d_s };
        apply.backward(from, by, GeometryRef { scales: &d_moved, ..from }, &mut d_from, &mut d_by);
        assert_eq!(d_by.scales, [3.0, 0.0, -7.0, -3.0, 0.0, 7.0]);
        assert_eq!(d_s, [Vec3::new(4.0, 1.0, -6.0), Vec3::new(-2.0, 1.0, 8.0)]);
    }

    #[test]
    fn columns_that_do_not_move_pass_everything() {
        let (means, quats, scales) = ([Vec3::ONE; 3], [[1.0, 2.0, 3.0, 4.0]; 3], [Vec3::splat(0.5); 3]);
        let rows = GeometryRef { means: &means, quats: &quats, scales: &scales };
        let apply = Apply { scale: ScaleRule::Log, quat: QuatRule::Compose, scale_limit: None };
        let (mut m, mut q, mut s) = ([Vec3::ZERO; 3], [[0.0; 4]; 3], [Vec3::ZERO; 3]);
        apply.forward(rows, Offsets::default(), &mut GeometryMut { means: &mut m, quats: &mut q, scales: &mut s });
        assert_eq!((m, q, s), (means, quats, scales));
        let mut d_by = OffsetColumns { means: vec![7.0; 9], ..OffsetColumns::default() };
        let mut d_from = GeometryMut { means: &mut m, quats: &mut q, scales: &mut s };
        apply.backward(rows, Offsets::default(), rows, &mut d_from, &mut d_by);
        assert_eq!((m[0], q[0], s[0]), (means[0] * 2.0, quats[0].map(|v| v * 2.0), scales[0] * 2.0));
        assert!(d_by.means.is_empty() && d_by.quats.is_empty() && d_by.scales.is_empty());
    }
}
