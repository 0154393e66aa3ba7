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
use gs_core::{Params, Splats, SplatsGrad, Time};
pub use plane_net::{PlaneNet, PlaneNetConfig, PlaneNetTape};

/// A deformation field: canonical splats to splats at a timestamp. Colours and opacities pass through unchanged.
///
/// Every method gives the same bits for any number of rayon threads and works on any number of splats.
///
/// ```
/// use gs_core::{Splats, SplatsGrad, Time};
/// use gs_deform::{DefGsConfig, DefMlp, Field};
/// use glam::Vec3;
///
/// let (means, quats, scales) = (vec![Vec3::X], vec![[1.0, 0.0, 0.0, 0.0]], vec![Vec3::ONE]);
/// let canonical = Splats { means, quats, scales, opacities: vec![1.0], ..Splats::default() };
/// let (mut field, mut tape, mut out) = (DefMlp::new(&DefGsConfig::fast(), 1)?, Default::default(), Splats::default());
/// field.forward(&canonical, Time::new(0.5)?, &mut tape, &mut out);
/// let d_out = SplatsGrad { means: vec![Vec3::Y], ..SplatsGrad::zeros_like(&out) };
/// let mut d_canonical = SplatsGrad::zeros_like(&canonical);
/// for calls in 1..=2 {
///     field.backward(&canonical, &mut tape, &d_out, &mut d_canonical);
///     assert_eq!(d_canonical.means[0], calls as f32 * Vec3::Y, "added; this field reads its means as constants");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Field: Params + Send + Sync {
    /// Activations between forward and backward, owned by the caller and reused: a warm tape allocates nothing.
    type Tape: Default + Send;

    /// Writes the splats at timestamp `t` to `out`: all columns, resized to `canonical`.
    fn forward(&self, canonical: &Splats, t: Time, tape: &mut Self::Tape, out: &mut Splats);

    /// Backward of [`Field::forward`] from the cotangents `d_out` of its output: adds to the parameters' `grad` and to
    /// `d_canonical` (shaped like `canonical`). `tape` must come from a forward of the same splats with the same
    /// parameters.
    fn backward(&mut self, canonical: &Splats, tape: &mut Self::Tape, d_out: &SplatsGrad, d_canonical: &mut SplatsGrad);

    /// Loss terms that need no image: adds their weighted gradients to the parameters, returns their weighted values by
    /// name. `canonical` and `t` are those of the step's [`Field::forward`]; `step` (from 1) seeds the random numbers.
    fn regularise(&mut self, canonical: &Splats, t: Time, step: u32) -> Vec<(&'static str, f32)>;

    /// Scalar attributes of the splats at a timestamp for inspection, by name (a gate, for example): `[splats]` each.
    fn quantities(&self, _canonical: &Splats, _t: Time) -> Vec<(&'static str, Vec<f32>)> {
        Vec::new()
    }
}
