//! What holds the arrays of an SPZ file: one gzip stream (versions 2 and 3) or one Zstandard stream per array (version 4).

use super::axes::from_numbered;
use super::error::{At, Source};
use super::spz::{MAGIC, SpzHeader};
use super::{IoError, Limits, RawSplats};
use crate::rot::Mat3;
use crate::sh;
use flate2::bufread::GzDecoder;
use ruzstd::decoding::StreamingDecoder;
use std::io::Read;

/// Bytes of the header of versions 2 and 3, and of version 4.
pub(super) const HEADER: usize = 16;
const HEADER_V4: usize = 32;
const ANTIALIASED: u8 = 1;
const EXTENSIONS: u8 = 2;
/// Type of the extension that names the axes of a file.
const COORDINATE_SYSTEM: u32 = 0xADBE_0003;
/// Number of SPZ's own axes, right-up-back.
const RIGHT_UP_BACK: u32 = 4;

/// The content of a file: its header, its arrays one after another, and the map from its axes to those of `.ply` files.
pub(super) type Content = (SpzHeader, Vec<u8>, Mat3<f64>);

/// Unpacks a file held in memory.
///
/// # Errors
/// Neither container, a damaged or cut stream, unsupported version or degree, wrong size, more than the limits allow.
pub(super) fn unpack(bytes: &[u8], limits: &Limits, src: Source<'_>) -> Result<Content, IoError> {
    match bytes.strip_prefix(MAGIC).and_then(<[u8]>::first_chunk) {
        Some(version) => match u32::from_le_bytes(*version) {
            4 => zstandard(bytes, limits, src),
            v @ (2 | 3) => {
                let what = format!("an SPZ version {v} payload that is not compressed");
                Err(src.unsupported(what, "compress the file with gzip"))
            }
            v => Err(unsupported_version(v, src)),
        },
        None => gzip(bytes, limits, src),
    }
}

fn unsupported_version(version: u32, src: Source<'_>) -> IoError {
    src.unsupported(format!("SPZ version {version}"), "export it as SPZ version 2, 3 or 4, or as PLY")
}

/// The fields that all versions share, and whether extensions follow.
fn parse_header(h: &[u8; HEADER], limits: &Limits, src: Source<'_>) -> Result<(SpzHeader, bool), IoError> {
    let [magic @ .., v0, v1, v2, v3, n0, n1, n2, n3, degree, fraction_bits, flags, _] = h;
    if magic != MAGIC {
        return Err(src.malformed(At::Byte(0), "the payload does not start with NGSP", "give an SPZ file"));
    }
    let version = u32::from_le_bytes([*v0, *v1, *v2, *v3]);
    if !(2..=4).contains(&version) {
        return Err(unsupported_version(version, src));
    }
    let count = limits.splats(src, u32::from_le_bytes([*n0, *n1, *n2, *n3]).into(), RawSplats::row_bytes(*degree))?;
    if *degree > sh::MAX_DEGREE {
        return Err(src.unsupported(format!("SPZ with SH degree {degree}"), "export it with degree 3 or less"));
    }
    if *fraction_bits > 23 {
        let what = format!("{fraction_bits} fraction bits in 24-bit positions");
        return Err(src.malformed(At::Byte(13), what, "the header is damaged"));
    }
    if flags & !(ANTIALIASED | EXTENSIONS) != 0 {
        return Err(src.unsupported(format!("SPZ with flags {flags:#04x}"), "export it as PLY"));
    }
    let antialiased = flags & ANTIALIASED != 0;
    let header = SpzHeader { version, count, degree: *degree, fraction_bits: *fraction_bits, antialiased };
    Ok((header, flags & EXTENSIONS != 0))
}

/// Fails if the decoded rows are larger than the file may become.
fn check_expansion(header: &SpzHeader, bytes: usize, limits: &Limits, src: Source<'_>) -> Result<(), IoError> {
    let row = header.row() + 4 * (11 + 3 * sh::coeffs(header.degree));
    limits.expansion(src, (header.count as u64).saturating_mul(row as u64), bytes)
}

fn gzip(bytes: &[u8], limits: &Limits, src: Source<'_>) -> Result<Content, IoError> {
    let mut stream = GzDecoder::new(bytes);
    let mut head = [0u8; HEADER];
    fill(&mut stream, &mut head, "header", 0, src)?;
    let (header, extended) = parse_header(&head, limits, src)?;
    if header.version == 4 {
        return Err(src.malformed(At::Byte(4), "version 4 in a gzip stream", "the header is damaged"));
    }
    if head.last() != Some(&0) {
        return Err(src.malformed(At::Byte(15), "the reserved byte is not 0", "the header is damaged"));
    }
    check_expansion(&header, bytes.len(), limits, src)?;
    let mut arrays = vec![0u8; header.count * header.row()];
    fill(&mut stream, &mut arrays, "splats", HEADER, src)?;
    let mut records = Vec::new();
    let allowed = if extended { MAX_RECORDS } else { 0 };
    let at = HEADER + arrays.len();
    let read = stream.by_ref().take(allowed + 1).read_to_end(&mut records);
    if read.map_err(|e| damaged(&e, at, src))? as u64 > allowed || !stream.into_inner().is_empty() {
        let fix = "the count or the degree in the header is wrong";
        return Err(src.malformed(At::Byte(at as u64), "bytes follow the last array", fix));
    }
    Ok((header, arrays, axes(&records, src)?))
}

/// Most bytes of extension records.
const MAX_RECORDS: u64 = 1 << 16;

fn zstandard(bytes: &[u8], limits: &Limits, src: Source<'_>) -> Result<Content, IoError> {
    let (fixed, rest) =
        bytes.split_at_checked(HEADER_V4).ok_or_else(|| src.truncated("header", 0, HEADER_V4 as u64, bytes.len()))?;
    let head = fixed.first_chunk::<HEADER>().unwrap_or(&[0; HEADER]);
    let (header, extended) = parse_header(head, limits, src)?;
    check_expansion(&header, bytes.len(), limits, src)?;
    let word = fixed.get(16..).and_then(<[u8]>::first_chunk).map_or(0, |b| u32::from_le_bytes(*b));
    let records = usize::try_from(word).ok().and_then(|w| w.checked_sub(HEADER_V4));
    let (records, table) = records.and_then(|n| rest.split_at_checked(n)).ok_or_else(|| {
        src.malformed(At::Byte(16), format!("a table of streams at byte {word}"), "the header is damaged")
    })?;
    let sizes: Vec<usize> = header.widths().map(|w| w * header.count).into_iter().filter(|&n| n > 0).collect();
    let [.., number] = *head;
    if usize::from(number) != sizes.len() {
        let what = format!("{number} streams, not {}", sizes.len());
        return Err(src.malformed(At::Byte(15), what, "the header is damaged"));
    }
    let arrays = streams(table, &sizes, bytes.len(), src)?;
    Ok((header, arrays, axes(if extended { records } else { &[] }, src)?))
}

/// The arrays of `sizes` bytes, from their table and the streams behind it; the file has `whole` bytes.
fn streams(table: &[u8], sizes: &[usize], whole: usize, src: Source<'_>) -> Result<Vec<u8>, IoError> {
    let start = whole - table.len();
    let (entries, mut rest) = table
        .split_at_checked(16 * sizes.len())
        .ok_or_else(|| src.truncated("table of streams", start, 16, table.len()))?;
    let mut arrays = vec![0u8; sizes.iter().sum()];
    let mut out = arrays.as_mut_slice();
    for (entry, &size) in entries.as_chunks::<8>().0.as_chunks::<2>().0.iter().zip(sizes) {
        let at = whole - rest.len();
        let [packed, plain] = entry.map(u64::from_le_bytes);
        if plain != size as u64 {
            let what = format!("a stream of {plain} bytes, not {size}");
            return Err(src.malformed(At::Byte(at as u64), what, "the count or the degree in the header is wrong"));
        }
        let split = usize::try_from(packed).ok().and_then(|n| rest.split_at_checked(n));
        let (stream, behind) = split.ok_or_else(|| src.truncated("a stream", at, packed, rest.len()))?;
        let (array, further) = std::mem::take(&mut out).split_at_mut(size);
        let unpacked = StreamingDecoder::new(stream).map_err(|e| std::io::Error::other(e.to_string()));
        let mut unpacked = unpacked.map_err(|e| damaged(&e, at, src))?;
        fill(&mut unpacked, array, "a stream", at, src)?;
        if unpacked.read(&mut [0]).map_err(|e| damaged(&e, at, src))? != 0 {
            return Err(src.malformed(At::Byte(at as u64), "a stream longer than its array", "the file is damaged"));
        }
        (out, rest) = (further, behind);
    }
    match rest {
        [] => Ok(arrays),
        _ => Err(src.malformed(
            At::Byte((whole - rest.len()) as u64),
            "bytes follow the last array",
            "the file is damaged",
        )),
    }
}

/// The map of the axes that the extension records name; unknown records are skipped.
fn axes(mut records: &[u8], src: Source<'_>) -> Result<Mat3<f64>, IoError> {
    let mut number = RIGHT_UP_BACK;
    while let Some(([k0, k1, k2, k3, length @ ..], rest)) = records.split_first_chunk::<8>() {
        let (kind, length) = (u32::from_le_bytes([*k0, *k1, *k2, *k3]), u32::from_le_bytes(*length));
        let split = usize::try_from(length).ok().and_then(|n| rest.split_at_checked(n));
        let (content, next) =
            split.ok_or_else(|| src.truncated("an extension record", 0, length.into(), rest.len()))?;
        if let (COORDINATE_SYSTEM, Some(value)) = (kind, content.first_chunk()) {
            // 0 stands for "unspecified", which is SPZ's own.
            number = Some(u32::from_le_bytes(*value)).filter(|&n| n > 0).unwrap_or(RIGHT_UP_BACK);
        }
        records = next;
    }
    from_numbered(number).ok_or_else(|| src.unsupported(format!("coordinate system {number}"), "export it as PLY"))
}

/// Fills `out` from the stream; a short stream is an error with the bytes read.
fn fill(stream: &mut impl Read, out: &mut [u8], field: &str, start: usize, src: Source<'_>) -> Result<(), IoError> {
    let mut have = 0;
    while let Some(rest) = out.get_mut(have..).filter(|r| !r.is_empty()) {
        match stream.read(rest) {
            Ok(0) => return Err(src.truncated(field, start, out.len() as u64, have)),
            Ok(n) => have += n,
            Err(e) => return Err(damaged(&e, start + have, src)),
        }
    }
    Ok(())
}

fn damaged(error: &std::io::Error, at: usize, src: Source<'_>) -> IoError {
    let what = format!("the compressed stream is damaged: {error}");
    src.malformed(At::Byte(at as u64), what, "copy or export the file again")
}

#[cfg(test)]
mod tests {
    use super::super::raw::tests::cloud;
    use super::super::spz::{SpzOptions, read, write};
    use super::*;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    /// The arrays of a version-3 file as version 4, with extension records and a count of streams.
    fn version_4(splats: &RawSplats, records: &[u8], streams: usize) -> Vec<u8> {
        let mut gz = Vec::new();
        write(splats, &SpzOptions::default(), &mut gz).unwrap();
        let src = Source { file: "t.spz", format: "SPZ" };
        let (header, arrays, _) = unpack(&gz, &Limits::default(), src).unwrap();
        let mut out = MAGIC.to_vec();
        out.extend(4u32.to_le_bytes());
        out.extend(u32::try_from(header.count).unwrap().to_le_bytes());
        let flags = if records.is_empty() { 0 } else { EXTENSIONS };
        out.extend([header.degree, header.fraction_bits, flags, u8::try_from(streams).unwrap()]);
        out.extend(u32::try_from(HEADER_V4 + records.len()).unwrap().to_le_bytes());
        out.extend([0; 12]);
        out.extend(records);
        let (mut table, mut packed, mut rest) = (Vec::new(), Vec::new(), arrays.as_slice());
        for width in header.widths().into_iter().filter(|&w| w > 0) {
            let (array, behind) = rest.split_at(width * header.count);
            let stream = compress_to_vec(array, CompressionLevel::Fastest);
            table.extend([stream.len(), array.len()].map(|n| (n as u64).to_le_bytes()).concat());
            packed.extend(stream);
            rest = behind;
        }
        [out, table, packed].concat()
    }

    fn record(kind: u32, value: u32) -> Vec<u8> {
        [kind, 4, value].map(u32::to_le_bytes).concat()
    }

    fn read_all(bytes: &[u8]) -> Result<RawSplats, IoError> {
        read(bytes, "t.spz", &Limits::default()).map(|(_, splats)| splats)
    }

    #[test]
    fn version_4_holds_the_arrays_of_version_3() {
        for degree in [0, 2, 3] {
            let splats = cloud(200, degree, 5);
            let mut gz = Vec::new();
            write(&splats, &SpzOptions::default(), &mut gz).unwrap();
            let streams = if degree == 0 { 5 } else { 6 };
            assert_eq!(read_all(&version_4(&splats, &[], streams)).unwrap(), read_all(&gz).unwrap());
        }
    }

    #[test]
    fn named_axes_are_honoured_and_unknown_records_skipped() {
        let splats = cloud(50, 3, 6);
        let plain = read_all(&version_4(&splats, &[], 6)).unwrap();
        let with = |records: &[u8]| read_all(&version_4(&splats, records, 6));
        assert_eq!(with(&record(0x1234_0001, 7)).unwrap(), plain);
        assert_eq!(with(&[record(0x1234_0001, 7), record(COORDINATE_SYSTEM, 0)].concat()).unwrap(), plain);
        // 6 is right-down-front: what is stored is what `.ply` holds.
        let own = with(&record(COORDINATE_SYSTEM, 6)).unwrap();
        for (a, b) in own.means.iter().zip(&plain.means) {
            assert_eq!(*a, glam::Vec3::new(b.x, -b.y, -b.z));
        }
        assert!(with(&record(COORDINATE_SYSTEM, 99)).unwrap_err().to_string().contains("coordinate system 99"));
    }

    #[test]
    fn damaged_files_are_errors() {
        let splats = cloud(20, 1, 7);
        let good = version_4(&splats, &record(COORDINATE_SYSTEM, 4), 6);
        assert!(read_all(&good).is_ok());
        for cut in 0..good.len() {
            assert!(read_all(&good[..cut]).is_err(), "cut at {cut}");
        }
        assert!(read_all(&[good.as_slice(), &[0]].concat()).unwrap_err().to_string().contains("bytes follow"));
        assert!(read_all(&version_4(&splats, &[], 5)).unwrap_err().to_string().contains("5 streams, not 6"));
        let mut wrong = good.clone();
        wrong[8] = 21; // one splat more than there are
        assert!(read_all(&wrong).unwrap_err().to_string().contains("bytes, not"));
        for at in 0..good.len() {
            let mut bytes = good.clone();
            bytes[at] ^= 0x55;
            let _ = read_all(&bytes);
        }
    }
}
