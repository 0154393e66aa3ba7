//! Images: row-major, origin top left, channels interleaved, display-encoded values in `[0, 1]` as `f32`.
//!
//! ```
//! use gs_core::Image;
//!
//! let image = Image::from_data(2, 1, 3, vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0])?; // red, blue
//! assert_eq!(image.pixel(1, 0), [0.0, 0.0, 1.0]);
//! assert!(Image::from_data(2, 2, 3, vec![0.0; 6]).is_err());
//! # Ok::<(), gs_core::image::ImageError>(())
//! ```

/// A `height × width × channels` image of `f32`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Image {
    /// Number of pixels per row.
    pub width: usize,
    /// Number of rows of pixels.
    pub height: usize,
    /// Values per pixel (1 grey, 3 RGB, 4 RGB + alpha).
    pub channels: usize,
    /// `height * width * channels` values.
    pub data: Vec<f32>,
}

/// A shape that does not fit the data.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// `data.len()` is not `width * height * channels`.
    #[error("an image of {width}x{height}x{channels} needs {want} values, {got} were given")]
    Length {
        /// Number of pixels per row.
        width: usize,
        /// Number of rows of pixels.
        height: usize,
        /// Number of values per pixel.
        channels: usize,
        /// Number of values the shape needs.
        want: usize,
        /// Number of values in the given data.
        got: usize,
    },
}

impl Image {
    /// An image whose values are all 0.
    pub fn zeros(width: usize, height: usize, channels: usize) -> Self {
        Self { width, height, channels, data: vec![0.0; width * height * channels] }
    }

    /// An image from its `height · width · channels` values, row-major.
    ///
    /// # Errors
    /// If the length does not fit the shape.
    pub fn from_data(width: usize, height: usize, channels: usize, data: Vec<f32>) -> Result<Self, ImageError> {
        let want = width * height * channels;
        if data.len() != want {
            return Err(ImageError::Length { width, height, channels, want, got: data.len() });
        }
        Ok(Self { width, height, channels, data })
    }

    /// The shape as `(width, height, channels)`.
    pub fn shape(&self) -> (usize, usize, usize) {
        (self.width, self.height, self.channels)
    }

    /// The `channels` values of pixel `(x, y)`: column `x`, row `y`.
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let at = (y * self.width + x) * self.channels;
        &self.data[at..at + self.channels]
    }

    /// As [`Image::pixel`], for writing the values.
    pub fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [f32] {
        let at = (y * self.width + x) * self.channels;
        &mut self.data[at..at + self.channels]
    }

    /// Flat index of the first value that is not finite, if any.
    pub fn first_non_finite(&self) -> Option<usize> {
        self.data.iter().position(|v| !v.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shape_is_checked() {
        assert!(Image::from_data(2, 2, 3, vec![0.0; 12]).is_ok());
        let e = Image::from_data(2, 2, 3, vec![0.0; 11]).unwrap_err();
        assert_eq!(e.to_string(), "an image of 2x2x3 needs 12 values, 11 were given");
    }

    #[test]
    fn pixels_are_row_major() {
        let mut im = Image::zeros(3, 2, 2);
        im.pixel_mut(2, 1)[1] = 7.0;
        assert_eq!(im.data[11], 7.0);
        assert_eq!(im.pixel(2, 1), &[0.0, 7.0]);
        im.data[4] = f32::NAN;
        assert_eq!(im.first_non_finite(), Some(4));
    }
}
