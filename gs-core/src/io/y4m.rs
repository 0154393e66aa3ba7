//! Uncompressed video, YUV4MPEG2 with full colour resolution (`C444`), which encoders and most players read.
//!
//! Colours become BT.601 with the narrow range of video (luma 16 to 235), as players assume of such a file; 8 bits keep
//! them within 2/255.
//!
//! ```
//! use gs_core::{Image, io::y4m};
//!
//! let mut video = Vec::new();
//! y4m::write_header(1, 1, 25.0, &mut video)?;
//! y4m::write_frame(&Image::from_data(1, 1, 3, vec![1.0; 3])?, &mut video)?;
//! assert!(video.ends_with(&[235, 128, 128])); // white: Y, Cb, Cr
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::Image;
use std::io::Write;

/// Writes the stream header: size in pixels, `fps` frames per second, to thousandths.
///
/// # Errors
/// The writer's own.
pub fn write_header(width: usize, height: usize, fps: f64, out: &mut dyn Write) -> std::io::Result<()> {
    let [rate, per] = if fps.fract() == 0.0 { [fps, 1.0] } else { [(1000.0 * fps).round(), 1000.0] };
    writeln!(out, "YUV4MPEG2 W{width} H{height} F{rate}:{per} Ip A1:1 C444")
}

/// Writes a frame `[height, width, 3]` of display-encoded colours in `[0, 1]`; others are clamped, NaN counts as 0.
///
/// # Errors
/// An image of other than 3 channels (as `InvalidInput`), or the writer's own.
pub fn write_frame(image: &Image, out: &mut dyn Write) -> std::io::Result<()> {
    if image.channels != 3 {
        let text = format!("a frame of video has 3 channels, not {}", image.channels);
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, text));
    }
    const PLANES: [[f32; 4]; 3] =
        [[65.481, 128.553, 24.966, 16.0], [-37.797, -74.203, 112.0, 128.0], [112.0, -93.786, -18.214, 128.0]];
    out.write_all(b"FRAME\n")?;
    for [r, g, b, offset] in PLANES {
        let value = |p: &[f32; 3]| {
            let [x, y, z] = p.map(|v| if v > 0.0 { v.min(1.0) } else { 0.0 });
            (r * x + g * y + b * z + offset).round() as u8
        };
        let plane: Vec<u8> = image.data.as_chunks::<3>().0.iter().map(value).collect();
        out.write_all(&plane)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_follow_the_standard() {
        let data = vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 2.0, -1.0, f32::NAN];
        let image = Image { width: 2, height: 2, channels: 3, data };
        let mut out = Vec::new();
        write_header(2, 2, 25.0, &mut out).unwrap();
        write_frame(&image, &mut out).unwrap();
        let head = b"YUV4MPEG2 W2 H2 F25:1 Ip A1:1 C444\nFRAME\n";
        assert_eq!(&out[..head.len()], head);
        // Black, white, red, and red again from values outside [0, 1].
        assert_eq!(out[head.len()..], [16, 235, 81, 81, 128, 128, 90, 90, 128, 128, 240, 240]);
        assert!(write_frame(&Image::zeros(1, 1, 1), &mut out).is_err());
    }
}
