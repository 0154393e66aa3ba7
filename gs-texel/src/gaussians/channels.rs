//! Layout of the channels of a texel: `[0:3] ŝ, [3:7] r, [7] α̂, [8:11] d, [11:14] SH dc, [14:] SH rest` (coefficient-major, rgb-minor).

use gs_core::{Image, sh};
use std::ops::Range;

/// Channels of the log standard deviations `ŝ`, before κ.
pub const SCALE: Range<usize> = 0..3;
/// Channels of the quaternion `r`, `(w, x, y, z)` in the bind pose, of any length.
pub const QUAT: Range<usize> = 3..7;
/// Channel of the opacity logit `α̂`.
pub const OPACITY: usize = 7;
/// Channels of the offset `d` in the bind pose, metres.
pub const OFFSET: Range<usize> = 8..11;
/// First channel of the spherical harmonics.
pub const COLOR: usize = 11;

/// Channel count for spherical harmonics up to `degree`: `11 + 3 (degree + 1)²`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channels {
    degree: u8,
}

/// Faults of maps or rows.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChannelsError {
    /// The degree of spherical harmonics is above 3.
    #[error("SH degree {0} is not supported (0 to 3)")]
    Degree(u8),
    /// A map has another shape.
    #[error("a map of {got:?} (width, height, channels) was given where {want:?} is needed")]
    Shape {
        /// Its width, height and channels.
        got: (usize, usize, usize),
        /// Width, height and channels needed.
        want: (usize, usize, usize),
    },
    /// A column has another length.
    #[error("`{column}` holds {got} values, {want} are needed for {texels} texels")]
    Length {
        /// Name of the column.
        column: &'static str,
        /// Number of values it has.
        got: usize,
        /// Number of values that the texels need.
        want: usize,
        /// Number of valid texels of the map.
        texels: usize,
    },
    /// A valid texel lies outside the map.
    #[error("texel {texel} lies beyond a map of {size} x {size}")]
    Beyond {
        /// Its index, `y · size + x`.
        texel: u32,
        /// Side of the map, texels.
        size: usize,
    },
}

impl Channels {
    /// Channels with spherical harmonics up to `degree`, 0 to 3.
    ///
    /// # Errors
    /// If it is above 3.
    pub fn new(degree: u8) -> Result<Self, ChannelsError> {
        if degree > sh::MAX_DEGREE { Err(ChannelsError::Degree(degree)) } else { Ok(Self { degree }) }
    }

    /// Degree of the spherical harmonics.
    pub fn degree(self) -> u8 {
        self.degree
    }

    /// Number of channels, the values per texel.
    pub fn width(self) -> usize {
        COLOR + 3 * sh::coeffs(self.degree)
    }

    /// Rows `[K, width]` of the valid texels of an `S × S × width` map.
    ///
    /// # Errors
    /// If the map has another shape or a texel lies outside it.
    pub fn gather(self, map: &Image, valid: &[u32]) -> Result<Vec<f32>, ChannelsError> {
        let want = (map.width, map.width, self.width());
        if map.shape() != want {
            return Err(ChannelsError::Shape { got: map.shape(), want });
        }
        self.check(&[], valid, map.width, false)?;
        let pixel = |t: &u32| &map.data[*t as usize * want.2..][..want.2];
        Ok(valid.iter().flat_map(pixel).copied().collect())
    }

    /// An `S × S × width` map of rows `[K, width]`, zero at other texels; also the backward of [`Channels::gather`].
    ///
    /// # Errors
    /// If the rows have another length or a texel lies outside the map.
    pub fn scatter(self, rows: &[f32], valid: &[u32], size: usize) -> Result<Image, ChannelsError> {
        self.check(rows, valid, size, true)?;
        let width = self.width();
        let mut map = Image::zeros(size, size, width);
        for (row, &t) in rows.chunks_exact(width).zip(valid) {
            map.data[t as usize * width..][..width].copy_from_slice(row);
        }
        Ok(map)
    }

    fn check(self, rows: &[f32], valid: &[u32], size: usize, with_rows: bool) -> Result<(), ChannelsError> {
        if with_rows {
            self.length("rows", rows.len(), self.width(), valid.len())?;
        }
        let beyond = valid.iter().find(|t| **t as usize >= size * size);
        beyond.map_or(Ok(()), |&texel| Err(ChannelsError::Beyond { texel, size }))
    }

    /// Checks that a column holds `each` values for every texel.
    pub(super) fn length(
        self,
        column: &'static str,
        got: usize,
        each: usize,
        texels: usize,
    ) -> Result<(), ChannelsError> {
        let want = each * texels;
        if got == want { Ok(()) } else { Err(ChannelsError::Length { column, got, want, texels }) }
    }
}
