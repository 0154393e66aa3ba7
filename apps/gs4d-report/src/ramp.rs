//! Colour maps for numbers in `[0, 1]`.

/// Magma (Smith and van der Walt 2015), ten evenly spaced sRGB colours.
const MAGMA: [[u8; 3]; 10] = [
    [0x00, 0x00, 0x04],
    [0x18, 0x0f, 0x3d],
    [0x44, 0x0f, 0x76],
    [0x72, 0x1f, 0x81],
    [0x9e, 0x2f, 0x7f],
    [0xcd, 0x40, 0x71],
    [0xf1, 0x60, 0x5d],
    [0xfd, 0x96, 0x68],
    [0xfe, 0xca, 0x8d],
    [0xfc, 0xfd, 0xbf],
];

/// A colour map: evenly spaced sRGB colours in `[0, 1]`, linear between them.
#[derive(Clone, Debug, PartialEq)]
pub struct Ramp(pub Vec<[f32; 3]>);

impl Ramp {
    /// Magma: black, purple, orange, pale yellow; perceptually uniform, in grey as well.
    pub fn magma() -> Self {
        Self(MAGMA.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect())
    }

    /// The colour at `share`, clamped to `[0, 1]`; NaN counts as 0.
    ///
    /// ```
    /// let ramp = gs4d_report::Ramp(vec![[0.0; 3], [1.0, 0.5, 0.0]]);
    /// assert_eq!((ramp.at(0.5), ramp.at(f32::NAN)), ([0.5, 0.25, 0.0], [0.0; 3]));
    /// ```
    pub fn at(&self, share: f32) -> [f32; 3] {
        let Some(last) = self.0.len().checked_sub(1) else { return [0.0; 3] };
        let place = share.clamp(0.0, 1.0).max(0.0) * last as f32;
        let k = (place as usize).min(last.saturating_sub(1));
        let (from, to, part) = (self.0[k], self.0[last.min(k + 1)], place - k as f32);
        std::array::from_fn(|c| (1.0 - part) * from[c] + part * to[c])
    }

    /// A CSS gradient from left to right.
    pub(crate) fn css(&self) -> String {
        let colors: Vec<String> = self.0.iter().map(|c| css_color(*c)).collect();
        format!("linear-gradient(to right,{})", colors.join(","))
    }
}

/// An RGB colour in CSS notation.
pub(crate) fn css_color(c: [f32; 3]) -> String {
    let [r, g, b] = c.map(|v| (255.0 * v.clamp(0.0, 1.0) + 0.5) as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CIE L* of an sRGB colour.
    fn lightness(c: [f32; 3]) -> f64 {
        let linear = |v: f32| {
            let v = f64::from(v);
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        };
        let y = 0.2126 * linear(c[0]) + 0.7152 * linear(c[1]) + 0.0722 * linear(c[2]);
        if y > 0.008_856 { 116.0 * y.cbrt() - 16.0 } else { 903.3 * y }
    }

    #[test]
    fn lightness_rises_in_even_steps() {
        let ramp = Ramp::magma();
        let all: Vec<f64> = (0..=20).map(|k| lightness(ramp.at(k as f32 / 20.0))).collect();
        let mean = (all[20] - all[0]) / 20.0;
        assert!(all[0] < 1.0 && all[20] > 97.0, "{all:?}");
        assert!(all.windows(2).all(|w| (0.5..1.5).contains(&((w[1] - w[0]) / mean))), "{all:?}");
    }

    #[test]
    fn ends_and_odd_places() {
        let ramp = Ramp(vec![[0.0; 3], [1.0, 0.5, 0.0]]);
        assert_eq!((ramp.at(-1.0), ramp.at(f32::NAN), ramp.at(7.0)), ([0.0; 3], [0.0; 3], [1.0, 0.5, 0.0]));
        assert_eq!(ramp.at(0.5), [0.5, 0.25, 0.0]);
        assert_eq!(ramp.css(), "linear-gradient(to right,#000000,#ff8000)");
        assert_eq!((Ramp(Vec::new()).at(0.5), Ramp(vec![[1.0; 3]]).at(0.7)), ([0.0; 3], [1.0; 3]));
    }
}
