//! 3D Gaussian Splatting `.ply`: properties found by name, in any order, text or binary of either byte order.
//!
//! Layout of the INRIA code (Kerbl et al. 2023): `x y z`, `nx ny nz` (zero, optional), `f_dc_0..2`,
//! `f_rest_0..3(K−1)−1` **channel-major** (`f_rest[c (K−1) + k−1]` is coefficient `k` of channel `c`), `opacity`
//! (logit), `scale_0..2` (natural logarithm), `rot_0..3` (w, x, y, z, not normalised). `K = (degree + 1)²` is inferred
//! from the number of `f_rest` properties: 0, 9, 24 or 45. Other properties are skipped; numbers of any PLY type are
//! converted to `f32`. Axes are taken as they are. An infinite opacity logit means opacity 0 or 1 exactly (files made from
//! 8-bit formats hold it); it becomes the logit of 1e-6 or 1 − 1e-6. Any other value that is not finite is an error.
//!
//! A comment `SplatRenderMode: mip`, as Brush writes it, says that the splats are drawn anti-aliased
//! ([`RawSplats::antialiased`]); Postshot's `antialiased 1` is read as well.
//!
//! Splats of other kernels have further properties at the end: `lambda_raw beta_raw lambda beta` (logits, then the values
//! themselves, which are used where both are present) or `acutance`; a file without them holds Gaussians.
//!
//! The crate has a parser of its own because a row is a fixed list of byte offsets here: a serde visitor per value costs
//! about fifteen times the copy, loses row and property in its errors, and cannot compare a count with the bytes present.
//!
//! ```
//! use gs_core::io::{Limits, ply};
//!
//! let file = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty uchar red\nend_header\n0.5 255\n1.5 0\n";
//! assert_eq!(ply::property_names(file, "points.ply")?, ["x", "red"]);
//! assert_eq!(ply::read_columns(file, "points.ply", &Limits::default(), &["red", "x"])?, [255.0, 0.5, 0.0, 1.5]);
//! # Ok::<(), gs_core::io::IoError>(())
//! ```

use super::error::{At, Source};
use super::ply_header::{Element, Header};
use super::ply_rows::for_each_row;
use super::raw::finite_logit;
use super::{IoError, Limits, RawSplats, sigmoid};
use crate::kernel::Kernel;
use crate::sh;
use glam::Vec3;
use std::borrow::Cow;
use std::io::Write;

const FORMAT: &str = "PLY";

/// Reads the splats of a 3DGS `.ply` file held in memory. `file` is the name used in errors.
///
/// # Errors
/// Truncation, malformed header, missing or repeated property, a value that is not finite (names row and property).
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<RawSplats, IoError> {
    let src = Source { file, format: FORMAT };
    let header = Header::parse(bytes, src)?;
    let (element, _, _) = header.locate("vertex", bytes.len(), limits, src)?;
    let degree = degree_of(element, &header, src)?;
    let mut names = splat_columns(degree);
    let plain = names.len();
    let kernel = kernel_columns(element);
    names.extend(kernel.iter().map(|&n| n.to_owned()));
    let mut kernel_values: Vec<f32> = Vec::new();
    let mut out = RawSplats::with_capacity(0, degree);
    let finite_end = |o: f32| if o.is_infinite() && !limits.allow_non_finite { finite_logit(sigmoid(o)) } else { o };
    for_each_row(bytes, &header, &names, "opacity", src, limits, |total, row| {
        if out.means.capacity() == 0 {
            out = RawSplats::with_capacity(total, degree);
        }
        let (row, kernel_row) = row.split_at_checked(plain).unwrap_or((row, &[]));
        kernel_values.extend_from_slice(kernel_row);
        if let [x, y, z, qw, qx, qy, qz, sx, sy, sz, opacity, sh @ ..] = row {
            out.means.push(Vec3::new(*x, *y, *z));
            out.quats.push([*qw, *qx, *qy, *qz]);
            out.log_scales.push(Vec3::new(*sx, *sy, *sz));
            out.logit_opacities.push(finite_end(*opacity));
            out.sh.extend_from_slice(sh);
        }
    })?;
    let column = |i: usize| kernel_values.iter().skip(i).step_by(kernel.len().max(1)).copied();
    out.kernel = match kernel {
        [] => Kernel::Gaussian,
        ["acutance"] => Kernel::Acutance { acutances: kernel_values },
        ["lambda", ..] => Kernel::Frequency { lambdas: column(0).collect(), betas: column(1).collect() },
        _ => Kernel::Frequency { lambdas: column(0).map(sigmoid).collect(), betas: column(1).map(sigmoid).collect() },
    };
    out.antialiased = header.antialiased;
    Ok(out)
}

/// The properties that hold a file's kernel. `lambda` and `beta` alone do not count: other programs use these names.
fn kernel_columns(element: &Element<'_>) -> &'static [&'static str] {
    let has = |name: &str| element.properties.iter().any(|p| p.name == name);
    match () {
        () if !has("lambda_raw") && !has("beta_raw") => {
            if has("acutance") {
                &["acutance"]
            } else {
                &[]
            }
        }
        () if has("lambda") && has("beta") => &["lambda", "beta"],
        () => &["lambda_raw", "beta_raw"],
    }
}

/// The properties of a kernel as written, in order, with their columns.
fn kernel_properties(kernel: &Kernel) -> Vec<(&'static str, Cow<'_, [f32]>)> {
    let logits = |values: &[f32]| values.iter().map(|&v| finite_logit(v)).collect();
    match kernel {
        Kernel::Gaussian => Vec::new(),
        Kernel::Frequency { lambdas, betas } => vec![
            ("lambda_raw", Cow::Owned(logits(lambdas))),
            ("beta_raw", Cow::Owned(logits(betas))),
            ("lambda", Cow::Borrowed(lambdas)),
            ("beta", Cow::Borrowed(betas)),
        ],
        Kernel::Acutance { acutances } => vec![("acutance", Cow::Borrowed(acutances))],
    }
}

/// Reads chosen `vertex` properties of any `.ply` as rows of `names.len()` values, flat (point clouds: `x y z red green
/// blue`). Integers keep their value (`uchar` 0 to 255).
///
/// # Errors
/// As [`read`].
pub fn read_columns(bytes: &[u8], file: &str, limits: &Limits, names: &[&str]) -> Result<Vec<f32>, IoError> {
    let src = Source { file, format: FORMAT };
    let header = Header::parse(bytes, src)?;
    let names: Vec<String> = names.iter().map(|&n| n.to_owned()).collect();
    let mut out: Vec<f32> = Vec::new();
    for_each_row(bytes, &header, &names, "", src, limits, |total, row| {
        if out.capacity() == 0 {
            out.reserve_exact(total.saturating_mul(row.len()));
        }
        out.extend_from_slice(row);
    })?;
    Ok(out)
}

/// Names of the `vertex` properties of a `.ply`, in file order.
///
/// # Errors
/// A malformed header. A file without `vertex` has no names.
pub fn property_names(bytes: &[u8], file: &str) -> Result<Vec<String>, IoError> {
    let src = Source { file, format: FORMAT };
    let header = Header::parse(bytes, src)?;
    let vertex = header.elements.iter().find(|e| e.name == "vertex");
    Ok(vertex.map(|e| e.properties.iter().map(|p| p.name.to_owned()).collect()).unwrap_or_default())
}

/// SH degree from the number of `f_rest_*` properties.
fn degree_of(element: &Element<'_>, header: &Header<'_>, src: Source<'_>) -> Result<u8, IoError> {
    let rest = element.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    match (0..=sh::MAX_DEGREE).find(|&d| 3 * (sh::coeffs(d) - 1) == rest) {
        Some(degree) => Ok(degree),
        None => {
            let what = format!("{rest} `f_rest` properties");
            let advice = "0, 9, 24 or 45 are needed for SH degree 0, 1, 2 or 3";
            Err(src.malformed(At::Byte(header.data_start as u64), what, advice))
        }
    }
}

/// Property names in the order [`read`] takes them: mean, quaternion, log-scale, opacity, SH `[K, 3]`.
fn splat_columns(degree: u8) -> Vec<String> {
    let fixed = ["x", "y", "z", "rot_0", "rot_1", "rot_2", "rot_3", "scale_0", "scale_1", "scale_2", "opacity"];
    let rest = sh::coeffs(degree) - 1;
    let mut names: Vec<String> = fixed.iter().map(|&s| s.to_owned()).collect();
    names.extend((0..3).map(|c| format!("f_dc_{c}")));
    for k in 0..rest {
        names.extend((0..3).map(|c| format!("f_rest_{}", c * rest + k)));
    }
    names
}

/// Writes splats as binary little-endian `.ply` in INRIA's property order: normals zero, kernel properties last. Every
/// `f32` keeps its bits. A viewer that does not know the kernel renders Gaussians.
///
/// # Errors
/// Columns of unequal length (as `InvalidInput`), or the writer's own.
pub fn write(splats: &RawSplats, out: &mut dyn Write) -> std::io::Result<()> {
    splats.check_shape().map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidInput, e))?;
    let rest = sh::coeffs(splats.degree) - 1;
    let drawn = if splats.antialiased { "comment SplatRenderMode: mip\n" } else { "" };
    writeln!(out, "ply\nformat binary_little_endian 1.0\n{drawn}element vertex {}", splats.len())?;
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(str::to_owned).into();
    names.extend((0..3).map(|c| format!("f_dc_{c}")));
    names.extend((0..3 * rest).map(|i| format!("f_rest_{i}")));
    names.push("opacity".into());
    names.extend((0..3).map(|i| format!("scale_{i}")));
    names.extend((0..4).map(|i| format!("rot_{i}")));
    let kernel = kernel_properties(&splats.kernel);
    names.extend(kernel.iter().map(|(name, _)| (*name).to_owned()));
    for name in &names {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")?;
    let mut row: Vec<u8> = Vec::with_capacity(4 * names.len());
    let columns = splats.means.iter().zip(&splats.quats).zip(&splats.log_scales).zip(&splats.logit_opacities);
    let rows = columns.zip(splats.sh.chunks_exact(splats.sh_width()));
    for (i, ((((mean, quat), scale), opacity), sh)) in rows.enumerate() {
        row.clear();
        let mut put = |v: &f32| row.extend_from_slice(&v.to_le_bytes());
        mean.as_ref().iter().for_each(&mut put);
        [0.0f32; 3].iter().for_each(&mut put);
        sh.iter().take(3).for_each(&mut put);
        for channel in 0..3 {
            sh.iter().skip(3 + channel).step_by(3).for_each(&mut put);
        }
        put(opacity);
        scale.as_ref().iter().for_each(&mut put);
        quat.iter().for_each(&mut put);
        kernel.iter().filter_map(|(_, values)| values.get(i)).for_each(&mut put);
        out.write_all(&row)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::ply_header::Encoding;
    use super::super::raw::tests::cloud;
    use super::*;

    fn bytes(splats: &RawSplats) -> Vec<u8> {
        let mut out = Vec::new();
        write(splats, &mut out).unwrap();
        out
    }

    fn read_ok(bytes: &[u8]) -> RawSplats {
        read(bytes, "t.ply", &Limits::default()).unwrap()
    }

    fn read_err(bytes: &[u8]) -> String {
        read(bytes, "t.ply", &Limits::default()).unwrap_err().to_string()
    }

    /// The same cloud with properties in reverse order and unknown ones between, in a chosen encoding.
    fn shuffled(splats: &RawSplats, encoding: Encoding) -> Vec<u8> {
        let names = splat_columns(splats.degree);
        let word = ["ascii", "binary_little_endian", "binary_big_endian"][encoding as usize];
        let mut out = format!("ply\r\nformat {word} 1.0\r\nelement junk 2\r\nproperty short s\r\n").into_bytes();
        out.extend(format!("element vertex {}\r\nproperty uchar unknown\r\n", splats.len()).bytes());
        for name in names.iter().rev() {
            let kind = if name == "opacity" { "double" } else { "float32" };
            out.extend(format!("property {kind} {name}\r\n").bytes());
        }
        out.extend(b"end_header\r\n");
        let put = |out: &mut Vec<u8>, value: f64, size: usize| match (encoding, size) {
            (Encoding::Ascii, 4) => out.extend(format!("{} ", value as f32).bytes()),
            (Encoding::Ascii, _) => out.extend(format!("{value}\n").bytes()),
            (_, 1) => out.push(value as u8),
            (_, 2) => out.extend([0, 0]),
            (Encoding::Little, 4) => out.extend((value as f32).to_le_bytes()),
            (Encoding::Little, _) => out.extend(value.to_le_bytes()),
            (Encoding::Big, 4) => out.extend((value as f32).to_be_bytes()),
            (Encoding::Big, _) => out.extend(value.to_be_bytes()),
        };
        (0..2).for_each(|_| put(&mut out, 0.0, 2));
        for i in 0..splats.len() {
            put(&mut out, 200.0, 1);
            let mut row: Vec<f32> = splats.means[i].to_array().to_vec();
            row.extend(splats.quats[i]);
            row.extend(splats.log_scales[i].to_array());
            row.push(splats.logit_opacities[i]);
            row.extend(&splats.sh[i * splats.sh_width()..(i + 1) * splats.sh_width()]);
            for (value, name) in row.iter().zip(&names).rev() {
                put(&mut out, f64::from(*value), if name == "opacity" { 8 } else { 4 });
            }
        }
        out
    }

    #[test]
    fn round_trip_keeps_every_bit() {
        for degree in 0..=3 {
            let mut splats = RawSplats { antialiased: degree == 1, ..cloud(17, degree, 5) };
            splats.means[3].x = f32::MIN_POSITIVE / 8.0;
            splats.quats[0] = [-0.0, 1e-30, 1e30, 0.0];
            let again = read_ok(&bytes(&splats));
            assert_eq!(again, splats);
            assert_eq!(again.quats[0][0].to_bits(), (-0.0f32).to_bits());
        }
        assert_eq!(read_ok(&bytes(&cloud(0, 2, 1))).degree, 2);
    }

    #[test]
    fn kernels_round_trip_and_gaussians_add_no_properties() {
        let plain = cloud(9, 1, 5);
        let header = |s: &RawSplats| property_names(&bytes(s), "t.ply").unwrap();
        assert_eq!(header(&plain).last().unwrap(), "rot_3");
        let column = |from: f32| (0..9u8).map(|i| (from + 0.1 * f32::from(i)).min(1.0)).collect::<Vec<f32>>();
        let frequency = Kernel::Frequency { lambdas: column(0.0), betas: column(0.3) };
        for kernel in [frequency.clone(), Kernel::Acutance { acutances: column(-0.4) }] {
            let raw = RawSplats { kernel, ..plain.clone() };
            assert_eq!(read_ok(&bytes(&raw)), raw);
            assert_eq!(RawSplats::from_splats(&raw.to_splats().unwrap()).unwrap().kernel, raw.kernel);
        }
        let raw = RawSplats { kernel: frequency, ..plain };
        assert_eq!(header(&raw)[header(&cloud(9, 1, 5)).len()..], ["lambda_raw", "beta_raw", "lambda", "beta"]);
        // Without the values the logits are used, up to rounding; one of the two alone is an error.
        let text = bytes(&raw);
        let end = text.windows(11).position(|w| w == b"end_header\n").unwrap();
        let edited = |from: &str, to: &str| {
            let head = String::from_utf8_lossy(&text[..end]).replacen(from, to, 1);
            [head.as_bytes(), &text[end..]].concat()
        };
        let Kernel::Frequency { lambdas, betas } = read_ok(&edited("float lambda\n", "float unknown\n")).kernel else {
            panic!("a frequency kernel")
        };
        for (got, want) in lambdas.iter().chain(&betas).zip(column(0.0).iter().chain(&column(0.3))) {
            assert!((got - want).abs() < 2e-6, "{got} {want}");
        }
        let half = edited("float beta_raw\n", "float beta_xyz\n").to_vec();
        let half = String::from_utf8_lossy(&half[..end]).replacen("float beta\n", "float other\n", 1).into_bytes();
        assert!(read_err(&[&half, &text[end..]].concat()).contains("`property beta_raw` is missing"));
    }

    #[test]
    fn formats_without_kernels_refuse_them() {
        let kernel = |l: f32| Kernel::Frequency { lambdas: vec![l; 2], betas: vec![0.5; 2] };
        let error = |s: &RawSplats| {
            let spz = super::super::spz::write(s, &Default::default(), &mut Vec::new());
            let splat = super::super::splat::write(s, &mut Vec::new());
            [spz, splat].map(|r| r.err().map(|e| e.to_string()))
        };
        let raw = RawSplats { kernel: kernel(0.6), ..cloud(2, 0, 1) };
        assert!(error(&raw).iter().flatten().filter(|e| e.contains("write a .ply")).count() == 2);
        assert_eq!(error(&RawSplats { kernel: kernel(0.5), ..raw }), [None, None]);
    }

    #[test]
    fn properties_are_found_by_name_in_every_encoding() {
        for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
            for degree in [0, 1, 3] {
                let splats = cloud(5, degree, 6);
                assert_eq!(read_ok(&shuffled(&splats, encoding)), splats, "{encoding:?} degree {degree}");
            }
        }
    }

    #[test]
    fn channel_major_rest() {
        let text = bytes(&cloud(1, 1, 7));
        let splats = read_ok(&text);
        let rest: Vec<String> = (0..9).map(|i| format!("f_rest_{i}")).collect();
        let names: Vec<&str> = rest.iter().map(String::as_str).collect();
        let flat = read_columns(&text, "t.ply", &Limits::default(), &names).unwrap();
        for c in 0..3 {
            for k in 1..4 {
                assert_eq!(flat[c * 3 + k - 1], splats.sh[3 * k + c]);
            }
        }
        assert_eq!(property_names(&text, "t.ply").unwrap()[3], "nx");
    }

    #[test]
    fn a_bad_value_is_named_by_row_and_property() {
        let good = cloud(4, 1, 8);
        for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
            let mut s = good.clone();
            s.log_scales[2].y = f32::NAN;
            assert!(read_err(&shuffled(&s, encoding)).contains("row 2, `scale_1` = NaN"));
            let mut s = good.clone();
            s.sh[12 + 3 * 2 + 1] = f32::NEG_INFINITY;
            assert!(read_err(&shuffled(&s, encoding)).contains("row 1, `f_rest_4` = -inf"));
            let lax = Limits { allow_non_finite: true, ..Limits::default() };
            let kept = read(&shuffled(&s, encoding), "t.ply", &lax).unwrap();
            assert_eq!(kept.non_finite_rows(), vec![(1, "sh")]);
        }
    }

    #[test]
    fn infinite_opacity_logits_become_finite() {
        let mut s = cloud(3, 0, 10);
        s.logit_opacities = vec![f32::INFINITY, f32::NEG_INFINITY, 20.0];
        let got = read_ok(&bytes(&s)).logit_opacities;
        assert_eq!(got, [finite_logit(1.0), finite_logit(0.0), 20.0]);
        let lax = Limits { allow_non_finite: true, ..Limits::default() };
        assert_eq!(read(&bytes(&s), "t.ply", &lax).unwrap(), s);
        s.logit_opacities[1] = f32::NAN;
        assert!(read_err(&bytes(&s)).contains("row 1, `opacity` = NaN"));
    }

    #[test]
    fn wrong_shapes_are_named() {
        let good = String::from_utf8_lossy(&bytes(&cloud(0, 1, 9))).into_owned();
        let error = |from: &str, to: &str| read_err(good.replacen(from, to, 1).as_bytes());
        assert!(error("property float rot_3\n", "").contains("`property rot_3` is missing"));
        assert!(error("float nx", "float x").contains("`x` appears twice"));
        assert!(error("property float f_rest_8\n", "").contains("8 `f_rest` properties"));
        assert!(error("f_rest_8", "f_rest_08").contains("`property f_rest_8` is missing"));
        assert!(error("vertex 0", "vertex 1").contains("needs 104 bytes, only 0 are there"));
        let mut long = bytes(&cloud(2, 0, 9));
        long.push(0);
        assert!(read_err(&long).contains("1 bytes follow the last row"));
        long.truncate(long.len() - 2);
        assert!(read_err(&long).contains("needs 136 bytes, only 135 are there"));
        let text = shuffled(&cloud(2, 0, 9), Encoding::Ascii);
        assert!(read_err(&[text.as_slice(), b" 7"].concat()).contains("`7` follows the last row"));
        assert!(read_err(&text[..text.len() - 40]).contains("bytes"));
        let broken = String::from_utf8_lossy(&text).replacen("200", "zzz", 1);
        assert_eq!(read_ok(broken.as_bytes()), cloud(2, 0, 9), "a skipped property is not parsed");
    }
}
