//! Tensors in fewer bytes than `f32` takes.
//!
//! # Payload of a packed tensor
//! ```text
//! encoding u8   deflated u8   columns u32   group u32   values u64   body
//! ```
//! `n` values are taken as rows of `columns` and stored column by column. The body, possibly deflated, is
//! ```text
//! 0  f32       n × 4 bytes, bit for bit
//! 1  f16       n × 2 bytes, the nearest
//! 2  affine 8  per group: low f32, step f32; then n codes of 1 byte
//! 3  affine 16 the same, codes of 2 bytes          value = low + code · step
//! 4  lattice   step f32, per column: low i32; then n codes of 4 bytes        value = (low + code) · step, exact
//! ```
//! A group is `group` neighbouring values of a column, or the whole column if that is 0. Values of several bytes are
//! stored as planes: the lowest byte of every value, then the next of every value, which deflates better.

use super::half;
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use std::io::{Read, Write};

/// Values of all tensors of a file together, at most: 4 GiB as `f32`.
const MAX_VALUES: u64 = 1 << 30;
/// Values that a file of any size may hold.
const FREE_VALUES: u64 = 1 << 20;
/// Values per byte of a file, at most, beside these.
const VALUES_PER_BYTE: u64 = 16;
/// Values of larger size are not quantised.
const MAX_AFFINE: f32 = 1e30;
/// Bytes before the body.
const HEAD: usize = 18;

/// How the values of a tensor are written down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coding {
    /// As `f32`, bit for bit.
    F32,
    /// As the nearest `f16`; as `f32` if one is too large for that.
    F16,
    /// As steps of 1/255 between the smallest and the largest of a group; as `f32` if one is beyond 10³⁰ or not finite.
    Affine8,
    /// As steps of 1/65535, likewise.
    Affine16,
    /// As whole multiples of a step, if all are exactly that.
    Lattice {
        /// Distance of neighbouring values, above 0.
        step: f32,
        /// Where a value is none of them, all are stored as they are; else in 16 bits.
        exact: bool,
    },
}

/// How a tensor is written down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoding {
    /// How each value is coded.
    pub coding: Coding,
    /// Values per row; a number that does not divide the number of values counts as 1.
    pub columns: usize,
    /// Neighbouring values of a column that share a scale; 0: all.
    pub group: usize,
    /// Deflate the result where that makes it smaller.
    pub deflate: bool,
}

/// Values that a file of `bytes` bytes may hold in all its tensors: a deflated body is not believed without bounds.
pub(super) fn max_values(bytes: u64) -> u64 {
    bytes.saturating_mul(VALUES_PER_BYTE).saturating_add(FREE_VALUES).min(MAX_VALUES)
}

/// Fills a deflated payload up with zeros, which inflating ignores, where all payloads together would hold more than
/// [`max_values`] of them.
pub(super) fn pad(payloads: &mut [Vec<u8>], values: u64) {
    let bytes: usize = payloads.iter().map(Vec::len).sum();
    let missing = values.saturating_sub(FREE_VALUES).div_ceil(VALUES_PER_BYTE).saturating_sub(bytes as u64);
    if let Some(deflated) = payloads.iter_mut().find(|p| p.get(1) == Some(&1)) {
        deflated.resize(deflated.len() + usize::try_from(missing).unwrap_or(0), 0);
    }
}

/// The payload of a tensor.
pub(super) fn pack(values: &[f32], encoding: &Encoding) -> Vec<u8> {
    let columns = encoding.columns.max(1);
    let columns = if values.len().is_multiple_of(columns) { columns } else { 1 };
    let turned = turn(values, columns);
    let group = u32::try_from(encoding.group).unwrap_or(0);
    let (code, body) = encode(&turned, encoding.coding, columns, group);
    let deflated = encoding.deflate.then(|| deflate(&body)).filter(|d| d.len() < body.len());
    let mut out = vec![code, u8::from(deflated.is_some())];
    out.extend((columns as u32).to_le_bytes());
    out.extend(group.to_le_bytes());
    out.extend((values.len() as u64).to_le_bytes());
    out.extend(deflated.unwrap_or(body));
    out
}

fn encode(turned: &[f32], coding: Coding, columns: usize, group: u32) -> (u8, Vec<u8>) {
    let largest = turned.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    let finite = turned.iter().all(|v| v.is_finite());
    let plain = || (0, planes(turned.len(), 4, |i, b| turned[i].to_le_bytes()[b]));
    match coding {
        Coding::F16 if finite && largest <= half::MAX => {
            (1, planes(turned.len(), 2, |i, b| half::from_f32(turned[i]).to_le_bytes()[b]))
        }
        Coding::Affine8 if finite && largest <= MAX_AFFINE => (2, affine(turned, columns, group, 255, 1)),
        Coding::Affine16 if finite && largest <= MAX_AFFINE => (3, affine(turned, columns, group, 65_535, 2)),
        Coding::Lattice { step, exact } => match lattice(turned, columns, step) {
            Some(body) => (4, body),
            None if exact => plain(),
            None => encode(turned, Coding::Affine16, columns, group),
        },
        _ => plain(),
    }
}

fn affine(turned: &[f32], columns: usize, group: u32, levels: u32, bytes: usize) -> Vec<u8> {
    let mut body = Vec::new();
    let mut codes: Vec<u32> = Vec::with_capacity(turned.len());
    for group in groups(turned.len(), columns, group).map(|range| &turned[range]) {
        let low = group.iter().copied().fold(f32::INFINITY, f32::min);
        let high = group.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let step = ((f64::from(high) - f64::from(low)) / f64::from(levels)) as f32;
        body.extend(low.to_le_bytes());
        body.extend(step.to_le_bytes());
        let inverse = if step > 0.0 { 1.0 / f64::from(step) } else { 0.0 };
        let code = |v: &f32| ((f64::from(*v) - f64::from(low)) * inverse).round() as u32;
        codes.extend(group.iter().map(|v| code(v).min(levels)));
    }
    body.extend(planes(codes.len(), bytes, |i, b| codes[i].to_le_bytes()[b]));
    body
}

/// `None` if a value is no multiple of the step that `i32` holds.
fn lattice(turned: &[f32], columns: usize, step: f32) -> Option<Vec<u8>> {
    let on_lattice = |cell: i32, step: f32| (f64::from(cell) * f64::from(step)) as f32;
    let cell = |v: &f32| {
        let cell = (f64::from(*v) / f64::from(step)).round_ties_even();
        // −0 is the only value of a lattice that does not come back by its bits, and it renders as 0 does.
        (cell.abs() < f64::from(1 << 30) && on_lattice(cell as i32, step) == *v).then_some(cell as i32)
    };
    let cells: Vec<i32> = turned.iter().map(cell).collect::<Option<_>>()?;
    let mut body = step.to_le_bytes().to_vec();
    let mut codes: Vec<u32> = Vec::with_capacity(cells.len());
    for column in cells.chunks((cells.len() / columns).max(1)) {
        let low = column.iter().copied().min().unwrap_or(0);
        body.extend(low.to_le_bytes());
        codes.extend(column.iter().map(|c| c.wrapping_sub(low) as u32));
    }
    body.extend(planes(codes.len(), 4, |i, b| codes[i].to_le_bytes()[b]));
    Some(body)
}

/// The values of a payload.
///
/// # Errors
/// Says what does not fit. At most `most` values are made, and no memory is taken for bytes that are not there.
pub(super) fn unpack(payload: &[u8], most: u64) -> Result<Vec<f32>, String> {
    let head: &[u8; HEAD] = payload.first_chunk().ok_or("is shorter than its head")?;
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let (code, deflated, columns, group) = (head[0], head[1], word(2) as usize, word(6));
    let n = u64::from(word(10)) | u64::from(word(14)) << 32;
    if n > most {
        return Err(format!("says it has {n} values; at most {most} more are read"));
    }
    let n = usize::try_from(n).map_err(|e| e.to_string())?;
    if columns == 0 || !n.is_multiple_of(columns) || deflated > 1 {
        return Err(format!("has {n} values in {columns} columns, deflated {deflated}"));
    }
    let scales = groups(n, columns, group);
    let expected = match code {
        0 => 4 * n,
        1 => 2 * n,
        2 => 8 * scales.len() + n,
        3 => 8 * scales.len() + 2 * n,
        4 => 4 + if n > 0 { 4 * columns } else { 0 } + 4 * n,
        _ => return Err(format!("has the unknown encoding {code}")),
    };
    let body = inflate(&payload[HEAD..], deflated == 1, expected)?;
    let turned = match code {
        0 => (0..n).map(|i| f32::from_bits(from_planes::<4>(&body, n, i))).collect(),
        1 => (0..n).map(|i| half::to_f32(from_planes::<2>(&body, n, i) as u16)).collect(),
        2 => from_affine::<1>(&body, n, scales)?,
        3 => from_affine::<2>(&body, n, scales)?,
        _ => from_lattice(&body, n, columns)?,
    };
    Ok(turn(&turned, n / columns))
}

fn from_affine<const BYTES: usize>(body: &[u8], n: usize, groups: Groups) -> Result<Vec<f32>, String> {
    let (scales, codes) = body.split_at(8 * groups.len());
    let mut out = Vec::with_capacity(n);
    for (range, scale) in groups.zip(scales.chunks_exact(8)) {
        let [low, step] = [0, 4].map(|at| f32::from_le_bytes([scale[at], scale[at + 1], scale[at + 2], scale[at + 3]]));
        let top = f64::from(low) + f64::from(step) * f64::from((1u32 << (8 * BYTES)) - 1);
        if !low.is_finite() || !step.is_finite() || step < 0.0 || top.abs() > f64::from(f32::MAX) {
            return Err(format!("has a scale from {low} by steps of {step}, which is no range of finite values"));
        }
        let value = |i: usize| f64::from(low) + f64::from(from_planes::<BYTES>(codes, n, i)) * f64::from(step);
        out.extend(range.map(|i| value(i) as f32));
    }
    Ok(out)
}

fn from_lattice(body: &[u8], n: usize, columns: usize) -> Result<Vec<f32>, String> {
    let word = |at: usize| [body[at], body[at + 1], body[at + 2], body[at + 3]];
    let step = f32::from_le_bytes(word(0));
    if !(step.is_finite() && step > 0.0) {
        return Err(format!("has a lattice of step {step}"));
    }
    let mut out = Vec::with_capacity(n);
    for (column, range) in groups(n, columns, 0).enumerate() {
        let low = i32::from_le_bytes(word(4 + 4 * column));
        let codes = &body[4 + 4 * columns..];
        for i in range {
            let cell = i64::from(low) + i64::from(from_planes::<4>(codes, n, i));
            let value = (cell as f64 * f64::from(step)) as f32;
            out.push(value);
        }
    }
    match out.iter().all(|v| v.is_finite()) {
        true => Ok(out),
        false => Err(format!("has cells beyond what a lattice of step {step} holds")),
    }
}

/// Index ranges of the groups of `n` values in `columns` columns, column by column.
fn groups(n: usize, columns: usize, group: u32) -> Groups {
    let rows = n / columns.max(1);
    let group = if group == 0 { rows } else { (group as usize).min(rows) };
    Groups { n, rows, group: group.max(1), at: 0 }
}

#[derive(Clone)]
struct Groups {
    n: usize,
    rows: usize,
    group: usize,
    at: usize,
}

impl Groups {
    /// Number of groups in all.
    fn len(&self) -> usize {
        self.n.checked_div(self.rows).unwrap_or(0) * self.rows.div_ceil(self.group)
    }
}

impl Iterator for Groups {
    type Item = std::ops::Range<usize>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.at >= self.n {
            return None;
        }
        let column_end = self.at - self.at % self.rows + self.rows;
        let range = self.at..(self.at + self.group).min(column_end);
        self.at = range.end;
        Some(range)
    }
}

/// Rows of `columns` values, stored column by column. With `n / columns` in the place of `columns` it turns back.
fn turn(values: &[f32], columns: usize) -> Vec<f32> {
    let columns = columns.max(1);
    (0..columns).flat_map(|c| values.iter().skip(c).step_by(columns).copied()).collect()
}

/// Byte `b` of value `i`, for all values, then the next byte of all values.
fn planes(n: usize, bytes: usize, byte: impl Fn(usize, usize) -> u8) -> Vec<u8> {
    (0..bytes).flat_map(|b| (0..n).map(move |i| (i, b))).map(|(i, b)| byte(i, b)).collect()
}

fn from_planes<const BYTES: usize>(planes: &[u8], n: usize, i: usize) -> u32 {
    (0..BYTES).fold(0, |word, b| word | u32::from(planes[b * n + i]) << (8 * b))
}

fn deflate(body: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    // Writing to memory does not fail; if it did, the body would be kept as it is.
    match encoder.write_all(body).and_then(|()| encoder.finish()) {
        Ok(deflated) => deflated,
        Err(_) => body.to_vec(),
    }
}

/// The body in its full length, which is known beforehand.
fn inflate(stored: &[u8], deflated: bool, expected: usize) -> Result<Vec<u8>, String> {
    let mut body = Vec::new();
    if deflated {
        let read = DeflateDecoder::new(stored).take(expected as u64 + 1).read_to_end(&mut body);
        read.map_err(|e| format!("cannot be inflated: {e}"))?;
    } else {
        body.extend_from_slice(stored);
    }
    match body.len() {
        n if n == expected => Ok(body),
        n => Err(format!("has a body of {n} bytes or more, {expected} are needed")),
    }
}

#[cfg(test)]
mod tests;
