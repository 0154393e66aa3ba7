//! A canonical cloud and a deformation field: the common body of DefGS, 4DGS, Grid4D and FAGS.
//!
//! ```text
//! raw → activate → canonical splats → field(t) → splats at t → draw
//! ```
//! and back the same way. In stages without the field, the canonical splats are drawn at every time.

use gs_core::{Camera, Param, Params, Splats, SplatsGrad, Time};
use gs_deform::Field;
use gs_deform::field::anneal::{Anneal, smooth_time};
use gs_raster::ScreenStats;
use gs_train::canonical::Canonical;
use gs_train::densify::Adapted;
use gs_train::kernel::kernel_quantities;
use gs_train::method::{Column, ColumnMut, Method, Overlay, Quantity, StageView};
use gs_train::palette::DIRECTIONS;
use gs_train::schedule::Schedule;
use gs_train::timestamp::Moment;

/// A cloud moved by a field.
pub struct Deformed<F: Field> {
    name: &'static str,
    canonical: Canonical,
    field: F,
    tape: F::Tape,
    moved: Splats,
    d_moved: SplatsGrad,
    /// Time of the present step.
    t: Time,
    anneal: Anneal,
    /// Spacing of training times, normalised.
    interval: f32,
    /// First step of the field's regularisers.
    regular_from: u32,
}

impl<F: Field> Deformed<F> {
    /// A cloud and its field; training times are blurred as `anneal` says (strength 0: not at all), `views` of them.
    pub fn new(name: &'static str, canonical: Canonical, field: F, anneal: Anneal, views: u32) -> Self {
        let interval = 1.0 / views.max(1) as f32;
        let (tape, moved, d_moved, t) = Default::default();
        Self { name, canonical, field, tape, moved, d_moved, t, anneal, interval, regular_from: 0 }
    }

    /// The same without the field's regularisers before this step of the run.
    pub fn regularised_from(mut self, step: u32) -> Self {
        self.regular_from = step;
        self
    }

    fn training_time(&self, t: Time) -> Time {
        smooth_time(t, self.interval, &self.anneal, self.canonical.seed(), self.canonical.step())
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

impl<F: Field> Method for Deformed<F>
where
    F::Tape: Sync,
{
    fn name(&self) -> &'static str {
        self.name
    }

    fn schedule(&self) -> &Schedule {
        &self.canonical.schedule
    }

    fn set_step(&mut self, step: u32) {
        self.canonical.set_step(step);
    }

    fn splats(&self, at: &Moment, _camera: &Camera) -> Splats {
        let canonical = self.canonical.activated();
        if !self.canonical.dynamic() {
            return canonical;
        }
        let mut moved = Splats::default();
        self.field.forward(&canonical, at.t, &mut F::Tape::default(), &mut moved);
        moved
    }

    fn step(&mut self, at: &Moment, _camera: &Camera, draw: &mut dyn FnMut(&Splats, &mut SplatsGrad)) {
        self.canonical.forward();
        if self.canonical.dynamic() {
            self.t = self.training_time(at.t);
            let canonical = &mut self.canonical;
            self.field.forward(&canonical.splats, self.t, &mut self.tape, &mut self.moved);
            self.d_moved.reset(&self.moved);
            draw(&self.moved, &mut self.d_moved);
            self.field.backward(&canonical.splats, &mut self.tape, &self.d_moved, &mut canonical.d_splats);
        } else {
            draw(&self.canonical.splats, &mut self.canonical.d_splats);
        }
        self.canonical.backward();
    }

    fn stages(&self, at: &Moment, camera: &Camera) -> Vec<StageView> {
        let canonical = self.canonical.activated();
        let before = Some(canonical.means.clone());
        vec![
            StageView { name: "canonical", splats: canonical, before: None },
            StageView { name: "full", splats: self.splats(at, camera), before },
        ]
    }

    fn penalties(&mut self, step: u32) -> Vec<(&'static str, f32)> {
        match self.canonical.schedule.dynamic(step) && step >= self.regular_from {
            true => self.field.regularise(&self.canonical.splats, self.t, step),
            false => Vec::new(),
        }
    }

    fn observe(&mut self, _at: &Moment, seen: &ScreenStats, camera: &Camera) {
        self.canonical.observe(seen, camera);
    }

    fn adapt(&mut self, step: u32) -> Adapted {
        self.canonical.adapt(step)
    }

    fn quantities(&self, at: &Moment) -> Vec<Quantity> {
        let canonical = self.canonical.activated();
        let mut all = kernel_quantities(&canonical.kernel);
        if self.canonical.dynamic() {
            let values = self.field.quantities(&canonical, at.t);
            all.extend(values.into_iter().map(|(name, values)| Quantity::share(name, values)));
        }
        all
    }

    /// `motion`: displacement from the canonical place, one colour channel per axis, grey for none.
    fn overlays(&self, at: &Moment) -> Vec<Overlay> {
        let canonical = self.canonical.activated();
        let mut moved = Splats::default();
        self.field.forward(&canonical, at.t, &mut F::Tape::default(), &mut moved);
        let shifts: Vec<_> = moved.means.iter().zip(&canonical.means).map(|(a, b)| *a - *b).collect();
        let largest = shifts.iter().map(|s| s.abs().max_element()).fold(f32::MIN_POSITIVE, f32::max);
        let colors = shifts.iter().map(|s| (0.5 + 0.5 * *s / largest).to_array()).collect();
        let motion = Overlay { name: "motion", colors, meaning: DIRECTIONS };
        std::iter::once(motion).chain(self.quantities(at).iter().map(Quantity::overlay)).collect()
    }

    fn columns(&self) -> Vec<Column<'_>> {
        self.canonical.density.columns().map(Column::per_row).into()
    }

    fn columns_mut(&mut self) -> Vec<ColumnMut<'_>> {
        self.canonical.density.columns_mut().map(ColumnMut::per_row).into()
    }

    fn len(&self) -> usize {
        self.canonical.cloud.len()
    }
}
