//! SOG (PlayCanvas, "spatially ordered Gaussians"), version 2: quantised splats in lossless WebP images, about a fifteenth of the
//! `.ply`. Read: one `.sog` archive, or `meta.json` with its images beside it.
//!
//! Source: the format's specification (developer.playcanvas.com, version 2), and splat-transform 2.7 (MIT), facts only. Splat `i` is
//! pixel `i` of every image, row by row:
//!
//! ```text
//! means_l, means_u   3 × u16, low and high bytes     n = min + (max − min) v / 65535,   x = sign(n) (exp|n| − 1)
//! scales             3 × u8   log-scale  = codebook[v]
//! quats              3 × u8   (v / 255 − ½) √2: the components in the order w, x, y, z without the largest, which is
//!                             number alpha − 252 and not negative
//! sh0                3 × u8   f_dc = codebook[v]       alpha: 255 · opacity
//! shN_labels         u16      row of the palette
//! shN_centroids      3 × u8   f_rest = codebook[v]: 64 rows of the palette a line, a pixel per coefficient
//! ```
//! Axes are those of `.ply`, as the tools that write the format leave them. Version 1 and streamed scenes (`lod-meta.json`) are refused
//! by name.
//!
//! ```no_run
//! use gs_core::io::{Limits, load_splats};
//!
//! let splats = load_splats("scene.sog".as_ref(), &Limits::default())?; // or "scene/meta.json"
//! # Ok::<(), gs_core::io::IoError>(())
//! ```

use super::error::{At, Source};
use super::images::{Rgba8, decode_webp};
use super::raw::finite_logit;
use super::{IoError, Limits, RawSplats, folder_of, read_file, zip};
use crate::sh;
use glam::Vec3;
use serde::Deserialize;
use std::fs;
use std::path::Path;

/// Largest `meta.json`: three codebooks have 20 kB.
const MAX_META: usize = 1 << 20;
/// Palette rows in a line of `shN_centroids`.
const PER_LINE: usize = 64;
/// Alpha of a quaternion whose first component is the largest.
const FIRST_MODE: u8 = 252;
const ADVICE: &str = "export the scene again";

/// What a file says beside its splats.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SogHeader {
    /// Number of splats.
    pub count: usize,
    /// SH degree, 0 to 3.
    pub degree: u8,
    /// Whether the cloud was trained with the antialiased projection: `antialias` is true, or `model` is `antialiased`, as
    /// splat-transform writes since version 3.
    pub antialiased: bool,
}

#[derive(Deserialize)]
struct Meta {
    version: Option<u64>,
    #[serde(default)]
    count: u64,
    #[serde(default)]
    antialias: bool,
    #[serde(default)]
    model: serde_json::Value,
    means: Option<Means>,
    scales: Option<Coded>,
    quats: Option<Files>,
    sh0: Option<Coded>,
    #[serde(rename = "shN")]
    rest: Option<Palette>,
}

#[derive(Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Deserialize)]
struct Files {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Coded {
    codebook: Vec<f32>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct Palette {
    count: u64,
    bands: u8,
    codebook: Vec<f32>,
    files: [String; 2],
}

/// Reads a `.sog` archive held in memory. `file` is the name used in errors.
///
/// # Errors
/// No archive, a member that is missing or damaged, another version, values outside their codebooks, more than the limits allow.
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<(SogHeader, RawSplats), IoError> {
    let meta = zip::member(bytes, file, "meta.json", limits)?;
    read_with(&meta, file, limits, bytes.len(), &|name| zip::member(bytes, file, name, limits))
}

/// Reads `meta.json` and the images beside it.
///
/// # Errors
/// As [`read()`]; a file that cannot be read.
pub fn load(meta: &Path, limits: &Limits) -> Result<(SogHeader, RawSplats), IoError> {
    let folder = folder_of(meta);
    let text = read_file(meta, limits)?;
    let sizes = fs::read_dir(folder).into_iter().flatten().flatten().filter_map(|entry| entry.metadata().ok());
    let packed = usize::try_from(sizes.fold(0u64, |sum, m| sum.saturating_add(m.len()))).unwrap_or(usize::MAX);
    read_with(&text, &meta.display().to_string(), limits, packed, &|name| read_file(&folder.join(name), limits))
}

/// Reads from `meta.json` and a function from names to contents; `packed` is the size of all files, bytes.
fn read_with(
    meta: &[u8],
    file: &str,
    limits: &Limits,
    packed: usize,
    get: &dyn Fn(&str) -> Result<Vec<u8>, IoError>,
) -> Result<(SogHeader, RawSplats), IoError> {
    let src = Source { file, format: "SOG" };
    if meta.len() > MAX_META {
        return Err(src.limit("size of meta.json", meta.len() as u64, MAX_META as u64, "max_bytes"));
    }
    let broken = |what: String| src.malformed(At::Byte(0), what, ADVICE);
    let meta: Meta = serde_json::from_slice(meta).map_err(|e| broken(format!("meta.json: {e}")))?;
    match meta.version {
        Some(2) => {}
        None => return Err(src.unsupported("SOG version 1", "convert it with splat-transform, which writes version 2")),
        Some(v) => return Err(src.unsupported(format!("SOG version {v}"), "export it as version 2, or as .ply")),
    }
    let missing = |field: &str| src.missing(At::Byte(0), format!("meta.json: {field}"), ADVICE);
    let (means, scales) = (meta.means.ok_or_else(|| missing("means"))?, meta.scales.ok_or_else(|| missing("scales"))?);
    let (quats, sh0) = (meta.quats.ok_or_else(|| missing("quats"))?, meta.sh0.ok_or_else(|| missing("sh0"))?);
    let degree = meta.rest.as_ref().map_or(0, |p| p.bands);
    if degree > sh::MAX_DEGREE {
        return Err(src.unsupported(format!("SOG with {degree} bands"), "export it with degree 3 or less"));
    }
    let count = limits.splats(src, meta.count, RawSplats::row_bytes(degree))?;
    limits.expansion(src, meta.count.saturating_mul(RawSplats::row_bytes(degree) as u64), packed)?;
    let images = Images { src, limits, get, count };
    let mut out = RawSplats::with_capacity(0, degree);
    out.antialiased = meta.antialias || meta.model == "antialiased";
    images.means(&means, &mut out)?;
    images.quats(&quats.files[0], &mut out)?;
    let log_scales = images.coded(&scales, "scales")?;
    out.log_scales = log_scales.iter().map(|(v, _)| Vec3::from_array(*v)).collect();
    let colors = images.coded(&sh0, "sh0")?;
    out.logit_opacities = colors.iter().map(|(_, a)| finite_logit(f32::from(*a) / 255.0)).collect();
    let rest = match &meta.rest {
        Some(palette) if palette.bands > 0 => images.rest(palette)?,
        _ => Vec::new(),
    };
    let width = 3 * (sh::coeffs(degree) - 1);
    for (i, (color, _)) in colors.iter().enumerate() {
        out.sh.extend_from_slice(color);
        out.sh.extend_from_slice(rest.get(i * width..(i + 1) * width).unwrap_or_default());
    }
    out.refuse_non_finite(src, limits)?;
    Ok((SogHeader { count, degree, antialiased: out.antialiased }, out))
}

/// The images of a scene.
struct Images<'a> {
    src: Source<'a>,
    limits: &'a Limits,
    get: &'a dyn Fn(&str) -> Result<Vec<u8>, IoError>,
    count: usize,
}

impl Images<'_> {
    /// An image by its name, which must be that of a file beside `meta.json`.
    fn image(&self, name: &str) -> Result<Rgba8, IoError> {
        if name.is_empty() || name.starts_with('.') || name.contains(['/', '\\', ':', '\0']) {
            let what = format!("meta.json names the file {name:?}, which is not one beside it");
            return Err(self.src.malformed(At::Byte(0), what, ADVICE));
        }
        decode_webp(&(self.get)(name)?, &format!("{}: {name}", self.src.file), self.limits)
    }

    /// The pixels of all splats.
    fn pixels(&self, name: &str) -> Result<Vec<[u8; 4]>, IoError> {
        let image = self.image(name)?;
        let mut pixels = image.data.as_chunks().0.to_vec();
        if pixels.len() < self.count {
            let what = format!("{name} has {} pixels, meta.json counts {} splats", pixels.len(), self.count);
            return Err(self.src.malformed(At::Byte(0), what, ADVICE));
        }
        pixels.truncate(self.count);
        Ok(pixels)
    }

    fn means(&self, means: &Means, out: &mut RawSplats) -> Result<(), IoError> {
        let [low, high] = [0, 1].map(|k| means.files.get(k).map_or("", String::as_str));
        let (low, high) = (self.pixels(low)?, self.pixels(high)?);
        let ranges = [0, 1, 2].map(|a| {
            let at = |of: &[f64; 3]| of.get(a).copied().unwrap_or_default();
            (at(&means.mins), at(&means.maxs))
        });
        for ([lx, ly, lz, _], [hx, hy, hz, _]) in low.iter().zip(&high) {
            let of = |low: u8, high: u8, (min, max): (f64, f64)| {
                let n = min + (max - min) * f64::from(u16::from_le_bytes([low, high])) / 65_535.0;
                (n.signum() * (n.abs().exp() - 1.0)) as f32
            };
            let [x, y, z] = ranges;
            out.means.push(Vec3::new(of(*lx, *hx, x), of(*ly, *hy, y), of(*lz, *hz, z)));
        }
        Ok(())
    }

    fn quats(&self, name: &str, out: &mut RawSplats) -> Result<(), IoError> {
        for (row, [a, b, c, mode]) in self.pixels(name)?.into_iter().enumerate() {
            let [a, b, c] = [a, b, c].map(|v| (f32::from(v) / 255.0 - 0.5) * std::f32::consts::SQRT_2);
            let d = (1.0 - a * a - b * b - c * c).max(0.0).sqrt();
            out.quats.push(match mode.checked_sub(FIRST_MODE) {
                Some(0) => [d, a, b, c],
                Some(1) => [a, d, b, c],
                Some(2) => [a, b, d, c],
                Some(_) => [a, b, c, d],
                None => return Err(self.src.value(row, "quats", mode.into(), "its alpha is 252 to 255")),
            });
        }
        Ok(())
    }

    /// Three values of a codebook for each splat, and its alpha.
    fn coded(&self, coded: &Coded, what: &str) -> Result<Vec<([f32; 3], u8)>, IoError> {
        let pixels = self.pixels(&coded.files[0])?;
        let values = pixels
            .iter()
            .enumerate()
            .map(|(row, [r, g, b, a])| Ok((self.values(&coded.codebook, [*r, *g, *b], row, what)?, *a)));
        values.collect()
    }

    fn values(&self, codebook: &[f32], [r, g, b]: [u8; 3], row: usize, what: &str) -> Result<[f32; 3], IoError> {
        let value = |v: u8| {
            let found = codebook.get(usize::from(v)).copied();
            found.ok_or_else(|| self.src.value(row, what, v.into(), "it must be a row of the codebook"))
        };
        Ok([value(r)?, value(g)?, value(b)?])
    }

    /// The SH coefficients beyond the first, colour fastest.
    fn rest(&self, palette: &Palette) -> Result<Vec<f32>, IoError> {
        let coefficients = sh::coeffs(palette.bands) - 1;
        let [centroids, labels] = [0, 1].map(|k| palette.files.get(k).map_or("", String::as_str));
        let image = self.image(centroids)?;
        if image.width != PER_LINE * coefficients {
            let what = format!("{centroids} is {} pixels wide, not {}", image.width, PER_LINE * coefficients);
            return Err(self.src.malformed(At::Byte(0), what, ADVICE));
        }
        let pixels = image.data.as_chunks::<4>().0;
        let mut out = Vec::with_capacity(3 * coefficients * self.count);
        for (row, [low, high, ..]) in self.pixels(labels)?.into_iter().enumerate() {
            let label = usize::from(u16::from_le_bytes([low, high]));
            let outside = || self.src.value(row, "shN", label as f64, "it must be a row of the palette");
            // The rows of a line lie side by side, so that a row's pixels follow one another.
            let entry =
                pixels.get(label * coefficients..(label + 1) * coefficients).filter(|_| (label as u64) < palette.count);
            for [r, g, b, _] in entry.ok_or_else(outside)? {
                out.extend(self.values(&palette.codebook, [*r, *g, *b], row, "shN")?);
            }
        }
        Ok(out)
    }
}
