//! Files: splats (`.ply`, `.splat`, `.spz`, `.glb`, `.sog`), cameras, images and arrays.
//!
//! One invariant holds for every reader: **any bytes give a value or a typed error**. Sizes are computed with checked or
//! saturating arithmetic and compared with the bytes present before anything is allocated; there is no recursion on
//! input and no panicking path (the lints below are denied). [`Limits`] bounds what a file may ask for; [`IoError`] names
//! what is wrong, where, and what to do. Writers write a temporary file in the same folder, flush and rename it, and
//! replace an existing file only with `overwrite`.
//!
//! ```
//! use glam::Vec3;
//! use gs_core::io::{Limits, RawSplats, SplatFormat, parse_splats, write_splats};
//! use gs_core::{Color, Kernel, Splats};
//!
//! let splats = Splats {
//!     means: vec![Vec3::X],
//!     quats: vec![[1.0, 0.0, 0.0, 0.0]],
//!     scales: vec![Vec3::ONE],
//!     opacities: vec![0.5],
//!     color: Color::Rgb(vec![[0.5; 3]]),
//!     kernel: Kernel::Gaussian,
//! };
//! let raw = RawSplats::from_splats(&splats)?; // logarithms of scales, logits of opacities
//! let mut ply = Vec::new();
//! write_splats(SplatFormat::Ply, &raw, &mut ply)?;
//! assert_eq!(parse_splats(&ply, "scene.ply", &Limits::default())?, raw); // every bit
//! let cut = parse_splats(&ply[..ply.len() - 1], "scene.ply", &Limits::default());
//! assert!(cut.unwrap_err().to_string().contains("needs 68 bytes, only 67 are there"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Memory held while reading stays below 8 × file size + 64 MiB for tables and JSON. Compressed formats (SPZ, PNG, JPEG,
//! EXR) may grow more: they get 48 MiB + 64 × file size (`Limits::max_expansion`), images at most 1 GiB.
//!
//! | format | read | write | notes |
//! |---|---|---|---|
//! | 3DGS `.ply` | yes | yes | exact, degree 0 to 3, all kernels |
//! | `.splat` | yes | yes | degree 0, 8-bit colour and rotation, Gaussians only |
//! | `.spz` 2, 3, 4 | yes | 2, 3 | quantised, Gaussians only; 1 and raw payloads are refused by name; see [`spz`] |
//! | `.glb` | yes | yes | `KHR_gaussian_splatting`, exact, degree 0 to 3, Gaussians only; rigid parts in motion, see [`glb`] |
//! | `.sog` 2, or its `meta.json` | feature `images` | no | quantised, Gaussians only, see `sog` |
//! | `.ksplat`, compressed `.ply`, `.sog` 1 | no | no | refused by name |
//! | camera JSON | yes | yes | three layouts, see [`cameras`] |
//! | `.npy` | yes | yes | f32 and f64 in, f32 out |
//! | PNG, JPEG | feature `images` | PNG | see `images` |
//! | YUV4MPEG2 | no | yes | video as a stream, see [`y4m`] |
//! | EXR | feature `exr` | yes | see `exr` |
//!
//! Whether splats are drawn anti-aliased ([`RawSplats::antialiased`]) is kept in `.ply` and `.spz` and read from `.sog`. What a file does
//! not say or clamps is in [`SplatFormat::note`].
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, clippy::unreachable)
)]

mod axes;
mod camera_json;
pub mod cameras;
pub mod disk;
mod error;
#[cfg(feature = "exr")]
pub mod exr;
mod files;
pub mod glb;
mod glb_read;
mod glb_scene;
mod glb_write;
#[cfg(feature = "images")]
pub mod images;
mod limits;
pub mod npy;
pub mod ply;
mod ply_header;
mod ply_rows;
mod raw;
#[cfg(feature = "images")]
pub mod sog;
pub mod splat;
pub mod spz;
mod spz_container;
mod spz_quat;
mod temporary;
mod whole;
pub mod y4m;
pub mod zip;

pub use crate::cloud::sigmoid;
pub use axes::upright;
pub use cameras::{NamedCamera, load_cameras, parse_cameras, save_cameras};
pub use error::{At, IoError};
pub use files::{SplatFormat, load_splats, parse_splats, read_file, read_text, save_splats, write_splats};
pub use limits::Limits;
pub use raw::RawSplats;
pub use temporary::{folder_of, is_temporary, remove_abandoned, temporary_beside};
pub use whole::write_file;
