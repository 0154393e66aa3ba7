//! Accessors of a glTF file as tables of numbers. Every range is checked before it is read.

use super::error::CharacterError;
use gltf::json::accessor::{Accessor, ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root, buffer};
use std::cell::Cell;

/// Memory that any file may use, bytes.
const BASE: u64 = 48 << 20;
/// Additional memory per byte of the file, bytes.
const PER_BYTE: u64 = 64;

/// A parsed file with its buffers.
pub(super) struct Data<'a> {
    pub(super) file: &'a str,
    pub(super) root: &'a Root,
    pub(super) buffers: Vec<Vec<u8>>,
    /// Memory it may still use, bytes.
    budget: Cell<u64>,
}

/// The rows of an accessor, `width` values each.
pub(super) struct Table {
    pub(super) width: usize,
    pub(super) values: Vec<f64>,
    /// Whether the values are integers that are not normalised.
    pub(super) integers: bool,
}

impl Table {
    pub(super) fn len(&self) -> usize {
        self.values.len() / self.width
    }

    pub(super) fn row(&self, i: usize) -> Option<&[f64]> {
        self.values.get(i.checked_mul(self.width)?..)?.get(..self.width)
    }

    pub(super) fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.width)
    }
}

/// Bytes of an accessor, and the distance between its elements.
struct Place<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> Data<'a> {
    pub(super) fn new(file: &'a str, root: &'a Root, buffers: Vec<Vec<u8>>, text: usize) -> Self {
        let present = text as u64 + buffers.iter().map(|b| b.len() as u64).sum::<u64>();
        Self { file, root, buffers, budget: Cell::new(BASE + PER_BYTE.saturating_mul(present)) }
    }

    pub(super) fn malformed(&self, place: impl Into<String>, what: impl Into<String>) -> CharacterError {
        CharacterError::Malformed { file: self.file.into(), place: place.into(), what: what.into() }
    }

    /// Subtracts `bytes` from the budget; `what` names them in the error.
    pub(super) fn spend(&self, bytes: u64, what: &str) -> Result<(), CharacterError> {
        let left = self.budget.get().checked_sub(bytes);
        self.budget.set(left.ok_or_else(|| CharacterError::TooMuch { file: self.file.into(), what: what.into() })?);
        Ok(())
    }

    /// The bytes of a buffer view.
    pub(super) fn view(&self, index: Index<buffer::View>) -> Result<(&[u8], Option<usize>), CharacterError> {
        let place = || format!("buffer view {}", index.value());
        let view = self.root.get(index).ok_or_else(|| self.malformed(place(), "does not exist"))?;
        let start = view.byte_offset.map_or(0, |o| o.0);
        let range = usize::try_from(start).ok().zip(start.checked_add(view.byte_length.0));
        let range = range.and_then(|(a, b)| Some(a..usize::try_from(b).ok()?));
        let bytes = self.buffers.get(view.buffer.value()).zip(range).and_then(|(b, r)| b.get(r));
        let bytes = bytes.ok_or_else(|| self.malformed(place(), "reaches beyond its buffer"))?;
        Ok((bytes, view.byte_stride.map(|s| s.0)))
    }

    /// The rows of an accessor of one of `types`; all values are finite.
    pub(super) fn table(&self, index: Index<Accessor>, types: &[Type]) -> Result<Table, CharacterError> {
        let place = format!("accessor {}", index.value());
        let wrong = |what: String| self.malformed(place.as_str(), what);
        let accessor = self.root.get(index).ok_or_else(|| wrong("does not exist".into()))?;
        let (Checked::Valid(kind), Checked::Valid(component)) = (accessor.type_, accessor.component_type) else {
            return Err(wrong("has a type that glTF does not know".into()));
        };
        if !types.contains(&kind) {
            return Err(wrong(format!("is {kind:?}, where one of {types:?} belongs")));
        }
        let (width, component) = (kind.multiplicity(), component.0);
        let count = usize::try_from(accessor.count.0).unwrap_or(usize::MAX);
        self.spend((count as u64).saturating_mul(8 * width as u64), &place)?;
        let scale = accessor.normalized.then_some(component);
        let mut values = vec![0.0; count * width];
        if let Some(view) = accessor.buffer_view {
            let size = component.size() * width;
            let source = self.place(view, accessor.byte_offset.map_or(0, |o| o.0), (count, size), &place)?;
            for (row, out) in values.chunks_exact_mut(width).enumerate() {
                read_row(&source, row, component, scale, out);
            }
        }
        if let Some(sparse) = &accessor.sparse {
            self.scatter(sparse, (width, component, scale), &mut values, &place)?;
        }
        if let Some((at, &value)) = values.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            let (row, component) = (at / width, at % width);
            return Err(CharacterError::NotFinite { file: self.file.into(), place, row, component, value });
        }
        Ok(Table { width, values, integers: component != ComponentType::F32 && scale.is_none() })
    }

    /// Integers of an accessor (indices of vertices or joints).
    pub(super) fn integers(&self, index: Index<Accessor>, types: &[Type]) -> Result<Table, CharacterError> {
        let table = self.table(index, types)?;
        if table.integers && table.values.iter().all(|&v| v >= 0.0) {
            return Ok(table);
        }
        Err(self.malformed(format!("accessor {}", index.value()), "must hold unsigned whole numbers"))
    }

    fn place(
        &self,
        view: Index<buffer::View>,
        offset: u64,
        (count, size): (usize, usize),
        what: &str,
    ) -> Result<Place<'_>, CharacterError> {
        let (bytes, stride) = self.view(view)?;
        let stride = stride.unwrap_or(size);
        let need = (count as u64).saturating_sub(1).saturating_mul(stride as u64);
        let need = if count == 0 { 0 } else { need.saturating_add(size as u64) };
        let bytes = usize::try_from(offset).ok().and_then(|o| bytes.get(o..)).unwrap_or(&[]);
        if stride < size || need > bytes.len() as u64 {
            let have = bytes.len();
            return Err(self.malformed(what, format!("needs {need} bytes, its view has {have} (stride {stride})")));
        }
        Ok(Place { bytes, stride })
    }

    /// Overwrites the rows that a sparse accessor lists.
    fn scatter(
        &self,
        sparse: &gltf::json::accessor::sparse::Sparse,
        (width, component, scale): (usize, ComponentType, Option<ComponentType>),
        values: &mut [f64],
        what: &str,
    ) -> Result<(), CharacterError> {
        let count = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
        let Checked::Valid(index_type) = sparse.indices.component_type else {
            return Err(self.malformed(what, "has sparse indices of an unknown type"));
        };
        let (indices, rows) = (&sparse.indices, &sparse.values);
        let at = self.place(indices.buffer_view, indices.byte_offset.0, (count, index_type.0.size()), what)?;
        let of = self.place(rows.buffer_view, rows.byte_offset.0, (count, component.size() * width), what)?;
        for k in 0..count {
            let mut row = [0.0];
            read_row(&at, k, index_type.0, None, &mut row);
            let start = (row[0] as usize).saturating_mul(width);
            let out = values.get_mut(start..start.saturating_add(width));
            let out = out.ok_or_else(|| self.malformed(what, format!("has a sparse row {} beyond its end", row[0])))?;
            read_row(&of, k, component, scale, out);
        }
        Ok(())
    }
}

/// Reads one element; its range has been checked. Normalised integers become `[0, 1]` or `[-1, 1]`.
fn read_row(place: &Place<'_>, row: usize, kind: ComponentType, normalised: Option<ComponentType>, out: &mut [f64]) {
    let bytes = place.bytes.get(row * place.stride..).unwrap_or(&[]);
    for (value, b) in out.iter_mut().zip(bytes.chunks_exact(kind.size())) {
        let raw = match (kind, b) {
            (ComponentType::I8, &[a]) => f64::from(a as i8),
            (ComponentType::U8, &[a]) => f64::from(a),
            (ComponentType::I16, &[a, b]) => f64::from(i16::from_le_bytes([a, b])),
            (ComponentType::U16, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            (ComponentType::U32, &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
            (ComponentType::F32, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            _ => 0.0,
        };
        *value = match normalised {
            Some(ComponentType::I8) => (raw / 127.0).max(-1.0),
            Some(ComponentType::U8) => raw / 255.0,
            Some(ComponentType::I16) => (raw / 32_767.0).max(-1.0),
            Some(ComponentType::U16) => raw / 65_535.0,
            _ => raw,
        };
    }
}
