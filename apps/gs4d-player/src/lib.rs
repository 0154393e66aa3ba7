//! A moving scene as one web page that plays it, without a server and without a request to anywhere; and as a `.4dgs` file for other
//! programs ([`Spans`]).
//!
//! ```
//! use gs_core::{Color, Kernel, Splats};
//! use gs4d_player::{Clip, Frames, Page, Start, Tolerance};
//!
//! // One red splat that moves along x, at eleven times.
//! let at = |x: f32| Splats {
//!     means: vec![glam::Vec3::new(x, 0.0, 4.0)],
//!     quats: vec![[1.0, 0.0, 0.0, 0.0]],
//!     scales: vec![glam::Vec3::splat(0.1)],
//!     opacities: vec![0.9],
//!     color: Color::Rgb(vec![[1.0, 0.0, 0.0]]),
//!     kernel: Kernel::Gaussian,
//! };
//! let times: Vec<f32> = (0..11).map(|k| k as f32 / 10.0).collect();
//! let frames = Frames::new(times.clone(), times.iter().map(|&t| at(t)).collect())?;
//! let clip = Clip::fit(&frames, &[], Tolerance::default());
//! // The motion is linear: two keys are enough, and half way is half way.
//! assert_eq!(clip.keys(), 2);
//! assert!((clip.splats(0.5).means[0].x - 0.5).abs() < 0.01);
//!
//! let html = Page { title: "one splat".into(), start: Start::default(), background: [0.0; 3], clock: None }.html(&clip)?;
//! assert_eq!(gs4d_player::read(&html)?, clip);
//! # Ok::<(), gs4d_player::PlayerError>(())
//! ```
//!
//! # What is stored
//! Each splat has five tracks: mean, quaternion, logarithms of the scales, opacity, colour. A track holds values at key frames of its
//! own, as whole multiples of a power of two, with linear interpolation between them; a track that never leaves its tolerance holds one
//! value. Spherical harmonics above degree 0 do not move: 8 bits, steps of 1/64. Kernels are kept as two bytes. Everything is deflated
//! and written as base64.
//!
//! # The error bound
//! [`Tolerance`] `t` is a share of `d`, the least standard deviation that a splat has at any frame, together with that of a pixel where the
//! nearest camera is. At every frame, as the page draws it:
//! - no coordinate of a mean is off by more than `t d`, but for the rounding of `f32`;
//! - no axis of a splat, one standard deviation long, has its end turned away by more than `t d`, or by 2⁻¹³ of the longest axis where that is
//!   more: the renderer has quaternions of 16 bits;
//! - no scale is wrong by a larger factor than `1 + t`, or 1.008 where that is more: the renderer has logarithms of 16 bits.
//!
//! Between two frames the same holds against the straight line between their values; an end may be off by √2 as much where a splat turns by half
//! a turn from one to the other. What a scene does beside that line is not looked at. Without a camera that a splat is in front of, a pixel is
//! as large as for the other splats. What all this costs in PSNR is measured by rendering [`Clip::splats`] of the file as it was read back.
//!
//! # How it is rendered
//! As [`Clip::render_settings`] says: near plane, dilation, and whether opacities make up for it. Files `.4dgs` have no place for this.
//!
//! # What it leaves out
//! Harmonics that change with time are averaged over it; colours are clamped to 0..1 where they have no harmonics; the page needs
//! WebGL2 and `DecompressionStream` (browsers since 2023).

#![warn(unreachable_pub)]

mod clip;
mod fit;
mod frames;
mod page;
mod spans;
mod stream;
mod track;
pub mod words;

pub use clip::{Clip, Layer, RenderSettings};
pub use frames::{Frames, Tolerance};
pub use page::{Page, SORT_JS, SPLATS_JS, Start, VECTORS_JS, read};
pub use spans::Spans;

/// A scene that cannot become a clip, or a page that holds none.
#[derive(Debug, thiserror::Error)]
pub enum PlayerError {
    /// Frames that do not belong together.
    #[error("frame {frame}: {what}")]
    Frames {
        /// Index of the frame.
        frame: usize,
        /// What is wrong with it.
        what: String,
    },
    /// A page whose scene this version does not read: its head is JSON with another version, other keys or values of another kind. Damage that
    /// leaves it JSON looks the same.
    #[error("the page is of another version of gs4d (head of its scene: {0}); export it again from the run")]
    OtherVersion(String),
    /// A page without a clip, or a damaged page or file.
    #[error("the page or file cannot be read back: {0}; export it again")]
    Damaged(String),
    /// A clip cannot be written as text, or a value is refused by the encoder of a file.
    #[error("the scene cannot be written: {0}; try a larger --tolerance, fewer --times or a lower --sh-degree")]
    Write(String),
}
