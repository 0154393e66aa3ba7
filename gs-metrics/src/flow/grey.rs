//! Grey values of 8 bits, as OpenCV computes them.

use gs_core::Image;

use crate::Quantise;
use crate::error::{MetricError, check_finite, check_image};

/// Weights of red, green and blue in units of `2⁻¹⁵` (BT.601), as OpenCV 4.10 rounds them.
const WEIGHTS: [u32; 3] = [9798, 19235, 3735];
/// Number of fractional bits of the weights.
const SHIFT: u32 = 15;

/// The 8-bit grey values of an image in `[0, 1]`, `[H, W]`: channels are clamped, rounded to 8 bits and combined as
/// `(9798 R + 19235 G + 3735 B + 2¹⁴) >> 15`. A grey image is only rounded.
///
/// # Errors
/// If the image is malformed, has 2 or 4 channels, or a value is not finite.
pub fn grey(image: &Image) -> Result<Vec<u8>, MetricError> {
    check_image("frame", image)?;
    check_finite("frame", image)?;
    match image.channels {
        1 => Ok(image.data.iter().map(|v| Quantise::Round.step(*v)).collect()),
        3 => Ok(image.data.as_chunks().0.iter().map(|p| luma(p.map(|v| Quantise::Round.step(v)))).collect()),
        got => Err(MetricError::Channels { metric: "optical flow", got, need: "1 or 3" }),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the weights add up to `1 << SHIFT`")]
fn luma(rgb: [u8; 3]) -> u8 {
    let sum: u32 = rgb.iter().zip(WEIGHTS).map(|(v, w)| u32::from(*v) * w).sum();
    ((sum + (1 << (SHIFT - 1))) >> SHIFT) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn greys_stay_grey() {
        for v in 0..=255u8 {
            assert_eq!(luma([v; 3]), v);
        }
        let half = Image { width: 3, height: 1, channels: 1, data: vec![-1.0, 0.5, 2.0] };
        assert_eq!(grey(&half).unwrap(), [0, 128, 255]);
    }

    #[test]
    fn bad_images_are_errors() {
        let rgba = Image::zeros(2, 2, 4);
        assert!(matches!(grey(&rgba), Err(MetricError::Channels { got: 4, .. })));
        let mut nan = Image::zeros(2, 2, 3);
        nan.data[7] = f32::NAN;
        assert!(matches!(grey(&nan), Err(MetricError::NotFinite { x: 0, y: 1, channel: 1, .. })));
    }
}
