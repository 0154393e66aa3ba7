//! Deformation fields: canonical splats and a time in, the splats at that time out, with exact gradients back to the
//! canonical splats and to the field's parameters.
//!
//! ```text
//! splats at t = apply(canonical, offsets(encode(means, t)))
//! ```
//! * [`HexPlaneField`]: six feature planes at several resolutions and small heads (4D Gaussian Splatting). The quick one.
//!   Its body, [`PlaneNet`], takes any heads.
//! * [`DefMlp`]: one wide network on encoded places and times (Deformable 3D Gaussians).
//! * [`Grid4dField`]: hash grids over space and space-time, a decoder with attention, a Fourier branch and a gate
//!   (Grid4D, FAGS).
//!
//! All are [`Field`]s: `forward`, `backward`, `regularise`, and a scratch tape the caller keeps. The parts are usable
//! alone: [`encode::HexPlane`] maps points to features, [`apply`] adds offsets to splats, [`mod@reference`] is the `f64` twin
//! that tests and benches measure against.
//!
//! # Conventions
//! Points and scales in world units, quaternions `(w, x, y, z)` of any length, times normalised to 0 … 1 over the
//! training span (beyond it planes and hash grids hold their end values, networks and waves extrapolate). A field that
//! was not trained is the identity, bit for bit. Gradients are added, never overwritten. Results are bitwise equal for
//! any number of threads; other instruction sets differ by rounding only.
//!
//! # What it leaves out
//! Opacities and colours do not change with time. Import of other codes' checkpoints: the reference mirrors its spatial
//! axes and this crate does not. Times have no gradient. Points are not sorted before a HexPlane is read: measured, it
//! gains a tenth of the whole field at best.

pub mod aabb;
pub mod apply;
pub mod encode;
pub mod field;
pub mod reference;

pub use aabb::Aabb;
pub use field::{DefGsConfig, DefMlp, Field, FourDgsConfig, Grid4dConfig, Grid4dField, HexPlaneField};
pub use field::{PlaneNet, PlaneNetConfig, PlaneNetTape};
use glam::Vec3;

/// What is wrong with a field's configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DeformError {
    /// A key has a value that cannot be built.
    #[error("field setting `{field}` = {value} cannot be built: it must be {rule}")]
    Config {
        /// The key.
        field: &'static str,
        /// The value met.
        value: String,
        /// What it must satisfy.
        rule: &'static str,
    },
    /// The box is not one.
    #[error(
        "the box from {min} to {max} is empty or not finite; give the corners of the scene, or at least one finite point"
    )]
    Aabb {
        /// Lowest corner met.
        min: Vec3,
        /// Highest corner met.
        max: Vec3,
    },
}
