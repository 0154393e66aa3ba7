//! The vocabulary of gs4d: splats and their cotangents, cameras, time, images, spherical harmonics, rotations,
//! parameters, random numbers, a few network layers and the file formats of the field.
//!
//! # Conventions, said once
//! * **Camera axes** are OpenCV's: +x right, +y down, +z forward. `viewmat` maps world to camera, `c2w` is its inverse.
//! * **Pixels**: pixel `(i, j)` covers `[i, i+1) × [j, j+1)`, its centre is at +½; the principal point may be anywhere.
//! * **Quaternions** are `(w, x, y, z)` of any non-zero length; zero means the identity. glam's `xyzw` appears only
//!   inside [`rot`].
//! * **Images** are row-major, origin top left, display-encoded colours in `[0, 1]`, straight alpha on disk.
//! * **Units** are the data's; time is kept in seconds beside normalised `[0, 1]`.
//! * **Numbers**: `f32` in production, `f64` in references, cameras and reductions.
//! * **Finite values** are checked once at the border ([`Splats::check`], [`Camera::check`], the readers); inside they
//!   are an invariant.
//!
//! # What it leaves out
//! Distortion models (readers refuse or undistort), GPU buffers, scene graphs.

pub mod camera;
pub mod cloud;
pub mod covariance;
pub mod image;
#[cfg(feature = "io")]
pub mod io;
pub mod kernel;
#[cfg(feature = "nn")]
pub mod nn;
pub mod param;
pub mod real;
pub mod rng;
pub mod rot;
pub mod sh;
pub mod speed;
pub mod splats;
pub mod testkit;
pub mod time;

pub use camera::Camera;
pub use cloud::Cloud;
pub use image::Image;
pub use kernel::{BetaMode, Kernel};
pub use param::{Param, Params, RowEdit};
pub use real::Real;
pub use rng::Rng;
pub use splats::{Color, Splats, SplatsGrad};
pub use time::Time;
