//! Rigid bodies refitted to how their particles moved: one path per body, with the error of its forecast.
//!
//! A law of motion is learnt one image at a time, and its values at the last time are those of a network at the edge of what it
//! has seen. What it says of a body at all times says more. At times `τ_k` a body has a centroid `c_k`, and the law gives
//! its particles a common twist: velocity `u_k` at the centroid and angular velocity `w_k`, by least squares. A [`Path`] of
//! parameters `p` predicts all three, and is fitted by the likelihood of three kinds of errors of unknown variance,
//!
//! ```text
//! minimise over p   Σ_kind N ln(S_kind(p) / N),    S_c = Σ_k |c_k − c_0 − ĉ_k(p)|²,  S_u = Σ_k |u_k − û_k(c_k; p)|²,
//!                                                  S_w = Σ_k ρ² |w_k − ŵ_k(p)|²      ρ: root mean square radius of the body
//! ```
//! by least squares whose weights `N / S` follow the fit, and whose errors of place are about their mean: the place at `τ = 0` is off
//! as all others are. A centre of mass more than three radii from the centroid is refused: turning about a point far away bends a path as gravity
//! does. Where particles of a learnt field are material points, places are the most accurate and rule; where they slide over a turning body, places disagree with twists and lose their weight.
//!
//! Where all of it was integrated from the motions at `τ = 0` ([`Tracks::carried`]), images have shown the places, and velocities
//! follow from them: `S_u` is left out, and errors of place count from `⅓ σ T / √3` on, those of turning (`ρ w`) from `σ`,
//! where particles disagree by `σ` in velocity over a span `T` of time. So what the law says of a turn that images hardly show does not bend
//! a path: by a law of twists about a fixed origin, a false turn `w` gives a flight `c‴ = w × a`, too little to be seen at seen times, and
//! growing ahead.
//!
//! Of all paths the one of least `Σ N/L ln(S/N) + n ln(N/L)` is taken (`n` parameters; `L`: number of frames that errors stay alike,
//! from their correlation), so that a body at rest stays at rest. The covariance of `p` is `L M / (M − L n) (JᵀJ)⁻¹` for `M` errors, of which `M / L`
//! are independent: [`Body::deviation`] carries it to any time, beside the error of the place at `τ = 0`.
//!
//! Motion that has changed (a ball leaves a hand) has no such path through all times. The oldest times are left out until the
//! velocities of the rest are explained about as well as those of the latest alone.

mod bodies;
mod fit;
mod path;
mod seen;
mod solve;

pub use bodies::Bodies;
pub use path::Path;
pub(crate) use solve::cholesky;

use crate::twist::Motion;
use fit::{Candidate, Window};
use glam::{DQuat, DVec3, Vec3};
use path::log;
use seen::{FEWEST, Seen};
use solve::{Square, jacobian};

/// Where particles were and how they moved: `means[k][i]` and `motions[k][i]` of particle `i` at time `taus[k]`, latest first; one of
/// them is 0. Motions are those read at each of these times, about [`Tracks::origin`].
#[derive(Clone, Debug, Default)]
pub struct Tracks {
    /// Times, descending at even intervals, one of them 0.
    pub taus: Vec<f64>,
    /// Positions at each, world units.
    pub means: Vec<Vec<Vec3>>,
    /// Motions at each, per unit of time.
    pub motions: Vec<Vec<Motion<f32>>>,
    /// The origin that motions refer to, world units.
    pub origin: Vec3,
    /// Whether places and motions were integrated from the motions at `τ = 0`.
    pub carried: bool,
}

/// Displacement and rotation of a body since `τ = 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// How far the centroid has gone, world units.
    pub centre: DVec3,
    /// How the body has turned.
    pub turn: DQuat,
}

/// A body and the path that was fitted to it.
#[derive(Clone, Debug)]
pub struct Body {
    /// Which path.
    pub path: Path,
    /// Centroid of its particles at `τ = 0`, world units.
    pub centroid: DVec3,
    /// Root mean square distance of its particles from the centroid, world units.
    pub radius: f64,
    /// Number of times that were fitted.
    pub times: usize,
    /// Root mean square error of the centroid's place (world units), of its velocity, and of `ρ w` (both per unit of time).
    pub residuals: [f64; 3],
    /// Root mean square difference between velocities of its particles and their common twist, per unit of time.
    pub disagreement: f64,
    /// Root mean square speed of its particles, per unit of time.
    pub speed: f64,
    /// Longest step of the integration.
    step: f64,
    /// Lengths over `radius`, times over `unit`.
    p: Vec<f64>,
    unit: f64,
    covariance: Square,
}

impl Body {
    /// Fits a path to the particles `members`, weighted by `weights` (one per particle of `tracks`). None without three members
    /// apart from each other, without weight or six times, or if a position or motion is not finite.
    pub fn fit(tracks: &Tracks, members: &[usize], weights: &[f32]) -> Option<Self> {
        let seen = Seen::new(tracks, members, weights)?;
        let count = seen.taus.len();
        // What follows from one motion has no older kind of motion in it.
        let mut window = Window::new(&seen, if seen.carried { count } else { FEWEST });
        let mut best = window.best();
        let limits = window.limits(&best);
        while window.times < count {
            let longer = Window::new(&seen, (window.times + window.times.div_ceil(4)).min(count));
            let next = longer.best();
            if (0..3).any(|kind| next.residuals[kind] > limits[kind]) {
                break;
            }
            (window, best) = (longer, next);
        }
        let Candidate { path, minimum, residuals, unit, variance } = best;
        let covariance = minimum.spread.iter().map(|row| row.iter().map(|v| v * variance).collect()).collect();
        let (times, step) = (window.times, seen.taus[0] - seen.taus[1]);
        let Seen { centroid, radius, disagreement, speed, .. } = seen;
        Some(Self {
            path,
            centroid,
            radius,
            times,
            residuals,
            disagreement,
            speed,
            step,
            p: minimum.at,
            unit,
            covariance,
        })
    }

    /// Its motion about `origin`, from `τ = 0` on.
    pub fn motion(&self, origin: DVec3) -> Motion<f64> {
        self.path.motion(&self.unscaled(&self.p)).shifted((origin - self.centroid).to_array())
    }

    /// The pose at a time.
    pub fn pose(&self, tau: f64) -> Pose {
        self.predict(&self.p, tau)
    }

    /// Where a particle of the body is at a time, that is at `x` at `τ = 0`, world units.
    pub fn carry(&self, tau: f64, x: Vec3) -> Vec3 {
        let pose = self.pose(tau);
        (self.centroid + pose.centre + pose.turn * (x.as_dvec3() - self.centroid)).as_vec3()
    }

    /// Standard deviation of where its particles are forecast to be at a time, root mean square over them, world units.
    pub fn deviation(&self, tau: f64) -> f64 {
        let reference = self.predict(&self.p, tau);
        let columns = jacobian(&self.p, |p| difference(&reference, &self.predict(p, tau), self.radius).to_vec());
        let variance: f64 = (0..self.p.len())
            .flat_map(|i| (0..self.p.len()).map(move |j| (i, j)))
            .map(|(i, j)| self.covariance[i][j] * columns[i].iter().zip(&columns[j]).map(|(a, b)| a * b).sum::<f64>())
            .sum();
        (variance.max(0.0) + 3.0 * self.residuals[0].powi(2)).sqrt()
    }

    fn predict(&self, p: &[f64], tau: f64) -> Pose {
        self.path.poses(&self.unscaled(p), &[tau], self.step)[0]
    }

    fn unscaled(&self, p: &[f64]) -> Vec<f64> {
        self.path.unscaled(p, self.radius, self.unit)
    }
}

/// What separates two poses, as six lengths: rotations count by the radius of the body.
fn difference(a: &Pose, b: &Pose, radius: f64) -> [f64; 6] {
    let (d, turn) = (a.centre - b.centre, log(a.turn * b.turn.inverse()) * radius);
    [d.x, d.y, d.z, turn.x, turn.y, turn.z]
}
