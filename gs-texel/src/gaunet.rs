//! GauNet: from the second unprojected texture and the root-free normals to the Gaussian of every texel.
//!
//! The classic U-Net (Ronneberger et al. 2015), with zero padding and group normalisation in eight groups:
//! ```text
//! double   (conv 3×3 without bias, GN(8 groups), ReLU) × 2
//! down     double → w;  then per level: 2 × 2 maximum, double → twice the channels
//! up       per level: transposed conv 2×2 halves the channels, [skip, ·], double
//! out      conv 1×1 → 11 + 3 (L + 1)²
//! ```
//! Channels out: log-scale (3), quaternion (4), opacity logit (1), offset (3), colour coefficients (3 for degree 0, then
//! the rest, colour running fastest); `L` is the degree of the spherical harmonics.
//!
//! ```
//! use gs_texel::{GauNet, GauNetConfig};
//!
//! let net = GauNet::new("gau", GauNetConfig::tiny(), 7)?;
//! let mut tape = net.tape(16, None)?;
//! let out = net.forward(&vec![0.5; 16 * 16 * 6], &mut tape)?;
//! assert_eq!((net.config().outputs(), out.len()), (14, 16 * 16 * 14));
//! # Ok::<(), gs_texel::net::NetError>(())
//! ```

use crate::net::block::{Activation, Unit, UnitTape};
use crate::net::{Level, NetError, NormOver, load};
use gs_core::nn::gemm::Write;
use gs_core::nn::{Conv, ConvSpec, ConvTranspose, Init, Map, resample};
use gs_core::{Param, Params};
use serde::{Deserialize, Serialize};

/// Channel groups of every normalisation.
const GROUPS: usize = 8;
/// Highest degree of the colours.
const MAX_SH_DEGREE: u32 = 3;
/// Most levels: a map is halved so often.
const MAX_LEVELS: u32 = 16;

/// Shape of a [`GauNet`]; defaults are those of the paper with spherical harmonics of degree 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GauNetConfig {
    /// Input channels. Default: 6, texture and normals.
    pub inputs: usize,
    /// Channels of the finest level, a multiple of 8; each coarser level has twice as many. Default: 64.
    pub width: usize,
    /// Number of times the map is halved. Default: 4.
    pub levels: u32,
    /// Degree of the spherical harmonics in the output, 0 to 3. Default: 1.
    pub sh_degree: u32,
    /// Texels that the network works on. Default: all.
    pub norm_over: NormOver,
    /// Whether invalid texels are skipped: faster and exact, with [`NormOver::Mask`] only. Default: yes.
    pub sparse: bool,
}

impl Default for GauNetConfig {
    fn default() -> Self {
        Self { inputs: 6, width: 64, levels: 4, sh_degree: 1, norm_over: NormOver::All, sparse: true }
    }
}

impl GauNetConfig {
    /// Half the width, a quarter of the cost: 32 channels, 4 levels.
    pub fn small() -> Self {
        Self { width: 32, ..Self::default() }
    }

    /// For tests and small machines: 16 channels, 3 levels, degree 0.
    pub fn tiny() -> Self {
        Self { width: 16, levels: 3, sh_degree: 0, ..Self::default() }
    }

    /// Output channels, `11 + 3 (sh_degree + 1)²`.
    pub fn outputs(&self) -> usize {
        11 + 3 * (self.sh_degree.min(MAX_SH_DEGREE) as usize + 1).pow(2)
    }

    fn check(&self) -> Result<(), NetError> {
        if self.inputs == 0 || self.levels == 0 {
            let what = if self.levels == 0 { "level" } else { "input channel" };
            return Err(NetError::Empty { net: "GauNet", what });
        }
        if self.levels > MAX_LEVELS {
            return Err(NetError::TooLarge { net: "GauNet", what: "levels", value: self.levels, most: MAX_LEVELS });
        }
        if self.sh_degree > MAX_SH_DEGREE {
            let (value, most) = (self.sh_degree, MAX_SH_DEGREE);
            return Err(NetError::TooLarge { net: "GauNet", what: "sh_degree", value, most });
        }
        if self.width == 0 || !self.width.is_multiple_of(GROUPS) {
            return Err(NetError::Width { net: "GauNet", width: self.width, multiple: GROUPS });
        }
        Ok(())
    }

    /// Channels of a level.
    fn channels(&self, level: usize) -> usize {
        2usize.saturating_pow(u32::try_from(level).unwrap_or(u32::MAX)).saturating_mul(self.width)
    }

    /// Input channels of a level of the encoder.
    fn below(&self, level: usize) -> usize {
        if level == 0 { self.inputs } else { self.channels(level - 1) }
    }

    /// The last convolution.
    fn last(&self) -> ConvSpec {
        ConvSpec { kernel: 1, stride: 1, inputs: self.width, outputs: self.outputs(), bias: true }
    }

    /// Number of parameters of the network; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        let double =
            |inputs, outputs| double(inputs, outputs).map(Unit::count).into_iter().fold(0, u64::saturating_add);
        let levels = self.levels.min(MAX_LEVELS) as usize;
        let down = (0..=levels).map(|l| double(self.below(l), self.channels(l)));
        let up = (0..levels).map(|l| {
            let (inputs, outputs) = (self.channels(l + 1), self.channels(l));
            grow(inputs, outputs).count().saturating_add(double(inputs, outputs))
        });
        down.chain(up).fold(self.last().count(), u64::saturating_add)
    }

    /// Multiply-adds of the convolutions of a forward pass, per texel of its map.
    ///
    /// ```
    /// let paper = gs_texel::GauNetConfig::default().multiply_adds() * 256.0 * 256.0;
    /// assert!((paper / 48.4e9 - 1.0).abs() < 1e-3, "{paper}");
    /// ```
    pub fn multiply_adds(&self) -> f64 {
        let levels = self.levels.min(MAX_LEVELS) as usize;
        // A texel of a level stands for 4^level of the map.
        let weights = |level: usize, spec| ConvSpec { bias: false, ..spec }.count() as f64 * 0.25f64.powf(level as f64);
        let double =
            |level, inputs, outputs| double(inputs, outputs).map(|spec| weights(level, spec)).iter().sum::<f64>();
        let down = (0..=levels).map(|l| double(l, self.below(l), self.channels(l)));
        let up = (0..levels).map(|l| {
            let (inputs, outputs) = (self.channels(l + 1), self.channels(l));
            // Each texel of the coarser level meets the whole kernel.
            weights(l + 1, grow(inputs, outputs)) + double(l, inputs, outputs)
        });
        down.chain(up).sum::<f64>() + weights(0, self.last())
    }
}

/// The two convolutions of a level.
fn double(inputs: usize, outputs: usize) -> [ConvSpec; 2] {
    [inputs, outputs].map(|inputs| ConvSpec { kernel: 3, stride: 1, inputs, outputs, bias: false })
}

/// The transposed convolution to a finer level, as [`ConvTranspose`].
fn grow(inputs: usize, outputs: usize) -> ConvSpec {
    ConvSpec { kernel: 2, stride: 2, inputs, outputs, bias: true }
}

type Double = [Unit; 2];
type DoubleTape = [UnitTape; 2];

/// The network, with its parameters ([`Params`]).
#[derive(Clone, Debug, PartialEq)]
pub struct GauNet {
    config: GauNetConfig,
    /// Finest first, one more than there are levels.
    down: Vec<Double>,
    /// Finest first.
    up: Vec<(ConvTranspose, Double)>,
    out: Conv,
}

/// Buffers of forward and backward passes of a [`GauNet`] over maps of one size and one mask; reused by every pass.
#[derive(Clone, Debug)]
pub struct GauNetTape {
    levels: Vec<Level>,
    input: Map,
    down: Vec<DoubleTape>,
    /// Pooled input of `down[i + 1]`.
    pooled: Vec<Activation>,
    up: Vec<UpTape>,
    out: Activation,
    output: Vec<f32>,
}

/// Buffers of one level of the decoder.
#[derive(Clone, Debug)]
struct UpTape {
    doubled: Activation,
    joined: Activation,
    double: DoubleTape,
}

fn forward_double(double: &Double, x: &Map, [a, b]: &mut DoubleTape, level: &Level) {
    double[0].forward(x, a, level);
    double[1].forward(&a.out.y, b, level);
}

fn backward_double(double: &mut Double, x: &Map, [a, b]: &mut DoubleTape, level: &Level, dx: Option<&mut Map>) {
    let [first, second] = double;
    second.backward(&a.out.y, b, [level, level], Some((&mut a.out.d, Write::Set)));
    first.backward(x, a, [level, level], dx.map(|dx| (dx, Write::Set)));
}

impl GauNet {
    /// A network with random weights of the given seed. Names of its parameters begin with `name`.
    ///
    /// # Errors
    /// If the width does not fit the normalisation groups, or there are no inputs or levels.
    pub fn new(name: &str, config: GauNetConfig, seed: u64) -> Result<Self, NetError> {
        config.check()?;
        let double = |part: String, inputs, outputs| {
            let [first, second] = double(inputs, outputs);
            let unit = |i: usize, spec| Unit::new(&format!("{name}.{part}.{i}"), spec, GROUPS, true, seed);
            [unit(0, first), unit(1, second)]
        };
        let channels = |level: usize| config.channels(level);
        let levels = config.levels as usize;
        let up = |l: usize| {
            let double = double(format!("up{l}"), 2 * channels(l), channels(l));
            (ConvTranspose::new(&format!("{name}.up{l}.grow"), channels(l + 1), channels(l), Init::FanIn, seed), double)
        };
        Ok(Self {
            config,
            down: (0..=levels).map(|l| double(format!("down{l}"), config.below(l), channels(l))).collect(),
            up: (0..levels).map(up).collect(),
            out: Conv::new(&format!("{name}.out"), config.last(), Init::FanIn, seed),
        })
    }

    /// The configuration it was built with.
    pub fn config(&self) -> &GauNetConfig {
        &self.config
    }

    /// Buffers for `size × size` maps. `mask` holds the valid texels, row-major; required by [`NormOver::Mask`], ignored
    /// otherwise.
    ///
    /// # Errors
    /// If `size` cannot be halved as often as there are levels, or the mask is missing, of another size or empty.
    pub fn tape(&self, size: usize, mask: Option<&[bool]>) -> Result<GauNetTape, NetError> {
        let config = &self.config;
        let levels = Level::pyramid(size, config.levels, config.norm_over, config.sparse, mask)?;
        let double = |double: &Double, level: &Level| double.each_ref().map(|u| u.tape(level));
        let up = |(l, up): (usize, &(ConvTranspose, Double))| UpTape {
            doubled: Activation::new(&levels[l], config.channels(l)),
            joined: Activation::new(&levels[l], 2 * config.channels(l)),
            double: double(&up.1, &levels[l]),
        };
        Ok(GauNetTape {
            input: levels[0].map(config.inputs),
            down: self.down.iter().zip(&levels).map(|(d, level)| double(d, level)).collect(),
            pooled: levels[1..]
                .iter()
                .enumerate()
                .map(|(l, level)| Activation::new(level, config.channels(l)))
                .collect(),
            up: self.up.iter().enumerate().map(up).collect(),
            out: Activation::new(&levels[0], config.outputs()),
            output: vec![0.0; size * size * config.outputs()],
            levels,
        })
    }

    /// Values `[size, size, outputs]` from `map: [size, size, inputs]`; zero at invalid texels. The result lies in
    /// `tape`.
    ///
    /// # Errors
    /// If the map has another length or a value that is not finite.
    pub fn forward<'t>(&self, map: &[f32], tape: &'t mut GauNetTape) -> Result<&'t [f32], NetError> {
        let GauNetTape { levels, input, down, pooled, up, out, output } = tape;
        load("input of GauNet", map, input, &levels[0])?;
        forward_double(&self.down[0], input, &mut down[0], &levels[0]);
        for l in 1..levels.len() {
            let (above, here) = down.split_at_mut(l);
            let pooled = &mut pooled[l - 1].y;
            resample::max_pool(&above[l - 1][1].out.y, pooled, &levels[l].valid);
            forward_double(&self.down[l], pooled, &mut here[0], &levels[l]);
        }
        for l in (0..up.len()).rev() {
            let (here, below) = up.split_at_mut(l + 1);
            let coarse = below.first().map_or(&down[l + 1][1].out.y, |b| &b.double[1].out.y);
            let (tape, level, (grow, double)) = (&mut here[l], &levels[l], &self.up[l]);
            grow.forward(coarse, &mut tape.doubled.y, level.compute());
            level.clear_invalid(&mut tape.doubled.y);
            resample::concat(&down[l][1].out.y, &tape.doubled.y, &mut tape.joined.y, &level.valid);
            forward_double(double, &tape.joined.y, &mut tape.double, level);
        }
        levels[0].conv(&self.out, &up[0].double[1].out.y, &mut out.y);
        out.y.store(output);
        Ok(output)
    }

    /// Adds the gradients of all parameters, from `d_out: [size, size, outputs]` of the last forward pass with `tape`. Values of
    /// `d_out` at invalid texels are ignored.
    ///
    /// # Errors
    /// If `d_out` has another length or a value that is not finite; nothing is added then.
    pub fn backward(&mut self, tape: &mut GauNetTape, d_out: &[f32]) -> Result<(), NetError> {
        let GauNetTape { levels, input, down, pooled, up, out, .. } = tape;
        load("gradient of GauNet's output", d_out, &mut out.d, &levels[0])?;
        let Activation { y, d } = &mut up[0].double[1].out;
        self.out.backward_params(y, &out.d, &levels[0].valid);
        levels[0].conv_input(&self.out, &out.d, d, Write::Set);
        for l in 0..up.len() {
            let (here, below) = up.split_at_mut(l + 1);
            let (tape, level, (grow, double)) = (&mut here[l], &levels[l], &mut self.up[l]);
            let Activation { y, d } = &mut tape.joined;
            backward_double(double, y, &mut tape.double, level, Some(&mut *d));
            let skip = &mut down[l][1].out.d;
            resample::concat_backward(d, 0, skip, &level.valid, Write::Set);
            resample::concat_backward(d, skip.channels(), &mut tape.doubled.d, &level.valid, Write::Set);
            let coarse = below.first_mut().map_or(&mut down[l + 1], |b| &mut b.double);
            let (Activation { y, d }, under) = (&mut coarse[1].out, &levels[l + 1]);
            grow.backward_params(y, &tape.doubled.d, &under.valid, &level.valid);
            grow.backward_input(&tape.doubled.d, d, under.compute(), Write::Set);
            under.clear_invalid(d);
        }
        for l in (1..levels.len()).rev() {
            let (above, here) = down.split_at_mut(l);
            let (Activation { y, d }, fine) = (&mut pooled[l - 1], &mut above[l - 1][1].out);
            backward_double(&mut self.down[l], y, &mut here[0], &levels[l], Some(&mut *d));
            resample::max_pool_backward(&fine.y, y, d, &mut fine.d, &levels[l - 1].valid, Write::Add);
        }
        backward_double(&mut self.down[0], input, &mut down[0], &levels[0], None);
        Ok(())
    }
}

impl GauNetTape {
    /// Memory of its maps, bytes.
    pub fn bytes(&self) -> usize {
        let double = |d: &DoubleTape| d.iter().map(UnitTape::bytes).sum::<usize>();
        let up = |u: &UpTape| u.doubled.bytes() + u.joined.bytes() + double(&u.double);
        let pooled = self.pooled.iter().map(Activation::bytes).sum::<usize>();
        let both = self.down.iter().map(double).sum::<usize>() + self.up.iter().map(up).sum::<usize>();
        self.input.bytes() + self.out.bytes() + pooled + both
    }
}

impl Params for GauNet {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.down.iter().flatten().for_each(|u| u.visit(f));
        for (grow, double) in &self.up {
            grow.visit(f);
            double.iter().for_each(|u| u.visit(f));
        }
        self.out.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.down.iter_mut().flatten().for_each(|u| u.visit_mut(f));
        for (grow, double) in &mut self.up {
            grow.visit_mut(f);
            double.iter_mut().for_each(|u| u.visit_mut(f));
        }
        self.out.visit_mut(f);
    }
}
