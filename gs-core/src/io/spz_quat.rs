//! Quaternions of SPZ: three bytes (version 2) or "smallest three" in four bytes (version 3). Order inside SPZ is
//! x, y, z, w; the functions here take and return (w, x, y, z).

/// Largest magnitude of a component that is not the largest one.
const LARGEST_REST: f32 = std::f32::consts::FRAC_1_SQRT_2;
/// Largest magnitude of a 9-bit component.
const MAGNITUDE: u32 = (1 << 9) - 1;

/// Version 2: x, y, z as `127.5 q + 127.5` with w ≥ 0. Error per component ≤ 1/255 (w: larger near 0).
pub(super) fn encode_first_three(unit: [f32; 4]) -> [u8; 3] {
    let [w, x, y, z] = unit;
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    [x, y, z].map(|v| (v * sign * 127.5 + 127.5).round().clamp(0.0, 255.0) as u8)
}

/// Inverse of [`encode_first_three`]; `w = √max(0, 1 − |xyz|²)`.
pub(super) fn decode_first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|v| f32::from(v) / 127.5 - 1.0);
    [(1.0 - (x * x + y * y + z * z)).max(0.0).sqrt(), x, y, z]
}

/// Version 3: two bits name the largest of x, y, z, w (made positive); the others follow in that order, each a sign bit
/// and nine bits of magnitude over `[0, 1/√2]`, the last one lowest. Error per stored component ≤ 7e-4.
pub(super) fn encode_smallest_three(unit: [f32; 4]) -> [u8; 4] {
    let [w, x, y, z] = unit;
    let xyzw = [x, y, z, w];
    let (mut largest, mut size, mut sign) = (0u32, -1.0f32, 1.0f32);
    for (i, v) in (0u32..).zip(xyzw) {
        if v.abs() > size {
            (largest, size, sign) = (i, v.abs(), v.signum());
        }
    }
    let mut packed = largest;
    for (i, v) in (0u32..).zip(xyzw) {
        if i != largest {
            let magnitude = ((MAGNITUDE as f32 * v.abs() / LARGEST_REST + 0.5) as u32).min(MAGNITUDE);
            packed = (packed << 10) | (u32::from(v * sign < 0.0) << 9) | magnitude;
        }
    }
    packed.to_le_bytes()
}

/// Inverse of [`encode_smallest_three`], up to quantisation.
pub(super) fn decode_smallest_three(bytes: [u8; 4]) -> [f32; 4] {
    let mut packed = u32::from_le_bytes(bytes);
    let largest = packed >> 30;
    let mut xyzw = [0.0f32; 4];
    let mut squares = 0.0;
    for (i, v) in (0u32..4).zip(xyzw.iter_mut()).rev() {
        if i != largest {
            let size = LARGEST_REST * (packed & MAGNITUDE) as f32 / MAGNITUDE as f32;
            *v = if packed & (1 << 9) == 0 { size } else { -size };
            squares += size * size;
            packed >>= 10;
        }
    }
    if let Some(v) = xyzw.get_mut(largest as usize) {
        *v = (1.0f32 - squares).max(0.0).sqrt();
    }
    let [x, y, z, w] = xyzw;
    [w, x, y, z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;
    use crate::rot;

    #[test]
    fn round_trips_within_their_bounds() {
        let mut r = Rng::new(1, "spz quat", 0, 0);
        for _ in 0..2000 {
            let q = rot::normalise([r.normal(), r.normal(), r.normal(), r.normal()]).wxyz;
            let angle = |p: [f32; 4]| {
                let dot: f64 = p.iter().zip(q).map(|(a, b)| f64::from(*a) * f64::from(b)).sum();
                let norm = p.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
                2.0 * (dot.abs() / norm).min(1.0).acos()
            };
            assert!(angle(decode_smallest_three(encode_smallest_three(q))) < 4e-3);
            assert!(angle(decode_first_three(encode_first_three(q))) < 0.2);
        }
    }

    #[test]
    fn known_words() {
        assert_eq!(encode_smallest_three([1.0, 0.0, 0.0, 0.0]), [0, 0, 0, 0xc0]);
        assert_eq!(decode_smallest_three([0, 0, 0, 0xc0]), [1.0, 0.0, 0.0, 0.0]);
        // Largest z (index 2), negative, so all signs flip: x = 0, y = -0.6·511/0.7071, w = 0.
        let word = u32::from_le_bytes(encode_smallest_three([0.0, 0.0, 0.6, -0.8]));
        assert_eq!((word >> 30, (word >> 20) & 1023, (word >> 10) & 1023, word & 1023), (2, 0, 512 + 434, 0));
        for bytes in [[0xff; 4], [0xff, 0xff, 0xff, 0x3f], [0; 4]] {
            assert!(decode_smallest_three(bytes).iter().all(|v| v.is_finite()));
        }
        assert!(decode_first_three([0; 3]).iter().all(|v| v.is_finite()));
    }
}
