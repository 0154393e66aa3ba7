//! The layers of the Fourier branch, and its fusion with the features of the grids.
//!
//! ```text
//! w = amplitudes(z_s)        add: h = p + f_fre      mul: h = p ⊙ (1 + f_fre)      concat: h = W_c [p, f_fre] + b_c
//! ```
//! with `p = a ⊙ f_t`. The last layer of the amplitudes starts at zero: an untrained branch adds nothing.

use super::config::{Fusion, Grid4dConfig, WaveTime};
use super::fourier::Waves;
use gs_core::nn::gemm::Write;
use gs_core::nn::{Dense, DenseGrad, Init, Mlp, MlpGrad, MlpTape};
use gs_core::{Param, Params, Time};

#[derive(Clone, Debug)]
pub(super) struct Branch {
    amplitudes: Amplitudes,
    /// `W_c`, only with [`Fusion::Concat`].
    concat: Option<Dense>,
    fusion: Fusion,
    bands: usize,
    /// Highest frequency, half cycles per unit of time.
    top: f64,
    /// Factor on the waves.
    gain: f64,
    /// Slope and offset of the waves' time as a linear function of `t`.
    wave_time: [f64; 2],
}

#[derive(Clone, Debug)]
enum Amplitudes {
    /// One linear layer that is folded into the head: no work per splat here.
    Collapsed(Box<Dense>),
    Full(Mlp),
}

/// Activations of the amplitude layers for one block.
#[derive(Clone, Debug, Default)]
pub(super) struct BranchTape {
    /// Input `z_s`, `[rows, width]`.
    z: Vec<f32>,
    /// Activations; the output is `w`, `[rows, m]`.
    net: MlpTape,
}

/// Activations of the fusion of one block at one timestamp.
#[derive(Clone, Debug, Default)]
pub(super) struct BranchScratch {
    /// `f_fre`, `[rows, 2m]`.
    waves: Vec<f32>,
    /// A copy of `p`, if the fusion overwrites it.
    product: Vec<f32>,
}

/// Parameter gradients of one chunk of blocks, and scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct BranchGrad {
    net: MlpGrad,
    concat: DenseGrad,
    d_waves: Vec<f32>,
    d_amplitudes: Vec<f32>,
    joined: Vec<f32>,
}

impl Branch {
    pub(super) fn new(config: &Grid4dConfig, seed: u64) -> Self {
        let (fourier, width) = (&config.fourier, config.width);
        let name = "field.net.amplitude";
        let joined = fourier.joined(width);
        let concat = joined.map(|inputs| Dense::new("field.net.concat", inputs, width, Init::FanIn, seed));
        let scale = 0.9 * f64::from(config.bound);
        Self {
            amplitudes: if config.collapses() {
                Amplitudes::Collapsed(Box::new(Dense::new(
                    &format!("{name}.0"),
                    width,
                    fourier.bands,
                    Init::Zero,
                    seed,
                )))
            } else {
                Amplitudes::Full(Mlp::new(name, &fourier.amplitudes(width), Init::FanIn, Init::Zero, seed))
            },
            concat,
            fusion: fourier.fusion,
            bands: fourier.bands,
            top: fourier.gamma_max,
            gain: fourier.gain,
            wave_time: if fourier.time == WaveTime::Raw { [1.0, 0.0] } else { [2.0 * scale, -scale] },
        }
    }

    /// Evaluates the waves at a timestamp.
    pub(super) fn set_time(&self, t: Time, waves: &mut Waves) {
        let t = self.wave_time[0] * f64::from(t.normalised) + self.wave_time[1];
        waves.set(self.bands, self.top, self.gain, t);
    }

    /// The amplitude layer of a collapsed branch.
    pub(super) fn linear(&self) -> Option<&Dense> {
        match &self.amplitudes {
            Amplitudes::Collapsed(layer) => Some(layer),
            Amplitudes::Full(_) => None,
        }
    }

    /// [`Branch::linear`], to add to the layer's gradient.
    pub(super) fn linear_mut(&mut self) -> Option<&mut Dense> {
        match &mut self.amplitudes {
            Amplitudes::Collapsed(layer) => Some(layer),
            Amplitudes::Full(_) => None,
        }
    }

    /// Computes the amplitudes `w` of a block from `z: [rows, width]`.
    pub(super) fn amplitudes(&self, z: &[f32], tape: &mut BranchTape) {
        if let Amplitudes::Full(net) = &self.amplitudes {
            tape.z.clear();
            tape.z.extend_from_slice(z);
            net.forward(&tape.z, &mut tape.net);
        }
    }

    /// Fuses in place: `fused` holds `p` and becomes `h`.
    pub(super) fn join(&self, times: &Waves, tape: &BranchTape, scratch: &mut BranchScratch, fused: &mut [f32]) {
        if self.linear().is_some() {
            return;
        }
        let BranchScratch { waves, product } = scratch;
        times.modulate(tape.net.output(), waves);
        match (self.fusion, &self.concat) {
            (Fusion::Mul, _) => fused.iter_mut().zip(waves).for_each(|(h, w)| *h *= 1.0 + *w),
            (Fusion::Concat, Some(concat)) => {
                let (width, all) = (concat.outputs(), concat.inputs());
                product.clear();
                product.extend_from_slice(fused);
                concat.start(&concat.bias.value, fused);
                concat.add_product(0..width, product, fused);
                concat.add_product(width..all, waves, fused);
            }
            _ => fused.iter_mut().zip(waves).for_each(|(h, w)| *h += *w),
        }
    }

    /// Backward of [`Branch::join`]: `d` holds `v_h` and becomes `v_p`; `product` is `p`.
    pub(super) fn join_backward(
        &self,
        times: &Waves,
        product: &[f32],
        scratch: &BranchScratch,
        d: &mut [f32],
        grad: &mut BranchGrad,
    ) {
        if self.linear().is_some() {
            return;
        }
        let BranchGrad { concat: d_concat, d_waves, d_amplitudes, joined, .. } = grad;
        let waves = &scratch.waves;
        d_waves.resize(waves.len(), 0.0);
        match (self.fusion, &self.concat) {
            (Fusion::Mul, _) => {
                for (((d, d_wave), p), w) in d.iter_mut().zip(&mut *d_waves).zip(product).zip(waves) {
                    *d_wave = *d * p;
                    *d *= 1.0 + w;
                }
            }
            (Fusion::Concat, Some(concat)) => {
                let (width, all) = (concat.outputs(), concat.inputs());
                concat.backward_bias(d, d_concat);
                concat.backward_weight(0..width, product, d, d_concat);
                concat.backward_weight(width..all, waves, d, d_concat);
                joined.resize(d.len(), 0.0);
                concat.backward_input(0..width, d, joined, Write::Set);
                concat.backward_input(width..all, d, d_waves, Write::Set);
                d.copy_from_slice(joined);
            }
            _ => d_waves.copy_from_slice(d),
        }
        times.modulate_backward(d_waves, d_amplitudes);
    }

    /// Backward of [`Branch::amplitudes`]: adds to `v_z`.
    pub(super) fn amplitudes_backward(&self, tape: &mut BranchTape, d_z: &mut [f32], grad: &mut BranchGrad) {
        if let Amplitudes::Full(net) = &self.amplitudes {
            net.backward(&tape.z, &mut tape.net, &grad.d_amplitudes, Some(d_z), &mut grad.net);
        }
    }

    /// Sets `grad` to zero, reusing memory.
    pub(super) fn reset(&self, grad: &mut BranchGrad) {
        if let Amplitudes::Full(net) = &self.amplitudes {
            grad.net.reset(net);
        }
        if let Some(concat) = &self.concat {
            grad.concat.reset(concat);
        }
    }

    /// Adds the chunks' gradients to the parameters, in order.
    pub(super) fn add_grads<'a>(&mut self, chunks: impl Iterator<Item = &'a BranchGrad> + Clone + Sync + Send) {
        if let Amplitudes::Full(net) = &mut self.amplitudes {
            net.add_grads(chunks.clone().map(|g| &g.net));
        }
        if let Some(concat) = &mut self.concat {
            concat.add_grads(chunks.map(|g| &g.concat));
        }
    }
}

impl Params for Branch {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        match &self.amplitudes {
            Amplitudes::Collapsed(layer) => layer.visit(f),
            Amplitudes::Full(net) => net.visit(f),
        }
        self.concat.iter().for_each(|l| l.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        match &mut self.amplitudes {
            Amplitudes::Collapsed(layer) => layer.visit_mut(f),
            Amplitudes::Full(net) => net.visit_mut(f),
        }
        self.concat.iter_mut().for_each(|l| l.visit_mut(f));
    }
}
