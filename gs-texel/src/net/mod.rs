//! Shared parts of GeoNet and GauNet: valid texels of every level, and blocks of convolution and normalisation with buffers.
//!
//! # Networks on a part of a map
//! A texture atlas is 50–70 % charts, the rest is background. As published ([`NormOver::All`]), a network runs on every texel,
//! and the statistics of its normalisations mix charts with background. With [`NormOver::Mask`], a texel of a coarser level is
//! valid if any of the texels it pools is; input and activations are zero at invalid texels (the edge of a chart is padded
//! like the edge of an image; Graham et al. 2018, "Submanifold sparse convolutional networks"), and statistics run over valid
//! texels. This is another function of the parameters, so a network is trained with one of the two. In return skipping is
//! exact: `sparse` computes valid texels only and gives the same bits as computing all and clearing the others.

pub(crate) mod block;
pub mod reference;

use gs_core::nn::gemm::Write;
use gs_core::nn::{Conv, Map, Sites};
use serde::{Deserialize, Serialize};

/// Inputs or configurations that a network refuses.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NetError {
    /// The width is not a multiple of the normalisation groups.
    #[error("a {net} of width {width} cannot be split into groups: use a multiple of {multiple}, at least {multiple}")]
    Width {
        /// Name of the network: GeoNet or GauNet.
        net: &'static str,
        /// The width asked for, channels.
        width: usize,
        /// What it must be a multiple of.
        multiple: usize,
    },
    /// There are no input channels or no levels.
    #[error("a {net} needs at least one {what}")]
    Empty {
        /// Name of the network: GeoNet or GauNet.
        net: &'static str,
        /// What is missing: `level` or `input channel`.
        what: &'static str,
    },
    /// A setting is above its largest value.
    #[error("{what} of a {net} is at most {most}, not {value}")]
    TooLarge {
        /// Name of the network: GeoNet or GauNet.
        net: &'static str,
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        value: u32,
        /// Its largest value.
        most: u32,
    },
    /// The side of the map cannot be halved often enough.
    #[error("a map of {size}x{size} cannot be halved {halvings} times: use a multiple of {}", 1usize << halvings)]
    Size {
        /// Side of the map, texels.
        size: usize,
        /// Number of times the network halves it.
        halvings: u32,
    },
    /// The mask that [`NormOver::Mask`] needs is missing, has another size, or has no valid texel.
    #[error(
        "normalisation over the mask needs a mask of {want} texels with at least one valid; got {got}, {valid} valid"
    )]
    Mask {
        /// Number of texels of the map.
        want: usize,
        /// Number of texels of the mask, 0 if it is missing.
        got: usize,
        /// Number of valid texels of the mask.
        valid: usize,
    },
    /// A slice does not have the length of the map.
    #[error("{what}: {want} values needed, {got} given")]
    Length {
        /// Which slice it is.
        what: &'static str,
        /// Number of values of the map.
        want: usize,
        /// Number of values of the slice.
        got: usize,
    },
    /// A value that is not finite.
    #[error("{what}: value of texel ({x}, {y}), channel {channel} is not finite")]
    NotFinite {
        /// Which slice it is.
        what: &'static str,
        /// Column of the texel, from 0.
        x: usize,
        /// Row of the texel, from 0.
        y: usize,
        /// Channel of the value, from 0.
        channel: usize,
    },
}

/// Texels that a network works on and takes normalisation statistics over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormOver {
    /// All texels of the map, as published.
    #[default]
    All,
    /// Valid texels only; see [`crate::net`].
    Mask,
}

/// The texels of one level of a network.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    /// Valid texels.
    pub(crate) valid: Sites,
    /// Texels at which convolutions are computed.
    compute: Sites,
    /// Whether invalid texels are computed and must be cleared.
    clear: bool,
}

impl Level {
    /// The `halvings + 1` levels of a `size × size` map, finest first, each half the size of the one before.
    pub(crate) fn pyramid(
        size: usize,
        halvings: u32,
        norm_over: NormOver,
        sparse: bool,
        mask: Option<&[bool]>,
    ) -> Result<Vec<Self>, NetError> {
        if size == 0 || !size.is_multiple_of(1 << halvings) {
            return Err(NetError::Size { size, halvings });
        }
        let finest = match norm_over {
            NormOver::All => Sites::full(size, size),
            NormOver::Mask => {
                let mask = mask.unwrap_or_default();
                let valid = mask.iter().filter(|v| **v).count();
                if mask.len() != size * size || valid == 0 {
                    return Err(NetError::Mask { want: size * size, got: mask.len(), valid });
                }
                Sites::from_fn(size, size, |y, x| mask[y * size + x])
            }
        };
        let mut levels: Vec<Self> = Vec::new();
        for _ in 0..=halvings {
            let valid = levels.last().map_or_else(|| finest.clone(), |l| l.valid.halved());
            let full = Sites::full(valid.height(), valid.width());
            let clear = !sparse && valid != full;
            levels.push(Self { compute: if sparse { valid.clone() } else { full }, valid, clear });
        }
        Ok(levels)
    }

    /// Texels per side.
    pub(crate) fn size(&self) -> usize {
        self.valid.height()
    }

    /// A map of zeros of this level, with a border of one texel.
    pub(crate) fn map(&self, channels: usize) -> Map {
        Map::zeros(self.size(), self.size(), channels, 1)
    }

    /// Texels at which maps of this level are computed.
    pub(crate) fn compute(&self) -> &Sites {
        &self.compute
    }

    /// Clears invalid texels that were computed.
    pub(crate) fn clear_invalid(&self, map: &mut Map) {
        if self.clear {
            map.clear_outside(&self.valid);
        }
    }

    /// `y`, a map of this level, from `x`.
    pub(crate) fn conv(&self, layer: &Conv, x: &Map, y: &mut Map) {
        layer.forward(x, y, &self.compute);
        self.clear_invalid(y);
    }

    /// The gradient of the input `x`, a map of this level.
    pub(crate) fn conv_input(&self, layer: &Conv, dy: &Map, dx: &mut Map, write: Write) {
        layer.backward_input(dy, dx, &self.compute, write);
        self.clear_invalid(dx);
    }
}

/// Copies a caller's map into `to` after checking length and finiteness; invalid texels become zero.
pub(crate) fn load(what: &'static str, values: &[f32], to: &mut Map, level: &Level) -> Result<(), NetError> {
    let (want, channels) = (to.height() * to.width() * to.channels(), to.channels());
    if values.len() != want {
        return Err(NetError::Length { what, want, got: values.len() });
    }
    if let Some(at) = values.iter().position(|v| !v.is_finite()) {
        let texel = at / channels;
        return Err(NetError::NotFinite { what, x: texel % to.width(), y: texel / to.width(), channel: at % channels });
    }
    to.load(values);
    if level.valid.len() < to.height() * to.width() {
        to.clear_outside(&level.valid);
    }
    Ok(())
}
