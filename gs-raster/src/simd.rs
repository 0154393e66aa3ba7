//! Choice of the instruction set at run time, and the vector exponential of the blend.
//!
//! `2^x` on `x ∈ [-126, 0]`: split `x = m + f` with `|f| ≤ ½` by adding `1.5·2²³`, a degree-5 relative-minimax
//! polynomial for `2^f` (worst relative error 7.5e-8), and `m` added to the exponent bits.

use crate::options::SimdLevel;
use fearless_simd::{Level, f32x16, prelude::*, u32x16};

/// Lanes of one vector: a 4×4 pixel block.
pub(crate) const LANES: usize = 16;

/// The instruction set that `choice` selects on this machine.
///
/// ```
/// use gs_raster::{SimdLevel, simd};
///
/// let name = simd::level_name(simd::level(SimdLevel::Auto)); // such as "avx2"
/// assert!(!name.is_empty() && name == name.to_lowercase());
/// ```
pub fn level(choice: SimdLevel) -> Level {
    let best = Level::new();
    match choice {
        SimdLevel::Auto => best,
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        SimdLevel::Avx2 => best.as_avx2().map_or(best, Level::Avx2),
        #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
        SimdLevel::Avx2 => best,
        SimdLevel::Portable => Level::baseline(),
    }
}

/// The lower-case name of an instruction set (`avx2`, `neon`, …), for reports.
pub fn level_name(level: Level) -> String {
    let text = format!("{level:?}");
    text.split(['(', ' ', '{']).next().unwrap_or_default().to_lowercase()
}

/// Coefficients of the polynomial, constant term first.
const EXP2: [f32; 6] = [1.000_000_1, 0.693_146_94, 0.240_221_2, 0.055_507_13, 0.009_675_542, 0.001_327_647_3];
/// `1.5 · 2²³`: adding it rounds to the nearest integer.
const ROUND: f32 = 12_582_912.0;

/// `2^x` for `-126 ≤ x ≤ 127`, relative error below 2.5e-7 (polynomial 0.8e-7, the rest rounding). Outside that range
/// the value is unspecified.
#[inline(always)]
pub(crate) fn exp2<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let c = |v: f32| f32x16::splat(simd, v);
    let shifted = x + c(ROUND);
    let f = x - (shifted - c(ROUND));
    let p = c(EXP2[5]).mul_add(f, c(EXP2[4]));
    let p = p.mul_add(f, c(EXP2[3]));
    let p = p.mul_add(f, c(EXP2[2]));
    let p = p.mul_add(f, c(EXP2[1]));
    let p = p.mul_add(f, c(EXP2[0]));
    let exponent: u32x16<S> = shifted.bitcast();
    let bits: u32x16<S> = p.bitcast();
    (bits + (exponent << 23)).bitcast()
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::dispatch;

    #[inline(always)]
    fn exp2_of_all<S: Simd>(simd: S, x: &[f32], y: &mut [f32]) {
        for (x, y) in x.chunks_exact(LANES).zip(y.chunks_exact_mut(LANES)) {
            exp2(simd, f32x16::from_slice(simd, x)).store_slice(y);
        }
    }

    #[test]
    fn exp2_is_accurate_at_every_level() {
        let x: Vec<f32> = (0..64_000u16).map(|i| -f32::from(i) * (126.0 / 64_000.0)).collect();
        let want: Vec<f64> = x.iter().map(|&v| f64::from(v).exp2()).collect();
        for choice in [SimdLevel::Auto, SimdLevel::Avx2, SimdLevel::Portable] {
            let mut y = vec![0.0f32; x.len()];
            dispatch!(level(choice), simd => exp2_of_all(simd, &x, &mut y));
            let worst = y.iter().zip(&want).fold(0.0f64, |m, (&y, w)| m.max((f64::from(y) / w - 1.0).abs()));
            assert!(worst < 2.5e-7, "{choice:?}: {worst:.2e}");
        }
    }

    #[test]
    fn levels_have_names() {
        assert!(!level_name(level(SimdLevel::Auto)).is_empty());
    }
}
