//! `.splat`: 32 bytes a splat, no header (format of antimatter15/splat, the first browser viewer of 3DGS).
//!
//! ```text
//! 0  f32×3  centre                      12  f32×3  standard deviations (linear)
//! 24 u8×4   r g b (0.5 + C0·f_dc), opacity; all ×255, rounded
//! 28 u8×4   quaternion w x y z, each 128 q + 128, rounded
//! ```
//! All numbers little-endian, axes as in `.ply`. Only SH degree 0 fits. Row order is kept (some writers sort by size).
//! Error of writing: colour and opacity ≤ ½/255, quaternion entries ≤ 1/128 before renormalisation (`q = 1` is stored as
//! 255, that is 127/128); colours outside 0 to 1 are clamped.
//!
//! ```
//! use gs_core::io::{Limits, splat};
//!
//! assert!(splat::read(&[0; 64], "scene.splat", &Limits::default())?.len() == 2);
//! assert!(splat::read(&[0; 63], "scene.splat", &Limits::default()).is_err());
//! # Ok::<(), gs_core::io::IoError>(())
//! ```

use super::error::{At, Source};
use super::raw::{finite_logit, log_scale};
use super::{IoError, Limits, RawSplats, sigmoid};
use crate::{rot, sh};
use glam::Vec3;
use std::io::Write;

/// Bytes of one splat in a file.
pub const ROW: usize = 32;

/// Reads a `.splat` file held in memory. `file` is the name used in errors.
///
/// # Errors
/// A length that is not a multiple of 32; a centre or scale that is not finite, a negative scale (names row and field).
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<RawSplats, IoError> {
    let src = Source { file, format: ".splat" };
    if !bytes.len().is_multiple_of(ROW) {
        let what = format!("{} bytes are not whole rows of {ROW}", bytes.len());
        let at = At::Byte((bytes.len() - bytes.len() % ROW) as u64);
        return Err(src.malformed(at, what, "the file was cut short or is no .splat file"));
    }
    let rows = limits.splats(src, (bytes.len() / ROW) as u64, RawSplats::row_bytes(0))?;
    let mut out = RawSplats::with_capacity(rows, 0);
    for (row, raw) in bytes.chunks_exact(ROW).enumerate() {
        let (floats, bytes) = raw.split_at_checked(24).unwrap_or_default();
        let mut numbers = [0.0f32; 6];
        for (value, four) in numbers.iter_mut().zip(floats.as_chunks::<4>().0) {
            *value = f32::from_le_bytes(*four);
        }
        let &[r, g, b, alpha, quat @ ..] = bytes.first_chunk::<8>().unwrap_or(&[0; 8]);
        check(row, &numbers, limits, src)?;
        let [x, y, z, scale @ ..] = numbers;
        out.means.push(Vec3::new(x, y, z));
        out.log_scales.push(Vec3::from_array(scale.map(log_scale)));
        out.sh.extend([r, g, b].map(|v| ((f64::from(v) / 255.0 - 0.5) / sh::C0) as f32));
        out.logit_opacities.push(finite_logit(f32::from(alpha) / 255.0));
        out.quats.push(quat.map(|v| (f32::from(v) - 128.0) / 128.0));
    }
    Ok(out)
}

fn check(row: usize, numbers: &[f32; 6], limits: &Limits, src: Source<'_>) -> Result<(), IoError> {
    const NAMES: [&str; 6] = ["x", "y", "z", "scale_0", "scale_1", "scale_2"];
    for (i, (value, name)) in numbers.iter().zip(NAMES).enumerate() {
        if !value.is_finite() && !limits.allow_non_finite {
            return Err(src.value(row, name, f64::from(*value), "must be finite"));
        }
        if i >= 3 && *value < 0.0 {
            return Err(src.value(row, name, f64::from(*value), "a linear scale must not be negative"));
        }
    }
    Ok(())
}

/// A value in `[0, 1]` as a byte, rounded to nearest.
fn byte(v: f32) -> u8 {
    (v * 255.0).round().clamp(0.0, 255.0) as u8
}

/// How many colours [`write()`] clamps: those of degree 0 that are outside 0 to 1 by more than half a step.
pub fn clamped(splats: &RawSplats) -> usize {
    let half = 0.5 / 255.0;
    let colors = splats.sh.chunks_exact(splats.sh_width()).flat_map(|row| row.iter().take(3));
    colors.filter(|v| !(-half..=1.0 + half).contains(&color(**v))).count()
}

/// The value of a coefficient of degree 0, 0 to 1 where it can be stored.
fn color(v: f32) -> f32 {
    0.5 + sh::C0 as f32 * v
}

/// Writes splats as `.splat`; SH coefficients above degree 0 are dropped.
///
/// # Errors
/// Columns of unequal length, values or scales that are not finite, or another kernel than the Gaussian (as `InvalidInput`), or the writer's
/// own.
pub fn write(splats: &RawSplats, out: &mut dyn Write) -> std::io::Result<()> {
    splats.check_shape().map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidInput, e))?;
    splats.refuse_kernel("the .splat format")?;
    splats.check_storable()?;
    let columns = splats.means.iter().zip(&splats.quats).zip(&splats.log_scales).zip(&splats.logit_opacities);
    let mut row: Vec<u8> = Vec::with_capacity(ROW);
    for ((((mean, quat), scale), opacity), sh) in columns.zip(splats.sh.chunks_exact(splats.sh_width())) {
        row.clear();
        let linear = scale.to_array().map(f32::exp);
        mean.as_ref().iter().chain(&linear).for_each(|v| row.extend_from_slice(&v.to_le_bytes()));
        row.extend(sh.iter().take(3).map(|v| byte(color(*v))));
        row.push(byte(sigmoid(*opacity)));
        let unit = match rot::normalise(*quat).wxyz {
            [0.0, 0.0, 0.0, 0.0] => [1.0, 0.0, 0.0, 0.0],
            q => q,
        };
        row.extend(unit.map(|q| (q * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8));
        out.write_all(&row)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::raw::tests::cloud;
    use super::*;

    fn read_all(bytes: &[u8]) -> Result<RawSplats, IoError> {
        read(bytes, "t.splat", &Limits::default())
    }

    #[test]
    fn what_would_not_be_read_again_is_not_written() {
        for (log_scale, mean) in [(90.0, 0.0), (0.0, f32::NAN)] {
            let mut splats = cloud(3, 0, 1);
            (splats.log_scales[1].y, splats.means[1].x) = (log_scale, mean);
            for write in [write, super::super::glb::write] {
                let refused = write(&splats, &mut Vec::new()).unwrap_err().to_string();
                assert!(refused.contains("row 1"), "{refused}");
            }
        }
    }

    #[test]
    fn one_row_by_hand() {
        let mut row: Vec<u8> = Vec::new();
        for v in [1.0f32, -2.0, 3.5, 0.5, 1.0, 2.0] {
            row.extend(v.to_le_bytes());
        }
        row.extend([255, 0, 128, 51, 255, 128, 0, 64]);
        let s = read_all(&row).unwrap();
        assert_eq!(s.means, [Vec3::new(1.0, -2.0, 3.5)]);
        assert_eq!(s.quats, [[127.0 / 128.0, 0.0, -1.0, -0.5]]);
        assert!((s.log_scales[0] - Vec3::new(0.5f32.ln(), 0.0, 2.0f32.ln())).length() < 1e-6);
        assert!((sigmoid(s.logit_opacities[0]) - 0.2).abs() < 1e-6);
        assert!((0.5 + sh::C0 as f32 * s.sh[0] - 1.0).abs() < 1e-6);
        let mut out = Vec::new();
        write(&RawSplats { quats: vec![[2.0, 0.0, 0.0, 0.0]], ..s }, &mut out).unwrap();
        assert_eq!(out[..28], row[..28]);
        assert_eq!(out[28..], [255, 128, 128, 128]);
    }

    #[test]
    fn round_trip_stays_within_the_declared_bound() {
        let splats = cloud(200, 2, 11);
        let mut out = Vec::new();
        write(&splats, &mut out).unwrap();
        let again = read_all(&out).unwrap();
        assert_eq!(again.means, splats.means);
        for i in 0..splats.len() {
            assert!((again.log_scales[i] - splats.log_scales[i]).abs().max_element() < 1e-5);
            assert!(
                (sigmoid(again.logit_opacities[i]) - sigmoid(splats.logit_opacities[i])).abs() < 0.5 / 255.0 + 1e-5
            );
            let q = rot::normalise(splats.quats[i]).wxyz;
            for (a, b) in again.quats[i].iter().zip(q) {
                assert!((a - b).abs() <= 1.0 / 128.0, "{a} {b}");
            }
            for c in 0..3 {
                let rgb = |s: &RawSplats| (0.5 + sh::C0 as f32 * s.sh[i * s.sh_width() + c]).clamp(0.0, 1.0);
                assert!((rgb(&again) - rgb(&splats)).abs() < 0.5 / 255.0 + 1e-5);
            }
        }
    }

    #[test]
    fn errors_name_row_and_field() {
        let mut out = Vec::new();
        write(&cloud(3, 0, 12), &mut out).unwrap();
        assert!(
            read_all(&out[..70]).unwrap_err().to_string().contains("70 bytes are not whole rows of 32 (at byte 64)")
        );
        for (field, name) in ["x", "y", "z", "scale_0", "scale_1", "scale_2"].iter().enumerate() {
            let mut bad = out.clone();
            bad[64 + 4 * field..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
            assert!(read_all(&bad).unwrap_err().to_string().contains(&format!("row 2, `{name}` = NaN")));
        }
        out[12..16].copy_from_slice(&(-1.0f32).to_le_bytes());
        assert!(read_all(&out).unwrap_err().to_string().contains("`scale_0` = -1"));
    }
}
