//! Skinning: blended joint matrices, skinned points and their gradients, and the rotation of a blended matrix.
//!
//! ```text
//! linear (LBS)   T_i = Σ_j w_ij A_j            x_i = T_i v_i            g_v = R_iᵀ g_x,  R_i the linear part of T_i
//! dual (DQS)     A_j = [Q_j | t_j] S_j         b_i = Σ_j w_ij σ_ij q̂_j / |real part|,   T_i = rigid(b_i) Σ_j w_ij S_j
//! ```
//! `q̂_j` is the unit dual quaternion of `[Q_j | t_j]`, `σ_ij` the sign that puts it in the half-space of the first influence
//! (Kavan et al. 2007, "Skinning with dual quaternions"; stretch is blended linearly before it).
//!
//! `R_i` of a linear blend is no rotation: two bones at weight ½ rotated by `θ` against one another shrink the plane across
//! their axis by `cos(θ/2)`. [`rotations`] gives the nearest rotation, by Newton's iteration for the polar factor with
//! Higham's scaling (1986): `X ← ½ (γ X + (γ X)⁻ᵀ)`, `γ² = ‖X⁻¹‖ / ‖X‖`.

use crate::template::SkinWeights;
use glam::{Affine3A, DAffine3, DMat3, DQuat, DVec3, Mat3A, Vec3, Vec3A};
use gs_core::rot;
use rayon::prelude::*;

/// A linear part whose determinant is at most this share of its size cubed is singular.
const SINGULAR: f64 = 1e-6;
/// Newton steps; a well-shaped matrix takes 3 to 5, one at the singular limit 9.
const MAX_STEPS: usize = 20;
/// The iteration stops once no entry changes by more than this.
const STEP_TOLERANCE: f64 = 1e-14;
/// Below this norm of the real part a sum of dual quaternions cannot be normalised.
const MIN_NORM: f64 = 1e-9;
/// Vertices of the smallest parallel task.
const CHUNK: usize = 512;

/// How the matrices of several joints are blended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Skinning {
    /// Linear blend skinning: a weighted sum of matrices.
    #[default]
    Lbs,
    /// Dual quaternion skinning: no collapse at twisted joints, some bulging at bent ones.
    Dqs,
}

impl Skinning {
    /// The blended matrix `T_i` of every vertex, from `A_j` of every joint ([`crate::Skeleton::skinning`]).
    pub fn blend(self, weights: &SkinWeights, joints: &[DAffine3]) -> Vec<Affine3A> {
        match self {
            Skinning::Lbs => blend(weights, joints),
            Skinning::Dqs => blend_dual(weights, joints),
        }
    }
}

/// Linear blend `T_i = Σ_j w_ij A_j`, one matrix per vertex, summed in `f64`.
///
/// ```
/// use glam::{DAffine3, DVec3, Vec3};
/// use gs_texel::SkinWeights;
/// use gs_texel::skin::{blend, skin};
///
/// let mut weights = SkinWeights::default();
/// weights.push([(0, 0.75), (1, 0.25)], 0);
/// let joints = [DAffine3::IDENTITY, DAffine3::from_translation(8.0 * DVec3::X)];
/// assert_eq!(skin(&[Vec3::Y], &blend(&weights, &joints)), [Vec3::new(2.0, 1.0, 0.0)]);
/// ```
pub fn blend(weights: &SkinWeights, joints: &[DAffine3]) -> Vec<Affine3A> {
    let row = |i| {
        let (mut m, mut t) = (DMat3::ZERO, DVec3::ZERO);
        for (j, w) in weights.row(i) {
            let a = &joints[j as usize];
            m += a.matrix3 * f64::from(w);
            t += a.translation * f64::from(w);
        }
        single(m, t)
    };
    (0..weights.len()).into_par_iter().with_min_len(CHUNK).map(row).collect()
}

fn single(m: DMat3, t: DVec3) -> Affine3A {
    let matrix3 = Mat3A::from_cols(column(m.x_axis), column(m.y_axis), column(m.z_axis));
    Affine3A { matrix3, translation: column(t) }
}

fn column(v: DVec3) -> Vec3A {
    v.as_vec3().into()
}

/// A joint matrix as a stretch followed by a rigid motion, the latter as a dual quaternion.
struct Dual {
    real: [f64; 4],
    dual: [f64; 4],
    stretch: DMat3,
}

impl Dual {
    fn of(a: &DAffine3) -> Self {
        let turn = rotation_of(a.matrix3).unwrap_or(DMat3::IDENTITY);
        let (real, t) = (quat_of(&turn), a.translation);
        let dual = rot::hamilton([0.0, t.x, t.y, t.z], real).map(|v| 0.5 * v);
        Self { real, dual, stretch: turn.transpose() * a.matrix3 }
    }
}

/// Dual quaternion blend, one matrix per vertex. Where the quaternions cancel, the matrix of the joint of largest weight.
pub fn blend_dual(weights: &SkinWeights, joints: &[DAffine3]) -> Vec<Affine3A> {
    let duals: Vec<Dual> = joints.iter().map(Dual::of).collect();
    let row = |i| {
        let (mut real, mut dual, mut stretch) = ([0.0; 4], [0.0; 4], DMat3::ZERO);
        let mut first = None;
        for (j, w) in weights.row(i) {
            let (d, w) = (&duals[j as usize], f64::from(w));
            let side = dot(*first.get_or_insert(d.real), d.real);
            let signed = if side < 0.0 { -w } else { w };
            real = std::array::from_fn(|k| real[k] + signed * d.real[k]);
            dual = std::array::from_fn(|k| dual[k] + signed * d.dual[k]);
            stretch += d.stretch * w;
        }
        let norm = dot(real, real).sqrt();
        if norm < MIN_NORM {
            let heaviest = dominant(weights, i).map_or(DAffine3::IDENTITY, |j| joints[j as usize]);
            return single(heaviest.matrix3, heaviest.translation);
        }
        let (q, d) = (real.map(|v| v / norm), dual.map(|v| v / norm));
        let t = rot::hamilton(d, [q[0], -q[1], -q[2], -q[3]]).map(|v| 2.0 * v);
        let turn = DMat3::from_cols_array_2d(&rot::matrix(q)).transpose();
        single(turn * stretch, DVec3::new(t[1], t[2], t[3]))
    };
    (0..weights.len()).into_par_iter().with_min_len(CHUNK).map(row).collect()
}

fn dot(a: [f64; 4], b: [f64; 4]) -> f64 {
    a.iter().zip(&b).map(|(a, b)| a * b).sum()
}

/// The joint of largest weight of a vertex (the first of equals).
fn dominant(weights: &SkinWeights, i: usize) -> Option<u32> {
    let heavier = |best: Option<(u32, f32)>, (j, w)| match best {
        Some((_, most)) if most >= w => best,
        _ => Some((j, w)),
    };
    weights.row(i).fold(None, heavier).map(|(j, _)| j)
}

/// Skinned points `x_i = T_i v_i`; rows of `points` and `transforms` correspond.
pub fn skin(points: &[Vec3], transforms: &[Affine3A]) -> Vec<Vec3> {
    points.iter().zip(transforms).map(|(&v, t)| t.transform_point3(v)).collect()
}

/// Backward of [`skin`] to the points, or to offsets added to them: `g_v = R_iᵀ g_x`.
pub fn skin_backward(transforms: &[Affine3A], grad: &[Vec3]) -> Vec<Vec3> {
    transforms.iter().zip(grad).map(|(t, &g)| t.matrix3.transpose() * g).collect()
}

/// The rotation nearest to a linear part (its polar factor). `None` if the matrix is singular (determinant at most 1e-6 of
/// its size cubed) or not finite. For a reflection, the rotation nearest to its negative, which maps ellipsoids alike.
pub fn rotation_of(m: DMat3) -> Option<DMat3> {
    let size = (m.to_cols_array().iter().map(|v| v * v).sum::<f64>() / 3.0).sqrt();
    if !size.is_finite() || size == 0.0 {
        return None;
    }
    let mut x = m * (1.0 / size);
    let volume = x.determinant();
    if volume.abs() <= SINGULAR {
        return None;
    }
    if volume < 0.0 {
        x *= -1.0;
    }
    for _ in 0..MAX_STEPS {
        // X⁻ᵀ has the cross products of X's columns, over the determinant.
        let (a, b, c) = (x.x_axis, x.y_axis, x.z_axis);
        let cofactors = DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b));
        let volume = a.dot(cofactors.x_axis);
        let norm = |m: &DMat3| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        let scale = (norm(&cofactors) / (volume * norm(&x))).sqrt();
        let next = (x * scale + cofactors * (1.0 / (volume * scale))) * 0.5;
        let converged = next.abs_diff_eq(x, STEP_TOLERANCE);
        x = next;
        if converged {
            break;
        }
    }
    Some(x)
}

/// The unit quaternion `(w, x, y, z)` of a rotation matrix, `w ≥ 0`.
pub fn quat_of(rotation: &DMat3) -> [f64; 4] {
    let q = DQuat::from_mat3(rotation).normalize();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [q.w, q.x, q.y, q.z].map(|v| sign * v)
}

/// The matrix-to-quaternion conversion applied to any matrix, given by rows: `(w, x, y, z)`, `w ≥ 0`, of unit length only if
/// the matrix is a rotation. The identity where the result is not finite.
pub fn raw_quat(linear: &rot::Mat3<f64>) -> [f64; 4] {
    let q = DQuat::from_mat3(&DMat3::from_cols_array_2d(linear).transpose());
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    if q.is_finite() { [q.w, q.x, q.y, q.z].map(|v| sign * v) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// The rotation nearest to every `T_i` as a unit quaternion `(w, x, y, z)`, `w ≥ 0`. Where `T_i` is singular or a reflection,
/// that of the joint of largest weight; where that is singular too, the identity. Never NaN.
pub fn rotations(weights: &SkinWeights, joints: &[DAffine3], transforms: &[Affine3A]) -> Vec<[f32; 4]> {
    let of_joints: Vec<[f32; 4]> = joints.iter().map(|a| rotation_or(a.matrix3, [1.0, 0.0, 0.0, 0.0])).collect();
    let row = |i| {
        let of_joint = dominant(weights, i).map_or([1.0, 0.0, 0.0, 0.0], |j: u32| of_joints[j as usize]);
        let m = transforms[i].matrix3;
        let m = DMat3::from_cols(m.x_axis.as_dvec3(), m.y_axis.as_dvec3(), m.z_axis.as_dvec3());
        if m.determinant() > 0.0 { rotation_or(m, of_joint) } else { of_joint }
    };
    (0..weights.len()).into_par_iter().with_min_len(CHUNK).map(row).collect()
}

/// The quaternion of the nearest rotation, or `fallback` where there is none.
fn rotation_or(m: DMat3, fallback: [f32; 4]) -> [f32; 4] {
    rotation_of(m).map_or(fallback, |r| quat_of(&r).map(|v| v as f32))
}
