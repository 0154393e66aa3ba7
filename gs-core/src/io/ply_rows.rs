//! Rows of the `vertex` element of a `.ply`: chosen properties as `f32`, text or binary of either byte order.

use super::error::{At, Source};
use super::ply_header::{Element, Encoding, Header, Property, Scalar, clip};
use super::{IoError, Limits};

/// One property to read: its place in a row and its type.
#[derive(Clone, Copy)]
struct Column {
    /// Position among the element's properties (text), or byte offset in a row (binary).
    place: usize,
    scalar: Scalar,
}

/// Finds each property by name; it must appear once.
fn find_columns(
    element: &Element<'_>,
    encoding: Encoding,
    names: &[String],
    at: usize,
    src: Source<'_>,
) -> Result<Vec<Column>, IoError> {
    let find = |name: &String| {
        let mut matches = element.properties.iter().enumerate().filter(|(_, p)| p.name == *name);
        let Some((index, Property { scalar, offset, .. })) = matches.next() else {
            let advice =
                "a 3D Gaussian Splatting file has it; this may be a point cloud, a mesh or a compressed export";
            return Err(src.missing(At::Byte(at as u64), format!("property {}", clip(name)), advice));
        };
        if matches.next().is_some() {
            let what = format!("property `{}` appears twice", clip(name));
            return Err(src.malformed(At::Byte(at as u64), what, "repair the header"));
        }
        let place = if encoding == Encoding::Ascii { index } else { *offset };
        Ok(Column { place, scalar: *scalar })
    };
    names.iter().map(find).collect()
}

/// Calls `take(number of rows, values)` for each `vertex` row, with the values of `names` in that order. Values must be
/// finite, those of `may_be_infinite` at least not NaN.
pub(super) fn for_each_row(
    bytes: &[u8],
    header: &Header<'_>,
    names: &[String],
    may_be_infinite: &str,
    src: Source<'_>,
    limits: &Limits,
    mut take: impl FnMut(usize, &[f32]),
) -> Result<(), IoError> {
    let (element, start, rows) = header.locate("vertex", bytes.len(), limits, src)?;
    let columns = find_columns(element, header.encoding, names, header.data_start, src)?;
    let data = bytes.get(start..).unwrap_or_default();
    let mut checked = |row: usize, values: &[f32]| {
        if !limits.allow_non_finite && !values.iter().all(|v| v.is_finite()) {
            let bad = |(v, n): &(&f32, &String)| !v.is_finite() && (v.is_nan() || *n != may_be_infinite);
            if let Some((value, name)) = values.iter().zip(names).find(bad) {
                return Err(src.value(row, name, f64::from(*value), "must be finite"));
            }
        }
        take(rows, values);
        Ok(())
    };
    match header.encoding {
        Encoding::Ascii => return ascii_rows(data, start, header, rows, &columns, src, checked),
        Encoding::Little | Encoding::Big => {
            let big = header.encoding == Encoding::Big;
            // The usual case, little-endian floats, decodes twice as fast without a match per value.
            let plain = !big && columns.iter().all(|c| c.scalar == Scalar::F32);
            let mut values = vec![0.0f32; columns.len()];
            for (row, raw) in data.chunks_exact(element.stride.max(1)).take(rows).enumerate() {
                let pairs = values.iter_mut().zip(&columns);
                if plain {
                    pairs.for_each(|(value, c)| *value = Column { scalar: Scalar::F32, ..*c }.decode(raw, false));
                } else {
                    pairs.for_each(|(value, c)| *value = c.decode(raw, big));
                }
                checked(row, &values)?;
            }
        }
    }
    refuse_trailing(header, element, start, rows, bytes.len(), src)
}

impl Column {
    /// This column's value in a binary row. The caller has verified that the row is whole.
    #[inline(always)]
    fn decode(self, row: &[u8], big: bool) -> f32 {
        fn take<const N: usize>(row: &[u8], at: usize, big: bool) -> [u8; N] {
            let mut bytes = row.get(at..).and_then(|r| r.first_chunk::<N>()).copied().unwrap_or([0; N]);
            if big {
                bytes.reverse();
            }
            bytes
        }
        let at = self.place;
        match self.scalar {
            Scalar::F32 => f32::from_le_bytes(take(row, at, big)),
            Scalar::F64 => f64::from_le_bytes(take(row, at, big)) as f32,
            Scalar::I8 => f32::from(i8::from_le_bytes(take(row, at, big))),
            Scalar::U8 => f32::from(u8::from_le_bytes(take(row, at, big))),
            Scalar::I16 => f32::from(i16::from_le_bytes(take(row, at, big))),
            Scalar::U16 => f32::from(u16::from_le_bytes(take(row, at, big))),
            Scalar::I32 => i32::from_le_bytes(take(row, at, big)) as f32,
            Scalar::U32 => u32::from_le_bytes(take(row, at, big)) as f32,
        }
    }
}

/// An error for bytes after the last element, unless a list property hides where it ends.
fn refuse_trailing(
    header: &Header<'_>,
    element: &Element<'_>,
    start: usize,
    rows: usize,
    len: usize,
    src: Source<'_>,
) -> Result<(), IoError> {
    let mut end = start.saturating_add(rows.saturating_mul(element.stride));
    for later in header.elements.iter().skip_while(|e| !std::ptr::eq(*e, element)).skip(1) {
        if later.list.is_some() {
            return Ok(());
        }
        let bytes = later.count.saturating_mul(later.stride as u64);
        let have = len.saturating_sub(end);
        if bytes > have as u64 {
            return Err(src.truncated(format!("element {}", clip(later.name)), end, bytes, have));
        }
        end = end.saturating_add(bytes as usize);
    }
    if end != len {
        let what = format!("{} bytes follow the last row", len.saturating_sub(end));
        return Err(src.malformed(At::Byte(end as u64), what, "the row count or a property type is wrong"));
    }
    Ok(())
}

/// Text rows: values separated by white space, in the order of the header.
fn ascii_rows(
    data: &[u8],
    start: usize,
    header: &Header<'_>,
    rows: usize,
    columns: &[Column],
    src: Source<'_>,
    mut take: impl FnMut(usize, &[f32]) -> Result<(), IoError>,
) -> Result<(), IoError> {
    let text = std::str::from_utf8(data).map_err(|e| {
        let at = At::Byte((start + e.valid_up_to()) as u64);
        src.malformed(at, "a byte that is not text", "the format line says ascii: correct it or export again")
    })?;
    let mut words = text.split_ascii_whitespace();
    let short = |name: &str| src.truncated(name, start, start as u64 + data.len() as u64 + 1, data.len());
    let mut wanted: Vec<(usize, usize)> = columns.iter().enumerate().map(|(slot, c)| (c.place, slot)).collect();
    wanted.sort_unstable();
    let mut values = vec![0.0f32; columns.len()];
    for element in &header.elements {
        let is_vertex = element.name == "vertex";
        if element.list.is_some() {
            return Ok(());
        }
        let count = if is_vertex { rows as u64 } else { element.count };
        for row in 0..if element.properties.is_empty() { 0 } else { count } {
            let mut next = wanted.iter().peekable();
            for (place, property) in element.properties.iter().enumerate() {
                let word = words.next().ok_or_else(|| short(property.name))?;
                while let Some((_, slot)) = next.next_if(|(p, _)| is_vertex && *p == place) {
                    let Ok(value) = word.parse::<f32>() else {
                        let what = format!("`{}` for property `{}`", clip(word), clip(property.name));
                        return Err(src.malformed(At::Row(row), what, "write a number such as 0.25"));
                    };
                    if let Some(v) = values.get_mut(*slot) {
                        *v = value;
                    }
                }
            }
            if is_vertex {
                take(row as usize, &values)?;
            }
        }
    }
    match words.next() {
        None => Ok(()),
        Some(word) => {
            let what = format!("`{}` follows the last row", clip(word));
            Err(src.malformed(At::Row(rows as u64), what, "the row count or a property is wrong"))
        }
    }
}
