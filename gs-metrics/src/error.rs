//! The error of all metrics: what is wrong with the input, where, and what to do.

use gs_core::Image;

/// Largest number of channels (grey, grey + alpha, RGB, RGB + alpha).
pub(crate) const MAX_CHANNELS: usize = 4;

/// Why a metric has no value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// Two images (or an image and its mask or gradient) differ in shape.
    #[error(
        "{what}: shapes (width, height, channels) {first:?} and {second:?} differ; resize or crop before comparing"
    )]
    Shape {
        /// The two inputs compared, for example `images a and b`.
        what: &'static str,
        /// `(width, height, channels)` of the first.
        first: (usize, usize, usize),
        /// `(width, height, channels)` of the second.
        second: (usize, usize, usize),
    },
    /// The number of values is not `width · height · channels`, or the number of channels is not 1 to 4.
    #[error("image {which} says {shape:?} (width, height, channels 1 to 4) but holds {len} values")]
    Malformed {
        /// Name of the argument: `a`, `b`, `mask`, …
        which: &'static str,
        /// The `(width, height, channels)` it declares.
        shape: (usize, usize, usize),
        /// Number of values it holds.
        len: usize,
    },
    /// The metric is not defined for this number of channels.
    #[error("{metric} needs {need} channels, the images have {got}; drop alpha or convert first")]
    Channels {
        /// Name of the metric, for example `MS-SSIM`.
        metric: &'static str,
        /// Number of channels of the images.
        got: usize,
        /// Numbers of channels the metric accepts.
        need: &'static str,
    },
    /// An image is smaller than the windows the metric needs.
    #[error("{metric} needs both sides of at least {need} pixels, the image is {width}x{height}; {hint}")]
    TooSmall {
        /// Name of the metric, for example `MS-SSIM`.
        metric: &'static str,
        /// Smallest allowed side in pixels.
        need: usize,
        /// Width of the image in pixels.
        width: usize,
        /// Height of the image in pixels.
        height: usize,
        /// What the caller can do instead.
        hint: &'static str,
    },
    /// A value is NaN or infinite.
    #[error(
        "image {which} has a value that is not finite at pixel ({x}, {y}), channel {channel}; repair the image first"
    )]
    NotFinite {
        /// Name of the argument: `a`, `b`, `mask`, …
        which: &'static str,
        /// Column of the first such pixel, from 0.
        x: usize,
        /// Row of that pixel, from 0 at the top.
        y: usize,
        /// Channel of the value, from 0.
        channel: usize,
    },
    /// All values are finite but so large that squares overflow `f32`.
    #[error("values are too large for {metric}: display-encoded images have values in [0, 1]")]
    Overflow {
        /// Name of the metric, for example `MS-SSIM`.
        metric: &'static str,
    },
    /// An option is out of its range.
    #[error("option {name} is {value}; it must be {must}")]
    Option {
        /// Name of the option or argument.
        name: &'static str,
        /// The value given, as text.
        value: String,
        /// The range it must lie in.
        must: &'static str,
    },
    /// A video is too short.
    #[error("{metric} needs at least {need} frames, {got} were given; give more, or keep the ends (no trim)")]
    TooFewFrames {
        /// Name of the metric, for example `MS-SSIM`.
        metric: &'static str,
        /// Number of frames of the video.
        got: usize,
        /// Fewest frames the metric accepts.
        need: usize,
    },
    /// A mask has no positive weight, so there is nothing to average.
    #[error("the mask is zero everywhere: no pixel is left to compare")]
    EmptyMask,
    /// A mask holds a negative weight.
    #[error("the mask is negative at pixel ({x}, {y}); weights are at least 0")]
    NegativeMask {
        /// Column of the first such pixel, from 0.
        x: usize,
        /// Row of that pixel, from 0 at the top.
        y: usize,
    },
}

/// Checks that two images have one shape, 1 to 4 channels, data of the right length and at least one pixel.
pub(crate) fn check_pair(a: &Image, b: &Image) -> Result<(), MetricError> {
    check_image("a", a)?;
    check_image("b", b)?;
    if a.shape() != b.shape() {
        return Err(MetricError::Shape { what: "images a and b", first: a.shape(), second: b.shape() });
    }
    Ok(())
}

/// Checks one image alone: see [`check_pair`].
pub(crate) fn check_image(which: &'static str, image: &Image) -> Result<(), MetricError> {
    let (w, h, c) = image.shape();
    let want = w.checked_mul(h).and_then(|n| n.checked_mul(c));
    if !(1..=MAX_CHANNELS).contains(&c) || want != Some(image.data.len()) {
        return Err(MetricError::Malformed { which, shape: image.shape(), len: image.data.len() });
    }
    if image.data.is_empty() {
        let hint = "an empty image has no score";
        return Err(MetricError::TooSmall { metric: "a comparison", need: 1, width: w, height: h, hint });
    }
    Ok(())
}

/// Returns an error for an image with a NaN or an infinity; it names the first one.
pub(crate) fn check_finite(which: &'static str, image: &Image) -> Result<(), MetricError> {
    let Some(at) = image.first_non_finite() else { return Ok(()) };
    let (pixel, channel) = (at / image.channels, at % image.channels);
    Err(MetricError::NotFinite { which, x: pixel % image.width, y: pixel / image.width, channel })
}

/// The error behind a score that came out as NaN or infinity: a bad pixel if there is one, else an overflow.
pub(crate) fn explain_non_finite(metric: &'static str, a: &Image, b: &Image) -> MetricError {
    let bad = check_finite("a", a).and_then(|()| check_finite("b", b));
    bad.err().unwrap_or(MetricError::Overflow { metric })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_says_what_and_where() {
        let a = Image::zeros(3, 2, 3);
        let e = check_pair(&a, &Image::zeros(2, 3, 3)).unwrap_err();
        assert!(e.to_string().contains("(3, 2, 3) and (2, 3, 3)"), "{e}");
        let e = check_pair(&a, &Image::zeros(3, 2, 5)).unwrap_err();
        assert!(matches!(e, MetricError::Malformed { which: "b", .. }), "{e}");
        let mut short = a.clone();
        short.data.pop();
        assert!(matches!(check_pair(&short, &a).unwrap_err(), MetricError::Malformed { which: "a", len: 17, .. }));
        let none = Image::zeros(0, 2, 3);
        assert!(matches!(check_pair(&none, &none).unwrap_err(), MetricError::TooSmall { .. }));
        let mut bad = a.clone();
        bad.pixel_mut(2, 1)[1] = f32::NEG_INFINITY;
        let want = MetricError::NotFinite { which: "a", x: 2, y: 1, channel: 1 };
        assert_eq!(check_finite("a", &bad).unwrap_err(), want);
        assert_eq!(explain_non_finite("m", &a, &a), MetricError::Overflow { metric: "m" });
        let huge = Image { width: usize::MAX, height: 2, channels: 3, data: vec![] };
        assert!(check_pair(&huge, &huge).is_err());
    }
}
