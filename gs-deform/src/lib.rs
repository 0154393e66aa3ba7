//! Deformation fields for dynamic Gaussian splatting: from canonical splats and a timestamp to the splats at that time,
//! with analytic gradients for the canonical splats and for the field's parameters.
//!
//! ```text
//! splats at t = apply(canonical, offsets(encode(means, t)))
//! ```
//! * [`HexPlaneField`]: six feature planes at several resolutions and small heads (4D Gaussian Splatting); the fastest.
//!   Its network, [`PlaneNet`], takes any list of heads.
//! * [`DefMlp`]: one wide MLP on positionally encoded means and times (Deformable 3D Gaussians).
//! * [`Grid4dField`]: hash grids over space and space-time, a decoder with attention, a Fourier branch and a gate
//!   (Grid4D, FAGS).
//!
//! All implement [`Field`]: `forward`, `backward`, `regularise`, and a tape of activations that the caller keeps
//! between calls. The parts are usable alone: [`encode::HexPlane`] and [`encode::HashGrid`] map points to features,
//! [`apply`] adds offsets to splats, [`mod@reference`] is the `f64` implementation that tests and benches measure
//! against.
//!
//! ```
//! use gs_core::{Geometry, Time};
//! use gs_deform::{Aabb, Field, FourDgsConfig, HexPlaneField};
//!
//! let canonical = Geometry {
//!     means: vec![glam::Vec3::X],
//!     quats: vec![[1.0, 0.0, 0.0, 0.0]],
//!     scales: vec![glam::Vec3::splat(0.1)],
//! };
//! let field = HexPlaneField::new("field", &FourDgsConfig::fast(), Aabb::cube(1.6), 1)?;
//! let (mut tape, mut out) = Default::default();
//! field.forward(canonical.view(), Time::new(0.3)?, &mut tape, &mut out);
//! assert_eq!(out, canonical, "an untrained field is the identity, bit for bit");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Conventions
//! Points and scales in world units, quaternions `(w, x, y, z)` of any length, times normalised to 0 … 1 over the
//! training span (beyond it planes and hash grids hold their end values, planes of an even number of rows from half a row before 0 and hash grids
//! from an eighteenth before 0 and after 1; MLPs and Fourier features extrapolate). An
//! untrained field is the identity, bit for bit. Gradients are added, never overwritten. Results are bitwise equal for
//! any number of threads; other instruction sets differ by rounding only.
//!
//! # What it leaves out
//! Opacities and colours do not change with time. The axes of a HexPlane are not mirrored, as those of the
//! reference are; `gs4d-checkpoints` turns its planes. Timestamps have no gradient. Points are not sorted before a HexPlane is
//! sampled: measured, sorting gains a tenth of the whole field at best.
#![warn(unreachable_pub)]

pub mod aabb;
pub mod apply;
pub mod encode;
pub mod field;
pub mod reference;

pub use aabb::Aabb;
pub use field::{DefGsConfig, DefMlp, Field, FourDgsConfig, Grid4dConfig, Grid4dField, HexPlaneField};
pub use field::{PlaneNet, PlaneNetConfig, PlaneNetTape};
use glam::Vec3;

/// A field configuration that cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DeformError {
    /// A setting has a value outside its domain.
    #[error("field setting `{field}` = {value} cannot be built: it must be {rule}")]
    Config {
        /// Name of the setting, without its section.
        field: &'static str,
        /// The rejected value as text.
        value: String,
        /// The domain in words, after "it must be".
        rule: &'static str,
    },
    /// A box that is empty or not finite.
    #[error(
        "the box from {min} to {max} is empty or not finite; give the corners of the scene, or at least one finite point"
    )]
    Aabb {
        /// Rejected lowest corner, world units.
        min: Vec3,
        /// Rejected highest corner, world units.
        max: Vec3,
    },
}
