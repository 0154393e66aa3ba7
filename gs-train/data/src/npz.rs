//! One array of a NumPy `.npz`: a ZIP archive (PKWARE APPNOTE 6.3) of `.npy` files, stored or deflated.
//!
//! The list of members is the central directory at the end of the archive; its sizes are right where local headers omit them. Archives above 4 GiB, encryption and several disks are refused.

use std::io::Read;
use std::path::Path;

use flate2::read::DeflateDecoder;

use super::error::{DataError, Place};

/// Bytes of the record that ends an archive, and of the longest comment behind it.
const END_BYTES: usize = 22;
const MAX_COMMENT: usize = 0xffff;
/// Memory that every member may take, whatever the size of its archive.
const BASE_BYTES: u64 = 64 << 20;
/// Additional bytes in memory per byte of the archive.
const BYTES_PER_FILE_BYTE: u64 = 8;

/// The bytes of member `name` of the archive `bytes`, which came from `file`.
///
/// # Errors
/// `data.syntax` if it is no archive, is damaged or has no such member; `limits.file` if the member unpacks to more than 64
/// MiB plus eight times the archive.
pub(crate) fn member(file: &Path, bytes: &[u8], name: &str) -> Result<Vec<u8>, DataError> {
    let broken = |at: &str, message: &str| DataError::syntax(file, at, message);
    let end = end_record(bytes).ok_or_else(|| broken("", "it is no ZIP archive"))?;
    let entry = find(bytes, end, name).ok_or_else(|| broken("", &format!("it holds no member \"{name}\"")))?;
    if entry.flags & 1 != 0 {
        return Err(broken(name, "it is encrypted"));
    }
    let packed = packed(bytes, &entry).ok_or_else(|| broken(name, "it ends early"))?;
    let limit = BASE_BYTES + BYTES_PER_FILE_BYTE * bytes.len() as u64;
    let mut out = Vec::new();
    match entry.method {
        0 => out.extend_from_slice(packed),
        8 => {
            let read = DeflateDecoder::new(packed).take(limit + 1).read_to_end(&mut out);
            read.map_err(|e| broken(name, &format!("it does not unpack: {e}")))?;
        }
        other => return Err(broken(name, &format!("packing method {other} is not supported"))),
    }
    if out.len() as u64 > limit {
        return Err(DataError::TooLarge { place: Place::new(file, name), bytes: out.len() as u64, limit });
    }
    let mut sum = crc32fast::Hasher::new();
    sum.update(&out);
    if out.len() as u64 != entry.size || sum.finalize() != entry.crc {
        return Err(broken(name, "its size or checksum is not what the archive states"));
    }
    Ok(out)
}

/// A member as the central directory lists it.
struct Entry {
    flags: u16,
    method: u16,
    crc: u32,
    packed: u64,
    size: u64,
    /// Offset of the local header.
    offset: u64,
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(bytes.get(at..at.checked_add(2)?)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

/// Offset of the record that ends the archive: the last one with its signature.
fn end_record(bytes: &[u8]) -> Option<usize> {
    let last = bytes.len().checked_sub(END_BYTES)?;
    let first = last.saturating_sub(MAX_COMMENT);
    (first..=last).rev().find(|&at| bytes[at..].starts_with(b"PK\x05\x06"))
}

fn find(bytes: &[u8], end: usize, name: &str) -> Option<Entry> {
    let entries = u16_at(bytes, end + 10)?;
    let mut at = u32_at(bytes, end + 16)? as usize;
    for _ in 0..entries {
        if !bytes.get(at..)?.starts_with(b"PK\x01\x02") {
            return None;
        }
        let lengths = [28, 30, 32].map(|k| u16_at(bytes, at + k).map(usize::from));
        let [Some(name_len), Some(extra), Some(comment)] = lengths else { return None };
        if bytes.get(at + 46..at + 46 + name_len)? == name.as_bytes() {
            return Some(Entry {
                flags: u16_at(bytes, at + 8)?,
                method: u16_at(bytes, at + 10)?,
                crc: u32_at(bytes, at + 16)?,
                packed: u64::from(u32_at(bytes, at + 20)?),
                size: u64::from(u32_at(bytes, at + 24)?),
                offset: u64::from(u32_at(bytes, at + 42)?),
            });
        }
        at += 46 + name_len + extra + comment;
    }
    None
}

/// The bytes behind a member's local header.
fn packed<'a>(bytes: &'a [u8], entry: &Entry) -> Option<&'a [u8]> {
    let at = usize::try_from(entry.offset).ok()?;
    if !bytes.get(at..)?.starts_with(b"PK\x03\x04") {
        return None;
    }
    let start = at + 30 + usize::from(u16_at(bytes, at + 26)?) + usize::from(u16_at(bytes, at + 28)?);
    bytes.get(start..start.checked_add(usize::try_from(entry.packed).ok()?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    /// An archive of one member, as `numpy.savez` and `numpy.savez_compressed` write it.
    fn archive(name: &str, contents: &[u8], deflate: bool) -> Vec<u8> {
        let packed = if deflate {
            let mut e = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::default());
            e.write_all(contents).unwrap();
            e.finish().unwrap()
        } else {
            contents.to_vec()
        };
        let crc = crc32fast::hash(contents);
        let method = if deflate { 8u16 } else { 0 };
        let words = |w: &[u16]| w.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let longs = |w: &[u32]| w.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let mut out = [b"PK\x03\x04".to_vec(), words(&[45, 0, method, 0, 33])].concat();
        // NumPy leaves the sizes of local headers to a 64-bit extra field.
        out.extend([longs(&[crc, u32::MAX, u32::MAX]), words(&[name.len() as u16, 20])].concat());
        out.extend(name.bytes().chain([0; 20]));
        out.extend(&packed);
        let directory = out.len() as u32;
        out.extend([b"PK\x01\x02".to_vec(), words(&[45, 45, 0, method, 0, 33])].concat());
        out.extend(longs(&[crc, packed.len() as u32, contents.len() as u32]));
        out.extend([words(&[name.len() as u16, 0, 0, 0, 0]), longs(&[0, 0])].concat());
        out.extend(name.bytes());
        let size = out.len() as u32 - directory;
        out.extend([b"PK\x05\x06".to_vec(), words(&[0, 0, 1, 1]), longs(&[size, directory]), words(&[0])].concat());
        out
    }

    fn read(bytes: &[u8]) -> Result<Vec<u8>, DataError> {
        member("a.npz".as_ref(), bytes, "data.npy")
    }

    #[test]
    fn stored_and_deflated_members_are_read() {
        let contents: Vec<u8> = (0..5000u32).map(|k| (k * k % 251) as u8).collect();
        for deflate in [false, true] {
            let mut bytes = archive("data.npy", &contents, deflate);
            assert_eq!(read(&bytes).unwrap(), contents);
            let at = bytes.len() / 2;
            bytes[at] ^= 0x40;
            let e = read(&bytes).unwrap_err();
            assert_eq!(e.code(), "data.syntax", "{e}");
            assert!(read(&archive("other.npy", &contents, deflate)).unwrap_err().to_string().contains("no member"));
        }
    }

    #[test]
    fn cut_changed_and_inflated_archives_are_errors() {
        let whole = archive("data.npy", b"some values, some values, some values", true);
        for cut in 0..whole.len() {
            assert!(read(&whole[..cut]).is_err(), "cut at {cut}");
        }
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0xff;
            // Times, versions and unused fields may change; nothing may panic, and contents must be right.
            assert!(read(&bytes).map_or(true, |c| c.starts_with(b"some values")), "byte {at}");
        }
        let bomb = archive("data.npy", &vec![0; 80 << 20], true);
        assert_eq!(read(&bomb).unwrap_err().code(), "limits.file");
    }
}
