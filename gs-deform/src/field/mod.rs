//! Deformation fields: what moves the splats, and how a loss on the moved splats reaches the canonical ones and the
//! field's parameters.

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

/// A deformation field: canonical splats to splats at a time. Colours and opacities pass through unchanged.
///
/// Every method is bitwise reproducible for any number of rayon threads and works on any number of splats.
pub trait Field: Params + Send + Sync {
    /// Scratch owned by the caller and reused between calls: nothing is allocated once it is warm.
    type Tape: Default + Send;

    /// Writes the splats at time `t` to `out` (all columns, resized as needed).
    fn forward(&self, canonical: &Splats, t: Time, tape: &mut Self::Tape, out: &mut Splats);

    /// The way back. Adds into its own parameters' `grad` and into `d_canonical` (shaped like `canonical`); never
    /// overwrites. `tape` must come from [`Field::forward`] of the same splats with unchanged parameters.
    fn backward(&mut self, canonical: &Splats, tape: &mut Self::Tape, d_out: &SplatsGrad, d_canonical: &mut SplatsGrad);

    /// Regularisers that need no image: adds their weighted gradients, returns their weighted values by name. `canonical`
    /// and `t` are those of the step's [`Field::forward`]; `step` (from 1) picks the random numbers, if there are any.
    fn regularise(&mut self, canonical: &Splats, t: Time, step: u32) -> Vec<(&'static str, f32)>;

    /// Numbers about each splat at a time that are worth looking at, by name (a gate, say); one value per splat each.
    fn quantities(&self, _canonical: &Splats, _t: Time) -> Vec<(&'static str, Vec<f32>)> {
        Vec::new()
    }
}
