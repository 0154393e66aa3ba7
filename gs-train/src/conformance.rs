//! What every method must keep, as checks for the tests of a method (cargo feature `conformance`).
//!
//! | check | what must hold |
//! |---|---|
//! | [`Subject::rates`] | names of blocks and buffers are unique, and every block has a rule for its learning rate |
//! | [`Subject::updates`] | what a stage gives no gradient is not updated in it |
//! | [`Subject::rows`] | after every step all row blocks and buffers have the same rows, and the run densifies if the method can |
//! | [`Subject::times`] | splats are finite at times inside and outside `[0, 1]`, as many as [`Method::splat_count`](crate::method::Method::splat_count) says |
//! | [`Subject::state`] | a saved state loads bit for bit, and training goes on from it bit for bit |
//! | [`Subject::threads`] | 1, 2 and 4 threads give the same bits |
//! | [`Subject::ranks`] | 1 and 2 ranks give the same bits, with steps of 3 views |
//! | [`Subject::gradients`] | gradients are those of finite differences ([`gradients`]) |
//!
//! Each trains the method by the given configuration, so that should describe a short run in which everything happens: tens
//! of steps, tens of splats, images of some 32 pixels, all stages, densification.

pub mod gradients;

use crate::checkpoint::Checkpoint;
use crate::method::MethodError;
use crate::model::Model;
use crate::registry::Registry;
use crate::saved;
use crate::testkit::on_ranks;
use crate::timestamp::Timestamp;
use crate::trainer::{StepReport, TrainError, TrainOptions, Trainer};
use gradients::{Rules, View};
use gs_core::Param;
use gs_data::Dataset;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Times that splats are asked for, normalised.
const TIMES: [f32; 8] = [-10.0, -0.5, 0.0, 0.4, 1.0, 1.5, 100.0, 1e6];
/// Memory for decoded images, bytes.
const IMAGE_BYTES: usize = 64 << 20;

/// What a method does not keep.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("method `{method}`, {check}, {place}: {what}")]
pub struct ConformanceError {
    /// Name of the method, as in its entry.
    pub method: String,
    /// Name of the check, as of the function of [`Subject`].
    pub check: &'static str,
    /// The block, buffer, step or time concerned.
    pub place: String,
    /// What was found, with the values that differ.
    pub what: String,
}

/// A method under test, and the run it is tested in.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// Registry that builds the method and loads its checkpoints.
    pub registry: &'a Registry,
    /// Name of the method in that registry.
    pub name: &'a str,
    /// What it is trained on.
    pub dataset: &'a Arc<Dataset>,
    /// Its resolved configuration: every key has a value.
    pub config: &'a toml::Table,
    /// How gradients are checked, and how strictly.
    pub rules: Rules<'a>,
    /// Normalised time at which gradients are checked.
    pub time: f32,
    /// A change of the trained parameters before gradients are checked: away from values where the method has no derivative.
    pub modify: &'a (dyn Fn(&mut Param) + Sync),
}

/// Runs every check on a method, each of its parameters required to have a right gradient.
///
/// # Errors
/// The first offence.
pub fn check(
    registry: &Registry,
    name: &str,
    dataset: &Arc<Dataset>,
    config: &toml::Table,
) -> Result<(), ConformanceError> {
    Subject::new(registry, name, dataset, config).check()
}

impl<'a> Subject<'a> {
    /// A method with the usual rules; gradients are checked at time 0.3.
    pub fn new(registry: &'a Registry, name: &'a str, dataset: &'a Arc<Dataset>, config: &'a toml::Table) -> Self {
        Self { registry, name, dataset, config, rules: Rules::default(), time: 0.3, modify: &|_| {} }
    }

    /// Runs every check.
    ///
    /// # Errors
    /// The first offence.
    pub fn check(&self) -> Result<(), ConformanceError> {
        self.rates()?;
        self.updates()?;
        self.rows()?;
        self.times()?;
        self.state()?;
        self.threads()?;
        self.ranks()?;
        self.gradients()
    }

    /// Names of blocks and buffers are unique, and every block has a rule for its learning rate.
    ///
    /// # Errors
    /// The first block without.
    pub fn rates(&self) -> Result<(), ConformanceError> {
        let fail = |block: &str, what: &str| self.error("rates", block.to_owned(), what);
        let trainer = self.start("rates")?;
        let (mut names, mut result) = (BTreeSet::new(), Ok(()));
        trainer.model().visit(&mut |p| {
            if !names.insert(p.name.clone()) {
                result = Err(fail(&p.name, "another block has the same name"));
            } else if trainer.schedule().rule(&p.name).is_none() {
                result = Err(fail(&p.name, "the schedule has no learning rate for this block"));
            }
        });
        trainer.model().buffers(&mut |b| {
            if !names.insert(b.name.to_owned()) {
                result = Err(fail(b.name, "a block or another buffer has the same name"));
            }
        });
        result
    }

    /// In no stage is a group of shared blocks (`field.…`, say) updated of which no block has had a gradient by the stage's end: Adam's
    /// first update of a block is as long as its rate only if no updates without gradients were counted before
    /// ([`Method::takes_part`](crate::method::Method::takes_part)).
    ///
    /// # Errors
    /// The first stage and group.
    pub fn updates(&self) -> Result<(), ConformanceError> {
        let mut trainer = self.start("updates")?;
        let (mut open, mut stage) = (BTreeSet::new(), String::new());
        loop {
            let report = self.step("updates", &mut trainer)?;
            if report.as_ref().is_none_or(|r| r.stage != stage)
                && let Some(group) = open.pop_first()
            {
                let what = "is updated in a stage that gives none of its blocks a gradient";
                return Err(self.error("updates", format!("`{group}` in `{stage}`"), what));
            }
            let Some(StepReport { step, stage: now, .. }) = report else { return Ok(()) };
            stage = now;
            let (model, mut learnt) = (trainer.model(), BTreeSet::new());
            model.visit(&mut |p| {
                let group = p.name.split('.').next().unwrap_or_default().to_owned();
                if p.row_width.is_none() && model.update(p, step, 1.0).is_some() {
                    open.insert(group.clone());
                }
                if p.moment2.iter().any(|v| *v > 0.0) {
                    learnt.insert(group);
                }
            });
            open.retain(|group| !learnt.contains(group));
        }
    }

    /// After every step all columns of all row blocks, and all buffers with rows, have the same rows. A method that states
    /// bounds of its growth must clone or split in the run.
    ///
    /// # Errors
    /// The first block or buffer with other rows.
    pub fn rows(&self) -> Result<(), ConformanceError> {
        let mut trainer = self.start("rows")?;
        let mut grown = 0;
        while let Some(report) = self.step("rows", &mut trainer)? {
            grown += report.adapted.cloned + report.adapted.split;
            let place = |name: &str| format!("`{name}` after step {}", report.step);
            check_rows(trainer.model()).map_err(|(name, what)| self.error("rows", place(&name), what))?;
        }
        match trainer.model().capabilities().growth {
            Some(_) if grown == 0 => Err(self.error("rows", "the run".into(), "nothing was cloned or split")),
            _ => Ok(()),
        }
    }

    /// Splats are finite and in their domains at times inside and outside `[0, 1]`; in the full order they and their
    /// quantities are as many as the method counts.
    ///
    /// # Errors
    /// The first time at which they are not.
    pub fn times(&self) -> Result<(), ConformanceError> {
        let trainer = self.run("times", u32::MAX)?;
        let (model, camera) = (trainer.model(), &self.dataset.train[0].camera);
        for t in TIMES {
            let fail = |what: String| self.error("times", format!("time {t}"), what);
            let wrong = |e: MethodError| fail(e.to_string());
            let at = Timestamp::normalised(t);
            let all = model.all_splats(&at, camera).map_err(wrong)?;
            model.splats(&at, camera).map_err(wrong)?.check().map_err(|e| fail(e.to_string()))?;
            all.check().map_err(|e| fail(e.to_string()))?;
            let quantities = model.quantities(&at).map_err(wrong)?;
            let lengths = quantities.iter().map(|q| (q.name, q.values.len()));
            let count = model.splat_count();
            if let Some((what, n)) = lengths.chain([("splats", all.len())]).find(|(_, n)| *n != count) {
                return Err(fail(format!("{n} {what}, the method counts {count}")));
            }
        }
        Ok(())
    }

    /// A state saved before the first step, in the middle or after the first densification is the same when it was loaded,
    /// and the run that goes on from it ends in the same bits as the run that was not interrupted.
    ///
    /// # Errors
    /// The first tensor and value that differ.
    pub fn state(&self) -> Result<(), ConformanceError> {
        let mut whole = self.start("state")?;
        let (mut saved, mut grown, half) = (vec![whole.state()], false, whole.steps() / 2);
        while let Some(report) = self.step("state", &mut whole)? {
            let first_growth = !grown && report.adapted.cloned + report.adapted.split > 0;
            grown |= first_growth;
            if report.step == half || first_growth {
                saved.push(whole.state());
            }
        }
        let last = whole.state();
        for state in &saved {
            let at = |place: &str, step: u32| format!("{place} step {step}");
            let fail = |place, e: TrainError| self.error("state", place, e.to_string());
            let resumed = Trainer::resume(self.registry, self.dataset.clone(), state, None, IMAGE_BYTES);
            let mut resumed = resumed.map_err(|e| fail("loading".into(), e))?;
            let step = resumed.steps_done();
            self.same("state", at("saved and loaded at", step), state, &resumed.state())?;
            while self.step("state", &mut resumed)?.is_some() {}
            self.same("state", at("resumed at", step), &last, &resumed.state())?;
        }
        Ok(())
    }

    /// The run ends in the same bits with 1, 2 and 4 threads.
    ///
    /// # Errors
    /// The first tensor and value that differ.
    pub fn threads(&self) -> Result<(), ConformanceError> {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.map_err(|e| self.error("threads", format!("{threads} threads"), e.to_string()))?;
            pool.install(|| self.run("threads", u32::MAX).map(|trainer| trainer.state()))
        };
        let one = with(1)?;
        [2, 4].into_iter().try_for_each(|n| self.same("threads", format!("1 and {n} threads"), &one, &with(n)?))
    }

    /// The run ends in the same bits on 1 and 2 ranks, if a step has 3 views.
    ///
    /// # Errors
    /// The first tensor and value that differ.
    pub fn ranks(&self) -> Result<(), ConformanceError> {
        let mut config = self.config.clone();
        if let Some(schedule) = config.get_mut("schedule").and_then(toml::Value::as_table_mut) {
            schedule.insert("batch".into(), 3.into());
        }
        let subject = Subject { config: &config, ..*self };
        let with = |ranks: usize| {
            on_ranks(self.registry, self.dataset, subject.start("ranks")?, ranks, |mut trainer| {
                while subject.step("ranks", &mut trainer)?.is_some() {}
                trainer.gather().map_err(|e| self.error("ranks", "the end".into(), e.to_string()))?;
                Ok(trainer.state())
            })
        };
        self.same("ranks", "1 and 2 ranks".into(), &with(1)?, &with(2)?)
    }

    /// The gradients of the model after three quarters of the run are those of finite differences.
    ///
    /// # Errors
    /// All faults, with the first block concerned as the place.
    pub fn gradients(&self) -> Result<(), ConformanceError> {
        let (mut model, view) = self.trained()?;
        let fail = |e: MethodError| self.error("gradients", "the step".into(), e.to_string());
        let right = view.gradients(&mut model).map_err(fail)?;
        let report = gradients::check(&mut model, &right, &mut |m, _| view.functional(m), &self.rules);
        match report.all_faults().first() {
            None => Ok(()),
            Some((block, _)) => Err(self.error("gradients", format!("block `{block}`"), format!("\n{report}"))),
        }
    }

    /// The model after three quarters of the run with its change, and the view its gradients are checked in: for functionals
    /// of a method's own.
    ///
    /// # Errors
    /// If the method cannot be trained or its state not be loaded.
    pub fn trained(&self) -> Result<(Model, View), ConformanceError> {
        let steps = self.start("gradients")?.steps();
        let trainer = self.run("gradients", steps - steps / 4)?;
        let avatar = self.dataset.avatar.clone();
        let loaded = saved::load_with(self.registry, &trainer.state(), None, avatar)
            .map_err(|e| self.error("gradients", "loading".into(), e))?;
        let mut model = loaded.model;
        model.visit_mut(&mut |p| (self.modify)(p));
        let camera = self.dataset.train[0].camera.clone();
        let view = View::new(&model, loaded.step, Timestamp::normalised(self.time), camera);
        Ok((model, view))
    }

    fn start(&self, check: &'static str) -> Result<Trainer, ConformanceError> {
        let options = TrainOptions { image_bytes: IMAGE_BYTES, ..TrainOptions::default() };
        Trainer::new(self.registry, self.dataset.clone(), self.name, self.config, options)
            .map_err(|e| self.error(check, "the start".into(), e.to_string()))
    }

    /// A run of at most so many steps.
    fn run(&self, check: &'static str, steps: u32) -> Result<Trainer, ConformanceError> {
        let mut trainer = self.start(check)?;
        while trainer.steps_done() < steps && self.step(check, &mut trainer)?.is_some() {}
        Ok(trainer)
    }

    /// The next step, if there is one.
    fn step(&self, check: &'static str, trainer: &mut Trainer) -> Result<Option<StepReport>, ConformanceError> {
        match trainer.step() {
            Ok(report) => Ok(Some(report)),
            Err(TrainError::Finished(_)) => Ok(None),
            Err(e) => Err(self.error(check, format!("step {}", trainer.steps_done() + 1), e.to_string())),
        }
    }

    /// Refuses states that differ in more than the time spent.
    fn same(&self, check: &'static str, place: String, a: &Checkpoint, b: &Checkpoint) -> Result<(), ConformanceError> {
        difference(a, b).map_or(Ok(()), |what| Err(self.error(check, place, what)))
    }

    fn error(&self, check: &'static str, place: String, what: impl Into<String>) -> ConformanceError {
        ConformanceError { method: self.name.to_owned(), check, place, what: what.into() }
    }
}

/// The first block or buffer with other rows than the first row block, and what is wrong with it.
fn check_rows(model: &Model) -> Result<(), (String, String)> {
    let (mut rows, mut result) = (None, Ok(()));
    let mut found = |name: &str, n: usize, width: usize, what: &str| {
        let rows = *rows.get_or_insert(n / width.max(1));
        if result.is_ok() && n != rows * width {
            result = Err((name.to_owned(), format!("{n} {what}, {rows} rows of {width} are needed")));
        }
    };
    model.visit(&mut |p| {
        let columns = [(&p.value, "values"), (&p.grad, "gradients"), (&p.moment1, "moments"), (&p.moment2, "moments")];
        let width = p.row_width.unwrap_or(1);
        for (column, what) in columns.into_iter().filter(|_| p.row_width.is_some()) {
            found(&p.name, column.len(), width, what);
        }
    });
    model.buffers(&mut |b| {
        if let Some(width) = b.row_width {
            found(b.name, b.values.len(), width, "values");
        }
    });
    result
}

/// The first difference of two states but for the time spent.
fn difference(a: &Checkpoint, b: &Checkpoint) -> Option<String> {
    let meta = |c: &Checkpoint| {
        let mut meta = c.meta.clone();
        meta["train_seconds"] = 0.into();
        meta
    };
    if meta(a) != meta(b) || !a.tensors.iter().map(|t| &t.0).eq(b.tensors.iter().map(|t| &t.0)) {
        return Some("metadata or names of tensors differ".into());
    }
    a.tensors.iter().zip(&b.tensors).find_map(|((name, x), (_, y))| {
        let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        let at = bits(x).iter().zip(&bits(y)).position(|(x, y)| x != y);
        match at {
            Some(i) => Some(format!("tensor `{name}`, value {i}: {} and {}", x[i], y[i])),
            None if x.len() != y.len() => Some(format!("tensor `{name}` has {} and {} values", x.len(), y.len())),
            None => None,
        }
    })
}
