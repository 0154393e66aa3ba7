//! From the head's outputs to the offsets of a splat, forward and backward.
//!
//! ```text
//! head row  [η_raw (with a gate) | ρ 4 | τ 3 | Δr 4 | Δs 3]         η = σ(η_raw), or 1 without a gate
//! q_d = (1,0,0,0) + rρ      D = R(q_d/|q_d|) μ − μ                    r = η for `scale_param`, else 1
//! δμ  = scale_param: D + ητ     lerp_position: η(D + τ)     translation_only: D + ητ     literal: η(μ + D + τ) − μ
//! δr  = ηΔr                     δs = ηΔs
//! ```
//! `D = 2w (v × μ) + 2v × (v × μ)` for `q_d/|q_d| = (w, v)` has no cancellation: a small rotation is as precise as a
//! large one, and the identity moves nothing, bit for bit. Where `|q_d|² < 1e-12` the rotation is the identity and has
//! no gradient. Rows outside the cube have no offsets and no gradient.

use super::config::{GateConfig, GateMode};
use crate::apply::OffsetColumns;
use glam::Vec3;
use gs_core::rot;

/// Below this `|q_d|²` the rotation is the identity.
const MIN_SQUARED_NORM: f32 = 1e-12;

/// The head's outputs for one splat.
pub(super) struct Row {
    /// Gate `η`, 0 … 1.
    pub gate: f32,
    /// Rotation parameters `ρ`.
    pub rho: [f32; 4],
    /// Translation `τ`, world units.
    pub tau: Vec3,
    /// `Δr` before the gate.
    rotation: [f32; 4],
    /// `Δs` before the gate.
    scale: [f32; 3],
}

impl Row {
    /// Reads `[η_raw | ρ | τ | Δr | Δs]`.
    pub(super) fn read(row: &[f32], gate: GateConfig) -> Self {
        let (raw, rest) = row.split_at(usize::from(gate.on));
        let at = |k: usize| rest[k];
        Self {
            gate: raw.first().map_or(1.0, |v| 1.0 / (1.0 + (-v).exp())),
            rho: [at(0), at(1), at(2), at(3)],
            tau: Vec3::new(at(4), at(5), at(6)),
            rotation: [at(7), at(8), at(9), at(10)],
            scale: [at(11), at(12), at(13)],
        }
    }

    /// `q_d`, not normalised, in a gate mode.
    fn raw_rotation(&self, mode: GateMode) -> [f32; 4] {
        let r = if mode == GateMode::ScaleParam { self.gate } else { 1.0 };
        [1.0 + r * self.rho[0], r * self.rho[1], r * self.rho[2], r * self.rho[3]]
    }
}

/// Offsets of a block from `heads: [rows, 14 or 15]` and, per row, its mean and whether it moves.
pub(super) fn forward(
    gate: GateConfig,
    heads: &[f32],
    rows: impl ExactSizeIterator<Item = (Vec3, bool)>,
    to: &mut OffsetColumns,
) {
    let width = 14 + usize::from(gate.on);
    to.means.clear();
    to.scales.clear();
    to.quats.clear();
    for (head, (mean, moves)) in heads.chunks_exact(width).zip(rows) {
        if !moves {
            to.means.extend([0.0; 3]);
            to.scales.extend([0.0; 3]);
            to.quats.extend([0.0; 4]);
            continue;
        }
        let row = Row::read(head, gate);
        to.means.extend(shift(&row, gate.mode, mean).to_array());
        to.scales.extend(row.scale.iter().map(|v| row.gate * v));
        to.quats.extend(row.rotation.iter().map(|v| row.gate * v));
    }
}

/// `δμ`.
fn shift(row: &Row, mode: GateMode, mean: Vec3) -> Vec3 {
    let rotated = rotation_shift(row.raw_rotation(mode), mean);
    match mode {
        GateMode::ScaleParam | GateMode::TranslationOnly => rotated + row.gate * row.tau,
        GateMode::LerpPosition => row.gate * (rotated + row.tau),
        GateMode::Literal => row.gate * (mean + rotated + row.tau) - mean,
    }
}

fn has_rotation(raw: [f32; 4]) -> bool {
    raw.iter().map(|v| v * v).sum::<f32>() >= MIN_SQUARED_NORM
}

/// `R(q/|q|) μ − μ`.
fn rotation_shift(raw: [f32; 4], mean: Vec3) -> Vec3 {
    if !has_rotation(raw) {
        return Vec3::ZERO;
    }
    let [w, x, y, z] = rot::normalise(raw).wxyz;
    let axis = Vec3::new(x, y, z);
    let across = axis.cross(mean);
    2.0 * (w * across + axis.cross(across))
}

/// Backward of [`rotation_shift`]: `v_q`, and `(R − I)ᵀ g` for the mean.
fn rotation_shift_backward(raw: [f32; 4], mean: Vec3, g: Vec3) -> ([f32; 4], Vec3) {
    if !has_rotation(raw) {
        return ([0.0; 4], Vec3::ZERO);
    }
    let unit = rot::normalise(raw);
    let (g3, m) = (g.to_array(), mean.to_array());
    let outer = std::array::from_fn(|i| std::array::from_fn(|j| g3[i] * m[j]));
    let d_raw = rot::normalise_backward(&unit, rot::matrix_backward(unit.wxyz, &outer));
    let [w, x, y, z] = unit.wxyz;
    (d_raw, rotation_shift([w, -x, -y, -z], g))
}

/// Backward of [`forward`] from the cotangents `d` of the offsets: sets `d_heads`, adds the gradient of `δμ` with
/// respect to the mean to each row's cotangent (that of the sum `μ + δμ` is added elsewhere).
pub(super) fn backward<'a>(
    gate: GateConfig,
    heads: &[f32],
    rows: impl ExactSizeIterator<Item = (Vec3, bool, &'a mut Vec3)>,
    d: &OffsetColumns,
    d_heads: &mut Vec<f32>,
) {
    let width = 14 + usize::from(gate.on);
    d_heads.clear();
    let offsets = d.means.as_chunks::<3>().0.iter().zip(d.quats.as_chunks::<4>().0).zip(d.scales.as_chunks::<3>().0);
    for ((head, (mean, moves, d_mean)), ((d_shift, d_quat), d_scale)) in
        heads.chunks_exact(width).zip(rows).zip(offsets)
    {
        if !moves {
            d_heads.extend(std::iter::repeat_n(0.0, width));
            continue;
        }
        let row = Row::read(head, gate);
        let eta = row.gate;
        let grads = shift_backward(&row, gate.mode, mean, Vec3::from_array(*d_shift));
        *d_mean += grads.mean;
        if gate.on {
            let by_rotation: f32 = row.rotation.iter().zip(d_quat).map(|(r, d)| r * d).sum();
            let by_scale: f32 = row.scale.iter().zip(d_scale).map(|(s, d)| s * d).sum();
            d_heads.push((grads.gate + by_rotation + by_scale) * eta * (1.0 - eta));
        }
        d_heads.extend(grads.rho);
        d_heads.extend(grads.tau.to_array());
        d_heads.extend(d_quat.map(|d| eta * d));
        d_heads.extend(d_scale.map(|d| eta * d));
    }
}

/// Cotangents of the inputs of [`shift`].
struct ShiftGrad {
    gate: f32,
    rho: [f32; 4],
    tau: Vec3,
    mean: Vec3,
}

fn shift_backward(row: &Row, mode: GateMode, mean: Vec3, g: Vec3) -> ShiftGrad {
    let raw = row.raw_rotation(mode);
    let eta = row.gate;
    let gated = matches!(mode, GateMode::LerpPosition | GateMode::Literal);
    let (d_raw, d_mean) = rotation_shift_backward(raw, mean, if gated { eta * g } else { g });
    let tau = eta * g;
    match mode {
        GateMode::ScaleParam => {
            let along: f32 = row.rho.iter().zip(d_raw).map(|(r, d)| r * d).sum();
            ShiftGrad { gate: along + row.tau.dot(g), rho: d_raw.map(|d| eta * d), tau, mean: d_mean }
        }
        GateMode::LerpPosition => {
            ShiftGrad { gate: (rotation_shift(raw, mean) + row.tau).dot(g), rho: d_raw, tau, mean: d_mean }
        }
        GateMode::TranslationOnly => ShiftGrad { gate: row.tau.dot(g), rho: d_raw, tau, mean: d_mean },
        GateMode::Literal => {
            let gate = (mean + rotation_shift(raw, mean) + row.tau).dot(g);
            ShiftGrad { gate, rho: d_raw, tau, mean: d_mean + eta * g - g }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODES: [GateMode; 4] =
        [GateMode::ScaleParam, GateMode::LerpPosition, GateMode::TranslationOnly, GateMode::Literal];

    fn offsets(gate: GateConfig, head: &[f32], mean: Vec3) -> OffsetColumns {
        let mut to = OffsetColumns::default();
        forward(gate, head, std::iter::once((mean, true)), &mut to);
        to
    }

    #[test]
    fn a_closed_gate_moves_nothing_or_to_the_origin_by_mode() {
        let mean = Vec3::new(1.0, -2.0, 3.0);
        let head = [-200.0, 0.3, 0.2, -0.5, 0.1, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7];
        for mode in [GateMode::ScaleParam, GateMode::LerpPosition] {
            let to = offsets(GateConfig { on: true, mode, start: 0.5 }, &head, mean);
            assert!(to.means.iter().chain(&to.quats).chain(&to.scales).all(|v| *v == 0.0), "{mode:?}: {to:?}");
        }
        let to = offsets(GateConfig { on: true, mode: GateMode::Literal, start: 0.5 }, &head, mean);
        assert_eq!(Vec3::from_slice(&to.means), -mean, "as printed, a closed gate sends the splat to the origin");
    }

    #[test]
    fn open_gates_agree_with_the_rigid_motion() {
        let mean = Vec3::new(1.0, -2.0, 3.0);
        let open = [200.0, 0.3, 0.2, -0.5, 0.1, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7];
        let want = {
            let m = rot::matrix(rot::normalise([1.3f64, 0.2, -0.5, 0.1]).wxyz);
            Vec3::from_array(std::array::from_fn(|i| {
                (m[i][0] - 2.0 * m[i][1] + 3.0 * m[i][2] + (i + 1) as f64) as f32 - mean[i]
            }))
        };
        for mode in MODES {
            for (on, head) in [(true, &open[..]), (false, &open[1..])] {
                let to = offsets(GateConfig { on, mode, start: 0.5 }, head, mean);
                let got = Vec3::from_slice(&to.means);
                assert!((got - want).abs().max_element() < 1e-6, "{mode:?}, gate {on}: {got} {want}");
                assert_eq!((to.quats[3], to.scales[0]), (0.4, 0.5));
            }
        }
    }

    #[test]
    fn a_rotation_that_vanishes_is_the_identity_without_gradient() {
        let mean = Vec3::new(1.0, -2.0, 3.0);
        for rho in [-1.0f32, -1.0 + 2e-7] {
            let mut head = [0.0; 14];
            head[0] = rho;
            let gate = GateConfig { on: false, mode: GateMode::ScaleParam, start: 0.5 };
            assert_eq!(offsets(gate, &head, mean).means, [0.0; 3]);
            let d = OffsetColumns { means: vec![1.0; 3], scales: vec![0.0; 3], quats: vec![0.0; 4] };
            let (mut d_heads, mut d_mean) = (Vec::new(), Vec3::ZERO);
            backward(gate, &head, std::iter::once((mean, true, &mut d_mean)), &d, &mut d_heads);
            assert_eq!((d_mean, &d_heads[..4], &d_heads[4..7]), (Vec3::ZERO, &[0.0; 4][..], &[1.0; 3][..]));
        }
    }
}
