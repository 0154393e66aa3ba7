//! IEEE 754 binary16 by bits.

/// Largest finite value.
pub(super) const MAX: f32 = 65_504.0;
/// Smallest normal exponent of `f16`, as a biased exponent of `f32`.
const MIN_NORMAL: u32 = 127 - 14;

/// The nearest `f16`, ties to even. Values beyond [`MAX`] (by more than half a step) become infinite.
pub(super) fn from_f32(v: f32) -> u16 {
    let bits = v.to_bits();
    let sign = (bits >> 16) as u16 & 0x8000;
    let exponent = bits >> 23 & 0xff;
    let mantissa = bits & 0x007f_ffff;
    if exponent == 0xff {
        // NaN stays a NaN.
        return sign | 0x7c00 | u16::from(mantissa != 0) << 9;
    }
    if exponent >= 127 + 16 {
        return sign | 0x7c00;
    }
    if exponent < MIN_NORMAL - 11 {
        return sign;
    }
    // The significand with its leading one, and how many of its bits are dropped.
    let significand = mantissa | 0x0080_0000;
    let (dropped, base) = match exponent.checked_sub(MIN_NORMAL) {
        Some(e) => (13, (e << 10) as u16),
        None => (13 + (MIN_NORMAL - exponent), 0),
    };
    let kept = (significand >> dropped) as u16;
    let rest = significand & ((1 << dropped) - 1);
    let half = 1 << (dropped - 1);
    let up = u16::from(rest > half || (rest == half && kept & 1 == 1));
    // For normal numbers the leading one adds one to the exponent, and so does a carry of the rounding.
    sign | (base + kept + up)
}

/// The value of an `f16`, exact.
pub(super) fn to_f32(half: u16) -> f32 {
    let sign = u32::from(half & 0x8000) << 16;
    let (exponent, mantissa) = (u32::from(half >> 10 & 0x1f), u32::from(half & 0x3ff));
    match exponent {
        0 => {
            let value = mantissa as f32 * (1.0 / 16_777_216.0);
            f32::from_bits(value.to_bits() | sign)
        }
        0x1f => f32::from_bits(sign | 0x7f80_0000 | mantissa << 13),
        _ => f32::from_bits(sign | (exponent + 112) << 23 | mantissa << 13),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_half_comes_back() {
        for half in 0..=u16::MAX {
            let value = to_f32(half);
            if value.is_nan() {
                assert!(to_f32(from_f32(value)).is_nan());
            } else {
                assert_eq!(from_f32(value), half, "{value}");
            }
        }
        assert_eq!((to_f32(0x3c00), to_f32(0x0001), to_f32(0x7bff)), (1.0, 2f32.powi(-24), MAX));
    }

    #[test]
    fn the_nearest_is_taken_and_ties_go_to_even() {
        for half in 0..0x7bffu16 {
            let (low, high) = (to_f32(half), to_f32(half + 1));
            let middle = (f64::from(low) + f64::from(high)) / 2.0;
            let even = half + (half & 1);
            assert_eq!(from_f32(middle as f32), even, "{middle} is exact in f32");
            assert_eq!(from_f32(f32::from_bits((middle as f32).to_bits() - 1)), half);
            assert_eq!(from_f32(f32::from_bits((middle as f32).to_bits() + 1)), half + 1);
            assert_eq!(from_f32(-low), half | 0x8000);
        }
        assert_eq!((from_f32(65_519.9), from_f32(65_520.0), from_f32(f32::MAX)), (0x7bff, 0x7c00, 0x7c00));
        assert_eq!((from_f32(1e-30), from_f32(-1e-45)), (0, 0x8000));
    }
}
