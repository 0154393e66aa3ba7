//! A canonical cloud and a deformation field: the common body of DefGS, 4DGS, Grid4D and FAGS.
//!
//! ```text
//! raw → activate → canonical splats → field(t) → splats at t → render
//! ```
//! and backward in reverse. In stages without the field, the canonical splats are rendered at every time.

use gs_core::{Camera, Geometry, GeometryRef, Param, Params, Splats, Time};
use gs_deform::Field;
use gs_deform::field::anneal::{Anneal, smooth_time};
use gs_train::canonical::Canonical;
use gs_train::capabilities::{Bake, Capabilities, FreezeOptions, FreezeReport, Inspect, Overlay, Quantity, StageView};
use gs_train::kernel::kernel_quantities;
use gs_train::method::{
    Buffer, BufferMut, Buffers, LossValue, Method, MethodError, MovedCloud, RenderView, StepEvents, ViewCtx,
};
use gs_train::palette::DIRECTIONS;
use gs_train::report::Section;
use gs_train::scene::SceneInfo;
use gs_train::step::StepCtx;
use gs_train::still::Still;
use gs_train::still::decisions::{Decision, section};
use gs_train::still::training::{StillConfig, StillRows};
use gs_train::timestamp::Timestamp;
use std::any::Any;
use std::sync::{Mutex, PoisonError};

#[cfg(test)]
mod tests;

/// A cloud moved by a field.
pub struct Deformed<F: Field> {
    canonical: Canonical,
    field: F,
    tape: F::Tape,
    moved: Geometry,
    d_canonical: Geometry,
    anneal: Anneal,
    /// Width of the blur of training times, normalised: one part of as many as there are training views [DefGS].
    interval: f32,
    /// First step of the field's regularisers.
    regular_from: u32,
    /// The tape of the last rendering without gradients, of the present parameters.
    rendering: Mutex<Option<F::Tape>>,
    /// What rendering leaves at rest.
    still: Option<Still>,
    /// What training leaves out of the field.
    resting: StillRows,
}

impl<F: Field> Deformed<F> {
    /// A cloud and its field; training times are blurred as `anneal` says (strength 0: not at all), `views` of them.
    pub fn new(canonical: Canonical, field: F, anneal: Anneal, views: u32) -> Self {
        let interval = 1.0 / views.max(1) as f32;
        let (tape, moved, d_canonical) = Default::default();
        let (rendering, still, regular_from) = Default::default();
        let resting = StillRows::new(StillConfig::default(), 0, 1.0);
        Self { canonical, field, tape, moved, d_canonical, anneal, interval, regular_from, rendering, still, resting }
    }

    /// The same, still splats left out of the field while training.
    ///
    /// # Errors
    /// As [`StillConfig::check`], of the method of that name.
    pub(crate) fn resting(
        self,
        method: &'static str,
        config: StillConfig,
        scene: &SceneInfo,
    ) -> Result<Self, MethodError> {
        config.check().map_err(|why| MethodError::Config { method, why })?;
        let resting = StillRows::new(config, self.canonical.cloud.len(), scene.last_time);
        Ok(Self { resting, ..self })
    }

    /// The same without the field's regularisers before this step of the run.
    pub(crate) fn regularised_from(mut self, step: u32) -> Self {
        self.regular_from = step;
        self
    }

    /// Where the field moves canonical splats, and what rests.
    fn moved(&self, canonical: &Splats, t: Time) -> Geometry {
        let mut moved = Geometry::default();
        let forward = |rows: GeometryRef<'_>, out: &mut Geometry| self.forward(rows, t, out);
        match &self.still {
            Some(still) => still.forward(canonical.geometry(), forward, &mut moved),
            None => forward(canonical.geometry(), &mut moved),
        }
        moved
    }

    /// The field without gradients, always of the same rows. What of its tape does not depend on time is kept.
    fn forward(&self, rows: GeometryRef<'_>, t: Time, out: &mut Geometry) {
        let lock = || self.rendering.lock().unwrap_or_else(PoisonError::into_inner);
        let warm = lock().take();
        let again = warm.is_some();
        let mut tape = warm.unwrap_or_default();
        match again {
            true => self.field.forward_again(rows, t, &mut tape, out),
            false => self.field.forward(rows, t, &mut tape, out),
        }
        *lock() = Some(tape);
    }

    /// To be called before or after any change of a parameter.
    fn forget(&mut self) {
        *self.rendering.get_mut().unwrap_or_else(PoisonError::into_inner) = None;
        self.still = None;
    }

    /// Decides which splats are left out of the field from now on, where that is due.
    fn decide_still(&mut self) -> Vec<serde_json::Value> {
        let step = self.canonical.at.step;
        if !self.resting.due(&self.canonical.at) {
            return Vec::new();
        }
        let splats = self.canonical.activated();
        let mut first = true;
        let probe = |t: Time, out: &mut Geometry| match std::mem::take(&mut first) {
            true => self.field.forward(splats.geometry(), t, &mut self.tape, out),
            false => self.field.forward_again(splats.geometry(), t, &mut self.tape, out),
        };
        let (still, entered) = self.resting.decide(splats.geometry(), self.canonical.rules().grad, probe);
        vec![serde_json::json!(Decision { step, still, entered, splats: splats.len() })]
    }

    fn training_time(&self, t: Time) -> Time {
        smooth_time(t, self.interval, &self.anneal, self.canonical.seed(), self.canonical.at.step)
    }
}

impl<F: Field> Params for Deformed<F> {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.canonical.cloud.visit(f);
        self.field.visit(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.canonical.cloud.visit_mut(f);
        self.field.visit_mut(f);
    }
}

impl<F: Field> Buffers for Deformed<F> {
    fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        self.canonical.buffers(f);
        self.resting.buffers(f);
    }

    fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        self.canonical.buffers_mut(f);
        self.resting.buffers_mut(f);
    }
}

impl<F: Field + Clone + 'static> Method for Deformed<F>
where
    F::Tape: Sync,
{
    fn begin_step(&mut self, at: &StepCtx) {
        self.canonical.begin_step(at);
        self.resting.begin_step(at);
        self.forget();
    }

    fn splats(&self, at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
        let mut splats = self.canonical.activated();
        if self.canonical.at.dynamic {
            splats.set_geometry(self.moved(&splats, at.t));
        }
        Ok(splats)
    }

    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        self.canonical.forward();
        let dynamic = self.canonical.at.dynamic;
        let mut own = Vec::new();
        let stats = if dynamic {
            let t = self.training_time(view.at.t);
            let Self { canonical: Canonical { splats, d_splats, at, .. }, field, tape, resting, .. } = self;
            let forward = |rows: GeometryRef<'_>, out: &mut Geometry| field.forward(rows, t, tape, out);
            resting.forward(splats.geometry(), forward, &mut self.moved);
            let stats = render.render(splats.with_geometry(self.moved.view()), d_splats)?;
            resting.see(&self.moved, stats, view.camera);
            at.keep_sizes(d_splats);
            let pull = resting.pull(splats.geometry(), &self.moved, at);
            if let Some((pull, value)) = &pull {
                d_splats.add_geometry(1.0, pull);
                own.push(("still", *value));
            }
            let backward =
                |rows: GeometryRef<'_>, d: GeometryRef<'_>, to: &mut Geometry| field.backward(rows, tape, d, to);
            resting.backward(splats.geometry(), d_splats.geometry(), backward, &mut self.d_canonical);
            d_splats.swap_geometry(&mut self.d_canonical);
            if let Some((pull, _)) = &pull {
                // It pulls at what the field adds, not at where it adds it.
                d_splats.add_geometry(-1.0, pull);
            }
            stats
        } else {
            render.render(self.canonical.splats.view(), &mut self.canonical.d_splats)?
        };
        self.canonical.backward();
        self.canonical.accumulate(stats, view.camera);
        Ok(own)
    }

    fn regularise(&mut self, last: &Timestamp) -> Vec<LossValue> {
        let step = self.canonical.at.step;
        if !self.canonical.at.dynamic || step < self.regular_from {
            return Vec::new();
        }
        self.canonical.forward();
        let t = self.training_time(last.t);
        self.field.regularise(self.canonical.splats.geometry(), t, step)
    }

    fn takes_part(&self, parameter: &str) -> bool {
        self.canonical.takes_part(parameter)
    }

    fn needs_whole_rows(&self) -> bool {
        self.canonical.needs_whole_rows() || self.resting.due(&self.canonical.at)
    }

    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        self.forget();
        let log = self.decide_still();
        let densified = self.canonical.densify_with(&mut [], &mut self.resting.columns_mut())?;
        Ok(StepEvents { densified, log })
    }

    fn moved_cloud(&self, view: &ViewCtx<'_>) -> Result<MovedCloud<'_>, &'static str> {
        let at = &self.canonical.at;
        if self.resting.on() || self.still.is_some() {
            return Err("still splats are left out of the field (still.pixels)");
        }
        if at.dynamic && at.step < self.regular_from {
            return Err("the field's regularisers begin later than the field");
        }
        Ok(self.canonical.moved_by(Some(&self.field as &dyn Any), self.training_time(view.at.t)))
    }

    fn splat_count(&self) -> usize {
        self.canonical.cloud.len()
    }

    fn capabilities(&self) -> Capabilities<'_> {
        let growth = Some(self.canonical.growth());
        Capabilities { inspect: Some(self), bake: Some(self), growth, ..Capabilities::default() }
    }
}

impl<F: Field + Clone + 'static> Inspect for Deformed<F>
where
    F::Tape: Sync,
{
    fn stages(&self, at: &Timestamp, camera: &Camera) -> Result<Vec<StageView>, MethodError> {
        let canonical = self.canonical.activated();
        let before = Some(canonical.means.clone());
        Ok(vec![
            StageView { name: "canonical", splats: canonical, before: None },
            StageView { name: "full", splats: self.splats(at, camera)?, before },
        ])
    }

    fn quantities(&self, at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        let canonical = self.canonical.activated();
        let mut all = kernel_quantities(&canonical.kernel);
        if self.canonical.at.dynamic {
            let values = self.field.quantities(canonical.geometry(), at.t);
            all.extend(values.into_iter().map(|(name, values)| Quantity::share(name, values)));
            let still: Vec<f32> = self.resting.flags().map(|still| f32::from(u8::from(still))).collect();
            all.extend((!still.is_empty()).then(|| Quantity::share("still", still)));
        }
        Ok(all)
    }

    /// `motion`: displacement from the canonical position, one colour channel per axis, grey for none.
    fn overlays(&self, at: &Timestamp) -> Result<Vec<Overlay>, MethodError> {
        let canonical = self.canonical.activated();
        let moved = self.moved(&canonical, at.t);
        let shifts: Vec<_> = moved.means.iter().zip(&canonical.means).map(|(a, b)| *a - *b).collect();
        let largest = shifts.iter().map(|s| s.abs().max_element()).fold(f32::MIN_POSITIVE, f32::max);
        let colors = shifts.iter().map(|s| (0.5 + 0.5 * *s / largest).to_array()).collect();
        let motion = Overlay { name: "motion", colors, meaning: DIRECTIONS };
        Ok(std::iter::once(motion).chain(self.quantities(at)?.iter().map(Quantity::overlay)).collect())
    }

    /// The splats that training left out of the field, if it did.
    fn report_section(&self, events: &[serde_json::Value]) -> Result<Option<Section>, MethodError> {
        Ok(section(events))
    }
}

impl<F: Field + Clone + 'static> Bake for Deformed<F>
where
    F::Tape: Sync,
{
    fn freeze_static(&self, options: &FreezeOptions<'_>) -> Option<(Box<dyn Method>, FreezeReport)> {
        let canonical = self.canonical.activated();
        let (field, mut tape) = (&self.field, F::Tape::default());
        let probe = |t: Time, moved: &mut Geometry| field.forward(canonical.geometry(), t, &mut tape, moved);
        let (still, report) = self.canonical.at.dynamic.then(|| Still::find(canonical.len(), options, probe))??;
        let fresh = Self::new(self.canonical.clone(), field.clone(), self.anneal, 1);
        let (interval, regular_from) = (self.interval, self.regular_from);
        let resting = self.resting.clone();
        Some((Box::new(Self { interval, regular_from, still: Some(still), resting, ..fresh }), report))
    }
}
