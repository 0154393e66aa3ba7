//! Convolution, normalisation and ReLU as one unit, residual blocks of two units, and the buffers of both.

use super::Level;
use gs_core::nn::gemm::Write;
use gs_core::nn::{Conv, ConvSpec, GroupNorm, Init, Map, NormTape, resample};
use gs_core::{Param, Params};

/// An activation `y` and its gradient `d`.
#[derive(Clone, Debug)]
pub(crate) struct Activation {
    pub(crate) y: Map,
    pub(crate) d: Map,
}

impl Activation {
    pub(crate) fn new(level: &Level, channels: usize) -> Self {
        Self { y: level.map(channels), d: level.map(channels) }
    }

    pub(crate) fn bytes(&self) -> usize {
        self.y.bytes() + self.d.bytes()
    }
}

/// Convolution, then group normalisation, then ReLU if wanted.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Unit {
    conv: Conv,
    norm: GroupNorm,
}

/// Buffers of a [`Unit`].
#[derive(Clone, Debug)]
pub(crate) struct UnitTape {
    /// Output of the convolution.
    z: Map,
    norm: NormTape,
    /// Output of the unit; backward turns its gradient into that of `z`.
    pub(crate) out: Activation,
}

impl Unit {
    pub(crate) fn new(name: &str, spec: ConvSpec, groups: usize, relu: bool, seed: u64) -> Self {
        let conv = Conv::new(&format!("{name}.conv"), spec, Init::FanIn, seed);
        Self { conv, norm: GroupNorm::new(&format!("{name}.norm"), spec.outputs, groups, relu) }
    }

    /// Number of parameters of such a unit.
    pub(crate) fn count(spec: ConvSpec) -> u64 {
        spec.count().saturating_add((spec.outputs as u64).saturating_mul(2))
    }

    pub(crate) fn tape(&self, level: &Level) -> UnitTape {
        let channels = self.conv.outputs();
        UnitTape { z: level.map(channels), norm: NormTape::default(), out: Activation::new(level, channels) }
    }

    /// Computes `tape.out.y` from `x`.
    pub(crate) fn forward(&self, x: &Map, tape: &mut UnitTape, to: &Level) {
        to.conv(&self.conv, x, &mut tape.z);
        self.norm.forward(&tape.z, &mut tape.out.y, &to.valid, &mut tape.norm);
    }

    /// Backward of `tape.out.d` to the parameters and, if given, to `dx`.
    pub(crate) fn backward(
        &mut self,
        x: &Map,
        tape: &mut UnitTape,
        [from, to]: [&Level; 2],
        dx: Option<(&mut Map, Write)>,
    ) {
        self.norm.backward(&tape.z, &mut tape.out.d, &to.valid, &mut tape.norm);
        self.conv.backward_params(x, &tape.out.d, &to.valid);
        if let Some((dx, write)) = dx {
            from.conv_input(&self.conv, &tape.out.d, dx, write);
        }
    }
}

impl UnitTape {
    pub(crate) fn bytes(&self) -> usize {
        self.z.bytes() + self.out.bytes()
    }
}

impl Params for Unit {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.conv.visit(f);
        self.norm.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.conv.visit_mut(f);
        self.norm.visit_mut(f);
    }
}

/// `y = ReLU(GN(conv3×3 ReLU(GN(conv3×3_s x)))⁺ + skip)`; `skip` is `x`, or `GN(conv1×1_s x)` where shapes change.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Residual {
    first: Unit,
    second: Unit,
    skip: Option<Unit>,
}

/// Buffers of a [`Residual`].
#[derive(Clone, Debug)]
pub(crate) struct ResidualTape {
    first: UnitTape,
    second: UnitTape,
    skip: Option<UnitTape>,
    pub(crate) out: Activation,
}

/// The convolutions of a residual block; the third only where shapes change.
fn residual(inputs: usize, outputs: usize, stride: usize) -> (ConvSpec, ConvSpec, Option<ConvSpec>) {
    let spec = |kernel, stride, inputs| ConvSpec { kernel, stride, inputs, outputs, bias: true };
    let changes = inputs != outputs || stride != 1;
    (spec(3, stride, inputs), spec(3, 1, outputs), changes.then(|| spec(1, stride, inputs)))
}

impl Residual {
    /// A block from `inputs` to `outputs` channels, with normalisation groups of eight.
    pub(crate) fn new(name: &str, inputs: usize, outputs: usize, stride: usize, seed: u64) -> Self {
        let unit = |part: &str, spec, relu| Unit::new(&format!("{name}.{part}"), spec, outputs / 8, relu, seed);
        let (first, second, skip) = residual(inputs, outputs, stride);
        Self {
            first: unit("first", first, true),
            second: unit("second", second, true),
            skip: skip.map(|spec| unit("skip", spec, false)),
        }
    }

    /// Number of parameters of such a block.
    pub(crate) fn count(inputs: usize, outputs: usize, stride: usize) -> u64 {
        let (first, second, skip) = residual(inputs, outputs, stride);
        [Some(first), Some(second), skip].into_iter().flatten().map(Unit::count).fold(0, u64::saturating_add)
    }

    pub(crate) fn tape(&self, to: &Level) -> ResidualTape {
        let [first, second] = [&self.first, &self.second].map(|u| u.tape(to));
        let channels = self.first.conv.outputs();
        ResidualTape { first, second, skip: self.skip.as_ref().map(|s| s.tape(to)), out: Activation::new(to, channels) }
    }

    pub(crate) fn forward(&self, x: &Map, tape: &mut ResidualTape, to: &Level) {
        let ResidualTape { first, second, skip, out } = tape;
        self.first.forward(x, first, to);
        self.second.forward(&first.out.y, second, to);
        let around = match (&self.skip, skip) {
            (Some(unit), Some(tape)) => {
                unit.forward(x, tape, to);
                &tape.out.y
            }
            _ => x,
        };
        resample::add_relu(&second.out.y, around, &mut out.y, &to.valid);
    }

    /// Backward of `tape.out.d` to the parameters and to `dx`.
    pub(crate) fn backward(
        &mut self,
        x: &Map,
        tape: &mut ResidualTape,
        levels: [&Level; 2],
        (dx, write): (&mut Map, Write),
    ) {
        let ([from, to], ResidualTape { first, second, skip, out }) = (levels, tape);
        resample::relu_map_backward(&out.y, &mut out.d, &to.valid);
        match (&mut self.skip, skip) {
            (Some(unit), Some(tape)) => {
                resample::copy(&out.d, &mut tape.out.d, &to.valid, Write::Set);
                unit.backward(x, tape, levels, Some((&mut *dx, write)));
            }
            _ => resample::copy(&out.d, dx, &from.valid, write),
        }
        resample::copy(&out.d, &mut second.out.d, &to.valid, Write::Set);
        self.second.backward(&first.out.y, second, [to, to], Some((&mut first.out.d, Write::Set)));
        self.first.backward(x, first, levels, Some((dx, Write::Add)));
    }
}

impl ResidualTape {
    pub(crate) fn bytes(&self) -> usize {
        self.first.bytes() + self.second.bytes() + self.skip.as_ref().map_or(0, UnitTape::bytes) + self.out.bytes()
    }
}

impl Params for Residual {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.first.visit(f);
        self.second.visit(f);
        self.skip.iter().for_each(|s| s.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.first.visit_mut(f);
        self.second.visit_mut(f);
        self.skip.iter_mut().for_each(|s| s.visit_mut(f));
    }
}
