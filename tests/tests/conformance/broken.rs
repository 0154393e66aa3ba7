//! Spacetime Gaussians with something wrong: what the checks must find.

use crate::spacetime;
use gs_core::{Camera, Param, Params, Splats};
use gs_train::capabilities::Capabilities;
use gs_train::method::{Buffer, BufferMut, Buffers, LossValue, Method, MethodError, RenderView, StepEvents, ViewCtx};
use gs_train::model::Model;
use gs_train::registry::MethodEntry;
use gs_train::scene::SceneInfo;
use gs_train::schedule::LearningRate;
use gs_train::step::StepCtx;
use gs_train::timestamp::Timestamp;

/// A row block that densification does not edit.
pub const ROWS: u8 = 0;
/// State that checkpoints do not keep.
pub const STATE: u8 = 1;
/// Gradients that depend on the number of threads.
pub const THREADS: u8 = 2;
/// A wrong number of splats.
pub const COUNT: u8 = 3;
/// Gradients of twice the size.
pub const GRADIENTS: u8 = 4;
/// Gradients that depend on earlier views of the step.
pub const VIEWS: u8 = 5;

/// A shared block that is updated and never has a gradient.
pub const UPDATES: u8 = 6;

/// The method with a fault.
pub const fn entry<const FAULT: u8>() -> MethodEntry {
    MethodEntry { build: build::<FAULT>, ..spacetime::ENTRY }
}

struct Broken<const FAULT: u8> {
    inner: Model,
    extra: Option<Param>,
    steps: u32,
    views: u32,
}

fn build<const FAULT: u8>(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let inner = (spacetime::ENTRY.build)(table, scene)?;
    let mut schedule = inner.schedule().clone();
    let extra = match FAULT {
        ROWS => Some(Param::rows("time.extra", 1, vec![0.0; inner.splat_count()])),
        UPDATES => {
            schedule.lr.insert("idle".into(), [("all".into(), LearningRate::constant(1e-3))].into());
            Some(Param::shared("idle.extra", vec![0.0]))
        }
        _ => None,
    };
    Model::new(spacetime::ENTRY.name, Broken::<FAULT> { inner, extra, steps: 0, views: 0 }, schedule)
}

impl<const FAULT: u8> Params for Broken<FAULT> {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.inner.visit(f);
        self.extra.iter().for_each(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.inner.visit_mut(f);
        self.extra.iter_mut().for_each(f);
    }
}

impl<const FAULT: u8> Buffers for Broken<FAULT> {
    fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        self.inner.buffers(f);
    }

    fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        self.inner.buffers_mut(f);
    }
}

impl<const FAULT: u8> Method for Broken<FAULT> {
    fn begin_step(&mut self, at: &StepCtx) {
        self.inner.begin_step(at.step);
        self.views = 0;
    }

    fn splats(&self, at: &Timestamp, camera: &Camera) -> Result<Splats, MethodError> {
        self.inner.splats(at, camera)
    }

    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        let losses = self.inner.step(view, render)?;
        self.steps += 1;
        self.views += 1;
        let factor = match FAULT {
            STATE => 1.0 / self.steps as f32,
            VIEWS => 1.0 / self.views as f32,
            THREADS => rayon::current_num_threads() as f32,
            GRADIENTS => 2.0,
            _ => 1.0,
        };
        self.inner.visit_mut(&mut |p| {
            if p.name == "motion.poly" {
                p.grad.iter_mut().for_each(|g| *g *= factor);
            }
        });
        Ok(losses)
    }

    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        self.inner.end_step()
    }

    fn splat_count(&self) -> usize {
        self.inner.splat_count() + usize::from(FAULT == COUNT)
    }

    fn capabilities(&self) -> Capabilities<'_> {
        self.inner.capabilities()
    }
}
