//! The Fourier branch (FAGS, Eqs. 6 and 7): waves in time whose amplitudes depend on the place.
//!
//! ```text
//! γ_i = 2^{3(i−1)/(m−1)}        s_i = sin πγ_i t,  c_i = cos πγ_i t                   i = 1 … m, half a cycle to four
//! f_fre = [w_1 s_1, w_1 c_1, …, w_m s_m, w_m c_m]          w = amplitudes(z_s)         one row of w per splat
//! ```
//! **Collapse.** Where the branch is linear and is added right before the head (no hidden layers, one linear amplitude
//! layer), it is one matrix per time, from the canonical features `x` to the head:
//!
//! ```text
//! W̃[:, i] = s_i W_h[:, 2i−1] + c_i W_h[:, 2i]        Q = W_a W_s,  r = W_a b_s + b_a
//! W_h f_fre = B x + β        B = W̃ Q,  β = W̃ r
//! back:  v_W̃ = v_B Qᵀ + v_β rᵀ      v_Q = W̃ᵀ v_B,  v_r = W̃ᵀ v_β
//!        v_W_a = v_Q W_sᵀ + v_r b_sᵀ,  v_b_a = v_r,  v_W_s = W_aᵀ v_Q,  v_b_s = W_aᵀ v_r
//! ```
//! No value changes but by rounding; the cost per splat falls from about 37 000 multiply-adds to 480.

use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use gs_core::nn::{Dense, Init};

/// `sin πγ_i t` and `cos πγ_i t`, shared by all splats of a call.
#[derive(Clone, Debug, Default)]
pub struct Waves {
    sin: Vec<f32>,
    cos: Vec<f32>,
}

impl Waves {
    /// The waves of `bands` frequencies at time `t`.
    pub fn set(&mut self, bands: usize, t: f64) {
        self.sin.clear();
        self.cos.clear();
        for i in 0..bands {
            let (sin, cos) = (std::f64::consts::PI * frequency(i, bands) * t).sin_cos();
            self.sin.push(sin as f32);
            self.cos.push(cos as f32);
        }
    }

    /// `f_fre: [rows, 2m]` from amplitudes `w: [rows, m]`.
    pub fn spread(&self, w: &[f32], features: &mut Vec<f32>) {
        features.resize(2 * w.len(), 0.0);
        let m = self.sin.len().max(1);
        for (w, row) in w.chunks_exact(m).zip(features.chunks_exact_mut(2 * m)) {
            for ((w, pair), (s, c)) in w.iter().zip(row.as_chunks_mut().0).zip(self.sin.iter().zip(&self.cos)) {
                *pair = [w * s, w * c];
            }
        }
    }

    /// The way back of [`Waves::spread`]: `v_w`.
    pub fn gather(&self, d_features: &[f32], d_w: &mut Vec<f32>) {
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

/// `γ` of band `i` (from 0) of `bands`.
pub fn frequency(i: usize, bands: usize) -> f64 {
    if bands > 1 { 2f64.powf(3.0 * i as f64 / (bands - 1) as f64) } else { 1.0 }
}

/// The layers a collapsed branch runs through.
pub struct Through<'a> {
    /// `W_s, b_s`: canonical features to the width.
    pub space: &'a mut Dense,
    /// `W_a, b_a`: the width to `m` amplitudes.
    pub amplitude: &'a mut Dense,
    /// `W_h`: the width to the head.
    pub head: &'a mut Dense,
}

/// The collapsed branch at one time.
#[derive(Clone, Debug, Default)]
pub struct Collapsed {
    /// `B` and `β + b_h`, as a layer in front of the head; its gradient is `v_B` and `v_β`.
    pub layer: Option<Dense>,
    /// `W̃: [outputs, m]`.
    waved: Vec<f32>,
    /// `Q: [m, inputs]`.
    inner: Vec<f32>,
    /// `r: [m]`.
    inner_bias: Vec<f32>,
    d_waved: Vec<f32>,
    d_inner: Vec<f32>,
    d_inner_bias: Vec<f32>,
}

impl Collapsed {
    /// Works out `B` and `β` at the time of `waves`.
    pub fn set(&mut self, waves: &Waves, space: &Dense, amplitude: &Dense, head: &Dense) {
        let (inputs, width, bands, outputs) = (space.inputs(), space.outputs(), amplitude.outputs(), head.outputs());
        self.waved.clear();
        for row in head.weight.value.chunks_exact(width) {
            let pairs = row.as_chunks::<2>().0.iter().zip(waves.sin.iter().zip(&waves.cos));
            self.waved.extend(pairs.map(|([a, b], (s, c))| s * a + c * b));
        }
        self.inner.resize(bands * inputs, 0.0);
        let (w_a, w_s) =
            (Mat::new(&amplitude.weight.value, bands, width), Mat::new(&space.weight.value, width, inputs));
        gemm(MatMut::new(&mut self.inner, bands, inputs), w_a, w_s, Write::Set);
        amplitude.fold_constant(0..width, &space.bias.value, &mut self.inner_bias);
        let fits = |l: &Dense| l.inputs() == inputs && l.outputs() == outputs;
        if !self.layer.as_ref().is_some_and(fits) {
            self.layer = Some(Dense::new("collapsed", inputs, outputs, Init::Zero, 0));
        }
        let Some(layer) = &mut self.layer else { return };
        let waved = Mat::new(&self.waved, outputs, bands);
        let b = MatMut::new(&mut layer.weight.value, outputs, inputs);
        gemm(b, waved, Mat::new(&self.inner, bands, inputs), Write::Set);
        let beta = MatMut::new(&mut layer.bias.value, outputs, 1);
        gemm(beta, waved, Mat::new(&self.inner_bias, bands, 1), Write::Set);
        layer.bias.value.iter_mut().zip(&head.bias.value).for_each(|(b, h)| *b += h);
    }

    /// Hands the gradient in [`Collapsed::layer`] on to the layers it stands for, once per call of the field.
    pub fn backward(&mut self, waves: &Waves, through: Through<'_>) {
        let Through { space, amplitude, head } = through;
        let Some(layer) = &self.layer else { return };
        let (inputs, width, bands, outputs) = (space.inputs(), space.outputs(), amplitude.outputs(), head.outputs());
        self.d_waved.resize(outputs * bands, 0.0);
        self.d_inner.resize(bands * inputs, 0.0);
        self.d_inner_bias.resize(bands, 0.0);
        let (v_b, v_beta) = (Mat::new(&layer.weight.grad, outputs, inputs), Mat::new(&layer.bias.grad, outputs, 1));
        let waved = Mat::new(&self.waved, outputs, bands).transposed();
        let inner = Mat::new(&self.inner, bands, inputs).transposed();
        gemm(MatMut::new(&mut self.d_waved, outputs, bands), v_b, inner, Write::Set);
        gemm(MatMut::new(&mut self.d_waved, outputs, bands), v_beta, Mat::new(&self.inner_bias, 1, bands), Write::Add);
        gemm(MatMut::new(&mut self.d_inner, bands, inputs), waved, v_b, Write::Set);
        gemm(MatMut::new(&mut self.d_inner_bias, bands, 1), waved, v_beta, Write::Set);

        for (row, d) in head.weight.grad.chunks_exact_mut(width).zip(self.d_waved.chunks_exact(bands)) {
            for ((pair, d), (s, c)) in
                row.as_chunks_mut::<2>().0.iter_mut().zip(d).zip(waves.sin.iter().zip(&waves.cos))
            {
                *pair = [pair[0] + s * d, pair[1] + c * d];
            }
        }
        let (d_inner, d_bias) = (Mat::new(&self.d_inner, bands, inputs), Mat::new(&self.d_inner_bias, bands, 1));
        let w_s = Mat::new(&space.weight.value, width, inputs).transposed();
        gemm(MatMut::new(&mut amplitude.weight.grad, bands, width), d_inner, w_s, Write::Add);
        gemm(
            MatMut::new(&mut amplitude.weight.grad, bands, width),
            d_bias,
            Mat::new(&space.bias.value, 1, width),
            Write::Add,
        );
        amplitude.bias.grad.iter_mut().zip(&self.d_inner_bias).for_each(|(g, d)| *g += d);
        let w_a = Mat::new(&amplitude.weight.value, bands, width).transposed();
        gemm(MatMut::new(&mut space.weight.grad, width, inputs), w_a, d_inner, Write::Add);
        gemm(MatMut::new(&mut space.bias.grad, width, 1), w_a, d_bias, Write::Add);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_run_from_one_to_eight() {
        for (i, want) in [(0, 1.0), (1, 1.016_508_34), (63, 2.805_365_95), (127, 8.0)] {
            assert!((frequency(i, 128) - want).abs() < 1e-8, "γ_{}", i + 1);
        }
        assert_eq!(frequency(0, 1), 1.0);
    }

    #[test]
    fn spreading_and_gathering_are_each_others_transpose() {
        let mut waves = Waves::default();
        waves.set(2, 0.25);
        let (mut f, mut d) = (Vec::new(), Vec::new());
        waves.spread(&[2.0, 3.0], &mut f);
        let root = 0.5f32.sqrt();
        // γ t = ¼ and 2: sin π/4 = cos π/4, sin 2π = 0, cos 2π = 1.
        for (got, want) in f.iter().zip([2.0 * root, 2.0 * root, 0.0, 3.0]) {
            assert!((got - want).abs() < 1e-6, "{f:?}");
        }
        let g = [1.0, -2.0, 5.0, 0.5];
        waves.gather(&g, &mut d);
        let (left, right) = (f[0] * g[0] + f[1] * g[1] + f[2] * g[2] + f[3] * g[3], 2.0 * d[0] + 3.0 * d[1]);
        assert!((left - right).abs() < 1e-5);
    }
}
