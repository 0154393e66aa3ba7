//! The bytes of a checkpoint, as the module above describes them. CRC-32 finds every burst of up to 32 bits; a length is believed only as far
//! as bytes are present.

use super::Checkpoint;
use super::packed::{self, Encoding};
use std::io::{self, Read, Write};

const MAGIC: &[u8; 8] = b"GS4DCKPT";
/// Version of the file layout.
pub const VERSION: u32 = 1;
/// Version of the layout whose tensors are packed.
pub const PACKED_VERSION: u32 = 2;
const META: &str = "meta";
const HEADER_BYTES: u64 = 20;
/// A section without name and payload: two lengths and a checksum.
const SECTION_OVERHEAD: u64 = 16;
const MAX_NAME_BYTES: u32 = 4096;
/// Floats converted at once.
const CHUNK: usize = 4096;

/// Writes header and sections.
pub(super) fn write(out: &mut impl Write, meta: &[u8], tensors: &[(String, Vec<f32>)]) -> io::Result<()> {
    write_head(out, VERSION, meta, tensors.len())?;
    for (name, values) in tensors {
        write_section(out, name, 4 * values.len() as u64, |w| {
            let mut bytes = [0u8; 4 * CHUNK];
            for chunk in values.chunks(CHUNK) {
                for (slot, v) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(chunk) {
                    *slot = v.to_bits().to_le_bytes();
                }
                w.write_all(&bytes[..4 * chunk.len()])?;
            }
            Ok(())
        })?;
    }
    Ok(())
}

/// Writes header and sections, each tensor packed by its encoding; gives the bytes of each payload.
pub(super) fn write_packed(
    out: &mut impl Write,
    meta: &[u8],
    tensors: &[(String, Vec<f32>)],
    encodings: &[Encoding],
) -> io::Result<Vec<usize>> {
    write_head(out, PACKED_VERSION, meta, tensors.len())?;
    let mut payloads: Vec<_> =
        tensors.iter().zip(encodings).map(|((_, values), encoding)| packed::pack(values, encoding)).collect();
    packed::pad(&mut payloads, tensors.iter().map(|(_, values)| values.len() as u64).sum());
    for ((name, _), payload) in tensors.iter().zip(&payloads) {
        write_section(out, name, payload.len() as u64, |w| w.write_all(payload))?;
    }
    Ok(payloads.iter().map(Vec::len).collect())
}

fn write_head(out: &mut impl Write, version: u32, meta: &[u8], tensors: usize) -> io::Result<()> {
    let sections = u32::try_from(tensors + 1).map_err(|_| io::Error::other("more than 2^32 tensors"))?;
    let mut summed = Summed::new(&mut *out);
    summed.write_all(MAGIC)?;
    summed.write_all(&version.to_le_bytes())?;
    summed.write_all(&sections.to_le_bytes())?;
    summed.finish()?;
    write_section(out, META, meta.len() as u64, |w| w.write_all(meta))
}

fn write_section<W: Write>(
    out: &mut W,
    name: &str,
    payload_len: u64,
    payload: impl FnOnce(&mut Summed<&mut W>) -> io::Result<()>,
) -> io::Result<()> {
    let name_len = u32::try_from(name.len()).ok().filter(|&n| n <= MAX_NAME_BYTES);
    let name_len = name_len.ok_or_else(|| io::Error::other("a tensor name is longer than 4096 bytes"))?;
    let mut summed = Summed::new(out);
    summed.write_all(&name_len.to_le_bytes())?;
    summed.write_all(&payload_len.to_le_bytes())?;
    summed.write_all(name.as_bytes())?;
    payload(&mut summed)?;
    summed.finish()
}

/// Passes bytes on and keeps their checksum.
struct Summed<W> {
    inner: W,
    crc: crc32fast::Hasher,
}

impl<W: Write> Summed<W> {
    fn new(inner: W) -> Self {
        Self { inner, crc: crc32fast::Hasher::new() }
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.crc.update(bytes);
        self.inner.write_all(bytes)
    }

    fn finish(mut self) -> io::Result<()> {
        let crc = self.crc.finalize();
        self.inner.write_all(&crc.to_le_bytes())
    }
}

/// A fault of the bytes, before the file's name is known.
pub(super) enum Fault {
    Io(io::Error),
    Version(u32),
    At(u64, String),
}

/// Reads at most what is left of the file, and sums it.
struct Source<'a, R> {
    inner: &'a mut R,
    offset: u64,
    left: u64,
    crc: crc32fast::Hasher,
}

impl<R: Read> Source<'_, R> {
    fn fault<T>(&self, what: impl Into<String>) -> Result<T, Fault> {
        Err(Fault::At(self.offset, what.into()))
    }

    /// Refuses a count that the rest of the file cannot hold, before anything is allocated for it.
    fn expect(&self, bytes: u64, what: &str) -> Result<usize, Fault> {
        if bytes > self.left {
            return self.fault(format!("{what} needs {bytes} bytes, {} are left", self.left));
        }
        usize::try_from(bytes).or_else(|_| self.fault(format!("{what} does not fit this machine's memory")))
    }

    fn fill(&mut self, buffer: &mut [u8], what: &str) -> Result<(), Fault> {
        self.expect(buffer.len() as u64, what)?;
        self.inner.read_exact(buffer).map_err(Fault::Io)?;
        self.crc.update(buffer);
        self.offset += buffer.len() as u64;
        self.left -= buffer.len() as u64;
        Ok(())
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], Fault> {
        let mut bytes = [0; N];
        self.fill(&mut bytes, what)?;
        Ok(bytes)
    }

    /// Compares the checksum of what was read since the last call with the one stored here.
    fn verify(&mut self, what: &str) -> Result<(), Fault> {
        let found = std::mem::take(&mut self.crc).finalize();
        let stored = u32::from_le_bytes(self.array("a checksum")?);
        self.crc = crc32fast::Hasher::new();
        if stored == found { Ok(()) } else { self.fault(format!("{what} does not match its checksum")) }
    }
}

/// Reads and verifies header and sections of a file of `bytes` bytes.
pub(super) fn read(inner: &mut impl Read, bytes: u64) -> Result<Checkpoint, Fault> {
    let mut source = Source { inner, offset: 0, left: bytes, crc: crc32fast::Hasher::new() };
    if &source.array::<8>("the header")? != MAGIC {
        return Err(Fault::At(0, "this is not a gs4d checkpoint".to_owned()));
    }
    let version = u32::from_le_bytes(source.array("the header")?);
    let sections = u32::from_le_bytes(source.array("the header")?);
    source.verify("the header")?;
    if ![VERSION, PACKED_VERSION].contains(&version) {
        return Err(Fault::Version(version));
    }
    debug_assert_eq!(source.offset, HEADER_BYTES);
    source.expect(u64::from(sections) * SECTION_OVERHEAD, "the list of sections")?;
    let meta = read_meta(&mut source)?;
    let mut tensors = Vec::new();
    let mut values_left = packed::max_values(bytes);
    for _ in 1..sections {
        tensors.push(match version {
            VERSION => read_tensor(&mut source)?,
            _ => read_packed(&mut source, &mut values_left)?,
        });
    }
    if source.left > 0 {
        return source.fault(format!("{} bytes stand behind the last section", source.left));
    }
    Ok(Checkpoint { meta, tensors })
}

fn read_meta<R: Read>(source: &mut Source<'_, R>) -> Result<serde_json::Value, Fault> {
    let (name, length) = read_section_head(source)?;
    if name != META {
        return source.fault(format!("the first section is `{name}`, not `{META}`"));
    }
    let mut json = vec![0; length];
    source.fill(&mut json, "the meta section")?;
    source.verify("section `meta`")?;
    serde_json::from_slice(&json).or_else(|e| source.fault(format!("section `meta` is not JSON: {e}")))
}

fn read_tensor<R: Read>(source: &mut Source<'_, R>) -> Result<(String, Vec<f32>), Fault> {
    let (name, length) = read_section_head(source)?;
    if !length.is_multiple_of(4) {
        return source.fault(format!("tensor `{name}` has {length} bytes, which is no whole number of values"));
    }
    let mut values = Vec::with_capacity(length / 4);
    let mut bytes = [0u8; 4 * CHUNK];
    let mut left = length;
    while left > 0 {
        let part = &mut bytes[..left.min(4 * CHUNK)];
        source.fill(part, "a tensor")?;
        values.extend(part.as_chunks::<4>().0.iter().map(|b| f32::from_bits(u32::from_le_bytes(*b))));
        left -= part.len();
    }
    source.verify(&format!("tensor `{name}`"))?;
    Ok((name, values))
}

fn read_packed<R: Read>(source: &mut Source<'_, R>, values_left: &mut u64) -> Result<(String, Vec<f32>), Fault> {
    let (name, length) = read_section_head(source)?;
    let mut payload = vec![0; length];
    source.fill(&mut payload, "a packed tensor")?;
    source.verify(&format!("tensor `{name}`"))?;
    let values = packed::unpack(&payload, *values_left);
    let values = values.or_else(|what| source.fault(format!("packed tensor `{name}` {what}")))?;
    *values_left -= values.len() as u64;
    Ok((name, values))
}

/// Name and payload length of the next section, both known to fit the file.
fn read_section_head<R: Read>(source: &mut Source<'_, R>) -> Result<(String, usize), Fault> {
    let name_len = u32::from_le_bytes(source.array("a section")?);
    let payload_len = u64::from_le_bytes(source.array("a section")?);
    if name_len > MAX_NAME_BYTES {
        return source.fault(format!("a section name of {name_len} bytes (limit {MAX_NAME_BYTES})"));
    }
    let mut name = vec![0; source.expect(u64::from(name_len), "a section name")?];
    source.fill(&mut name, "a section name")?;
    let name = String::from_utf8(name).or_else(|_| source.fault("a section name is not UTF-8"))?;
    let payload_len = source.expect(payload_len, &format!("section `{name}`"))?;
    Ok((name, payload_len))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn sample() -> Checkpoint {
        let odd = [f32::NAN.to_bits(), 0x7fa0_1234, 0xffc0_0001, 1, 0x8000_0000, f32::MAX.to_bits()];
        Checkpoint {
            meta: json!({"step": 7, "lr": 0.1 + 0.2, "tiny": 5e-324, "seed": u64::MAX}),
            tensors: vec![
                ("cloud.means".into(), vec![1.0, -2.5, 3.25]),
                ("odd".into(), odd.map(f32::from_bits).to_vec()),
                ("empty".into(), vec![]),
            ],
        }
    }

    fn bytes_of(c: &Checkpoint) -> Vec<u8> {
        let mut out = Vec::new();
        write(&mut out, &serde_json::to_vec(&c.meta).unwrap(), &c.tensors).unwrap();
        out
    }

    fn parse(bytes: &[u8]) -> Result<Checkpoint, String> {
        read(&mut &bytes[..], bytes.len() as u64).map_err(|f| match f {
            Fault::Io(e) => panic!("reads past the stated end: {e}"),
            Fault::Version(v) => format!("version {v}"),
            Fault::At(offset, what) => format!("{offset}: {what}"),
        })
    }

    #[test]
    fn every_bit_survives() {
        let bits = |c: &Checkpoint| -> Vec<(String, Vec<u32>)> {
            c.tensors.iter().map(|(n, v)| (n.clone(), v.iter().map(|x| x.to_bits()).collect())).collect()
        };
        let mut large = sample();
        large.tensors.push(("large".into(), (0..3 * CHUNK + 5).map(|i| f32::from_bits(i as u32 * 77_777)).collect()));
        let back = parse(&bytes_of(&large)).unwrap();
        assert_eq!(bits(&back), bits(&large));
        assert_eq!(back.meta, large.meta);
        assert_eq!(back.meta["lr"].as_f64(), Some(0.1 + 0.2));
    }

    #[test]
    fn truncation_at_every_byte_is_an_error() {
        let whole = bytes_of(&sample());
        for cut in 0..whole.len() {
            assert!(parse(&whole[..cut]).is_err(), "cut at {cut} of {}", whole.len());
        }
        let mut longer = whole.clone();
        longer.push(0);
        assert!(parse(&longer).unwrap_err().contains("1 bytes stand behind"));
    }

    #[test]
    fn every_flipped_bit_is_found() {
        let whole = bytes_of(&sample());
        for bit in 0..8 * whole.len() {
            let mut bad = whole.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(parse(&bad).is_err(), "bit {bit}");
        }
    }

    #[test]
    fn huge_lengths_are_refused_before_allocation() {
        for length in [1u64 << 31, 1 << 32, 1 << 63, u64::MAX] {
            let mut bytes = bytes_of(&Checkpoint::default());
            bytes[24..32].copy_from_slice(&length.to_le_bytes());
            assert!(parse(&bytes).unwrap_err().contains("bytes, 8 are left"), "{length}");
        }
        let mut bytes = bytes_of(&sample());
        bytes[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
        let crc = crc32fast::hash(&bytes[..16]);
        bytes[16..20].copy_from_slice(&crc.to_le_bytes());
        assert!(parse(&bytes).unwrap_err().contains("list of sections"));
    }

    #[test]
    fn another_version_is_named() {
        let mut bytes = bytes_of(&sample());
        bytes[8..12].copy_from_slice(&9u32.to_le_bytes());
        let crc = crc32fast::hash(&bytes[..16]);
        bytes[16..20].copy_from_slice(&crc.to_le_bytes());
        assert_eq!(parse(&bytes).unwrap_err(), "version 9");
    }

    /// Accepts `left` bytes, then fails as a full disk does.
    struct Full {
        left: usize,
    }

    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.left == 0 {
                return Err(io::Error::from(io::ErrorKind::StorageFull));
            }
            let n = bytes.len().min(self.left);
            self.left -= n;
            Ok(n)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_write_that_fails_anywhere_is_reported() {
        let c = sample();
        let meta = serde_json::to_vec(&c.meta).unwrap();
        let size = bytes_of(&c).len();
        for left in 0..size {
            let error = write(&mut Full { left }, &meta, &c.tensors).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        }
        assert!(write(&mut Full { left: size }, &meta, &c.tensors).is_ok());
    }
}
