//! Element-wise parts of the decoder, sixteen values at a time.
//!
//! ```text
//! a = 2σ(z) − 1 = tanh(z/2)      or      a = σ(z) = ½ + ½ tanh(z/2)
//! h = a ⊙ relu(f)        v_f = v_h ⊙ a ⊙ [f > 0]        v_z = v_h ⊙ f ⊙ da/dz,   da/dz = ½(1 − a²)   or   a(1 − a)
//! ```
//! `tanh x = x P(x²) / Q(x²)` with `P` of degree 6 and `Q` of degree 3, a relative-minimax fit on `|x| ≤ 8.6` (4e-9),
//! constant beyond (where `1 − tanh` is below 7e-8).

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f32x16};

const LANES: usize = 16;
const TANH_END: f32 = 8.6;
const TANH_P: [f32; 7] =
    [1.0, 1.310_070_3e-1, 3.122_684_3e-3, 1.135_321_5e-5, -2.105_593_6e-8, 5.694_520_6e-11, -9.611_477e-14];
const TANH_Q: [f32; 4] = [1.0, 4.643_403_3e-1, 2.456_952_2e-2, 2.573_580_4e-4];

#[inline(always)]
fn horner<S: Simd, const N: usize>(simd: S, c: &[f32; N], x: f32x16<S>) -> f32x16<S> {
    let mut p = f32x16::splat(simd, c[N - 1]);
    for k in (0..N - 1).rev() {
        p = p.mul_add(x, f32x16::splat(simd, c[k]));
    }
    p
}

#[inline(always)]
fn tanh<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let end = f32x16::splat(simd, TANH_END);
    let x = x.min(end).max(-end);
    let square = x * x;
    x * horner(simd, &TANH_P, square) / horner(simd, &TANH_Q, square)
}

#[inline(always)]
fn squash<S: Simd>(simd: S, z: f32x16<S>, directional: bool) -> f32x16<S> {
    let half = f32x16::splat(simd, 0.5);
    let t = tanh(simd, z * half);
    if directional { t } else { half.mul_add(t, half) }
}

#[inline(always)]
fn attention_all<S: Simd>(simd: S, z: &mut [f32], directional: bool) {
    let (rows, rest) = z.as_chunks_mut::<LANES>();
    for z in rows {
        squash(simd, f32x16::load_array_ref(simd, z), directional).store_array(z);
    }
    let mut last = [0.0; LANES];
    last[..rest.len()].copy_from_slice(rest);
    squash(simd, f32x16::load_array_ref(simd, &last), directional).store_array(&mut last);
    rest.copy_from_slice(&last[..rest.len()]);
}

/// Attention in place: `z` becomes `a`.
pub(super) fn attention(level: Level, z: &mut [f32], directional: bool) {
    dispatch!(level, simd => attention_all(simd, z, directional));
}

#[inline(always)]
fn attend_all<S: Simd>(_: S, f: &mut [f32], a: &[f32], h: &mut [f32]) {
    for ((f, a), h) in f.iter_mut().zip(a).zip(h) {
        *f = f.max(0.0);
        *h = *a * *f;
    }
}

/// `f = relu(f)`, `h = a ⊙ f`.
pub(super) fn attend(level: Level, f: &mut [f32], a: &[f32], h: &mut [f32]) {
    dispatch!(level, simd => attend_all(simd, f, a, h));
}

#[inline(always)]
fn product_all<S: Simd>(_: S, a: &[f32], f: &[f32], h: &mut [f32]) {
    for ((a, f), h) in a.iter().zip(f).zip(h) {
        *h = a * f;
    }
}

/// `h = a ⊙ f`.
pub(super) fn product(level: Level, a: &[f32], f: &[f32], h: &mut [f32]) {
    dispatch!(level, simd => product_all(simd, a, f, h));
}

#[inline(always)]
fn attend_backward_all<S: Simd>(_: S, a: &[f32], f: &[f32], d: &mut [f32], d_f: &mut [f32], directional: bool) {
    for (((a, f), d), d_f) in a.iter().zip(f).zip(d).zip(d_f) {
        let slope = if directional { 0.5 * (1.0 - a * a) } else { a * (1.0 - a) };
        *d_f = if *f > 0.0 { *d * a } else { 0.0 };
        *d *= f * slope;
    }
}

/// Backward of [`attention`] and [`attend`]: `d` holds `v_h` and becomes `v_z`; `d_f` is set.
pub(super) fn attend_backward(level: Level, a: &[f32], f: &[f32], d: &mut [f32], d_f: &mut [f32], directional: bool) {
    dispatch!(level, simd => attend_backward_all(simd, a, f, d, d_f, directional));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attention_is_accurate_at_every_length_and_level() {
        for n in [0, 1, 15, 16, 17, 40_001] {
            let z: Vec<f32> = (0..n).map(|i| 40.0 * (i as f32 - 0.5 * n as f32) / n as f32).collect();
            for level in [Level::new(), Level::baseline()] {
                let (mut signed, mut unsigned) = (z.clone(), z.clone());
                attention(level, &mut signed, true);
                attention(level, &mut unsigned, false);
                for ((z, a), b) in z.iter().zip(&signed).zip(&unsigned) {
                    let want = (f64::from(*z) / 2.0).tanh();
                    assert!((f64::from(*a) - want).abs() <= 5e-7 * want.abs(), "tanh({z} / 2): {a} {want}");
                    assert!((f64::from(*b) - 0.5 - 0.5 * want).abs() <= 3e-7, "σ({z}): {b}");
                }
            }
        }
    }

    #[test]
    fn backward_follows_the_kink_and_the_slope() {
        let level = Level::new();
        let (a, mut f, mut h) = ([0.5, -0.5, 0.25], [2.0, -1.0, 0.0], [9.0; 3]);
        attend(level, &mut f, &a, &mut h);
        assert_eq!((f, h), ([2.0, 0.0, 0.0], [1.0, 0.0, 0.0]));
        let (mut d, mut d_f) = ([4.0; 3], [9.0; 3]);
        attend_backward(level, &a, &f, &mut d, &mut d_f, true);
        assert_eq!((d, d_f), ([4.0 * 2.0 * 0.375, 0.0, 0.0], [2.0, 0.0, 0.0]));
        let (mut d, mut d_f) = ([4.0; 3], [9.0; 3]);
        attend_backward(level, &a, &f, &mut d, &mut d_f, false);
        assert_eq!((d[0], d_f[0]), (4.0 * 2.0 * 0.25, 2.0));
    }
}
