//! Settings of a [`Grid4dField`](super::Grid4dField).

use crate::DeformError;
use crate::encode::HashGridConfig;
use gs_core::nn::{Dense, Mlp};
use serde::{Deserialize, Serialize};

/// Size and parts of the field. The default is FAGS on the grids published for D-NeRF; without [`FourierConfig::on`]
/// and [`GateConfig::on`] it is Grid4D.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid4dConfig {
    /// Half the side of the cube `[−b, b]³` that is encoded, world units, above 0. Splats outside do not move.
    pub bound: f32,
    /// Size of the grid over x, y, z.
    pub canonical: HashGridConfig,
    /// Size of each of the three grids over two coordinates and time (time last).
    pub temporal: HashGridConfig,
    /// Width of the decoder's layers, 1 to 4096.
    pub width: usize,
    /// Hidden layers between fusion and head, at most 64.
    pub depth: usize,
    /// Attention in −1 … 1 (`2σ − 1`) instead of 0 … 1 (`σ`).
    pub directional: bool,
    /// Start the head at zero, so that nothing moves, instead of at ±1/√width as the public code does.
    pub zero_init: bool,
    /// Move splats outside the cube by the decoder's output for zero features, as the public code does.
    pub compat_grid4d: bool,
    /// Settings of the Fourier branch.
    pub fourier: FourierConfig,
    /// Settings of the gate on the motion.
    pub gate: GateConfig,
    /// Settings of the smoothness regulariser.
    pub smooth: SmoothConfig,
    /// Savings that change results by rounding only.
    pub exact: ExactConfig,
}

/// The Fourier branch (FAGS, Eqs. 5 to 7).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FourierConfig {
    /// Whether the field has a Fourier branch.
    pub on: bool,
    /// Frequencies `m`; `2m` must equal the width unless the fusion is `concat`.
    pub bands: usize,
    /// Highest frequency `γ`, half cycles per unit of time (FAGS: 8), at least 1.
    #[serde(default = "published_gamma")]
    pub gamma_max: f64,
    /// Factor on the waves, above 0 (FAGS: 1). Adam moves every amplitude by one rate, so a step moves the branch by about
    /// `m` times what it moves an amplitude, at all times at once; a factor lessens that without lessening what can be fitted.
    #[serde(default = "published_gain")]
    pub gain: f64,
    /// Time argument of the waves.
    pub time: WaveTime,
    /// How the branch is combined with the features of the grids.
    pub fusion: Fusion,
    /// Widths of the hidden layers between the spatial features and the amplitudes; empty: one linear layer.
    pub hidden: Vec<usize>,
}

fn published_gamma() -> f64 {
    8.0
}

fn published_gain() -> f64 {
    1.0
}

/// Time argument of the waves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WaveTime {
    /// `t`, 0 to 1 over the training span: half a cycle to four cycles.
    Raw,
    /// `0.9 b (2t − 1)`, the coordinate of the grids: `1.8 b` times as many cycles.
    Scaled,
}

/// How the features `a ⊙ f_t` of the grids and `f_fre` of the waves are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fusion {
    /// `a ⊙ f_t + f_fre`.
    Add,
    /// A linear layer on the concatenation of both.
    Concat,
    /// `a ⊙ f_t ⊙ (1 + f_fre)`.
    Mul,
}

/// The gate (FAGS, Eq. 8).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GateConfig {
    /// Whether the head has a gate; without it `η = 1`.
    pub on: bool,
    /// How the gate scales the rigid motion.
    pub mode: GateMode,
    /// `η` of every splat before training, inside `(0, 1)`. The first steps' gradients are scaled by it.
    pub start: f32,
}

/// How the gate `η` scales the rigid motion with quaternion parameters `ρ` and translation `τ`. `R(v)` is the rotation
/// of `normalise((1,0,0,0) + v)`. Rotation and scale offsets are multiplied by `η` in all modes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GateMode {
    /// `R(ηρ) μ + ητ`: rigid for every `η`, the identity at 0.
    ScaleParam,
    /// `(1 − η) μ + η (R(ρ) μ + τ)`.
    LerpPosition,
    /// `R(ρ) μ + ητ`.
    TranslationOnly,
    /// `η R(ρ) μ + ητ`, as printed in FAGS, Eq. 8: a gate of 0 moves the splat to the origin.
    Literal,
}

/// The smoothness regulariser of Grid4D: features of nearby points should agree.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SmoothConfig {
    /// Weight for the canonical grid; 0: no look-ups.
    pub lambda_s: f32,
    /// Weight for the temporal grids; 0: no look-ups.
    pub lambda_t: f32,
    /// Largest shift along x, y, z, world units.
    pub eps: [f32; 3],
    /// Largest shift of the scaled time `0.9 b (2t − 1)`.
    pub eps_t: f32,
    /// Share of splats sampled per step, above 0, at most 1; sampled separately for space and time.
    pub share: f32,
    /// Leave out pairs with a point outside the cube; otherwise they pull features at the faces to zero.
    pub drop_leaving: bool,
}

/// Optimisations that change results by rounding only; each can be turned off for comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExactConfig {
    /// Blend the temporal grids along time once per call: 4 corners per splat and level instead of 8.
    pub time_slicing: bool,
    /// Run a linear Fourier branch as one small matrix from the canonical features to the head.
    pub fourier_collapse: bool,
    /// Cache the time-independent part when the same splats are evaluated at many times
    /// ([`Field::forward_again`](crate::Field::forward_again)).
    pub cached_attention: bool,
}

impl Default for Grid4dConfig {
    fn default() -> Self {
        Self {
            bound: 1.6,
            canonical: HashGridConfig { base: [16.0; 3], end: [2048.0; 3], levels: 16, log2_table: 19 },
            temporal: HashGridConfig { base: [8.0; 3], end: [32.0, 32.0, 16.0], levels: 32, log2_table: 19 },
            width: 256,
            depth: 0,
            directional: true,
            zero_init: true,
            compat_grid4d: false,
            fourier: FourierConfig {
                on: true,
                bands: 128,
                gamma_max: published_gamma(),
                gain: published_gain(),
                time: WaveTime::Raw,
                fusion: Fusion::Add,
                hidden: Vec::new(),
            },
            gate: GateConfig { on: true, mode: GateMode::ScaleParam, start: 0.5 },
            smooth: SmoothConfig {
                lambda_s: 0.5,
                lambda_t: 0.5,
                eps: [1e-2; 3],
                eps_t: 1e-3,
                share: 0.1,
                drop_leaving: true,
            },
            exact: ExactConfig { time_slicing: true, fourier_collapse: true, cached_attention: true },
        }
    }
}

impl Grid4dConfig {
    /// The default without Fourier branch and gate: Grid4D.
    pub fn grid4d() -> Self {
        let plain = Self::default();
        Self {
            fourier: FourierConfig { on: false, ..plain.fourier },
            gate: GateConfig { on: false, ..plain.gate },
            ..plain
        }
    }

    /// Outputs of the head per splat: gate (if any), ρ 4, τ 3, Δr 4, Δs 3.
    pub fn head_width(&self) -> usize {
        14 + usize::from(self.gate.on)
    }

    /// Features per point of the canonical grid and of the three temporal grids together.
    pub(super) fn features(&self) -> [usize; 2] {
        [self.canonical.width(), self.temporal.width().saturating_mul(3)]
    }

    /// Number of parameters of the field; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        let ([space, time], width) = (self.features(), self.width);
        let grids = self.temporal.param_count().saturating_mul(3).saturating_add(self.canonical.param_count());
        let layers = [space, time].map(|inputs| Dense::count(inputs, width)).into_iter();
        let hidden = Dense::count(width, width).saturating_mul(self.depth as u64);
        let branch = if self.fourier.on { self.fourier.param_count(width) } else { 0 };
        let rest = [grids, branch, hidden, Dense::count(width, self.head_width())];
        layers.chain(rest).fold(0, u64::saturating_add)
    }

    /// Whether the Fourier branch is evaluated as one small matrix.
    pub(super) fn collapses(&self) -> bool {
        let linear = self.depth == 0 && self.fourier.fusion == Fusion::Add && self.fourier.hidden.is_empty();
        self.fourier.on && linear && self.exact.fourier_collapse
    }

    pub(super) fn check(&self) -> Result<(), DeformError> {
        let reject = |field, value: String, rule| Err(DeformError::Config { field, value, rule });
        if !(self.bound.is_finite() && self.bound > 0.0) {
            return reject("bound", self.bound.to_string(), "finite and above 0");
        }
        if !(1..=4096).contains(&self.width) {
            return reject("width", self.width.to_string(), "1 to 4096");
        }
        if self.depth > 64 {
            return reject("depth", self.depth.to_string(), "at most 64");
        }
        if !(self.gate.start > 0.0 && self.gate.start < 1.0) {
            return reject("start", self.gate.start.to_string(), "above 0 and below 1");
        }
        self.fourier.check(self.width)?;
        self.smooth.check()
    }
}

impl FourierConfig {
    /// Widths of the network of the amplitudes, in a field of the given width.
    pub(super) fn amplitudes(&self, width: usize) -> Vec<usize> {
        [&[width], &self.hidden[..], &[self.bands]].concat()
    }

    /// Inputs of the layer that joins waves and features, if there is one.
    pub(super) fn joined(&self, width: usize) -> Option<usize> {
        (self.fusion == Fusion::Concat).then_some(self.bands.saturating_mul(2).saturating_add(width))
    }

    fn param_count(&self, width: usize) -> u64 {
        let joining = self.joined(width).map_or(0, |inputs| Dense::count(inputs, width));
        Mlp::count(&self.amplitudes(width)).saturating_add(joining)
    }

    fn check(&self, width: usize) -> Result<(), DeformError> {
        let reject = |field, value: String, rule| Err(DeformError::Config { field, value, rule });
        if !self.on {
            return Ok(());
        }
        if !(1..=4096).contains(&self.bands) {
            return reject("bands", self.bands.to_string(), "1 to 4096");
        }
        if !(1.0..=1024.0).contains(&self.gamma_max) {
            return reject("gamma_max", self.gamma_max.to_string(), "1 to 1024");
        }
        if !(self.gain > 0.0 && self.gain <= 1e3) {
            return reject("gain", self.gain.to_string(), "above 0, at most 1000");
        }
        if self.fusion != Fusion::Concat && 2 * self.bands != width {
            return reject("bands", self.bands.to_string(), "half the width, unless the fusion is `concat`");
        }
        if self.hidden.len() > 64 || self.hidden.iter().any(|h| !(1..=4096).contains(h)) {
            return reject("hidden", format!("{:?}", self.hidden), "at most 64 widths of 1 to 4096");
        }
        Ok(())
    }
}

impl SmoothConfig {
    fn check(&self) -> Result<(), DeformError> {
        let reject = |field, value: String, rule| Err(DeformError::Config { field, value, rule });
        let [x, y, z] = self.eps;
        for (field, v) in [
            ("lambda_s", self.lambda_s),
            ("lambda_t", self.lambda_t),
            ("eps", x),
            ("eps", y),
            ("eps", z),
            ("eps_t", self.eps_t),
        ] {
            if !(v.is_finite() && v >= 0.0) {
                return reject(field, v.to_string(), "finite and at least 0");
            }
        }
        if !(self.share > 0.0 && self.share <= 1.0) {
            return reject("share", self.share.to_string(), "above 0 and at most 1");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_published_setting_for_synthetic_scenes() {
        let c = Grid4dConfig::default();
        assert_eq!(c.check(), Ok(()));
        assert_eq!((c.head_width(), c.collapses()), (15, true));
        let plain = Grid4dConfig::grid4d();
        assert_eq!((plain.head_width(), plain.collapses()), (14, false));
    }

    #[test]
    fn what_cannot_be_built_is_refused_by_name() {
        let error = |change: &dyn Fn(&mut Grid4dConfig)| {
            let mut c = Grid4dConfig::default();
            change(&mut c);
            c.check().unwrap_err().to_string()
        };
        assert!(error(&|c| c.bound = 0.0).contains("`bound` = 0"));
        assert!(error(&|c| c.width = 0).contains("`width` = 0"));
        assert!(error(&|c| c.depth = 65).contains("`depth` = 65"));
        assert!(error(&|c| c.fourier.bands = 100).contains("`bands` = 100"));
        assert!(error(&|c| c.fourier.hidden = vec![0]).contains("`hidden` = [0]"));
        assert!(error(&|c| c.smooth.eps[1] = -1.0).contains("`eps` = -1"));
        assert!(error(&|c| c.smooth.share = 0.0).contains("`share` = 0"));
        assert!(error(&|c| c.smooth.lambda_t = f32::NAN).contains("`lambda_t` = NaN"));
        let mut c = Grid4dConfig::grid4d();
        c.fourier.bands = 0;
        assert_eq!(c.check(), Ok(()), "a branch that is off is not checked");
    }
}
