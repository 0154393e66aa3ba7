//! Settings of transport: when dynamics carry splats, and how far.

use gs_train::scene::SceneInfo;
use serde::{Deserialize, Serialize};

/// From when on, how often and how far dynamics carry splats.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhysicsConfig {
    /// Δt, the step from the field's time to the image's, in intervals between frames.
    pub step_frames: f32,
    /// In training the dynamics carry splats over 1 to so many steps Δt, drawn anew each time (TRACE: 1). The farther, the
    /// better accelerations can be told: they move a particle by ½ a (n Δt)². The range opens over a share of the stage
    /// ([`Self::reach_until`]).
    pub reach: u32,
    /// Share of the stage, above 0, over which the range opens: above 1 it does not open fully. A run that gets another length while it
    /// opens has another share, with which it goes on opening as it did.
    #[serde(default = "whole")]
    pub reach_until: f32,
    /// Share of the training steps, up to `T_def`, in which the field alone renders the image, at its own time (TRACE: 0).
    /// What moves is then kept while the dynamics are still wrong, and seen timestamps are learnt as without dynamics.
    pub direct: f32,
    /// The field is read up to `T_def`, this many intervals between frames before the last training time (one Δt at least).
    pub back_frames: f32,
    /// Before this share of the training span only the field moves splats (scenes that stand still at first).
    pub start: f32,
    /// How timestamps that were seen are rendered.
    pub inside: Inside,
    /// Whether the field takes part. Without it the dynamics carry splats from time 0.
    pub field: bool,
    /// Whether the lobes of colours turn with their splats (TRACE: no, they keep to the axes of the world).
    #[serde(default)]
    pub turn_colours: bool,
    /// How far a forecast may put a splat off to save work, of the scene's extent, up to the end of the sequence: closed forms
    /// instead of steps, one motion for a body. 0: only what is exact. Integrators that are not rigid keep their steps.
    #[serde(default)]
    pub slack: f32,
    /// Most bodies whose splats share one motion in a forecast, as far as `slack` allows; 0: every splat follows its own.
    #[serde(default)]
    pub bodies: u32,
    /// Whether a forecast refits the paths of rigid bodies to all times that were seen ([`gs_physics::refit`]), and moves their splats
    /// rigidly whatever the integrator. Where the dynamics settle on `T_def`, they are read there alone.
    #[serde(default)]
    pub refit: bool,
    /// Share of the moving stage, at its end, in which the dynamics set out from `T_def` for every image they render: forecasts
    /// begin there, and the farther an image is from it, the more it says about velocities and accelerations. 0: never (TRACE).
    #[serde(default)]
    pub settle: f32,
    /// How far before `T_def` such images may be, in intervals between frames: where motion is of one kind. 0: any.
    #[serde(default)]
    pub settle_frames: f32,
    /// Whether gradients of centres are turned back with their particle (`Rᵀ g`, of a rigid motion); false: they pass as if the
    /// displacement were a constant (TRACE), which points aside after a quarter of a turn and backwards after half of one.
    #[serde(default)]
    pub turn_gradients: bool,
}

fn whole() -> f32 {
    1.0
}

/// How timestamps that were seen are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Inside {
    /// By the field at that timestamp: strategy (1), the cheapest.
    Field,
    /// By the dynamics from the first timestamp: strategy (2), which adds up errors.
    Physics,
    /// By the field at `t − Δt` and the dynamics, as in training: strategy (3).
    Step,
}

impl PhysicsConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        let need = |good: bool, name: &str, value: f32, rule: &str| {
            if good { Ok(()) } else { Err(format!("physics.{name} = {value}: {rule}")) }
        };
        need(self.step_frames > 0.0 && self.step_frames.is_finite(), "step_frames", self.step_frames, "above 0")?;
        need((1..=1000).contains(&self.reach), "reach", self.reach as f32, "1 to 1000")?;
        let until = self.reach_until;
        need(until > 0.0 && until.is_finite(), "reach_until", until, "above 0")?;
        need((0.0..1.0).contains(&self.direct), "direct", self.direct, "0 or more, below 1")?;
        need(self.back_frames >= 0.0 && self.back_frames.is_finite(), "back_frames", self.back_frames, "0 or more")?;
        need((0.0..1.0).contains(&self.start), "start", self.start, "0 or more, below 1")?;
        need((0.0..=1.0).contains(&self.settle), "settle", self.settle, "0 to 1")?;
        let frames = self.settle_frames;
        need(frames >= 0.0 && frames.is_finite(), "settle_frames", frames, "0 or more")?;
        need(self.slack >= 0.0 && self.slack.is_finite(), "slack", self.slack, "0 or more")?;
        need(self.bodies <= 1000, "bodies", self.bodies as f32, "0 to 1000")
    }

    /// Δt of a scene, normalised; a hundredth of the span where there is one timestamp only.
    pub fn step(&self, scene: &SceneInfo) -> f64 {
        let frame = if scene.frame_interval > 0.0 { scene.frame_interval } else { 0.01 };
        f64::from(self.step_frames) * f64::from(frame)
    }
}
