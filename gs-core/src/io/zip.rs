//! Members of a ZIP archive (PKWARE APPNOTE 6.3), stored or deflated.
//!
//! The list of members is the central directory at the end of the archive; its sizes are right where local headers omit them.
//! Archives above 4 GiB, encryption and several disks are refused.

use super::error::{At, Source};
use super::{IoError, Limits};
use flate2::read::DeflateDecoder;
use std::io::Read;

/// Bytes of the record that ends an archive, and of the longest comment behind it.
const END_BYTES: usize = 22;
const MAX_COMMENT: usize = 0xffff;
/// What to do about an archive that cannot be read.
const ADVICE: &str = "copy or export the file again";

/// The bytes of member `name` of the archive `bytes`. `file` is the name used in errors.
///
/// # Errors
/// If it is no archive, is damaged or has no such member, or the member unpacks to more than the limits allow.
pub fn member(bytes: &[u8], file: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
    let src = Source { file, format: "ZIP" };
    let broken = |what: String| src.malformed(At::Byte(0), what, ADVICE);
    let end = end_record(bytes).ok_or_else(|| broken("it is no ZIP archive".into()))?;
    let entry = find(bytes, end, name)
        .ok_or_else(|| src.missing(At::Byte(end as u64), name, "the archive is not of the kind that was expected"))?;
    if entry.flags & 1 != 0 {
        return Err(src.unsupported(format!("the encrypted member {name}"), "export it without a password"));
    }
    let packed = packed(bytes, &entry).ok_or_else(|| broken(format!("{name} ends early")))?;
    let mut out = Vec::new();
    match entry.method {
        0 => out.extend_from_slice(packed),
        8 => {
            // Its stated size may be wrong, so that what comes out is bounded, too.
            limits.expansion(src, entry.size, bytes.len())?;
            let read = DeflateDecoder::new(packed).take(entry.size + 1).read_to_end(&mut out);
            read.map_err(|e| broken(format!("{name} does not unpack: {e}")))?;
        }
        other => return Err(src.unsupported(format!("packing method {other} of {name}"), "store or deflate it")),
    }
    let mut sum = flate2::Crc::new();
    sum.update(&out);
    if out.len() as u64 != entry.size || sum.sum() != entry.crc {
        return Err(broken(format!("size or checksum of {name} is not what the archive states")));
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
    (first..=last).rev().find(|&at| bytes.get(at..).is_some_and(|rest| rest.starts_with(b"PK\x05\x06")))
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
pub(super) mod tests {
    use super::*;
    use std::io::Write;

    /// An archive of members, with sizes as NumPy writes them: those of local headers in a 64-bit extra field.
    pub(in crate::io) fn archive(members: &[(&str, &[u8])], deflate: bool) -> Vec<u8> {
        let words = |w: &[u16]| w.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let longs = |w: &[u32]| w.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let (mut out, mut directory) = (Vec::new(), Vec::new());
        for (name, contents) in members {
            let packed = if deflate {
                let mut e = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::default());
                e.write_all(contents).unwrap();
                e.finish().unwrap()
            } else {
                contents.to_vec()
            };
            let mut crc = flate2::Crc::new();
            crc.update(contents);
            let (crc, method, at) = (crc.sum(), if deflate { 8u16 } else { 0 }, out.len() as u32);
            out.extend([b"PK\x03\x04".to_vec(), words(&[45, 0, method, 0, 33])].concat());
            out.extend([longs(&[crc, u32::MAX, u32::MAX]), words(&[name.len() as u16, 20])].concat());
            out.extend(name.bytes().chain([0; 20]));
            out.extend(&packed);
            directory.extend([b"PK\x01\x02".to_vec(), words(&[45, 45, 0, method, 0, 33])].concat());
            directory.extend(longs(&[crc, packed.len() as u32, contents.len() as u32]));
            directory.extend([words(&[name.len() as u16, 0, 0, 0, 0]), longs(&[0, at])].concat());
            directory.extend(name.bytes());
        }
        let (n, at, size) = (members.len() as u16, out.len() as u32, directory.len() as u32);
        out.extend(directory);
        out.extend([b"PK\x05\x06".to_vec(), words(&[0, 0, n, n]), longs(&[size, at]), words(&[0])].concat());
        out
    }

    fn read(bytes: &[u8], name: &str) -> Result<Vec<u8>, IoError> {
        member(bytes, "a.zip", name, &Limits::default())
    }

    #[test]
    fn stored_and_deflated_members_are_read() {
        let contents: Vec<u8> = (0..5000u32).map(|k| (k * k % 251) as u8).collect();
        for deflate in [false, true] {
            let mut bytes = archive(&[("other", b"x"), ("data.npy", &contents)], deflate);
            assert_eq!(read(&bytes, "data.npy").unwrap(), contents);
            assert_eq!(read(&bytes, "other").unwrap(), b"x");
            assert!(read(&bytes, "none").unwrap_err().to_string().contains("`none` is missing"));
            let at = bytes.len() / 2;
            bytes[at] ^= 0x40;
            assert!(matches!(read(&bytes, "data.npy"), Err(IoError::Malformed { .. })));
        }
    }

    #[test]
    fn cut_changed_and_inflated_archives_are_errors() {
        let whole = archive(&[("data.npy", b"some values, some values, some values")], true);
        for cut in 0..whole.len() {
            assert!(read(&whole[..cut], "data.npy").is_err(), "cut at {cut}");
        }
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0xff;
            // Times, versions and unused fields may change; nothing may panic, and contents must be right.
            assert!(read(&bytes, "data.npy").map_or(true, |c| c.starts_with(b"some values")), "byte {at}");
        }
        let bomb = archive(&[("data.npy", &vec![0; 80 << 20])], true);
        assert!(matches!(read(&bomb, "data.npy"), Err(IoError::Limit { .. })));
    }
}
