//! Binary glTF with the extension `KHR_gaussian_splatting`: plain Gaussians as a point primitive, exact in `f32`.
//!
//! The extension stores activated values: linear scales, opacities in `[0, 1]`, unit quaternions `(x, y, z, w)`; SH
//! coefficients are one attribute each, with the signs of [`crate::sh`]. glTF's axes are left, up, front: x and y of `.ply`
//! files change sign on the way in and out. `COLOR_0` holds degree 0 for viewers that render points.
//!
//! The reader takes the first primitive with the extension, from the file's own binary chunk, attributes `f32`. Node
//! transforms are not applied; other glTF features need a glTF library.

use super::error::{At, Source};
use super::raw::{finite_logit, log_scale};
use super::{IoError, Limits, RawSplats, sigmoid};
use crate::{rot, sh};
use glam::Vec3;
use serde_json::{Value, json};
use std::io::Write;

const MAGIC: &[u8; 4] = b"glTF";
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BINARY_CHUNK: u32 = 0x004E_4942;
const EXTENSION: &str = "KHR_gaussian_splatting";
/// Axes whose signs differ between `.ply` and glTF.
const FLIPPED: [bool; 3] = [true, true, false];
/// glTF's component type of `f32`.
const FLOAT: u64 = 5126;
const POINTS: u64 = 0;

/// Name of an attribute of the extension.
fn own(name: &str) -> String {
    format!("{EXTENSION}:{name}")
}

/// Names of the SH attributes of a degree, in the order of [`RawSplats::sh`].
fn sh_names(degree: u8) -> impl Iterator<Item = String> {
    (0..=degree).flat_map(|l| (0..=2 * l).map(move |k| own(&format!("SH_DEGREE_{l}_COEF_{k}"))))
}

/// One vertex attribute to write.
struct Attribute {
    name: String,
    width: usize,
    values: Vec<f32>,
}

/// All attributes of the splats, in file order.
fn attributes(splats: &RawSplats) -> Vec<Attribute> {
    let new = |name: String, width, values| Attribute { name, width, values };
    let unit_xyzw = |q: &[f32; 4]| match rot::normalise(*q).wxyz {
        [0.0, 0.0, 0.0, 0.0] => [0.0, 0.0, 0.0, 1.0],
        [w, x, y, z] => [x, y, z, w],
    };
    let opacities: Vec<f32> = splats.logit_opacities.iter().map(|&o| sigmoid(o)).collect();
    let rows = || splats.sh.chunks_exact(splats.sh_width());
    let color = |(row, &o): (&[f32], &f32)| {
        let channel = |k: usize| (0.5 + sh::C0 as f32 * row.get(k).copied().unwrap_or(0.0)).clamp(0.0, 1.0);
        [channel(0), channel(1), channel(2), o]
    };
    let mut out = vec![
        new("POSITION".into(), 3, splats.means.iter().flat_map(|m| m.to_array()).collect()),
        new("COLOR_0".into(), 4, rows().zip(&opacities).flat_map(color).collect()),
        new(own("ROTATION"), 4, splats.quats.iter().flat_map(unit_xyzw).collect()),
        new(own("SCALE"), 3, splats.log_scales.iter().flat_map(|s| s.to_array().map(f32::exp)).collect()),
        new(own("OPACITY"), 1, opacities.clone()),
    ];
    for (k, name) in sh_names(splats.degree).enumerate() {
        out.push(new(name, 3, rows().flat_map(|r| r.iter().skip(3 * k).take(3).copied()).collect()));
    }
    out
}

/// The content of the JSON chunk.
fn document(splats: &RawSplats, attributes: &[Attribute]) -> Value {
    let (mut views, mut accessors, mut named, mut at) = (Vec::new(), Vec::new(), serde_json::Map::new(), 0);
    for (k, attribute) in attributes.iter().enumerate() {
        let bytes = attribute.values.len() * 4;
        views.push(json!({"buffer": 0, "byteOffset": at, "byteLength": bytes, "target": 34962}));
        let kind = match attribute.width {
            1 => "SCALAR",
            3 => "VEC3",
            _ => "VEC4",
        };
        accessors.push(json!({"bufferView": k, "componentType": FLOAT, "count": splats.len(), "type": kind}));
        named.insert(attribute.name.clone(), json!(k));
        at += bytes;
    }
    // glTF requires the bounds of positions.
    let bound = |f: fn(Vec3, Vec3) -> Vec3| splats.means.iter().copied().reduce(f).unwrap_or_default().to_array();
    if let Some(position) = accessors.first_mut().and_then(Value::as_object_mut) {
        position.insert("min".into(), json!(bound(Vec3::min)));
        position.insert("max".into(), json!(bound(Vec3::max)));
    }
    let extension = json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
        "projection": "perspective", "sortingMethod": "cameraDistance",
    });
    json!({
        "asset": {"version": "2.0", "generator": "gs4d"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"mode": POINTS, "attributes": named, "extensions": {EXTENSION: extension}}]}],
        "buffers": [{"byteLength": at}],
        "bufferViews": views,
        "accessors": accessors,
    })
}

/// Writes splats as binary glTF with the extension.
///
/// # Errors
/// No splats, columns of unequal length, another kernel than the Gaussian, a value that is not finite, more than 4 GiB (as `InvalidInput`),
/// or the writer's own.
pub fn write(splats: &RawSplats, out: &mut dyn Write) -> std::io::Result<()> {
    let invalid = |text: String| std::io::Error::new(std::io::ErrorKind::InvalidInput, text);
    splats.check_shape().map_err(|e| invalid(e.to_string()))?;
    splats.refuse_kernel("binary glTF")?;
    if splats.is_empty() {
        return Err(invalid("glTF cannot store a scene without splats".into()));
    }
    if let Some((row, column)) = splats.non_finite_rows().first() {
        return Err(invalid(format!("row {row}, `{column}` is not finite")));
    }
    let turned = splats.clone().flipped(FLIPPED);
    let attributes = attributes(&turned);
    let mut text = serde_json::to_vec(&document(&turned, &attributes))?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary: usize = attributes.iter().map(|a| a.values.len() * 4).sum();
    let size = |n: usize| u32::try_from(n).map_err(|_| invalid("more than 4 GiB".into()));
    out.write_all(MAGIC)?;
    for word in [2, size(12 + 16 + text.len() + binary)?, size(text.len())?, JSON_CHUNK] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(&text)?;
    out.write_all(&size(binary)?.to_le_bytes())?;
    out.write_all(&BINARY_CHUNK.to_le_bytes())?;
    for attribute in &attributes {
        let bytes: Vec<u8> = attribute.values.iter().flat_map(|v| v.to_le_bytes()).collect();
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// The JSON and the binary chunk of a file.
fn chunks<'a>(bytes: &'a [u8], src: Source<'_>) -> Result<(&'a [u8], &'a [u8]), IoError> {
    let word = |at: usize| -> Result<u64, IoError> {
        let found = bytes.get(at..).and_then(|b| b.first_chunk::<4>());
        found.map(|b| u64::from(u32::from_le_bytes(*b))).ok_or_else(|| src.truncated("a header", at, 4, bytes.len()))
    };
    if !bytes.starts_with(MAGIC) || word(4)? != 2 {
        return Err(src.malformed(At::Byte(0), "no glTF 2 header", "give a .glb file of version 2"));
    }
    let chunk = |at: usize, kind: u32, name: &'static str| -> Result<(&'a [u8], usize), IoError> {
        let (length, found) = (word(at)?, word(at + 4)?);
        if found != u64::from(kind) {
            return Err(src.malformed(At::Byte(at as u64), format!("no chunk `{name}`"), "write the file again"));
        }
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        let end = (at + 8).saturating_add(length);
        let content = bytes.get(at + 8..end);
        Ok((content.ok_or_else(|| src.truncated(name, at + 8, length as u64, bytes.len()))?, end))
    };
    let (text, next) = chunk(12, JSON_CHUNK, "JSON")?;
    Ok((text, chunk(next, BINARY_CHUNK, "BIN")?.0))
}

/// Resolves the accessors of a document.
struct Reader<'a> {
    document: Value,
    binary: &'a [u8],
    src: Source<'a>,
}

impl Reader<'_> {
    fn list<'v>(&'v self, name: &'static str, index: u64) -> Result<&'v Value, IoError> {
        let entry = usize::try_from(index).ok().and_then(|i| self.document.get(name)?.get(i));
        entry.ok_or_else(|| self.src.missing(At::Byte(0), format!("{name}[{index}]"), "write the file again"))
    }

    /// The first primitive with the extension.
    fn primitive(&self) -> Result<&Value, IoError> {
        let meshes = self.document.get("meshes").and_then(Value::as_array).into_iter().flatten();
        let mut primitives = meshes.filter_map(|m| m.get("primitives")?.as_array()).flatten();
        let splats = primitives.find(|p| p.get("extensions").is_some_and(|e| e.get(EXTENSION).is_some()));
        let splats =
            splats.ok_or_else(|| self.src.unsupported("a glTF file without Gaussian splats", "give splats"))?;
        let kernel = splats.pointer(&format!("/extensions/{EXTENSION}/kernel")).and_then(Value::as_str);
        if kernel.is_some_and(|k| k != "ellipse") {
            return Err(self.src.unsupported(format!("the kernel {kernel:?}"), "export with the kernel `ellipse`"));
        }
        let inner = splats.pointer(&format!("/extensions/{EXTENSION}/extensions"));
        match inner.and_then(Value::as_object).and_then(|e| e.keys().next()) {
            Some(name) => Err(self.src.unsupported(format!("the extension `{name}`"), "export without compression")),
            None => Ok(splats),
        }
    }

    /// `count` and values `[count, width]` of an attribute; `None` if it is absent.
    fn column(&self, primitive: &Value, name: &str, width: usize) -> Result<Option<(u64, Vec<f32>)>, IoError> {
        let Some(index) = primitive.pointer("/attributes").and_then(|a| a.get(name)?.as_u64()) else { return Ok(None) };
        let accessor = self.list("accessors", index)?;
        let number = |v: &Value, field: &str| v.get(field).and_then(Value::as_u64).unwrap_or(0);
        let components = match accessor.get("type").and_then(Value::as_str) {
            Some("SCALAR") => 1,
            Some("VEC3") => 3,
            Some("VEC4") => 4,
            _ => 0,
        };
        if number(accessor, "componentType") != FLOAT || components != width || accessor.get("sparse").is_some() {
            let what = format!("`{name}` in another form than {width} plain f32");
            return Err(self.src.unsupported(what, "export without quantisation"));
        }
        let view = self.list("bufferViews", number(accessor, "bufferView"))?;
        if number(view, "buffer") != 0 {
            return Err(self.src.unsupported("a second buffer", "pack everything into the .glb"));
        }
        let (count, row) = (number(accessor, "count"), 4 * width as u64);
        let stride = view.get("byteStride").and_then(Value::as_u64).unwrap_or(row).max(row);
        let within = number(accessor, "byteOffset");
        let need = count.saturating_sub(1).saturating_mul(stride).saturating_add(row).saturating_add(within);
        let start = number(view, "byteOffset");
        let bytes = usize::try_from(start).ok().and_then(|s| self.binary.get(s..)).unwrap_or_default();
        if count > 0 && need > number(view, "byteLength").min(bytes.len() as u64) {
            return Err(self.src.truncated(name, 0, start.saturating_add(need), self.binary.len()));
        }
        // From here on everything lies inside the bytes present.
        let mut values = Vec::with_capacity(count as usize * width);
        for k in 0..count as usize {
            let at = within as usize + k * stride as usize;
            let row = bytes.get(at..at + row as usize).unwrap_or_default();
            values.extend(row.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)));
        }
        Ok(Some((count, values)))
    }

    /// As [`Self::column`] for a required attribute of `count` rows.
    fn needed(&self, primitive: &Value, name: &str, width: usize, count: u64) -> Result<Vec<f32>, IoError> {
        match self.column(primitive, name, width)? {
            Some((n, values)) if n == count => Ok(values),
            Some((n, _)) => {
                let what = format!("`{name}` has {n} rows, POSITION {count}");
                Err(self.src.malformed(At::Byte(0), what, "write the file again"))
            }
            None => Err(self.src.missing(At::Byte(0), name, "the extension requires it; export again")),
        }
    }
}

/// Reads splats of a binary glTF file.
///
/// # Errors
/// Bytes that are no such file, attributes that are missing, of unequal length, quantised or compressed, values outside
/// their domain or not finite.
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<RawSplats, IoError> {
    let src = Source { file, format: "glTF" };
    let (text, binary) = chunks(bytes, src)?;
    let parsed = serde_json::from_slice(text);
    let document = parsed.map_err(|e| src.malformed(At::Byte(20), e.to_string(), "write the file again"))?;
    let reader = Reader { document, binary, src };
    let primitive = reader.primitive()?;
    let position = reader.column(primitive, "POSITION", 3)?;
    let (count, means) = position.ok_or_else(|| src.missing(At::Byte(0), "POSITION", "export again"))?;
    let degree = degree(primitive);
    let rows = limits.splats(src, count, RawSplats::row_bytes(degree))?;
    let mut out = RawSplats::with_capacity(rows, degree);
    let vec3 = |values: &[f32]| values.as_chunks::<3>().0.iter().map(|v| Vec3::from_array(*v)).collect::<Vec<_>>();
    out.means = vec3(&means);
    let quats = reader.needed(primitive, &own("ROTATION"), 4, count)?;
    out.quats = quats.as_chunks::<4>().0.iter().map(|&[x, y, z, w]| [w, x, y, z]).collect();
    let scales = vec3(&reader.needed(primitive, &own("SCALE"), 3, count)?);
    if let Some(row) = scales.iter().position(|s| s.min_element() < 0.0) {
        let value = scales.get(row).map_or(0.0, |s| s.min_element());
        return Err(src.value(row, "SCALE", f64::from(value), "a linear scale must not be negative"));
    }
    out.log_scales = scales.iter().map(|s| Vec3::from_array(s.to_array().map(log_scale))).collect();
    let opacities = reader.needed(primitive, &own("OPACITY"), 1, count)?;
    if let Some((row, value)) = opacities.iter().enumerate().find(|(_, o)| !(0.0..=1.0).contains(*o)) {
        return Err(src.value(row, "OPACITY", f64::from(*value), "an opacity is between 0 and 1"));
    }
    out.logit_opacities = opacities.iter().map(|&o| finite_logit(o)).collect();
    let names: Vec<String> = sh_names(degree).collect();
    let columns = names.iter().map(|n| reader.needed(primitive, n, 3, count)).collect::<Result<Vec<_>, _>>()?;
    out.sh = (0..rows).flat_map(|r| columns.iter().flat_map(move |c| c.iter().skip(3 * r).take(3).copied())).collect();
    out.refuse_non_finite(src, limits)?;
    Ok(out.flipped(FLIPPED))
}

/// The largest degree whose first coefficient is present, at most 3; missing lower ones are an error when read.
fn degree(primitive: &Value) -> u8 {
    let has = |l: &u8| {
        primitive.pointer("/attributes").is_some_and(|a| a.get(own(&format!("SH_DEGREE_{l}_COEF_0"))).is_some())
    };
    (1..=sh::MAX_DEGREE).rev().find(has).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::super::raw::tests::cloud;
    use super::*;
    use crate::rng::Rng;

    fn encode(splats: &RawSplats) -> Vec<u8> {
        let mut out = Vec::new();
        write(splats, &mut out).unwrap();
        out
    }

    fn read_all(bytes: &[u8]) -> Result<RawSplats, IoError> {
        read(bytes, "t.glb", &Limits::default())
    }

    #[test]
    fn writing_and_reading_round_trips() {
        for degree in 0..=3 {
            let raw = cloud(40, degree, 5);
            let again = read_all(&encode(&raw)).unwrap();
            assert_eq!((&again.means, &again.sh, again.degree), (&raw.means, &raw.sh, degree));
            for (a, b) in again.log_scales.iter().zip(&raw.log_scales) {
                assert!((*a - *b).abs().max_element() < 2e-6);
            }
            for (a, b) in again.quats.iter().zip(&raw.quats) {
                let unit = rot::normalise(*b).wxyz;
                assert!(a.iter().zip(unit).all(|(a, b)| (a - b).abs() < 1e-6));
            }
            for (a, b) in again.logit_opacities.iter().zip(&raw.logit_opacities) {
                assert!((sigmoid(*a) - sigmoid(*b)).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn splats_that_gltf_cannot_store_are_refused() {
        let mut raw = cloud(3, 0, 1);
        raw.kernel = crate::Kernel::Acutance { acutances: vec![0.5; 3] };
        assert!(write(&raw, &mut Vec::new()).unwrap_err().to_string().contains("another kernel"));
        let mut raw = cloud(3, 0, 1);
        raw.means[1].y = f32::NAN;
        assert!(write(&raw, &mut Vec::new()).unwrap_err().to_string().contains("row 1"));
        assert!(write(&RawSplats::default(), &mut Vec::new()).is_err());
    }

    /// The file with its JSON edited.
    fn edited(bytes: &[u8], edit: impl Fn(&mut Value)) -> Vec<u8> {
        let (text, binary) = chunks(bytes, Source { file: "t", format: "glTF" }).unwrap();
        let mut document: Value = serde_json::from_slice(text).unwrap();
        edit(&mut document);
        let mut text = serde_json::to_vec(&document).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut out = MAGIC.to_vec();
        for word in [2, (28 + text.len() + binary.len()) as u32, text.len() as u32, JSON_CHUNK] {
            out.extend(word.to_le_bytes());
        }
        out.extend(text);
        out.extend((binary.len() as u32).to_le_bytes());
        out.extend(BINARY_CHUNK.to_le_bytes());
        out.extend(binary);
        out
    }

    #[test]
    fn errors_name_the_cause() {
        let good = encode(&cloud(5, 1, 2));
        type Edit = fn(&mut Value);
        let cases: [(Edit, &str); 8] = [
            (|d| d["accessors"][2]["count"] = json!(4), "has 4 rows"),
            (|d| d["accessors"][0]["count"] = json!(1u64 << 60), "POSITION"),
            (|d| d["accessors"][3]["componentType"] = json!(5123), "SCALE"),
            (|d| d["bufferViews"][2]["buffer"] = json!(1), "a second buffer"),
            // Centres instead of opacities.
            (|d| d["accessors"][4]["bufferView"] = json!(0), "an opacity is between 0 and 1"),
            (|d| d["meshes"][0]["primitives"][0]["extensions"] = json!({}), "without Gaussian splats"),
            (|d| d["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["kernel"] = json!("box"), "box"),
            (|d| d["bufferViews"][0]["byteOffset"] = json!(u64::MAX), "POSITION"),
        ];
        for (k, (edit, want)) in cases.iter().enumerate() {
            let text = read_all(&edited(&good, edit)).unwrap_err().to_string();
            assert!(text.contains(want), "case {k}: {text}");
        }
    }

    #[test]
    fn any_bytes_give_a_value_or_an_error() {
        let good = encode(&cloud(6, 2, 3));
        for cut in 0..good.len() {
            assert!(read_all(&good[..cut]).is_err(), "cut at {cut}");
        }
        let mut rng = Rng::new(7, "glb fuzz", 0, 0);
        for _ in 0..3000 {
            let mut bytes = good.clone();
            for _ in 0..=(rng.uniform() * 4.0) as usize {
                let at = ((rng.uniform() * bytes.len() as f32) as usize).min(bytes.len() - 1);
                bytes[at] = (rng.uniform() * 256.0) as u8;
            }
            let _ = read_all(&bytes);
        }
    }
}
