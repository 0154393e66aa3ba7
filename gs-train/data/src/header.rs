//! The size of an image without decoding it: the PNG `IHDR` chunk (PNG specification, 11.2.2) or the JPEG frame header
//! (ITU T.81, B.2.2).

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::error::DataError;
use super::files::open_regular;

/// Size and pixel format of an image file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ImageHeader {
    /// Pixels per row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// Whether the pixels carry alpha (PNG colour types 4 and 6, others with a `tRNS` chunk).
    pub(crate) has_alpha: bool,
    /// The file format.
    pub(crate) format: Format,
    /// Largest number of bytes per pixel that decoding holds at once.
    pub(crate) bytes_per_pixel: u64,
}

/// Image formats with a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    /// Portable Network Graphics, 1 to 16 bit.
    Png,
    /// JPEG, baseline or progressive.
    Jpeg,
}

const PNG_SIGNATURE: [u8; 8] = [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n'];
/// Chunks read before the pixels of a PNG.
const MAX_PNG_CHUNKS: usize = 1000;
/// Segments read before a JPEG must have its frame header.
const MAX_JPEG_SEGMENTS: usize = 1000;

/// Reads the header of an image file.
///
/// # Errors
/// `io.read` if the file cannot be opened, `data.image` if it is neither PNG nor JPEG or ends before its size is known.
pub(crate) fn read(file: &Path) -> Result<ImageHeader, DataError> {
    let mut r = BufReader::new(open_regular(file)?);
    let mut start = [0u8; 8];
    r.read_exact(&mut start).map_err(|_| DataError::decode(file, "it ends within its first 8 bytes"))?;
    let header = if start == PNG_SIGNATURE {
        png(&mut r)
    } else if start[..2] == [0xff, 0xd8] {
        r.seek(SeekFrom::Start(2)).map_err(|e| DataError::read(file, e))?;
        jpeg(&mut r)
    } else {
        return Err(DataError::decode(file, "it is neither PNG nor JPEG"));
    };
    let header = header.map_err(|_| DataError::decode(file, "it ends before its size is known"))?;
    if header.width == 0 || header.height == 0 {
        return Err(DataError::decode(file, "its size is zero"));
    }
    Ok(header)
}

fn ends() -> std::io::Error {
    std::io::ErrorKind::UnexpectedEof.into()
}

fn png(r: &mut (impl Read + Seek)) -> std::io::Result<ImageHeader> {
    let mut ihdr = [0u8; 18];
    r.read_exact(&mut ihdr)?;
    if ihdr[4..8] != *b"IHDR" {
        return Err(ends());
    }
    let word = |at: usize| u32::from_be_bytes([ihdr[at], ihdr[at + 1], ihdr[at + 2], ihdr[at + 3]]);
    let (depth, colour) = (ihdr[16], ihdr[17]);
    let channels: u64 = match colour {
        0 => 2, // a tRNS chunk may add alpha
        4 => 2,
        _ => 4,
    };
    Ok(ImageHeader {
        width: word(8),
        height: word(12),
        has_alpha: colour & 4 != 0 || names_transparent(r),
        format: Format::Png,
        bytes_per_pixel: (channels * if depth == 16 { 2 } else { 1 }).max(4),
    })
}

/// Whether a `tRNS` chunk comes before the pixels, from within `IHDR` on: a file that ends has none.
fn names_transparent(r: &mut (impl Read + Seek)) -> bool {
    // Three bytes of `IHDR` and its checksum.
    let mut skip = 7i64;
    for _ in 0..MAX_PNG_CHUNKS {
        let mut chunk = [0u8; 8];
        if r.seek_relative(skip).is_err() || r.read_exact(&mut chunk).is_err() {
            return false;
        }
        match &chunk[4..] {
            b"tRNS" => return true,
            b"IDAT" => return false,
            _ => skip = i64::from(u32::from_be_bytes([chunk[0], chunk[1], chunk[2], chunk[3]])) + 4,
        }
    }
    false
}

fn jpeg(r: &mut (impl Read + Seek)) -> std::io::Result<ImageHeader> {
    for _ in 0..MAX_JPEG_SEGMENTS {
        let mut byte = [0u8; 1];
        r.read_exact(&mut byte)?;
        if byte[0] != 0xff {
            return Err(ends());
        }
        while byte[0] == 0xff {
            r.read_exact(&mut byte)?;
        }
        let marker = byte[0];
        let mut length = [0u8; 2];
        r.read_exact(&mut length)?;
        let body = i64::from(u16::from_be_bytes(length)) - 2;
        let is_frame = (0xc0..=0xcf).contains(&marker) && ![0xc4, 0xc8, 0xcc].contains(&marker);
        if is_frame {
            let mut frame = [0u8; 5];
            r.read_exact(&mut frame)?;
            let side = |at: usize| u32::from(u16::from_be_bytes([frame[at], frame[at + 1]]));
            // Progressive frames keep 16-bit coefficients of up to three components beside the pixels.
            let progressive = marker == 0xc2;
            return Ok(ImageHeader {
                width: side(3),
                height: side(1),
                has_alpha: false,
                format: Format::Jpeg,
                bytes_per_pixel: if progressive { 12 } else { 4 },
            });
        }
        if body < 0 {
            return Err(ends());
        }
        r.seek(SeekFrom::Current(body))?;
    }
    Err(ends())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Name and body.
    type Chunk<'a> = (&'a [u8; 4], &'a [u8]);

    /// A palette file up to its pixels, with these chunks before them; checksums are not read.
    fn palette(chunks: &[Chunk]) -> ImageHeader {
        let mut bytes = PNG_SIGNATURE.to_vec();
        let mut put = |name: &[u8; 4], body: &[u8]| {
            bytes.extend(u32::try_from(body.len()).unwrap().to_be_bytes());
            bytes.extend(name);
            bytes.extend(body);
            bytes.extend([0; 4]);
        };
        put(b"IHDR", &[0, 0, 0, 5, 0, 0, 0, 3, 8, 3, 0, 0, 0]);
        chunks.iter().for_each(|(name, body)| put(name, body));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read(file.path()).unwrap()
    }

    #[test]
    fn palettes_are_transparent_where_a_chunk_before_the_pixels_says_so() {
        let colours = (b"PLTE", &[1, 2, 3, 4, 5, 6][..]);
        let (clear, pixels) = ((b"tRNS", &[0, 255][..]), (b"IDAT", &[0][..]));
        let kinds: [(&[Chunk], bool); 5] = [
            (&[colours, clear, pixels], true),
            (&[(b"tEXt", &[9; 300]), colours, clear, pixels], true),
            (&[colours, pixels], false),
            (&[colours, pixels, clear], false),
            (&[colours], false),
        ];
        for (chunks, transparent) in kinds {
            let header = palette(chunks);
            assert_eq!((header.width, header.height, header.has_alpha), (5, 3, transparent), "{chunks:?}");
        }
    }
}
