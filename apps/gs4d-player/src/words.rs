//! Splats for the renderer in the browser: eight 32-bit words each, little-endian.
//!
//! | words | content |
//! |---|---|
//! | 0 to 2 | mean, f32 |
//! | 3 | red, green, blue, opacity, 8 bits each, red lowest |
//! | 4, 5 | quaternion `(w, x, y, z)`, normalised, 16-bit signed shares of 1, `w` lowest |
//! | 6, 7 | natural logarithms of the three scales, f16; in the upper half of word 7 the kernel's knot `p` and its value `v`, 8 bits each of ½ |
//!
//! Colours are those that the camera sees. `alpha = opacity · ψ(g)`, where `ψ` is piecewise linear through `(0, 0)`, `(p, v)`,
//! `(1 − p, 1 − v)`, `(1, 1)`: every kernel of [`gs_core::Kernel`] with bounded support; `p = v` is the Gaussian.

use gs_core::kernel::Profile;
use gs_core::{Camera, Color, Splats, cast, rot, sh};
use half::f16;

/// Bytes of a splat.
pub const BYTES: usize = 32;
/// Steepness from which on a profile has no outer segments, see [`Profile`].
const NO_FOOT: f64 = 1e29;
/// Knot and value of the Gaussian.
const GAUSSIAN: [u8; 2] = [128, 128];

/// The splats as bytes, in their order; colours as `camera` sees them.
pub fn bytes(splats: &Splats, camera: &Camera) -> Vec<u8> {
    let mut out = Vec::with_capacity(BYTES * splats.len());
    let eye = camera.position().to_array();
    for i in 0..splats.len() {
        splats.means[i].to_array().iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(color(&splats.color, i, splats.means[i].to_array(), eye).map(unit));
        out.push(unit(splats.opacities[i]));
        out.extend(unit_quat(splats.quats[i]).map(signed).iter().flat_map(|v| v.to_le_bytes()));
        let scales = splats.scales[i].to_array().map(|s| f16::from_f32(s.abs().max(f32::MIN_POSITIVE).ln()));
        out.extend(scales.iter().flat_map(|v| v.to_le_bytes()));
        out.extend(splats.kernel.bend(i).map_or(GAUSSIAN, knot));
    }
    out
}

/// The display-encoded colour of a splat as seen from `eye`.
fn color(color: &Color, i: usize, mean: [f32; 3], eye: [f64; 3]) -> [f32; 3] {
    match color {
        Color::Rgb(all) => all[i],
        Color::Sh { degree, coeffs } => {
            let basis = sh::basis(sh::direction(mean.map(f64::from), eye).0, *degree);
            let width = 3 * (usize::from(*degree) + 1).pow(2);
            let row = coeffs[i * width..(i + 1) * width].chunks_exact(3);
            let sum = row
                .zip(basis)
                .fold([0.5; 3], |rgb: [f64; 3], (c, b)| std::array::from_fn(|k| rgb[k] + b * f64::from(c[k])));
            sum.map(cast::to_f32)
        }
    }
}

/// A quaternion of length 1; zero is the identity.
fn unit_quat(q: [f32; 4]) -> [f32; 4] {
    let unit = rot::normalise(q).wxyz;
    if unit == [0.0; 4] { [1.0, 0.0, 0.0, 0.0] } else { unit }
}

/// A share of 1 as a byte: clamped to 0 to 1 and rounded to the nearest.
pub fn unit(v: f32) -> u8 {
    cast::to_u8((v.clamp(0.0, 1.0) * 255.0).round())
}

#[expect(clippy::cast_possible_truncation, reason = "the value is within ±32767")]
fn signed(v: f32) -> i16 {
    (v.clamp(-1.0, 1.0) * 32767.0).round() as i16
}

/// Knot and value of a profile, as shares of ½.
pub(crate) fn knot(profile: Profile<f64>) -> [u8; 2] {
    let p = 0.5 / (1.0 + profile.kappa);
    // A profile that never decays has no outer segments: its inner one ends at g = 0, above 0.
    let v = if profile.kappa < NO_FOOT { profile.foot * p } else { -0.5 * profile.u };
    [p, v].map(|v| unit(cast::to_f32(2.0 * v)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Kernel;

    fn splats(kernel: Kernel) -> Splats {
        Splats {
            means: vec![glam::Vec3::new(1.0, -2.0, 3.0)],
            quats: vec![[0.0, 0.0, 2.0, 0.0]],
            scales: vec![glam::Vec3::new(1.0, 0.5, 0.25)],
            opacities: vec![0.8],
            color: Color::Rgb(vec![[1.0, 0.0, 0.5]]),
            kernel,
        }
    }

    fn camera() -> Camera {
        gs_raster::measure::camera(64)
    }

    #[test]
    fn every_field_is_where_the_table_says() {
        let bytes = bytes(&splats(Kernel::Gaussian), &camera());
        assert_eq!(bytes.len(), BYTES);
        let float = |k: usize| f32::from_le_bytes(bytes[4 * k..4 * k + 4].try_into().unwrap());
        assert_eq!([float(0), float(1), float(2)], [1.0, -2.0, 3.0]);
        assert_eq!(bytes[12..16], [255, 0, 128, 204]);
        let short = |k: usize| i16::from_le_bytes(bytes[16 + 2 * k..18 + 2 * k].try_into().unwrap());
        assert_eq!([short(0), short(1), short(2), short(3)], [0, 0, 32767, 0]);
        let log = |k: usize| f16::from_le_bytes(bytes[24 + 2 * k..26 + 2 * k].try_into().unwrap()).to_f32();
        assert!((0..3).all(|k| (log(k) - [0.0, 0.5f32.ln(), 0.25f32.ln()][k]).abs() < 1e-3));
        assert_eq!(bytes[30..], GAUSSIAN);
    }

    #[test]
    fn kernels_are_given_by_their_knots() {
        // Acutance 0.5: the knot at 3/8, the slope before it 1/3.
        let sharp = bytes(&splats(Kernel::Acutance { acutances: vec![0.5] }), &camera());
        let [p, v] = [sharp[30], sharp[31]].map(|b| f64::from(b) / 510.0);
        assert!((p - 0.375).abs() < 2e-3 && (v - 0.125).abs() < 2e-3, "{p} {v}");
    }

    #[test]
    fn harmonics_are_those_of_the_rasteriser() {
        let mut scene = splats(Kernel::Gaussian);
        scene.means[0] = glam::Vec3::new(0.0, 0.0, 0.0);
        scene.quats[0] = [1.0, 0.0, 0.0, 0.0];
        scene.scales[0] = glam::Vec3::splat(1e3);
        scene.opacities[0] = 1.0;
        let coeffs: Vec<f32> = (0..48).map(|k| 0.05 * ((k * 7 % 11) as f32 - 5.0)).collect();
        scene.color = Color::Sh { degree: 3, coeffs };
        let camera = camera();
        let frame = gs_raster::render(&scene, &camera, &Default::default(), &mut Default::default());
        let ours = bytes(&scene, &camera);
        let middle = frame.rgb.pixel(32, 32);
        // Alpha is at most 0.99, over black.
        for k in 0..3 {
            let want = (middle[k] / 0.99).clamp(0.0, 1.0) * 255.0;
            assert!((f32::from(ours[12 + k]) - want).abs() <= 1.5, "{k}: {} {want}", ours[12 + k]);
        }
    }
}
