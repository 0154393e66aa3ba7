//! Light on decoded Gaussians: their colours times a factor per channel.
//!
//! With colours `c = ½ + Σ Y_k s_k` (before they are cut at 0) and a light `l`:
//! ```text
//! l c = ½ + Y_0 (l s_0 + (l − 1) ½ / Y_0) + Σ_{k>0} Y_k l s_k
//! ```

use gs_core::{Color, Splats, SplatsGrad, cast, sh};

/// The light that changes nothing.
pub(crate) const NONE: [f32; 3] = [1.0; 3];

/// Multiplies the colours of texel Gaussians, which are spherical harmonics.
pub(crate) fn put_on(splats: &mut Splats, light: [f32; 3]) {
    let Color::Sh { degree, coeffs } = &mut splats.color else { return };
    if light == NONE {
        return;
    }
    let width = 3 * (usize::from(*degree) + 1).pow(2);
    coeffs.chunks_exact_mut(width).for_each(|row| put_on_one(row, light));
}

/// Multiplies the colours of one Gaussian, given by all of its spherical harmonics.
pub(crate) fn put_on_one(coeffs: &mut [f32], light: [f32; 3]) {
    let half = cast::to_f32(0.5 / sh::C0);
    coeffs.iter_mut().enumerate().for_each(|(i, s)| *s *= light[i % 3]);
    coeffs.iter_mut().zip(light).for_each(|(s, light)| *s += (light - 1.0) * half);
}

/// Pulls cotangents of lit colours back to those of colours without.
pub(crate) fn pull_back(d_splats: &mut SplatsGrad, light: [f32; 3]) {
    if light != NONE {
        d_splats.color.iter_mut().enumerate().for_each(|(i, d)| *d *= light[i % 3]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_multiplies_colours_and_their_cotangents() {
        let light = [0.5, 1.0, 1.7f32];
        let coeffs: Vec<f32> = (0..24).map(|i| 0.1 * (i as f32 * 1.7).sin()).collect();
        let color = |coeffs: &[f32], i: usize| {
            // Any basis values whose first is that of degree 0.
            let basis = [cast::to_f32(sh::C0), 0.3, -0.2, 0.4];
            0.5 + (0..4).map(|k| basis[k] * coeffs[3 * k + i]).sum::<f32>()
        };
        let mut splats = Splats { color: Color::Sh { degree: 1, coeffs: coeffs.clone() }, ..Splats::default() };
        put_on(&mut splats, light);
        let Color::Sh { coeffs: lit, .. } = &splats.color else { panic!("spherical harmonics stay such") };
        for (before, after) in coeffs.chunks_exact(12).zip(lit.chunks_exact(12)) {
            (0..3).for_each(|i| assert!((color(after, i) - light[i] * color(before, i)).abs() < 1e-6));
        }
        // Linear, so a difference of any size is the derivative.
        let mut d = SplatsGrad { color: vec![1.0; 24], ..SplatsGrad::default() };
        pull_back(&mut d, light);
        for i in 0..24 {
            let mut moved = coeffs.clone();
            moved[i] += 1.0;
            let mut other = Splats { color: Color::Sh { degree: 1, coeffs: moved }, ..Splats::default() };
            put_on(&mut other, light);
            let Color::Sh { coeffs: other, .. } = &other.color else { panic!("spherical harmonics stay such") };
            let sum = |v: &[f32]| v.iter().sum::<f32>();
            assert!((sum(other) - sum(lit) - d.color[i]).abs() < 1e-5, "{i}");
        }
    }

    #[test]
    fn no_light_changes_no_bit() {
        let splats = Splats { color: Color::Sh { degree: 0, coeffs: vec![0.3, -0.1, 1e-7] }, ..Splats::default() };
        let mut lit = splats.clone();
        put_on(&mut lit, [1.0; 3]);
        assert_eq!(lit, splats);
    }
}
