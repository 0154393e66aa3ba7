//! GeoNet: from the first unprojected texture and the root-free normals to offsets of the canonical surface.
//!
//! A light residual U-Net. `GN(c)` has `c/8` groups (the first layer 8), convolutions have a bias; widths for the
//! published `width` of 32, others in proportion:
//! ```text
//! stem   conv 5×5, stride 2 → 32, GN, ReLU                      S/2
//! enc1   2 × RB 32                                              S/2   f1
//! enc2   RB 32→48 stride 2, RB 48                               S/4   f2
//! enc3   RB 48→96 stride 2, RB 96                               S/8
//! dec3   2 × RB 96, ×2 bilinear                                 S/4
//! dec2   [·, f2] RB 144→64, RB 64, ×2                           S/2
//! dec1   [·, f1] RB 96→48, RB 48, ×2                            S
//! head   [·, input] conv 3×3 → 32, ReLU, conv 3×3, ReLU, conv 1×1 → 3
//! ```
//! Offsets are along canonical axes, in units of `offset_unit` metres, without an output activation. The last layer starts at
//! zero, so that training starts at the undeformed template:
//! ```
//! use gs_texel::{GeoNet, GeoNetConfig};
//!
//! let net = GeoNet::new("geo", GeoNetConfig { width: 16, ..GeoNetConfig::default() }, 7)?;
//! let mut tape = net.tape(16, None)?;
//! assert_eq!(net.forward(&vec![0.5; 16 * 16 * 6], &mut tape)?, [0.0; 16 * 16 * 3]);
//! # Ok::<(), gs_texel::net::NetError>(())
//! ```

use crate::net::block::{Activation, Residual, ResidualTape, Unit, UnitTape};
use crate::net::{Level, NetError, NormOver, load};
use gs_core::nn::gemm::Write;
use gs_core::nn::{Conv, ConvSpec, Init, Map, resample};
use gs_core::{Param, Params};
use serde::{Deserialize, Serialize};

/// Output channels: an offset per texel.
const OUTPUTS: usize = 3;
/// Number of times the map is halved.
const HALVINGS: u32 = 3;

/// Shape of a [`GeoNet`]; defaults are those of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeoNetConfig {
    /// Input channels. Default: 6, texture and normals.
    pub inputs: usize,
    /// Channels of the first stage, a multiple of 16; other stages in proportion. Default: 32.
    pub width: usize,
    /// Metres per unit of output, above 0: offsets are centimetres, while optimizer steps suit values about 1. Default: 1.
    pub offset_unit: f32,
    /// Texels that the network works on. Default: all.
    pub norm_over: NormOver,
    /// Whether invalid texels are skipped: faster and exact, with [`NormOver::Mask`] only. Default: yes.
    pub sparse: bool,
}

impl Default for GeoNetConfig {
    fn default() -> Self {
        Self { inputs: 6, width: 32, offset_unit: 1.0, norm_over: NormOver::All, sparse: true }
    }
}

/// Sizes of the parts of a [`GeoNet`].
struct Shape {
    stem: ConvSpec,
    /// Name, inputs, outputs and stride of the two residual blocks of each stage.
    stages: [(&'static str, usize, usize, usize); 6],
    head: [ConvSpec; 3],
}

impl GeoNetConfig {
    fn shape(&self) -> Shape {
        let Self { inputs, width: w, .. } = *self;
        let (w2, w3) = (w.saturating_mul(3) / 2, w.saturating_mul(3));
        let spec = |kernel, inputs, outputs| ConvSpec { kernel, stride: 1, inputs, outputs, bias: true };
        Shape {
            stem: ConvSpec { stride: 2, ..spec(5, inputs, w) },
            stages: [
                ("enc1", w, w, 1),
                ("enc2", w, w2, 2),
                ("enc3", w2, w3, 2),
                ("dec3", w3, w3, 1),
                ("dec2", w3.saturating_add(w2), w.saturating_mul(2), 1),
                ("dec1", w3, w2, 1),
            ],
            head: [spec(3, w2.saturating_add(inputs), w), spec(3, w, w), spec(1, w, OUTPUTS)],
        }
    }

    /// Number of parameters of the network; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        let Shape { stem, stages, head } = self.shape();
        let blocks = stages.map(|(_, inputs, outputs, stride)| {
            Residual::count(inputs, outputs, stride).saturating_add(Residual::count(outputs, outputs, 1))
        });
        let layers = blocks.into_iter().chain(head.map(|spec| spec.count()));
        layers.fold(Unit::count(stem), u64::saturating_add)
    }

    fn check(&self) -> Result<(), NetError> {
        if self.inputs == 0 {
            return Err(NetError::Empty { net: "GeoNet", what: "input channel" });
        }
        if self.width == 0 || !self.width.is_multiple_of(16) {
            return Err(NetError::Width { net: "GeoNet", width: self.width, multiple: 16 });
        }
        Ok(())
    }
}

/// Two residual blocks, one after the other.
type Stage = [Residual; 2];
type StageTape = [ResidualTape; 2];

/// The network, with its parameters ([`Params`]).
#[derive(Clone, Debug, PartialEq)]
pub struct GeoNet {
    config: GeoNetConfig,
    stem: Unit,
    /// enc1, enc2, enc3, dec3, dec2, dec1.
    stages: [Stage; 6],
    head: [Conv; 3],
}

/// Buffers of forward and backward passes of a [`GeoNet`] over maps of one size and one mask; reused by every pass.
#[derive(Clone, Debug)]
pub struct GeoNetTape {
    /// S, S/2, S/4, S/8.
    levels: Vec<Level>,
    input: Map,
    stem: UnitTape,
    stages: [StageTape; 6],
    /// Upsampled outputs of dec3, dec2, dec1.
    doubled: [Activation; 3],
    /// These concatenated with f2, f1 and the input.
    joined: [Activation; 3],
    head: [Activation; 3],
    output: Vec<f32>,
}

/// Upsamples the coarse map to twice its size and concatenates the fine one.
fn join([coarse, fine]: [&Map; 2], doubled: &mut Activation, joined: &mut Activation, level: &Level) {
    resample::upsample(coarse, &mut doubled.y, &level.valid);
    resample::concat(&doubled.y, fine, &mut joined.y, &level.valid);
}

/// Level of the output of each stage.
const LEVEL: [usize; 6] = [1, 2, 3, 3, 2, 1];

impl GeoNet {
    /// A network with random weights of the given seed. Names of its parameters begin with `name`.
    ///
    /// # Errors
    /// If the width does not fit the normalisation groups, or there are no inputs or levels.
    pub fn new(name: &str, config: GeoNetConfig, seed: u64) -> Result<Self, NetError> {
        config.check()?;
        let Shape { stem, stages, head } = config.shape();
        let stage = |(part, inputs, outputs, stride): (&str, usize, usize, usize)| {
            let block =
                |i: usize, inputs, stride| Residual::new(&format!("{name}.{part}.{i}"), inputs, outputs, stride, seed);
            [block(0, inputs, stride), block(1, outputs, 1)]
        };
        let conv = |part: usize, init| Conv::new(&format!("{name}.head.{part}"), head[part], init, seed);
        Ok(Self {
            config,
            stem: Unit::new(&format!("{name}.stem"), stem, 8, true, seed),
            stages: stages.map(stage),
            head: [conv(0, Init::FanIn), conv(1, Init::FanIn), conv(2, Init::Zero)],
        })
    }

    /// The configuration it was built with.
    pub fn config(&self) -> &GeoNetConfig {
        &self.config
    }

    /// Buffers for `size × size` maps. `mask` holds the valid texels, row-major; required by [`NormOver::Mask`], ignored
    /// otherwise.
    ///
    /// # Errors
    /// If `size` is no multiple of 8, or the mask is missing, of another size or empty.
    pub fn tape(&self, size: usize, mask: Option<&[bool]>) -> Result<GeoNetTape, NetError> {
        let GeoNetConfig { inputs, width: w, norm_over, sparse, .. } = self.config;
        let levels = Level::pyramid(size, HALVINGS, norm_over, sparse, mask)?;
        let mut at = 0..;
        let stages = self.stages.each_ref().map(|s| {
            let level = &levels[LEVEL[at.next().unwrap_or_default()]];
            s.each_ref().map(|b| b.tape(level))
        });
        let slot = |level: usize, channels| Activation::new(&levels[level], channels);
        Ok(GeoNetTape {
            input: Map::zeros(size, size, inputs, 2),
            stem: self.stem.tape(&levels[1]),
            stages,
            doubled: [slot(2, 3 * w), slot(1, 2 * w), slot(0, 3 * w / 2)],
            joined: [slot(2, 9 * w / 2), slot(1, 3 * w), slot(0, 3 * w / 2 + inputs)],
            head: [slot(0, w), slot(0, w), slot(0, OUTPUTS)],
            output: vec![0.0; size * size * OUTPUTS],
            levels,
        })
    }

    /// Offsets `[size, size, 3]` from `map: [size, size, inputs]`; zero at invalid texels. The result lies in
    /// `tape`.
    ///
    /// # Errors
    /// If the map has another length or a value that is not finite.
    pub fn forward<'t>(&self, map: &[f32], tape: &'t mut GeoNetTape) -> Result<&'t [f32], NetError> {
        let GeoNetTape { levels, input, stem, stages, doubled, joined, head, output } = tape;
        load("input of GeoNet", map, input, &levels[0])?;
        self.stem.forward(input, stem, &levels[1]);
        let [enc1, enc2, enc3, dec3, dec2, dec1] = stages;
        let run = |i: usize, x: &Map, tape: &mut StageTape| {
            let ([a, b], level) = (tape, &levels[LEVEL[i]]);
            self.stages[i][0].forward(x, a, level);
            self.stages[i][1].forward(&a.out.y, b, level);
        };
        run(0, &stem.out.y, enc1);
        run(1, &enc1[1].out.y, enc2);
        run(2, &enc2[1].out.y, enc3);
        run(3, &enc3[1].out.y, dec3);
        join([&dec3[1].out.y, &enc2[1].out.y], &mut doubled[0], &mut joined[0], &levels[2]);
        run(4, &joined[0].y, dec2);
        join([&dec2[1].out.y, &enc1[1].out.y], &mut doubled[1], &mut joined[1], &levels[1]);
        run(5, &joined[1].y, dec1);
        join([&dec1[1].out.y, input], &mut doubled[2], &mut joined[2], &levels[0]);
        self.forward_head(&joined[2].y, head, &levels[0]);
        head[2].y.store(output);
        output.iter_mut().for_each(|v| *v *= self.config.offset_unit);
        Ok(output)
    }

    fn forward_head(&self, x: &Map, head: &mut [Activation; 3], level: &Level) {
        let [first, second, last] = head;
        level.conv(&self.head[0], x, &mut first.y);
        resample::relu_map(&mut first.y, &level.valid);
        level.conv(&self.head[1], &first.y, &mut second.y);
        resample::relu_map(&mut second.y, &level.valid);
        level.conv(&self.head[2], &second.y, &mut last.y);
    }

    /// Adds the gradients of all parameters, from `d_out: [size, size, 3]` of the last forward pass with `tape`. Values of
    /// `d_out` at invalid texels are ignored.
    ///
    /// # Errors
    /// If `d_out` has another length or a value that is not finite; nothing is added then.
    pub fn backward(&mut self, tape: &mut GeoNetTape, d_out: &[f32]) -> Result<(), NetError> {
        let GeoNetTape { levels, input, stem, stages, doubled, joined, head, .. } = tape;
        let d_out: Vec<f32> = d_out.iter().map(|d| d * self.config.offset_unit).collect();
        load("gradient of GeoNet's output", &d_out, &mut head[2].d, &levels[0])?;
        self.backward_head(&mut joined[2], head, &levels[0]);
        let [enc1, enc2, enc3, dec3, dec2, dec1] = stages;
        // To the doubled map and through the doubling; `fine` is what it was joined with.
        let split =
            |joined: &Activation, doubled: &mut Activation, coarse: &mut Map, fine: Option<&mut Map>, at: usize| {
                resample::concat_backward(&joined.d, 0, &mut doubled.d, &levels[at].valid, Write::Set);
                if let Some(fine) = fine {
                    resample::concat_backward(&joined.d, doubled.d.channels(), fine, &levels[at].valid, Write::Set);
                }
                resample::upsample_backward(&doubled.d, coarse, &levels[at + 1].valid, Write::Set);
            };
        let mut run = |i: usize, x: &Map, tape: &mut StageTape, from: usize, dx: (&mut Map, Write)| {
            let ([a, b], [first, second]) = (tape, &mut self.stages[i]);
            let (from, to) = (&levels[from], &levels[LEVEL[i]]);
            second.backward(&a.out.y, b, [to, to], (&mut a.out.d, Write::Set));
            first.backward(x, a, [from, to], dx);
        };
        split(&joined[2], &mut doubled[2], &mut dec1[1].out.d, None, 0);
        let Activation { y, d } = &mut joined[1];
        run(5, y, dec1, 1, (d, Write::Set));
        split(&joined[1], &mut doubled[1], &mut dec2[1].out.d, Some(&mut enc1[1].out.d), 1);
        let Activation { y, d } = &mut joined[0];
        run(4, y, dec2, 2, (d, Write::Set));
        split(&joined[0], &mut doubled[0], &mut dec3[1].out.d, Some(&mut enc2[1].out.d), 2);
        let Activation { y, d } = &mut enc3[1].out;
        run(3, y, dec3, 3, (d, Write::Set));
        let Activation { y, d } = &mut enc2[1].out;
        run(2, y, enc3, 2, (d, Write::Add));
        let Activation { y, d } = &mut enc1[1].out;
        run(1, y, enc2, 1, (d, Write::Add));
        let Activation { y, d } = &mut stem.out;
        run(0, y, enc1, 1, (d, Write::Set));
        self.stem.backward(input, stem, [&levels[0], &levels[1]], None);
        Ok(())
    }

    fn backward_head(&mut self, joined: &mut Activation, head: &mut [Activation; 3], level: &Level) {
        let [first, second, last] = head;
        self.head[2].backward_params(&second.y, &last.d, &level.valid);
        level.conv_input(&self.head[2], &last.d, &mut second.d, Write::Set);
        resample::relu_map_backward(&second.y, &mut second.d, &level.valid);
        self.head[1].backward_params(&first.y, &second.d, &level.valid);
        level.conv_input(&self.head[1], &second.d, &mut first.d, Write::Set);
        resample::relu_map_backward(&first.y, &mut first.d, &level.valid);
        self.head[0].backward_params(&joined.y, &first.d, &level.valid);
        level.conv_input(&self.head[0], &first.d, &mut joined.d, Write::Set);
    }
}

impl GeoNetTape {
    /// Memory of its maps, bytes.
    pub fn bytes(&self) -> usize {
        let slots = self.doubled.iter().chain(&self.joined).chain(&self.head).map(Activation::bytes).sum::<usize>();
        let stages = self.stages.iter().flatten().map(ResidualTape::bytes).sum::<usize>();
        self.input.bytes() + self.stem.bytes() + slots + stages
    }
}

impl Params for GeoNet {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.stem.visit(f);
        self.stages.iter().flatten().for_each(|b| b.visit(f));
        self.head.iter().for_each(|c| c.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.stem.visit_mut(f);
        self.stages.iter_mut().flatten().for_each(|b| b.visit_mut(f));
        self.head.iter_mut().for_each(|c| c.visit_mut(f));
    }
}
