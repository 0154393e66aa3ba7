//! Deformation fields: canonical splats to splats at a timestamp, and the gradients of both the canonical splats and
//! the field's parameters.

pub mod anneal;
pub mod defgs;
mod defgs_net;
pub mod fourdgs;
pub mod grid4d;
pub mod plane_net;

pub use defgs::{DefGsConfig, DefMlp};
pub use fourdgs::{FourDgsConfig, HexPlaneField};
pub use grid4d::{Grid4dConfig, Grid4dField};
use gs_core::{Geometry, GeometryRef, Params, Time};
pub use plane_net::{PlaneNet, PlaneNetConfig, PlaneNetTape};

/// A deformation field: the means, quaternions and scales of canonical splats to those at a timestamp. Colours, opacities
/// and kernels are not its business.
///
/// Every method gives the same bits for any number of rayon threads and works on any number of splats.
///
/// ```
/// use gs_core::{Geometry, Time};
/// use gs_deform::{DefGsConfig, DefMlp, Field};
/// use glam::Vec3;
///
/// let canonical = Geometry { means: vec![Vec3::X], quats: vec![[1.0, 0.0, 0.0, 0.0]], scales: vec![Vec3::ONE] };
/// let (mut field, mut tape, mut out) = (DefMlp::new(&DefGsConfig::fast(), 1)?, Default::default(), Geometry::default());
/// field.forward(canonical.view(), Time::new(0.5)?, &mut tape, &mut out);
/// let d_out = Geometry { means: vec![Vec3::Y], ..Geometry::zeros(1) };
/// let mut d_canonical = Geometry::zeros(1);
/// for calls in 1..=2 {
///     field.backward(canonical.view(), &mut tape, d_out.view(), &mut d_canonical);
///     assert_eq!(d_canonical.means[0], calls as f32 * Vec3::Y, "added; this field reads its means as constants");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Field: Params + Send + Sync {
    /// Activations between forward and backward, owned by the caller and reused: a warm tape allocates nothing.
    type Tape: Default + Send;

    /// Writes means, quaternions and scales at timestamp `t` to `out`, resized to `canonical`.
    fn forward(&self, canonical: GeometryRef<'_>, t: Time, tape: &mut Self::Tape, out: &mut Geometry);

    /// The same at another timestamp, for the rows and parameters of the last forward with this tape. A field whose work depends on
    /// time in part only saves the rest.
    fn forward_again(&self, canonical: GeometryRef<'_>, t: Time, tape: &mut Self::Tape, out: &mut Geometry) {
        self.forward(canonical, t, tape, out);
    }

    /// Backward of [`Field::forward`] from the cotangents `d_out` of its output: adds to the parameters' `grad` and to
    /// `d_canonical` (shaped like `canonical`). `tape` must come from a forward of the same rows with the same
    /// parameters.
    fn backward(
        &mut self,
        canonical: GeometryRef<'_>,
        tape: &mut Self::Tape,
        d_out: GeometryRef<'_>,
        d_canonical: &mut Geometry,
    );

    /// Loss terms that need no image: adds their weighted gradients to the parameters, returns their weighted values by
    /// name. `canonical` and `t` are those of the step's [`Field::forward`]; `step` (from 1) seeds the random numbers.
    fn regularise(&mut self, canonical: GeometryRef<'_>, t: Time, step: u32) -> Vec<(&'static str, f32)>;

    /// Scalar attributes of the splats at a timestamp for inspection, by name (a gate, for example): `[splats]` each.
    fn quantities(&self, _canonical: GeometryRef<'_>, _t: Time) -> Vec<(&'static str, Vec<f32>)> {
        Vec::new()
    }
}
