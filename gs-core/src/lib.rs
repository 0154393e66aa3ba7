//! The vocabulary of gs4d: splats and their cotangents, cameras, time, images, spherical harmonics, rotations,
//! parameters, random numbers, a few network layers and the file formats of the field.
//!
//! # Conventions
//! Every crate of the workspace follows these. Conversions happen in readers and writers only.
//! * **Camera axes** are OpenCV's: +x right, +y down, +z forward. `viewmat` maps world to camera, `c2w` is its inverse.
//! * **Pixels**: pixel `(i, j)` covers `[i, i+1) × [j, j+1)`, its centre is at +½; the principal point may be anywhere.
//! * **Quaternions** are `(w, x, y, z)` of any non-zero length; zero means the identity. glam's `xyzw` appears only
//!   inside [`rot`].
//! * **Images** are row-major, origin top left, display-encoded colours in `[0, 1]`, straight alpha on disk.
//! * **Units**: world units as the data give them; time in seconds beside normalised `[0, 1]` ([`Time`]).
//! * **Rendering constants** are those of 3DGS, fields of the options of gs-raster: `α ≤ 0.99`, samples below
//!   `α = 1/255` are skipped, a pixel stops at transmittance `1e-4`, dilation 0.3 pixels². The radius of a splat inverts
//!   its kernel at `α = 1/255` ([`kernel::Profile::support`]).
//! * **Numbers**: `f32` in production; `f64` in references, cameras, clocks, reductions and least squares.
//! * **Finite values** are checked once at the border ([`Splats::check`], [`Camera::check`], the readers); inside they
//!   are an invariant.
//!
//! # Example
//! ```
//! use glam::Vec3;
//! use gs_core::{Cloud, RowEdit, Splats};
//!
//! // Two trainable Gaussians at SH degree 0. Activation gives the splats a rasteriser takes.
//! let mut cloud = Cloud::from_points(&[Vec3::ZERO, Vec3::X], &[[0.5; 3]; 2], &[1.0; 2], 0.5, 0)?;
//! let mut splats = Splats::default();
//! cloud.activate(0, &mut splats);
//! splats.check()?;
//! assert_eq!((splats.scales[1], splats.opacities[1]), (Vec3::ONE, 0.5));
//! // Clone the second one: values, gradients and Adam's moments are edited together.
//! cloud.edit(&RowEdit { keep: vec![0, 1], append_from: vec![1] })?;
//! assert_eq!(cloud.len(), 3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//! `io` (default): splat files, cameras, arrays. `images`: PNG and JPEG. `exr`: OpenEXR. `nn` (default): network layers. `neighbours`:
//! nearest neighbours of points. `testkit`: shared data for tests.
//!
//! # What it leaves out
//! Distortion models (readers refuse or undistort), GPU buffers, scene graphs.
#![warn(unreachable_pub)]

pub mod camera;
pub mod cast;
pub mod cloud;
pub mod covariance;
pub mod geometry;
pub mod image;
#[cfg(feature = "io")]
pub mod io;
pub mod kernel;
#[cfg(feature = "neighbours")]
pub mod neighbours;
#[cfg(feature = "nn")]
pub mod nn;
pub mod param;
pub mod real;
pub mod rng;
pub mod rot;
pub mod sh;
pub mod speed;
pub mod splats;
#[cfg(feature = "testkit")]
pub mod testkit;
pub mod time;

pub use camera::Camera;
pub use cloud::Cloud;
pub use geometry::{Geometry, GeometryMut, GeometryRef};
pub use image::Image;
pub use kernel::{BetaMode, Kernel};
pub use param::{Param, Params, RowEdit};
pub use real::Real;
pub use rng::Rng;
pub use splats::{Color, Splats, SplatsGrad, SplatsRef};
pub use time::Time;
