//! What the two networks share: where they are run, and blocks of convolution and normalisation with their memory.
//!
//! # Networks on a part of a map
//! A texture atlas is 50–70 % charts, the rest is empty. Run as published ([`NormOver::All`]) a network works on every
//! texel, and the statistics of its normalisations mix charts with emptiness. With [`NormOver::Mask`] the charts are all
//! there is: at every level the valid texels are those with a valid one among the texels they stand for, activations and
//! input are zero elsewhere (a chart's edge is padded like the edge of an image; Graham et al. 2018, "Submanifold sparse
//! convolutional networks"), and statistics run over valid texels. It is another network than the first, trained as
//! such; in return leaving out what is not valid is exact: `sparse` computes valid texels only and gives the same bits
//! as computing all and clearing the others.

pub(crate) mod block;
pub mod reference;

use gs_core::nn::gemm::Write;
use gs_core::nn::{Conv, Map, Sites};
use serde::{Deserialize, Serialize};

/// What a network cannot work with.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NetError {
    /// A width the normalisation groups do not divide.
    #[error("a {net} of width {width} cannot be split into groups: use a multiple of {multiple}, at least {multiple}")]
    Width {
        /// Which network.
        net: &'static str,
        /// The width asked for.
        width: usize,
        /// What it must be a multiple of.
        multiple: usize,
    },
    /// No channels in, or no levels.
    #[error("a {net} needs at least one {what}")]
    Empty {
        /// Which network.
        net: &'static str,
        /// What is missing.
        what: &'static str,
    },
    /// A map whose side cannot be halved often enough.
    #[error("a map of {size}x{size} cannot be halved {halvings} times: use a multiple of {}", 1usize << halvings)]
    Size {
        /// Texels per side.
        size: usize,
        /// How often the network halves it.
        halvings: u32,
    },
    /// A mask is needed and missing, of another size, or empty.
    #[error(
        "normalisation over the mask needs a mask of {want} texels with at least one valid; got {got}, {valid} valid"
    )]
    Mask {
        /// Texels of the map.
        want: usize,
        /// Texels of the mask, 0 if there is none.
        got: usize,
        /// Valid ones.
        valid: usize,
    },
    /// A slice of another length than the map.
    #[error("{what}: {want} values needed, {got} given")]
    Length {
        /// Which slice.
        what: &'static str,
        /// Values the map has.
        want: usize,
        /// Values given.
        got: usize,
    },
    /// A value that is not finite.
    #[error("{what}: value of texel ({x}, {y}), channel {channel} is not finite")]
    NotFinite {
        /// Which slice.
        what: &'static str,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// Channel.
        channel: usize,
    },
}

/// Which texels the statistics of a normalisation run over, and with them where the network exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormOver {
    /// All of them, as published.
    #[default]
    All,
    /// Valid ones; see [`crate::net`].
    Mask,
}

/// Texels of one level of a network.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    /// Where the network exists.
    pub valid: Sites,
    /// Where convolutions are computed.
    compute: Sites,
    /// Whether more is computed than exists.
    clear: bool,
}

impl Level {
    /// The levels of a map of `size × size`, each of half the size of the one before, `halvings + 1` of them.
    pub fn pyramid(
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
                Sites::where_(size, size, |y, x| mask[y * size + x])
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
    pub fn size(&self) -> usize {
        self.valid.height()
    }

    /// A map of zeros of this level, with a border of one.
    pub fn map(&self, channels: usize) -> Map {
        Map::zeros(self.size(), self.size(), channels, 1)
    }

    /// Where to compute a map of this level.
    pub fn compute(&self) -> &Sites {
        &self.compute
    }

    /// Clears what was computed beyond the valid texels.
    pub fn tidy(&self, map: &mut Map) {
        if self.clear {
            map.clear_outside(&self.valid);
        }
    }

    /// `y`, a map of this level, from `x`.
    pub fn conv(&self, layer: &Conv, x: &Map, y: &mut Map) {
        layer.forward(x, y, &self.compute);
        self.tidy(y);
    }

    /// The gradient of the input `x`, a map of this level.
    pub fn conv_input(&self, layer: &Conv, dy: &Map, dx: &mut Map, write: Write) {
        layer.backward_input(dy, dx, &self.compute, write);
        self.tidy(dx);
    }
}

/// Reads a caller's map into `to`: right length, finite, zero outside the valid texels.
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
