//! Videos by ffmpeg, where it is installed: frames go to its input, the file appears when it is whole.

use crate::failure::{Class, Failure};
use std::ffi::OsString;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A running ffmpeg that reads YUV4MPEG2 and writes H.264.
pub struct Encoder {
    child: Child,
    path: PathBuf,
    unfinished: PathBuf,
}

impl Encoder {
    /// Fails if there is no ffmpeg, before anything is rendered.
    pub fn find() -> Result<(), Failure> {
        let found = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        match found {
            Ok(status) if status.success() => Ok(()),
            _ => Err(Failure::new(Class::Usage, "video.ffmpeg", "--format mp4 needs ffmpeg, which is not on the PATH")
                .remedy("install it, or write --format y4m, which it and most players read")),
        }
    }

    /// Begins a file; an older one at its place stays until the new one is whole.
    pub fn start(path: &Path) -> Result<Self, Failure> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let unfinished = path.with_file_name(format!(".{}-{name}", std::process::id()));
        let child = Command::new("ffmpeg")
            .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "yuv4mpegpipe", "-i", "pipe:0"])
            // H.264 wants even sides.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p"])
            .arg("-movflags")
            .arg("+faststart")
            .arg(output(&unfinished))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .map_err(|e| Failure::io("start ffmpeg for", path, &e))?;
        Ok(Self { child, path: path.to_owned(), unfinished })
    }

    /// Gives ffmpeg the bytes that `write` makes.
    pub fn write(&mut self, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), Failure> {
        let Some(input) = &mut self.child.stdin else { return Ok(()) };
        write(input).map_err(|e| Failure::io("give frames to ffmpeg for", &self.path, &e))
    }

    /// Waits for the end, and puts the file in its place.
    pub fn finish(mut self) -> Result<(), Failure> {
        drop(self.child.stdin.take());
        let status = self.child.wait().map_err(|e| Failure::io("wait for ffmpeg for", &self.path, &e))?;
        if !status.success() {
            return Err(Failure::new(Class::Io, "video.ffmpeg", format!("ffmpeg ended with {status}"))
                .remedy("write --format y4m and convert it by hand"));
        }
        std::fs::rename(&self.unfinished, &self.path).map_err(|e| Failure::io("write", &self.path, &e))
    }
}

/// How ffmpeg is given a file: no name is taken for a flag or for a protocol.
fn output(path: &Path) -> OsString {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let mut text = OsString::from("file:");
    text.push(absolute);
    text
}

impl Drop for Encoder {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
        let _ = std::fs::remove_file(&self.unfinished);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_neither_flags_nor_protocols() {
        let text = output(Path::new("take:2/-y.mp4"));
        let path = text.to_str().unwrap().strip_prefix("file:").unwrap();
        assert!(Path::new(path).is_absolute() && Path::new(path).ends_with("take:2/-y.mp4"), "{path}");
    }
}
