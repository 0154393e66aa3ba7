//! A canonical cloud that a field deforms to a time nearby, and dynamics carry from there to the timestamp of the image:
//! the common body of TRACE (a law of twists) and of DefGS with NVFi's velocity field.
//!
//! ```text
//! t ≤ T_def   t' = clamp(t ∓ Δt, 0, T_def), either side with probability ½     T_def < t   t' = T_def
//! x' = x₀ + δx(x₀, t')      x_t, q_phys = dynamics(x', t' → t)
//! mean = x₀ + δx + sg(x_t − x')      q = q_phys ⊗ q_def(t') ⊗ q₀      s = s(t')
//! ```
//! (TRACE, its code's training loop; Δt may be drawn from several of its multiples, [`PhysicsConfig::reach`].) `sg` stops gradients: centres and offsets learn as if the physical displacement were a
//! constant, the dynamics learn from the same cotangent at its end, and nothing flows through the place they are read at. With
//! [`PhysicsConfig::turn_gradients`] the gradient of a centre is that of a rigid motion, `x_t = R x' + b`.
//! Moments before the first step of Δt are the field's alone.
//!
//! Past `T_def` the scene is rendered from the deformation at `T_def` and the dynamics; the field is read at a later time in stages
//! of its own only ([`Stage::field_alone`](gs_train::schedule::Stage::field_alone)), where it moves splats by itself.

use glam::{DVec3, Vec3};
use gs_core::{Camera, Color, Geometry, GeometryRef, Param, Params, Splats, SplatsGrad, Time, cast, rot};
use gs_deform::Field;
use gs_physics::classes::ClassRule;
use gs_physics::{Dynamics, ParticleState, Start};
use gs_raster::ScreenStats;
use gs_train::canonical::Canonical;
use gs_train::capabilities::Capabilities;
use gs_train::method::{Buffer, BufferMut, Buffers, LossValue, Method, MethodError, RenderView, StepEvents, ViewCtx};
use gs_train::scene::SceneInfo;
use gs_train::step::StepCtx;
use gs_train::timestamp::Timestamp;
use std::sync::{Mutex, PoisonError};

mod colours;
mod config;
mod future;
mod overlays;
mod spans;
#[cfg(test)]
mod tests;
mod tracks;

pub use config::{Inside, PhysicsConfig};
use future::{Future, Tolerance};
use spans::{Span, Times};

/// How far a splat goes before it tells what moves, of the extent of the scene.
const LITTLE: f32 = 0.01;

/// A cloud under a field and dynamics.
pub struct Advected<F: Field, D: Dynamics> {
    canonical: Canonical,
    field: F,
    dynamics: D,
    config: PhysicsConfig,
    times: Times,
    /// What forecasts may leave out.
    tolerance: Tolerance,
    /// Splats that moved less than this hardly say where the middle of what moves is, world units.
    little: f32,
    scratch: Scratch<F, D>,
    /// What is known of the time after `T_def`; gone with any change of a parameter.
    future: Mutex<Option<Future>>,
}

/// Buffers of one step.
struct Scratch<F: Field, D: Dynamics> {
    field: F::Tape,
    dynamics: D::Tape,
    /// Where the field puts splats.
    moved: Geometry,
    d_canonical: Geometry,
    /// Where the dynamics carry them from there, and how they turn them.
    moves: ParticleState,
    d_moves: ParticleState,
    /// Rotations after that.
    quats: Vec<[f32; 4]>,
    /// Colours as they are rendered, where they turn with their splats.
    color: Color,
}

impl<F: Field, D: Dynamics> Default for Scratch<F, D> {
    fn default() -> Self {
        let (field, dynamics, moved, d_canonical) = Default::default();
        let (moves, d_moves, quats, color) = Default::default();
        Self { field, dynamics, moved, d_canonical, moves, d_moves, quats, color }
    }
}

impl<F: Field, D: Dynamics> Advected<F, D> {
    /// A cloud with its field and its dynamics.
    ///
    /// # Errors
    /// If a setting is out of its domain.
    pub fn new(
        canonical: Canonical,
        field: F,
        dynamics: D,
        config: PhysicsConfig,
        scene: &SceneInfo,
    ) -> Result<Self, String> {
        config.check()?;
        let (times, scratch, future) = (Times::new(&config, scene), Scratch::default(), Mutex::new(None));
        let little = LITTLE * scene.extent;
        let tolerance = Tolerance {
            rule: ClassRule {
                tolerance: f64::from(config.slack * scene.extent),
                horizon: (1.0 - if config.field { times.last_field } else { 0.0 }).max(times.step),
            },
            bodies: config.bodies as usize,
        };
        Ok(Self { canonical, field, dynamics, config, times, tolerance, little, scratch, future })
    }

    /// Where the field puts canonical splats at a time.
    fn deformed(&self, canonical: GeometryRef<'_>, t: f64) -> Geometry {
        let mut moved = Geometry::default();
        deform(self.config.field.then_some(&self.field), canonical, t, &mut F::Tape::default(), &mut moved);
        moved
    }

    fn transported(&self, span: Span) -> Splats {
        let mut splats = self.canonical.activated();
        if !self.canonical.at.dynamic {
            return splats;
        }
        let moved = match span.from == self.times.last_field && span.to > span.from {
            true => self.ahead(span.to),
            false => self.near(&splats, span),
        };
        if self.config.turn_colours {
            colours::turn(&splats.quats, &moved.quats, &mut splats.color);
        }
        splats.set_geometry(moved);
        splats
    }

    /// The splats at a time that the field is read at or near to.
    fn near(&self, canonical: &Splats, span: Span) -> Geometry {
        let mut moved = self.deformed(canonical.geometry(), span.from);
        if span.from != span.to {
            let (mut tape, mut moves) = Default::default();
            let start = self.start(canonical, &moved.means, span.from);
            self.dynamics.integrate(start, span.to, &mut tape, &mut moves);
            carry(&mut moved, &mut moves);
        }
        moved
    }

    /// The splats at a time after `T_def`, by what is known of the future.
    fn ahead(&self, t: f64) -> Geometry {
        self.with_future(|future| future.at(t, &self.dynamics))
    }

    /// What is known of the future, found out where it is asked for first. Nothing is computed under the lock: a thread of a
    /// pool that waits there may begin another task, which asks as well.
    fn with_future<T>(&self, f: impl FnOnce(&mut Future) -> T) -> T {
        let lock = || self.future.lock().unwrap_or_else(PoisonError::into_inner);
        let known = lock().take();
        let mut future = known.unwrap_or_else(|| self.find_future());
        let answer = f(&mut future);
        *lock() = Some(future);
        answer
    }

    fn find_future(&self) -> Future {
        let (canonical, from) = (self.canonical.activated(), self.first_ahead());
        let begin = self.deformed(canonical.geometry(), from);
        let middle = self.start(&canonical, &begin.means, from).middle;
        let refit = self.config.refit && self.config.field && self.dynamics.motion_rollout().is_some();
        let tracks = refit.then(|| self.tracks(&canonical));
        Future::new(begin, &canonical.opacities, from, middle, tracks.as_ref(), &self.dynamics, self.tolerance)
    }

    /// Deformed splats, at `x`, as particles that set out at a time.
    fn start<'a>(&self, canonical: &Splats, x: &'a [Vec3], t: f64) -> Start<'a> {
        Start { x, t, middle: middle(canonical, x, self.dynamics.origin(), self.little) }
    }

    fn forget(&mut self) {
        *self.future.get_mut().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Forward and backward through field and dynamics.
    fn learn<'a>(
        &mut self,
        view: &ViewCtx<'_>,
        render: &'a mut dyn RenderView,
    ) -> Result<&'a ScreenStats, MethodError> {
        let span = self.training_span(f64::from(view.at.t.normalised), view.draw);
        let Scratch { field: tape, dynamics, moved, d_canonical, moves, d_moves, quats, color } = &mut self.scratch;
        let Canonical { splats, d_splats, at, .. } = &mut self.canonical;
        let rest = splats.geometry();
        let field = self.config.field.then_some(&mut self.field);
        deform(field.as_deref(), rest, span.from, tape, moved);
        let mut shown = splats.with_geometry(moved.view());
        let travels = span.from != span.to;
        let middle = middle(splats, &moved.means, self.dynamics.origin(), self.little);
        let start = Start { x: &moved.means, t: span.from, middle };
        if travels {
            self.dynamics.integrate(start, span.to, dynamics, moves);
            quats.clear();
            quats.extend(moved.quats.iter().zip(&moves.rotations).map(|(q, turn)| rot::hamilton(*turn, *q)));
            (shown.means, shown.quats) = (&moves.means, quats);
        }
        if self.config.turn_colours {
            color.clone_from(&splats.color);
            colours::turn(rest.quats, shown.quats, color);
            shown.color = color;
        }
        let stats = render.render(shown, d_splats)?;
        at.keep_sizes(d_splats);
        if self.config.turn_colours {
            colours::turn_back(&splats.color, rest.quats, shown.quats, &mut d_splats.color);
        }
        if travels {
            turn_back(&moved.quats, moves, d_splats, d_moves);
            if self.config.turn_gradients {
                for (d, turn) in d_splats.means.iter_mut().zip(&moves.rotations) {
                    *d = rot::to_glam(rot::normalise(*turn).wxyz).inverse() * *d;
                }
            }
            self.dynamics.integrate_backward(start, dynamics, d_moves);
        }
        if let Some(field) = field {
            d_canonical.reset(rest.len());
            field.backward(rest, tape, d_splats.geometry(), d_canonical);
            d_splats.swap_geometry(d_canonical);
        }
        Ok(stats)
    }
}

/// Writes where a field puts canonical splats at a time to `moved`; without a field, where they are.
fn deform<F: Field>(field: Option<&F>, canonical: GeometryRef<'_>, t: f64, tape: &mut F::Tape, moved: &mut Geometry) {
    match field {
        Some(field) => field.forward(canonical, at(t), tape, moved),
        None => {
            moved.resize(canonical.len());
            moved.view_mut().copy_from(canonical);
        }
    }
}

/// The middle of what moved: the mean of the positions weighted by opacity and squared distance from rest, drawn towards `origin`
/// where splats moved by no more than `little`.
fn middle(canonical: &Splats, now: &[Vec3], origin: Vec3, little: f32) -> Vec3 {
    let origin = origin.as_dvec3();
    let all: f64 = canonical.opacities.iter().map(|o| f64::from(*o)).sum();
    let (mut sum, mut weight) = (DVec3::ZERO, f64::from(little * little) * all);
    for ((rest, now), opacity) in canonical.means.iter().zip(now).zip(&canonical.opacities) {
        let w = f64::from(*opacity) * f64::from((*now - *rest).length_squared());
        sum += w * (now.as_dvec3() - origin);
        weight += w;
    }
    if weight > 0.0 { (origin + sum / weight).as_vec3() } else { origin.as_vec3() }
}

/// A time for the field; its clock is the normalised one.
fn at(t: f64) -> Time {
    Time { normalised: cast::to_f32(t), seconds: t }
}

/// Puts splats where the dynamics carried them, turned as they turned. What a velocity field has carried beyond all numbers stays
/// where it was.
fn carry(splats: &mut Geometry, moves: &mut ParticleState) {
    for ((to, turn), from) in moves.means.iter_mut().zip(&mut moves.rotations).zip(&splats.means) {
        if !(to.is_finite() && turn.iter().all(|v| v.is_finite())) {
            (*to, *turn) = (*from, [1.0, 0.0, 0.0, 0.0]);
        }
    }
    splats.means.copy_from_slice(&moves.means);
    for (q, turn) in splats.quats.iter_mut().zip(&moves.rotations) {
        *q = rot::hamilton(*turn, *q);
    }
}

/// Pulls the cotangents of what was carried, `d`, back: to the dynamics, `d_moves`, and in place to the splats before, whose
/// rotations are `quats`. With `q = p ⊗ r`: `d_p = d ⊗ r*`, `d_r = p* ⊗ d`.
fn turn_back(quats: &[[f32; 4]], moves: &ParticleState, d: &mut SplatsGrad, d_moves: &mut ParticleState) {
    d_moves.means.clone_from(&d.means);
    d_moves.rotations.clear();
    d_moves.rotations.extend(d.quats.iter().zip(quats).map(|(d, r)| rot::hamilton(*d, rot::conjugate(*r))));
    for (d, p) in d.quats.iter_mut().zip(&moves.rotations) {
        *d = rot::hamilton(rot::conjugate(*p), *d);
    }
}

impl<F: Field, D: Dynamics> Params for Advected<F, D> {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.canonical.cloud.visit(f);
        if self.config.field {
            self.field.visit(f);
        }
        self.dynamics.visit(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.canonical.cloud.visit_mut(f);
        if self.config.field {
            self.field.visit_mut(f);
        }
        self.dynamics.visit_mut(f);
    }
}

impl<F: Field, D: Dynamics> Buffers for Advected<F, D> {
    fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        self.canonical.buffers(f);
    }

    fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        self.canonical.buffers_mut(f);
    }
}

impl<F: Field, D: Dynamics> Method for Advected<F, D>
where
    F::Tape: Sync,
{
    fn begin_step(&mut self, at: &StepCtx) {
        self.forget();
        self.canonical.begin_step(at);
    }

    fn splats(&self, at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
        Ok(self.transported(self.render_span(f64::from(at.t.normalised))))
    }

    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        self.canonical.forward();
        let stats = match self.canonical.at.dynamic {
            true => self.learn(view, render)?,
            false => render.render(self.canonical.splats.view(), &mut self.canonical.d_splats)?,
        };
        self.canonical.backward();
        self.canonical.accumulate(stats, view.camera);
        Ok(Vec::new())
    }

    fn regularise(&mut self, _last: &Timestamp) -> Vec<LossValue> {
        let step = self.canonical.at.step;
        if !self.canonical.at.dynamic {
            return Vec::new();
        }
        self.canonical.forward();
        let t = at(self.times.last_field);
        let mut all = match self.config.field {
            true => self.field.regularise(self.canonical.splats.geometry(), t, step),
            false => Vec::new(),
        };
        if !self.canonical.at.deform_only {
            all.extend(self.dynamics.regularise(self.canonical.seed(), step));
        }
        all
    }

    fn takes_part(&self, parameter: &str) -> bool {
        self.canonical.takes_part(parameter)
    }

    fn needs_whole_rows(&self) -> bool {
        self.canonical.needs_whole_rows()
    }

    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        self.forget();
        Ok(StepEvents { densified: self.canonical.densify()?, log: Vec::new() })
    }

    fn splat_count(&self) -> usize {
        self.canonical.cloud.len()
    }

    fn capabilities(&self) -> Capabilities<'_> {
        let growth = Some(self.canonical.growth());
        Capabilities { inspect: Some(self), particles: Some(self), growth, ..Capabilities::default() }
    }
}
