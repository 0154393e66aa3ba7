//! Rounding to 8 bit, as protocols which score image files imply it.

use gs_core::Image;

/// What becomes of values between the 256 steps of an 8-bit file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quantise {
    /// Nothing.
    #[default]
    None,
    /// `⌊255·v + ½⌋`: what writing a PNG does.
    Round,
    /// `⌊255·v⌋`: what DyCheck does to predictions.
    Truncate,
}

impl Quantise {
    /// The 8-bit step of a value, which is clamped to `[0, 1]` first. Steps themselves (`n/255` in `f32`) stay where they are.
    pub(crate) fn step(self, v: f32) -> u8 {
        // `n/255·255` may fall short of n by the rounding of f32.
        let lift = if self == Quantise::Truncate { 1e-4 } else { 0.5 };
        (v.clamp(0.0, 1.0) * 255.0 + lift) as u8
    }

    /// The image with every value on a step, clamped to `[0, 1]`; unchanged for [`Quantise::None`]. NaN stays NaN.
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
    fn steps_stay_and_values_between_go_up_or_down() {
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
        assert!(image.data[1].is_nan(), "a hole must not become black");
    }
}
