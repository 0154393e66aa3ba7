//! Settings of a law.

use crate::error::{PhysicsError, check, within};
use crate::integrator::Integrator;
use serde::{Deserialize, Serialize};

/// Which numbers the network predicts; [`BodyState`](crate::BodyState) relates a centre to a twist.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LawForm {
    /// A twist and its derivatives, 6 numbers per order (TRACE).
    Twist12,
    /// Centre, its velocity and acceleration, rotation vector, angular acceleration, 3 numbers each: TRACE without the
    /// equivalent twist form.
    Centre15,
    /// As [`LawForm::Centre15`] with a scalar angular acceleration about the axis, integrated along its exact arc. GVFi
    /// evaluates it at canonical positions for time 0; here it is evaluated at a particle's own start position and time.
    Gvfi13,
    /// Independent velocity and angular velocity, 3 numbers each: no rigid motion, no accelerations.
    Free,
}

/// What the network is given of a particle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LawInput {
    /// The encoded position alone: a law that does not change with time.
    X,
    /// Encoded position and encoded time.
    Xt,
}

/// Map from outputs of the network to accelerations and jerks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AccelMap {
    /// `a |a| / 10`, as the authors' code does it: outputs that nothing supervises stay near 0.
    SignedSq10,
    /// The output itself, without a map.
    Linear,
}

/// Settings of a [`Law`](super::Law); the defaults are the authors' "light" network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LawConfig {
    /// Which numbers the network predicts.
    pub form: LawForm,
    /// 1: constant twists; 2: with accelerations; 3: with jerks. No effect on [`LawForm::Free`].
    pub order: u8,
    /// The order of the rotation alone, at most `order`: with 1, angular velocities stay constant however bodies are
    /// accelerated. 0: the same as `order`.
    pub spin_order: u8,
    /// Width of the hidden layers, 1 to 4096.
    pub hidden: usize,
    /// Number of hidden layers, SiLU after each, 1 to 64.
    pub depth: usize,
    /// Frequency bands of the positional encoding of position and time, 0 to 24.
    pub bands: usize,
    /// Whether the network is given the time.
    pub input: LawInput,
    /// How outputs become accelerations and jerks.
    pub accel: AccelMap,
    /// Integration rule; [`LawForm::Gvfi13`] and [`LawForm::Free`] have closed forms instead.
    pub integrator: Integrator,
    /// Factor on world coordinates before they are encoded; finite.
    pub coordinate_scale: f32,
    /// Twists refer to the centre of the scene instead of the world's origin.
    pub local_origin: bool,
    /// Factor on the network's outputs, above 0 (the authors': 1). More lets a short training reach fast motion sooner,
    /// because Adam's steps do not grow with the residual.
    pub gain: f32,
    /// Factor on the angular outputs, beside the gain, above 0 (the authors': 1). A rotation about a far origin displaces a
    /// particle as a velocity does; below 1, straight motion is learnt as velocity and rotation only where it is needed.
    pub spin_gain: f32,
    /// Weight of a penalty on angular acceleration, half the mean of `|ε|²` over the particles of a call (the authors': 0).
    /// It hardly shows within the steps of the training loss, but adds up beyond them.
    pub spin_up_weight: f32,
    /// [`LawForm::Twist12`] also predicts a rotation about the centroid of the moving particles, beside the twist about the
    /// origin (the authors': no). The sum spans the same motions as the twist alone, but descends better: about a far
    /// origin a rotation can hardly change without a velocity and an acceleration to compensate.
    pub own_turn: bool,
    /// Factor on the initial weights of the outputs of first order, above 0. Those of derivatives are not scaled, since a
    /// signed square has no gradient at 0.
    pub head_start: f32,
    /// Largest norm of the gradient by one particle's outputs for derivatives; 0: no limit.
    pub accel_clamp: f32,
    /// Formulas as the papers print them: `ā` of [`LawForm::Centre15`] without `−w × v_c`, angles of
    /// [`LawForm::Gvfi13`] from the angular velocity at the start of each step.
    pub literal: bool,
}

impl Default for LawConfig {
    fn default() -> Self {
        Self {
            form: LawForm::Twist12,
            order: 2,
            spin_order: 0,
            hidden: 128,
            depth: 7,
            bands: 3,
            input: LawInput::Xt,
            accel: AccelMap::SignedSq10,
            integrator: Integrator::Rk2,
            coordinate_scale: 1.0,
            local_origin: true,
            gain: 1.0,
            spin_gain: 1.0,
            spin_up_weight: 0.0,
            own_turn: false,
            head_start: 0.1,
            accel_clamp: 1.0,
            literal: false,
        }
    }
}

impl LawConfig {
    /// Three layers of 64: about a tenth of the work of the default.
    pub fn small() -> Self {
        Self { hidden: 64, depth: 3, ..Self::default() }
    }

    pub(super) fn check(&self) -> Result<(), PhysicsError> {
        within("order", self.order.into(), 1, 3, "1 to 3")?;
        within("spin_order", self.spin_order.into(), 0, self.order.into(), "0 to `order`")?;
        within("hidden", self.hidden, 1, 4096, "1 to 4096")?;
        within("depth", self.depth, 1, 64, "1 to 64")?;
        within("bands", self.bands, 0, 24, "0 to 24")?;
        let scale = self.coordinate_scale;
        check("coordinate_scale", scale, scale.is_finite(), "finite")?;
        let factors = [("gain", self.gain), ("spin_gain", self.spin_gain), ("head_start", self.head_start)];
        for (name, factor) in factors {
            check(name, factor, factor.is_finite() && factor > 0.0, "above 0 and finite")?;
        }
        let weight = self.spin_up_weight;
        check("spin_up_weight", weight, weight.is_finite() && weight >= 0.0, "0 or more, finite")?;
        let clamp = self.accel_clamp;
        check("accel_clamp", clamp, clamp.is_finite() && clamp >= 0.0, "0 or more, finite")
    }
}
