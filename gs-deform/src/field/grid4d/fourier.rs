//! The Fourier branch (FAGS, Eqs. 6 and 7): waves in time whose amplitudes depend on the position.
//!
//! ```text
//! γ_i = γ_max^{(i−1)/(m−1)}     s_i = g sin πγ_i t,  c_i = g cos πγ_i t               i = 1 … m; FAGS: γ_max = 8, four cycles; g = 1
//! f_fre = [w_1 s_1, w_1 c_1, …, w_m s_m, w_m c_m]          w = amplitudes(z_s)         one row of w per splat
//! ```
//! **Collapse.** If the branch is linear and added right before the head (no hidden layers, one linear amplitude
//! layer), it is one matrix per timestamp, from the canonical features `x` to the head:
//!
//! ```text
//! W̃[:, i] = s_i W_h[:, 2i−1] + c_i W_h[:, 2i]        Q = W_a W_s,  r = W_a b_s + b_a
//! W_h f_fre = B x + β        B = W̃ Q,  β = W̃ r
//! backward:  v_W̃ = v_B Qᵀ + v_β rᵀ      v_Q = W̃ᵀ v_B,  v_r = W̃ᵀ v_β
//!            v_W_a = v_Q W_sᵀ + v_r b_sᵀ,  v_b_a = v_r,  v_W_s = W_aᵀ v_Q,  v_b_s = W_aᵀ v_r
//! ```
//! Values change by rounding only; the cost per splat falls from about 37 000 multiply-adds to 480.

use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use gs_core::nn::{Dense, Init};

/// `g sin πγ_i t` and `g cos πγ_i t`, shared by all splats of a call.
#[derive(Clone, Debug, Default)]
pub(super) struct Waves {
    sin: Vec<f32>,
    cos: Vec<f32>,
}

impl Waves {
    /// Evaluates the waves of `bands` frequencies up to `top`, `gain` high, at time `t`.
    pub(super) fn set(&mut self, bands: usize, top: f64, gain: f64, t: f64) {
        self.sin.clear();
        self.cos.clear();
        for i in 0..bands {
            let (sin, cos) = (std::f64::consts::PI * frequency(i, bands, top) * t).sin_cos();
            self.sin.push((gain * sin) as f32);
            self.cos.push((gain * cos) as f32);
        }
    }

    /// `f_fre: [rows, 2m]` from amplitudes `w: [rows, m]`.
    pub(super) fn modulate(&self, w: &[f32], features: &mut Vec<f32>) {
        features.resize(2 * w.len(), 0.0);
        let m = self.sin.len().max(1);
        for (w, row) in w.chunks_exact(m).zip(features.chunks_exact_mut(2 * m)) {
            for ((w, pair), (s, c)) in w.iter().zip(row.as_chunks_mut().0).zip(self.sin.iter().zip(&self.cos)) {
                *pair = [w * s, w * c];
            }
        }
    }

    /// Backward of [`Waves::modulate`]: sets `v_w`, `[rows, m]`.
    pub(super) fn modulate_backward(&self, d_features: &[f32], d_w: &mut Vec<f32>) {
        d_w.resize(d_features.len() / 2, 0.0);
        let m = self.sin.len().max(1);
        for (d_w, row) in d_w.chunks_exact_mut(m).zip(d_features.chunks_exact(2 * m)) {
            for ((d_w, pair), (s, c)) in d_w.iter_mut().zip(row.as_chunks::<2>().0).zip(self.sin.iter().zip(&self.cos))
            {
                *d_w = pair[0] * s + pair[1] * c;
            }
        }
    }
}

/// Frequency `γ` of band `i` (from 0) of `bands`, in half cycles per unit of time: 1 … `top`.
pub(crate) fn frequency(i: usize, bands: usize, top: f64) -> f64 {
    if bands > 1 { 2f64.powf(top.log2() * i as f64 / (bands - 1) as f64) } else { 1.0 }
}

/// The layers that a collapsed branch is the product of.
pub(super) struct CollapsedLayers<'a> {
    /// `W_s, b_s`: canonical features to the width.
    pub space: &'a mut Dense,
    /// `W_a, b_a`: the width to `m` amplitudes.
    pub amplitude: &'a mut Dense,
    /// `W_h`: the width to the head.
    pub head: &'a mut Dense,
}

/// The collapsed branch at one timestamp.
#[derive(Clone, Debug, Default)]
pub(super) struct Collapsed {
    /// `B` and `β + b_h`, as a layer in front of the head; its gradient is `v_B` and `v_β`.
    pub layer: Option<Dense>,
    /// `W̃`, `[outputs, m]`.
    w_tilde: Vec<f32>,
    /// `Q`, `[m, inputs]`.
    q: Vec<f32>,
    /// `r`, `[m]`.
    r: Vec<f32>,
    d_w_tilde: Vec<f32>,
    d_q: Vec<f32>,
    d_r: Vec<f32>,
}

impl Collapsed {
    /// Computes `B` and `β` at the time of `waves`.
    pub(super) fn set(&mut self, waves: &Waves, space: &Dense, amplitude: &Dense, head: &Dense) {
        let (inputs, width, bands, outputs) = (space.inputs(), space.outputs(), amplitude.outputs(), head.outputs());
        self.w_tilde.clear();
        for row in head.weight.value.chunks_exact(width) {
            let pairs = row.as_chunks::<2>().0.iter().zip(waves.sin.iter().zip(&waves.cos));
            self.w_tilde.extend(pairs.map(|([a, b], (s, c))| s * a + c * b));
        }
        self.q.resize(bands * inputs, 0.0);
        let (w_a, w_s) =
            (Mat::new(&amplitude.weight.value, bands, width), Mat::new(&space.weight.value, width, inputs));
        gemm(MatMut::new(&mut self.q, bands, inputs), w_a, w_s, Write::Set);
        amplitude.fold_constant(0..width, &space.bias.value, &mut self.r);
        let fits = |l: &Dense| l.inputs() == inputs && l.outputs() == outputs;
        if !self.layer.as_ref().is_some_and(fits) {
            self.layer = Some(Dense::new("collapsed", inputs, outputs, Init::Zero, 0));
        }
        let Some(layer) = &mut self.layer else { return };
        let w_tilde = Mat::new(&self.w_tilde, outputs, bands);
        let b = MatMut::new(&mut layer.weight.value, outputs, inputs);
        gemm(b, w_tilde, Mat::new(&self.q, bands, inputs), Write::Set);
        let beta = MatMut::new(&mut layer.bias.value, outputs, 1);
        gemm(beta, w_tilde, Mat::new(&self.r, bands, 1), Write::Set);
        layer.bias.value.iter_mut().zip(&head.bias.value).for_each(|(b, h)| *b += h);
    }

    /// Adds the gradient in [`Collapsed::layer`] to the layers it is the product of, once per call of the field.
    pub(super) fn backward(&mut self, waves: &Waves, layers: CollapsedLayers<'_>) {
        let CollapsedLayers { space, amplitude, head } = layers;
        let Some(layer) = &self.layer else { return };
        let (inputs, width, bands, outputs) = (space.inputs(), space.outputs(), amplitude.outputs(), head.outputs());
        self.d_w_tilde.resize(outputs * bands, 0.0);
        self.d_q.resize(bands * inputs, 0.0);
        self.d_r.resize(bands, 0.0);
        let (v_b, v_beta) = (Mat::new(&layer.weight.grad, outputs, inputs), Mat::new(&layer.bias.grad, outputs, 1));
        let w_tilde = Mat::new(&self.w_tilde, outputs, bands).transposed();
        let q = Mat::new(&self.q, bands, inputs).transposed();
        gemm(MatMut::new(&mut self.d_w_tilde, outputs, bands), v_b, q, Write::Set);
        gemm(MatMut::new(&mut self.d_w_tilde, outputs, bands), v_beta, Mat::new(&self.r, 1, bands), Write::Add);
        gemm(MatMut::new(&mut self.d_q, bands, inputs), w_tilde, v_b, Write::Set);
        gemm(MatMut::new(&mut self.d_r, bands, 1), w_tilde, v_beta, Write::Set);

        for (row, d) in head.weight.grad.chunks_exact_mut(width).zip(self.d_w_tilde.chunks_exact(bands)) {
            for ((pair, d), (s, c)) in
                row.as_chunks_mut::<2>().0.iter_mut().zip(d).zip(waves.sin.iter().zip(&waves.cos))
            {
                *pair = [pair[0] + s * d, pair[1] + c * d];
            }
        }
        let (d_q, d_r) = (Mat::new(&self.d_q, bands, inputs), Mat::new(&self.d_r, bands, 1));
        let w_s = Mat::new(&space.weight.value, width, inputs).transposed();
        gemm(MatMut::new(&mut amplitude.weight.grad, bands, width), d_q, w_s, Write::Add);
        gemm(
            MatMut::new(&mut amplitude.weight.grad, bands, width),
            d_r,
            Mat::new(&space.bias.value, 1, width),
            Write::Add,
        );
        amplitude.bias.grad.iter_mut().zip(&self.d_r).for_each(|(g, d)| *g += d);
        let w_a = Mat::new(&amplitude.weight.value, bands, width).transposed();
        gemm(MatMut::new(&mut space.weight.grad, width, inputs), w_a, d_q, Write::Add);
        gemm(MatMut::new(&mut space.bias.grad, width, 1), w_a, d_r, Write::Add);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_run_from_one_to_eight() {
        for (i, want) in [(0, 1.0), (1, 1.016_508_34), (63, 2.805_365_95), (127, 8.0)] {
            assert!((frequency(i, 128, 8.0) - want).abs() < 1e-8, "γ_{}", i + 1);
        }
        assert_eq!(frequency(0, 1, 8.0), 1.0);
    }

    #[test]
    fn modulation_and_its_backward_are_transposes() {
        let mut waves = Waves::default();
        waves.set(2, 8.0, 1.0, 0.25);
        let (mut f, mut d) = (Vec::new(), Vec::new());
        waves.modulate(&[2.0, 3.0], &mut f);
        let root = 0.5f32.sqrt();
        // γ t = ¼ and 2: sin π/4 = cos π/4, sin 2π = 0, cos 2π = 1.
        for (got, want) in f.iter().zip([2.0 * root, 2.0 * root, 0.0, 3.0]) {
            assert!((got - want).abs() < 1e-6, "{f:?}");
        }
        let g = [1.0, -2.0, 5.0, 0.5];
        waves.modulate_backward(&g, &mut d);
        let (left, right) = (f[0] * g[0] + f[1] * g[1] + f[2] * g[2] + f[3] * g[3], 2.0 * d[0] + 3.0 * d[1]);
        assert!((left - right).abs() < 1e-5);
    }
}
