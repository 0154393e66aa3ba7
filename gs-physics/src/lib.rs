//! Rigid-particle physics: twists and their integration, a learnt law of motion, roll-out past the last frame.
//!
//! ```text
//! law(x, t) = (v̄, w, v̄', w')        v̄(τ) = v̄ + v̄' τ,  w(τ) = w + w' τ
//! dx/dτ = v̄(τ) + w(τ) × (x − o)      dR/dτ = [w(τ)]× R
//! ```
//! Every particle of one rigid body has the same twist, which is why twists extrapolate and cluster (TRACE, Li, Song and
//! Yang, ICCV 2025).
//!
//! # Conventions
//! Positions in world units, quaternions `(w, x, y, z)`, rotations in the world frame (products from the left), angles in
//! radians, times in any unit (gs-train: normalised). A twist is the velocity field `u(x) = v + w × (x − o)` about an
//! origin `o` that all particles share.

mod blocks;
pub mod centre;
pub mod classes;
pub mod clip;
pub mod complexity;
pub mod dynamics;
pub mod error;
pub mod extrapolate;
pub mod groups;
pub mod integrator;
pub mod kabsch;
mod lanes;
pub mod law;
pub mod order;
pub mod pinn;
pub mod reference;
pub mod rollout;
pub mod scalar;
pub mod segment;
mod so3;
pub mod step;
pub mod truth;
pub mod twist;
mod vec3;
pub mod velocity;

pub use centre::{Centre, Reduction};
pub use classes::{ClassRule, Classified, MotionClass};
pub use clip::clip_fast;
pub use dynamics::{Dynamics, Moves, Start};
pub use error::PhysicsError;
pub use extrapolate::{Extrapolator, RowsError};
pub use groups::{Group, Groups};
pub use integrator::Integrator;
pub use law::{AccelMap, Law, LawConfig, LawForm, LawInput, LawTape};
pub use rollout::{RollTape, Rollout};
pub use scalar::Scalar;
pub use step::{Affine, step_map};
pub use twist::{Motion, Orders, Twist};
pub use velocity::{VelocityConfig, VelocityField, VelocityTape};
