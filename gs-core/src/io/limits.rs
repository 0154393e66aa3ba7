//! Limits of readers: on by default, so that a wrong or hostile header cannot make them allocate memory.

use super::error::{IoError, Source};

/// Memory that a decoder of a compressed format may use whatever the size of its file, bytes.
const DECODE_BASE: u64 = 48 << 20;

/// Bounds that a reader verifies before it allocates. Every error names the field to raise.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Largest number of rows (splats, cameras, array entries). Default: 2³⁰.
    pub max_rows: u64,
    /// Largest file that is read, bytes. Default: 16 GiB.
    pub max_bytes: u64,
    /// Largest side of an image, pixels. Default: 32768.
    pub max_side: u32,
    /// Largest memory of a decoded image with its intermediate copies, bytes. Default: 1 GiB.
    pub max_image_bytes: u64,
    /// Largest decoded size of a compressed file per byte of the file, above a base of 48 MiB. Default: 64.
    pub max_expansion: u64,
    /// Largest memory that the splats of a file take, bytes: those of the file and the activated ones. Default: no limit.
    pub max_memory: u64,
    /// Keep NaN and infinite values of splat files, arrays and EXR images instead of refusing them. Default: off.
    pub allow_non_finite: bool,
}

impl Default for Limits {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Limits {
    /// The default, for constants.
    pub const DEFAULT: Self = Self {
        max_rows: 1 << 30,
        max_bytes: 16 << 30,
        max_side: crate::camera::MAX_SIDE,
        max_image_bytes: 1 << 30,
        max_expansion: 64,
        max_memory: u64::MAX,
        allow_non_finite: false,
    };

    /// The number of rows as a `usize`, if it is allowed.
    pub(super) fn rows(&self, src: Source<'_>, rows: u64) -> Result<usize, IoError> {
        match usize::try_from(rows) {
            Ok(n) if rows <= self.max_rows => Ok(n),
            _ => Err(src.limit("rows", rows, self.max_rows, "max_rows")),
        }
    }

    /// The number of splats as a `usize`, if it and the memory for rows of `row_bytes` are allowed.
    pub(super) fn splats(&self, src: Source<'_>, rows: u64, row_bytes: usize) -> Result<usize, IoError> {
        let need = rows.saturating_mul(row_bytes as u64).saturating_mul(2);
        if need > self.max_memory {
            return Err(src.limit("memory of the splats", need, self.max_memory, "max_memory"));
        }
        self.rows(src, rows)
    }

    /// Verifies that `need` bytes of decoded data are plausible for a compressed file of `file_len` bytes.
    pub(super) fn expansion(&self, src: Source<'_>, need: u64, file_len: usize) -> Result<(), IoError> {
        let limit = DECODE_BASE.saturating_add((file_len as u64).saturating_mul(self.max_expansion));
        if need <= limit { Ok(()) } else { Err(src.limit("decoded bytes", need, limit, "max_expansion")) }
    }

    /// Verifies an image's sides and the memory its decoding takes (`bytes_per_pixel` over all copies).
    #[cfg(any(feature = "images", feature = "exr"))]
    pub(super) fn image(
        &self,
        src: Source<'_>,
        sides: (u64, u64),
        bytes_per_pixel: u64,
        file_len: usize,
    ) -> Result<(), IoError> {
        let side = sides.0.max(sides.1);
        if side > u64::from(self.max_side) {
            return Err(src.limit("image side", side, self.max_side.into(), "max_side"));
        }
        let need = sides.0.saturating_mul(sides.1).saturating_mul(bytes_per_pixel);
        if need > self.max_image_bytes {
            return Err(src.limit("image memory", need, self.max_image_bytes, "max_image_bytes"));
        }
        self.expansion(src, need, file_len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_refuse_by_name() {
        let src = Source { file: "x", format: "T" };
        let tight = Limits { max_rows: 10, max_expansion: 2, ..Limits::default() };
        assert_eq!(tight.rows(src, 10).unwrap(), 10);
        assert!(tight.rows(src, 11).unwrap_err().to_string().contains("`max_rows`"));
        assert!(tight.rows(src, u64::MAX).is_err());
        let little = Limits { max_memory: 1000, ..Limits::default() };
        assert_eq!(little.splats(src, 10, 50).unwrap(), 10);
        assert!(little.splats(src, 10, 51).unwrap_err().to_string().contains("`max_memory`"));
        assert!(little.splats(src, u64::MAX, usize::MAX).is_err());
        assert!(tight.expansion(src, DECODE_BASE + 20, 10).is_ok());
        assert!(tight.expansion(src, DECODE_BASE + 21, 10).unwrap_err().to_string().contains("`max_expansion`"));
        assert!(tight.expansion(src, u64::MAX, usize::MAX).is_ok(), "saturates, never overflows");
    }
}
