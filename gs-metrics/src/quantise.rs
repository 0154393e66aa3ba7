//! Rounding to 8 bits, which a protocol that scores image files implies.

use gs_core::Image;

/// How values are rounded to the 256 steps of an 8-bit file.
///
/// ```
/// use gs_core::Image;
/// use gs_metrics::Quantise;
/// let mut image = Image { width: 3, height: 1, channels: 1, data: vec![-0.2, 0.5, 1.2] };
/// Quantise::Round.apply(&mut image);
/// assert_eq!(image.data, [0.0, 128.0 / 255.0, 1.0]);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quantise {
    /// No rounding and no clamping.
    #[default]
    None,
    /// `⌊255·v + ½⌋` of the clamped value, as when a PNG is written.
    Round,
    /// `⌊255·v⌋` of the clamped value, as DyCheck quantises predictions.
    Truncate,
}

impl Quantise {
    /// The 8-bit step of a value, which is clamped to `[0, 1]` first. A value `n/255` in `f32` becomes `n`.
    #[expect(clippy::cast_possible_truncation, reason = "at most 255.5")]
    pub(crate) fn step(self, v: f32) -> u8 {
        // `n/255·255` in f32 may be smaller than n by rounding.
        let lift = if self == Quantise::Truncate { 1e-4 } else { 0.5 };
        (v.clamp(0.0, 1.0) * 255.0 + lift) as u8
    }

    /// Clamps every value to `[0, 1]` and rounds it to a step `n/255`; [`Quantise::None`] changes nothing. NaN stays NaN.
    pub fn apply(self, image: &mut Image) {
        if self != Quantise::None {
            let finite = image.data.iter_mut().filter(|v| !v.is_nan());
            finite.for_each(|v| *v = f32::from(self.step(*v)) / 255.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_kept_and_values_between_are_rounded_or_truncated() {
        for n in 0..=255u8 {
            let v = f32::from(n) / 255.0;
            assert_eq!((Quantise::Round.step(v), Quantise::Truncate.step(v)), (n, n));
        }
        let between = |v: f32| (Quantise::Round.step(v / 255.0), Quantise::Truncate.step(v / 255.0));
        assert_eq!([between(7.4), between(7.6), between(7.99)], [(7, 7), (8, 7), (8, 7)]);
        assert_eq!((between(-3.0), between(300.0)), ((0, 0), (255, 255)));
        let mut image = Image { width: 3, height: 1, channels: 1, data: vec![0.1, f32::NAN, 1.7] };
        let kept = image.clone();
        Quantise::None.apply(&mut image);
        assert_eq!((image.data[0], image.data[2]), (kept.data[0], kept.data[2]));
        Quantise::Truncate.apply(&mut image);
        assert_eq!((image.data[0], image.data[2]), (25.0 / 255.0, 1.0));
        assert!(image.data[1].is_nan(), "NaN must not become black");
    }
}
