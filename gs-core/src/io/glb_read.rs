//! Reading binary glTF: chunks, accessors, primitives of splats.

use super::error::{At, Source};
use super::glb::{BINARY_CHUNK, COLOR_SPACE, EXTENSION, FLOAT, JSON_CHUNK, MAGIC, own, sh_names};
use super::glb_scene::GlbScene;
use super::raw::{finite_logit, log_scale};
use super::{IoError, Limits, RawSplats};
use crate::sh;
use glam::Vec3;
use serde_json::Value;

/// Most bytes of parsed JSON for each `{`, `[` or `,` in its text.
const MARK_BYTES: u64 = 384;

/// The JSON and the binary chunk of a file.
pub(super) fn chunks<'a>(bytes: &'a [u8], src: Source<'_>) -> Result<(&'a [u8], &'a [u8]), IoError> {
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
pub(super) struct Reader<'a> {
    pub(super) document: Value,
    binary: &'a [u8],
    pub(super) src: Source<'a>,
}

impl Reader<'_> {
    fn list<'v>(&'v self, name: &'static str, index: u64) -> Result<&'v Value, IoError> {
        let entry = usize::try_from(index).ok().and_then(|i| self.document.get(name)?.get(i));
        entry.ok_or_else(|| self.src.missing(At::Byte(0), format!("{name}[{index}]"), "write the file again"))
    }

    /// The primitives with the extension, with the mesh of each.
    fn primitives(&self) -> Result<Vec<(usize, &Value)>, IoError> {
        let meshes = self.document.get("meshes").and_then(Value::as_array).into_iter().flatten().enumerate();
        let all = meshes.flat_map(|(mesh, m)| {
            let list = m.get("primitives").and_then(Value::as_array).into_iter().flatten();
            list.map(move |p| (mesh, p))
        });
        let splats: Vec<_> =
            all.filter(|(_, p)| p.get("extensions").is_some_and(|e| e.get(EXTENSION).is_some())).collect();
        if splats.is_empty() {
            return Err(self.src.unsupported("a glTF file without Gaussian splats", "give splats"));
        }
        splats.iter().try_for_each(|(_, p)| self.check(p))?;
        Ok(splats)
    }

    /// Fails if the splats of a primitive are of a kind that is not read.
    fn check(&self, splats: &Value) -> Result<(), IoError> {
        let kernel = splats.pointer(&format!("/extensions/{EXTENSION}/kernel")).and_then(Value::as_str);
        if kernel.is_some_and(|k| k != "ellipse") {
            return Err(self.src.unsupported(format!("the kernel {kernel:?}"), "export with the kernel `ellipse`"));
        }
        // Splats of linear colours blend otherwise as well.
        let space = splats.pointer(&format!("/extensions/{EXTENSION}/colorSpace")).and_then(Value::as_str);
        if space.is_some_and(|s| s != COLOR_SPACE) {
            let advice = "export with the colour space `srgb_rec709_display`";
            return Err(self.src.unsupported(format!("the colour space {space:?}"), advice));
        }
        let inner = splats.pointer(&format!("/extensions/{EXTENSION}/extensions"));
        match inner.and_then(Value::as_object).and_then(|e| e.keys().next()) {
            Some(name) => Err(self.src.unsupported(format!("the extension `{name}`"), "export without compression")),
            None => Ok(()),
        }
    }

    /// `count` and values `[count, width]` of an attribute; `None` if it is absent.
    fn column(&self, primitive: &Value, name: &str, width: usize) -> Result<Option<(u64, Vec<f32>)>, IoError> {
        let index = primitive.pointer("/attributes").and_then(|a| a.get(name)?.as_u64());
        index.map(|index| self.accessor(index, name, width)).transpose()
    }

    /// `count` and values `[count, width]` of an accessor; `name` is what they are, for errors.
    pub(super) fn accessor(&self, index: u64, name: &str, width: usize) -> Result<(u64, Vec<f32>), IoError> {
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
        let Some(view) = accessor.get("bufferView").and_then(Value::as_u64) else {
            return Err(self
                .src
                .unsupported(format!("`{name}` without a buffer view"), "export with all values written"));
        };
        let view = self.list("bufferViews", view)?;
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
        Ok((count, values))
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

    /// The splats of a primitive, in glTF's axes.
    fn splats(&self, primitive: &Value, limits: &Limits) -> Result<RawSplats, IoError> {
        let src = self.src;
        let position = self.column(primitive, "POSITION", 3)?;
        let (count, means) = position.ok_or_else(|| src.missing(At::Byte(0), "POSITION", "export again"))?;
        let degree = degree(primitive);
        let rows = limits.splats(src, count, RawSplats::row_bytes(degree))?;
        let mut out = RawSplats::with_capacity(rows, degree);
        let vec3 = |values: &[f32]| values.as_chunks::<3>().0.iter().map(|v| Vec3::from_array(*v)).collect::<Vec<_>>();
        out.means = vec3(&means);
        let quats = self.needed(primitive, &own("ROTATION"), 4, count)?;
        out.quats = quats.as_chunks::<4>().0.iter().map(|&[x, y, z, w]| [w, x, y, z]).collect();
        let scales = vec3(&self.needed(primitive, &own("SCALE"), 3, count)?);
        if let Some(row) = scales.iter().position(|s| s.min_element() < 0.0) {
            let value = scales.get(row).map_or(0.0, |s| s.min_element());
            return Err(src.value(row, "SCALE", f64::from(value), "a linear scale must not be negative"));
        }
        out.log_scales = scales.iter().map(|s| Vec3::from_array(s.to_array().map(log_scale))).collect();
        let opacities = self.needed(primitive, &own("OPACITY"), 1, count)?;
        if let Some((row, value)) = opacities.iter().enumerate().find(|(_, o)| !(0.0..=1.0).contains(*o)) {
            return Err(src.value(row, "OPACITY", f64::from(*value), "an opacity is between 0 and 1"));
        }
        out.logit_opacities = opacities.iter().map(|&o| finite_logit(o)).collect();
        let names: Vec<String> = sh_names(degree).collect();
        let columns = names.iter().map(|n| self.needed(primitive, n, 3, count)).collect::<Result<Vec<_>, _>>()?;
        out.sh =
            (0..rows).flat_map(|r| columns.iter().flat_map(move |c| c.iter().skip(3 * r).take(3).copied())).collect();
        out.refuse_non_finite(src, limits)?;
        Ok(out)
    }
}

/// Reads the splats of a binary glTF file: of several times, the first.
///
/// # Errors
/// As [`read_scene`].
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<RawSplats, IoError> {
    Ok(read_scene(bytes, file, limits)?.at(0.0))
}

/// Reads the splats of a binary glTF file and how their nodes move.
///
/// # Errors
/// Bytes that are no such file, attributes that are missing, of unequal length, quantised or compressed, values outside
/// their domain or not finite; nodes that mirror or scale axes unequally, in a ring, or animated by splines or in their scale.
pub fn read_scene(bytes: &[u8], file: &str, limits: &Limits) -> Result<GlbScene, IoError> {
    let src = Source { file, format: "glTF" };
    let (text, binary) = chunks(bytes, src)?;
    let marks = text.iter().filter(|b| matches!(b, b'{' | b'[' | b',')).count();
    limits.expansion(src, (marks as u64).saturating_mul(MARK_BYTES), bytes.len())?;
    let parsed = serde_json::from_slice(text);
    let document = parsed.map_err(|e| src.malformed(At::Byte(20), e.to_string(), "write the file again"))?;
    let reader = Reader { document, binary, src };
    let (mut splats, mut memory) = (Vec::new(), 0u64);
    for (mesh, primitive) in reader.primitives()? {
        let read = reader.splats(primitive, limits)?;
        // Primitives may share their bytes.
        memory = memory.saturating_add((read.len() * RawSplats::row_bytes(read.degree)) as u64);
        limits.expansion(src, memory, bytes.len())?;
        splats.push((mesh, read));
    }
    GlbScene::of(&reader, splats, bytes.len(), limits)
}

/// The largest degree whose first coefficient is present, at most 3; missing lower ones are an error when read.
fn degree(primitive: &Value) -> u8 {
    let has = |l: &u8| {
        primitive.pointer("/attributes").is_some_and(|a| a.get(own(&format!("SH_DEGREE_{l}_COEF_0"))).is_some())
    };
    (1..=sh::MAX_DEGREE).rev().find(has).unwrap_or(0)
}
