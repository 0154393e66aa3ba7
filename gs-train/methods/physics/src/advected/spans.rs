//! From where to where the dynamics carry splats, for an image in training and in rendering.

use super::{Advected, Inside, PhysicsConfig};
use gs_core::Rng;
use gs_deform::Field;
use gs_physics::Dynamics;
use gs_train::scene::SceneInfo;

/// Farthest that dynamics carry splats, in steps Δt: at timestamps beyond, the scene stands as it is there.
const FARTHEST: f64 = 4096.0;
/// How far times of frames may be off, in intervals between frames: they are normalised in `f32`.
pub(super) const ROUNDING: f64 = 1e-3;

/// The times a scene is divided by, normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Times {
    /// Δt.
    pub step: f64,
    /// Last time the field is read at.
    pub last_field: f64,
    /// Last training time.
    pub last: f64,
    /// Before this only the field moves splats.
    pub start: f64,
}

impl Times {
    pub(super) fn new(config: &PhysicsConfig, scene: &SceneInfo) -> Self {
        let step = config.step(scene);
        let back = step.max(f64::from(config.back_frames) * step / f64::from(config.step_frames));
        let last = f64::from(scene.last_time);
        Self { step, last_field: (last - back).max(0.0), last, start: f64::from(config.start) * last }
    }
}

/// The two times of a transport.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    pub from: f64,
    pub to: f64,
}

impl<F: Field, D: Dynamics> Advected<F, D> {
    /// From where to where the dynamics act in training for an image at time `t`, the `draw`-th of the step.
    pub(super) fn training_span(&self, t: f64, draw: u32) -> Span {
        let Times { step, last_field, start, .. } = self.times;
        if !self.config.field {
            return Span { from: 0.0, to: t };
        }
        if self.canonical.at.deform_only {
            return Span { from: t, to: t };
        }
        if t > last_field {
            return Span { from: last_field, to: t };
        }
        if t < step.max(start) {
            return Span { from: t, to: t };
        }
        let mut rng = Rng::new(self.canonical.seed(), "side-of-time", self.canonical.at.step, draw.into());
        let forward = rng.uniform() < 0.5;
        if rng.uniform() < self.config.direct {
            return Span { from: t, to: t };
        }
        if self.settles(t) {
            return Span { from: last_field, to: t };
        }
        let steps = 1.0 + (f64::from(rng.uniform()) * self.reach()).floor();
        let from = if forward { t - steps * step } else { t + steps * step };
        Span { from: from.clamp(start, last_field), to: t }
    }

    /// Steps Δt that the dynamics carry splats at most in the present step of training.
    pub(super) fn reach(&self) -> f64 {
        let PhysicsConfig { reach, reach_until, .. } = self.config;
        1.0 + (self.stage_share() / f64::from(reach_until)).min(1.0) * f64::from(reach - 1)
    }

    /// Whether the dynamics set out from `T_def` for an image at time `t` in the present step.
    pub(super) fn settles(&self, t: f64) -> bool {
        let (Times { last_field, .. }, PhysicsConfig { settle, settle_frames, .. }) = (self.times, self.config);
        let near = settle_frames == 0.0 || last_field - t <= (f64::from(settle_frames) + ROUNDING) * self.frame();
        near && settle > 0.0 && self.stage_share() >= 1.0 - f64::from(settle)
    }

    /// Share of the present stage that is over.
    pub(super) fn stage_share(&self) -> f64 {
        let at = &self.canonical.at;
        if at.stage_steps == 0 { 1.0 } else { f64::from(at.stage_offset) / f64::from(at.stage_steps) }
    }

    /// The interval between frames, normalised.
    pub(super) fn frame(&self) -> f64 {
        self.times.step / f64::from(self.config.step_frames)
    }

    /// From where to where the dynamics act in rendering.
    pub(super) fn render_span(&self, t: f64) -> Span {
        let Times { step, last_field, start, .. } = self.times;
        let t = t.clamp(-FARTHEST * step, last_field + FARTHEST * step);
        match self.config.inside {
            _ if !self.config.field => Span { from: 0.0, to: t },
            _ if self.canonical.at.deform_only => Span { from: t, to: t },
            _ if t > last_field => Span { from: last_field, to: t },
            _ if t < 0.0 => Span { from: 0.0, to: t },
            Inside::Physics => Span { from: start.min(t), to: t },
            Inside::Step if t >= step.max(start) => Span { from: (t - step).max(start), to: t },
            _ => Span { from: t, to: t },
        }
    }

    /// The time from which the dynamics rule alone.
    pub(super) fn first_ahead(&self) -> f64 {
        if self.config.field { self.times.last_field } else { 0.0 }
    }
}
