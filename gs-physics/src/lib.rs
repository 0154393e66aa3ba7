//! Rigid-particle physics for dynamic Gaussians: twists and their integration, a learnt law of motion, extrapolation past
//! the last observed time, rigid groups, motion segments.
//!
//! ```text
//! law(x, t) = (v̄, w, v̄', w')        v̄(τ) = v̄ + v̄' τ,  w(τ) = w + w' τ
//! dx/dτ = v̄(τ) + w(τ) × (x − o)      dR/dτ = [w(τ)]× R
//! ```
//! All particles of one rigid body share a twist, so twists extrapolate in time and cluster into bodies (TRACE, Li, Song
//! and Yang, ICCV 2025).
//!
//! # Conventions
//! Positions in world units, quaternions `(w, x, y, z)`, rotations in the world frame (products from the left), angles in
//! radians, times in any unit (gs-train: normalised). A twist is the velocity field `u(x) = v + w × (x − o)` about an
//! origin `o` that all particles share.
//!
//! # Example
//! A particle on a helix, one turn about z in a unit of time while it rises by 1, asked for at any time:
//! ```
//! use glam::Vec3;
//! use gs_physics::{Extrapolator, Integrator, Motion, Rollout, Twist};
//!
//! let twist = Twist { v: [0.0, 0.0, 1.0], w: [0.0, 0.0, std::f32::consts::TAU] };
//! let motion = Motion { twist, ..Motion::default() };
//! let rollout = Rollout { rule: Integrator::Se3Mid, dt: 1.0 / 30.0, origin: Vec3::ZERO };
//! let mut body = Extrapolator::new(rollout, 0.0, vec![motion], vec![Vec3::X], vec![[1.0, 0.0, 0.0, 0.0]])?;
//! let (means, _) = body.at(1.5);
//! assert!((means[0] - Vec3::new(-1.0, 0.0, 1.5)).length() < 1e-5);
//! # Ok::<(), gs_physics::RowsError>(())
//! ```
//!
//! # Contents
//! * [`Twist`], [`Motion`]: a velocity field of a rigid body, and how it changes; [`centre`]: the same by a point of the body.
//! * [`Integrator`], [`Rollout`]: rules of integration, roll-out of many particles forward and backward; [`Extrapolator`]: particles at
//!   any time; [`classes`]: motions with closed forms.
//! * [`Law`], [`VelocityField`]: what is learnt, with gradients; [`pinn`]: the physics-informed loss of NVFi.
//! * [`groups`], [`segment`], [`refit`], [`kabsch`]: rigid bodies among particles.
//! * [`truth`]: motions with exact ends; [`mod@reference`]: the same mathematics in `f64`.
//!
//! # What it leaves out
//! Contacts, forces between bodies, bodies that bend: a particle goes on as its law says, whatever is in its way. Fitting to images is in
//! `gs-method-physics`.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

mod blocks;
pub mod centre;
pub mod classes;
pub mod complexity;
mod dynamics;
mod error;
pub mod extrapolate;
pub mod groups;
mod integrator;
pub mod kabsch;
mod lanes;
pub mod law;
pub mod pinn;
pub mod reference;
pub mod refit;
pub mod rollout;
mod scalar;
pub mod segment;
mod so3;
pub mod step;
pub mod truth;
pub mod twist;
mod vec3;
pub mod velocity;

pub use centre::{BodyState, Reduction};
pub use classes::{ClassRule, Classified, MotionClass};
pub use dynamics::{Dynamics, ParticleState, Start};
pub use error::PhysicsError;
pub use extrapolate::{Extrapolator, RowsError};
pub use groups::{Group, Groups};
pub use integrator::Integrator;
pub use law::{AccelMap, Law, LawConfig, LawForm, LawInput, LawTape};
pub use rollout::{RollTape, Rollout};
pub use step::{Affine, step_map};
pub use twist::{Motion, Twist};
pub use velocity::{VelocityConfig, VelocityField, VelocityTape};
