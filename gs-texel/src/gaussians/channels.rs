//! Which channel says what: `[0:3] ŝ, [3:7] r, [7] α̂, [8:11] d, [11:14] SH dc, [14:] SH rest` (coefficient-major, rgb-minor).

use gs_core::{Image, sh};
use std::ops::Range;

/// Log standard deviations, before κ.
pub const SCALE: Range<usize> = 0..3;
/// Quaternion `(w, x, y, z)` in the bind pose, any length.
pub const QUAT: Range<usize> = 3..7;
/// Logit of the opacity.
pub const OPACITY: usize = 7;
/// Offset in the bind pose, metres.
pub const OFFSET: Range<usize> = 8..11;
/// Spherical harmonics begin here.
pub const COLOR: usize = 11;

/// The channels of a texel with spherical harmonics up to `degree`: `11 + 3 (degree + 1)²`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channels {
    degree: u8,
}

/// Maps or rows that do not have the channels.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChannelsError {
    /// Spherical harmonics end at degree 3.
    #[error("SH degree {0} is not supported (0 to 3)")]
    Degree(u8),
    /// A map of another shape.
    #[error("a map of {got:?} (width, height, channels) was given where {want:?} is needed")]
    Shape {
        /// Its shape.
        got: (usize, usize, usize),
        /// The shape of the table with these channels.
        want: (usize, usize, usize),
    },
    /// A column of another length.
    #[error("`{column}` holds {got} values, {want} are needed for {texels} texels")]
    Length {
        /// Which column.
        column: &'static str,
        /// Values there.
        got: usize,
        /// Values needed.
        want: usize,
        /// Valid texels.
        texels: usize,
    },
    /// A valid texel beyond the map.
    #[error("texel {texel} lies beyond a map of {size} x {size}")]
    Beyond {
        /// Its number, `y · size + x`.
        texel: u32,
        /// Side of the map.
        size: usize,
    },
}

impl Channels {
    /// Channels with spherical harmonics up to `degree`.
    ///
    /// # Errors
    /// If it is above 3.
    pub fn new(degree: u8) -> Result<Self, ChannelsError> {
        if degree > sh::MAX_DEGREE { Err(ChannelsError::Degree(degree)) } else { Ok(Self { degree }) }
    }

    /// The highest degree there is room for.
    pub fn degree(self) -> u8 {
        self.degree
    }

    /// Values per texel.
    pub fn width(self) -> usize {
        COLOR + 3 * sh::coeffs(self.degree)
    }

    /// Rows `[K, width]` of the valid texels of an `S × S × width` map.
    ///
    /// # Errors
    /// If the map has another shape or a texel lies beyond it.
    pub fn gather(self, map: &Image, valid: &[u32]) -> Result<Vec<f32>, ChannelsError> {
        let want = (map.width, map.width, self.width());
        if map.shape() != want {
            return Err(ChannelsError::Shape { got: map.shape(), want });
        }
        self.check(&[], valid, map.width, false)?;
        let pixel = |t: &u32| &map.data[*t as usize * want.2..][..want.2];
        Ok(valid.iter().flat_map(pixel).copied().collect())
    }

    /// An `S × S × width` map of rows `[K, width]`, zeros at other texels: also the way back of [`Channels::gather`].
    ///
    /// # Errors
    /// If the rows have another length or a texel lies beyond the map.
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

    /// Refuses a column that does not hold `each` values for every texel.
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
