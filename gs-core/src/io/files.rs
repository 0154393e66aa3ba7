//! Files of splats: bounded reads, and formats recognised by content or chosen by name.

use super::error::{At, Source, os};
use super::{IoError, Limits, RawSplats, glb, ply, splat, spz, write_file};
use std::fs;
use std::io::{Read, Write};
use std::path::Path;

/// A format of splat files that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatFormat {
    /// 3DGS `.ply`: exact, SH degree 0 to 3, all kernels.
    Ply,
    /// `.splat`: SH degree 0, 8-bit colours and rotations.
    Splat,
    /// `.spz` version 3: quantised, about a tenth of the `.ply`, Gaussians only.
    Spz,
    /// `.glb` with the extension `KHR_gaussian_splatting`: exact, Gaussians only.
    Glb,
}

impl SplatFormat {
    /// The format of a file name's extension, in upper or lower case; `None` for others.
    pub fn of_path(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "splat" => Some(Self::Splat),
            "spz" => Some(Self::Spz),
            "glb" => Some(Self::Glb),
            _ => None,
        }
    }

    /// The extension of its files, without a dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Splat => "splat",
            Self::Spz => "spz",
            Self::Glb => "glb",
        }
    }

    /// Whether its files say if splats are drawn anti-aliased ([`RawSplats::antialiased`]).
    pub fn keeps_antialiased(self) -> bool {
        matches!(self, Self::Ply | Self::Spz)
    }

    /// What a file of this format does not say of splats, or clamps, in words; none if nothing. What the format rounds, and harmonics
    /// above its degree, are not named.
    ///
    /// ```
    /// use gs_core::io::{RawSplats, SplatFormat};
    ///
    /// let splats = RawSplats { antialiased: true, ..RawSplats::default() };
    /// assert!(SplatFormat::Glb.note(&splats).unwrap().contains("anti-aliased"));
    /// assert_eq!(SplatFormat::Spz.note(&splats), None);
    /// ```
    pub fn note(self, splats: &RawSplats) -> Option<String> {
        let mut parts = Vec::new();
        if splats.antialiased && !self.keeps_antialiased() {
            let name = self.extension();
            parts.push(format!(
                ".{name} files cannot say that splats are to be drawn anti-aliased: viewers draw small ones too opaque"
            ));
        }
        let clamped = match self {
            Self::Ply | Self::Glb => spz::Clamped::default(),
            Self::Splat => spz::Clamped { colors: splat::clamped(splats), ..spz::Clamped::default() },
            Self::Spz => spz::Clamped::of(splats, &spz::SpzOptions::default()),
        };
        if clamped.total() > 0 {
            let spz::Clamped { colors, log_scales, sh } = clamped;
            let (name, splats) = (self.extension(), splats.len());
            parts.push(format!(
                "of {splats} splats, values beyond the range of .{name} files were clamped: {colors} colours, {log_scales} scales, {sh} harmonics"
            ));
        }
        (!parts.is_empty()).then(|| parts.join("; "))
    }
}

/// The bytes of a regular file of at most `limits.max_bytes`.
///
/// # Errors
/// The system's, a size above the limit, or a path that is no regular file (device, pipe, folder).
pub fn read_file(path: &Path, limits: &Limits) -> Result<Vec<u8>, IoError> {
    let name = path.display().to_string();
    let src = Source { file: &name, format: "file" };
    let meta = fs::metadata(path).map_err(|e| os(path, "open", e))?;
    if !meta.is_file() {
        return Err(src.unsupported("a path that is not a regular file", "give a file"));
    }
    for (limit, name) in [(limits.max_bytes, "max_bytes"), (limits.max_memory, "max_memory")] {
        if meta.len() > limit {
            return Err(src.limit("file size", meta.len(), limit, name));
        }
    }
    let mut bytes = Vec::new();
    let file = fs::File::open(path).map_err(|e| os(path, "open", e))?;
    let size = usize::try_from(meta.len()).unwrap_or(usize::MAX);
    bytes.try_reserve_exact(size).map_err(|e| os(path, "read", std::io::Error::other(e)))?;
    // A file that grows meanwhile is cut at its size when opened.
    file.take(meta.len()).read_to_end(&mut bytes).map_err(|e| os(path, "read", e))?;
    Ok(bytes)
}

/// The text of a regular file of at most `limits.max_bytes`.
///
/// # Errors
/// As [`read_file`]; bytes that are no UTF-8.
pub fn read_text(path: &Path, limits: &Limits) -> Result<String, IoError> {
    let text = String::from_utf8(read_file(path, limits)?);
    text.map_err(|e| os(path, "read", std::io::Error::new(std::io::ErrorKind::InvalidData, e)))
}

/// Splats from bytes; the content determines the format. `.splat` has no magic number: other content is read as `.splat`
/// if `file`, the name used in errors, ends in `.splat`.
///
/// # Errors
/// Those of the format's reader; an unknown or unsupported format by name.
pub fn parse_splats(bytes: &[u8], file: &str, limits: &Limits) -> Result<RawSplats, IoError> {
    let src = Source { file, format: "splat file" };
    let ends_with = |extension: &str| file.to_ascii_lowercase().ends_with(extension);
    if bytes.starts_with(b"ply") || bytes.starts_with(b"\xEF\xBB\xBFply") {
        return ply::read(bytes, file, limits);
    }
    if bytes.starts_with(b"\x1f\x8b") || bytes.starts_with(b"NGSP") {
        return spz::read(bytes, file, limits).map(|(_, splats)| splats);
    }
    if bytes.starts_with(b"glTF") {
        return glb::read(bytes, file, limits);
    }
    // A .ksplat starts with its version (0.1) and a header of 4096 bytes.
    if ends_with(".ksplat") || (bytes.starts_with(&[0, 1, 0, 0]) && bytes.len() >= 4096 && !ends_with(".splat")) {
        return Err(src.unsupported("the .ksplat format", "convert it to .ply, .splat, .spz, .glb or .sog"));
    }
    if bytes.starts_with(b"PK") {
        return sog(bytes, file, limits);
    }
    if ends_with(".splat") {
        return splat::read(bytes, file, limits);
    }
    let what = "neither PLY, nor SPZ, GLB or SOG, and the name does not end in .splat";
    Err(src.malformed(At::Byte(0), what, "give a .ply, .splat, .spz, .glb or .sog file"))
}

#[cfg(feature = "images")]
fn sog(bytes: &[u8], file: &str, limits: &Limits) -> Result<RawSplats, IoError> {
    super::sog::read(bytes, file, limits).map(|(_, splats)| splats)
}

#[cfg(not(feature = "images"))]
fn sog(_: &[u8], file: &str, _: &Limits) -> Result<RawSplats, IoError> {
    let src = Source { file, format: "splat file" };
    Err(src.unsupported("a zip archive (.sog?)", "build gs-core with the feature `images`, or convert it to .ply"))
}

/// Reads a splat file of any supported format; the content determines the format. `meta.json` of a SOG scene is read with the images
/// beside it.
///
/// # Errors
/// As [`read_file`] and [`parse_splats`].
pub fn load_splats(path: &Path, limits: &Limits) -> Result<RawSplats, IoError> {
    #[cfg(feature = "images")]
    if path.file_name().is_some_and(|name| name == "meta.json") {
        return super::sog::load(path, limits).map(|(_, splats)| splats);
    }
    let bytes = read_file(path, limits)?;
    parse_splats(&bytes, &path.display().to_string(), limits)
}

/// Writes splats in the format of the file name's extension, completely or not at all.
///
/// # Errors
/// An unknown extension, an existing file without `overwrite`, columns of unequal length, or the system's.
pub fn save_splats(path: &Path, splats: &RawSplats, overwrite: bool) -> Result<(), IoError> {
    splats.check_shape()?;
    let format = SplatFormat::of_path(path).ok_or_else(|| IoError::Unsupported {
        file: path.display().to_string().into(),
        what: "writing splats to this extension".into(),
        advice: "end the name in .ply, .splat, .spz or .glb",
    })?;
    write_file(path, overwrite, |out| write_in(format, splats, out))
}

fn write_in(format: SplatFormat, splats: &RawSplats, out: &mut dyn Write) -> std::io::Result<()> {
    match format {
        SplatFormat::Ply => ply::write(splats, out),
        SplatFormat::Splat => splat::write(splats, out),
        SplatFormat::Spz => spz::write(splats, &spz::SpzOptions::default(), out),
        SplatFormat::Glb => glb::write(splats, out),
    }
}

/// Appends splats, encoded in a format, to `out`.
///
/// # Errors
/// Splats that the format cannot hold.
pub fn write_splats(format: SplatFormat, splats: &RawSplats, out: &mut Vec<u8>) -> Result<(), IoError> {
    let name = format!("memory.{}", format.extension());
    write_in(format, splats, out).map_err(|e| os(Path::new(&name), "write", e))
}

#[cfg(test)]
mod tests {
    use super::super::raw::tests::cloud;
    use super::*;

    #[test]
    fn content_determines_the_format_and_nothing_is_overwritten_by_default() {
        let dir = tempfile::tempdir().unwrap();
        let splats = cloud(20, 1, 31);
        for name in ["a.ply", "b.splat", "c.SPZ"] {
            let path = dir.path().join(name);
            save_splats(&path, &splats, false).unwrap();
            let error = save_splats(&path, &splats, false).unwrap_err();
            assert!(matches!(error, IoError::Exists { .. }), "{error}");
            save_splats(&path, &splats, true).unwrap();
            assert_eq!(load_splats(&path, &Limits::default()).unwrap().len(), 20);
        }
        // The content decides, whatever the name.
        fs::rename(dir.path().join("a.ply"), dir.path().join("x.spz")).unwrap();
        assert_eq!(load_splats(&dir.path().join("x.spz"), &Limits::default()).unwrap(), splats);
        assert!(save_splats(&dir.path().join("a.obj"), &splats, false).unwrap_err().to_string().contains(".ply"));
        let left: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left.len(), 3, "no temporary file stays: {left:?}");
    }

    #[test]
    fn what_a_file_does_not_keep_is_told() {
        let mut bright = RawSplats { antialiased: true, ..cloud(20, 1, 32) };
        bright.sh.fill(0.0);
        let keeps = |format: SplatFormat| {
            let mut bytes = Vec::new();
            write_splats(format, &bright, &mut bytes).unwrap();
            parse_splats(&bytes, "a.splat", &Limits::default()).unwrap().antialiased
        };
        for format in [SplatFormat::Ply, SplatFormat::Spz, SplatFormat::Splat, SplatFormat::Glb] {
            assert_eq!([keeps(format), format.note(&bright).is_none()], [format.keeps_antialiased(); 2], "{format:?}");
        }
        bright.antialiased = false;
        (bright.sh[0], bright.sh[1], bright.sh[3]) = (1.7, 4.0, 2.0);
        assert_eq!(SplatFormat::Ply.note(&bright), None);
        let note = |format: SplatFormat| format.note(&bright).unwrap();
        assert!(note(SplatFormat::Spz).ends_with("clamped: 1 colours, 0 scales, 1 harmonics"));
        assert!(note(SplatFormat::Splat).ends_with("clamped: 1 colours, 0 scales, 0 harmonics"));
    }

    #[test]
    fn unknown_formats_and_paths_are_named() {
        let parse = |bytes: &[u8], name: &str| parse_splats(bytes, name, &Limits::default()).unwrap_err().to_string();
        assert!(parse(b"solid", "a.stl").contains("neither PLY"));
        assert!(parse(&[0; 64], "a.ksplat").contains(".ksplat"));
        assert!(parse_splats(&[0; 0], "a.splat", &Limits::default()).unwrap().is_empty());
        let dir = tempfile::tempdir().unwrap();
        let read = |path: &Path, limits: &Limits| read_file(path, limits).unwrap_err().to_string();
        assert!(read(dir.path(), &Limits::default()).contains("not a regular file"));
        assert!(read(&dir.path().join("none"), &Limits::default()).contains("cannot open"));
        let path = dir.path().join("big");
        fs::write(&path, [0; 100]).unwrap();
        let tight = Limits { max_bytes: 99, ..Limits::default() };
        assert!(read(&path, &tight).contains("file size = 100 is above the limit 99"));
    }
}
