//! Settings of a law.

use crate::error::{PhysicsError, check, within};
use crate::integrator::Integrator;
use serde::{Deserialize, Serialize};

/// Which numbers the network predicts; [`Centre`](crate::Centre) says how a centre and a twist hang together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LawForm {
    /// A twist and its derivatives, 6 numbers per order (TRACE).
    Twist12,
    /// Centre, its velocity and acceleration, rotation vector, angular acceleration: TRACE without the equivalent form.
    Centre15,
    /// The same with a scalar angular acceleration about the axis, carried along its exact arc (GVFi, which reads it at
    /// canonical places for time 0; here it is read where and when a particle sets out).
    Gvfi13,
    /// A free velocity and angular velocity that know nothing of each other: no rigid motion, no accelerations.
    Free,
}

/// What the network sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LawInput {
    /// The position alone.
    X,
    /// Position and time.
    Xt,
}

/// From outputs of the network to accelerations and jerks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AccelMap {
    /// `a |a| / 10`, as the authors' code does it: outputs that nothing supervises stay near 0.
    SignedSq10,
    /// As they are.
    Linear,
}

/// Settings of a [`Law`](super::Law); the defaults are the authors' "light" network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LawConfig {
    /// What is predicted.
    pub form: LawForm,
    /// 1: constant twists; 2: with accelerations; 3: with jerks. No effect on [`LawForm::Free`].
    pub order: u8,
    /// The order of the turning alone, where it is lower: with 1, bodies turn evenly however they are accelerated. 0: `order`.
    pub spin_order: u8,
    /// Width of the hidden layers.
    pub hidden: usize,
    /// Hidden layers, SiLU after each.
    pub depth: usize,
    /// Bands of the positional encoding of position and time.
    pub bands: usize,
    /// What the network sees.
    pub input: LawInput,
    /// How accelerations are read from outputs.
    pub accel: AccelMap,
    /// How particles are carried; [`LawForm::Gvfi13`] and [`LawForm::Free`] have closed forms instead.
    pub integrator: Integrator,
    /// Factor on world coordinates before they are encoded.
    pub coordinate_scale: f32,
    /// Twists refer to the centre of the scene instead of the world's origin.
    pub local_origin: bool,
    /// Factor on the network's outputs. The authors' is 1; with more a short training reaches fast motion sooner, because
    /// the steps of Adam do not grow with what is missing.
    pub gain: f32,
    /// Factor on the outputs that say how particles turn, beside the gain (the authors': 1). A turn about a far origin moves
    /// a particle as a velocity does; below 1 what moves straight is learnt as such, and turns where only they explain it.
    pub spin_gain: f32,
    /// Weight of a penalty on changes of turning, half the mean of `|ε|²` over the particles of a call (the authors': 0). A
    /// change of turning hardly shows within the steps that are learnt from, but adds up beyond them.
    pub spin_up_weight: f32,
    /// [`LawForm::Twist12`] also predicts a turn of bodies about the middle of what moves, beside the twist about the origin
    /// (the authors': no). The sum says no more than the twist alone, but descends better: about a far origin a turn can
    /// hardly change without a velocity and an acceleration that make up for it.
    pub own_turn: bool,
    /// Factor on the start of the outputs that give velocities. Accelerations always start as the other layers do: a
    /// signed square has no gradient at 0.
    pub head_start: f32,
    /// Longest gradient by one particle's outputs for accelerations; 0: any length.
    pub accel_clamp: f32,
    /// Formulas as the papers print them: `ā` of [`LawForm::Centre15`] without `−w × v_c`, angles of
    /// [`LawForm::Gvfi13`] from the angular velocity at the begin of each step.
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
