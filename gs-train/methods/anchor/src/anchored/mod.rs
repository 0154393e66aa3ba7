//! Anchors decoded as a camera sees them, and moved in two stages: the common body of Scaffold-GS and MoDec-GS.
//!
//! ```text
//! anchors → GAD(t_c) → local anchors → visible → decode → LGD(t) → splats at t → draw
//! ```
//! and back the same way. `t_c` is the canonical time of the interval that holds `t`. A scene at rest, and every stage that
//! is not dynamic, has neither GAD nor LGD. What a camera cannot see is not decoded; the picture is the same.

mod drawing;
mod forward;
mod motion;
mod rest;

pub use forward::{Filter, Statistics};
pub use motion::{Motion, SparsityConfig};

use drawing::Cache;
use forward::Tape;
use gs_anchor::{
    Adapt, AdaptAt, AdaptRules, AnchorInit, AnchorShape, AnchorView, Anchors, Decoder, DecoderConfig, Intervals,
    StorageSizes, StorageTable,
};
use gs_core::{Camera, Param, Params, Splats, SplatsGrad};
use gs_raster::ScreenStats;
use gs_train::densify::Adapted;
use gs_train::method::{
    Column, ColumnMut, Growth, Method, MethodError, Overlay, Quantity, RestOptions, RestReport, SceneInfo, StageView,
};
use gs_train::palette::label_color;
use gs_train::schedule::Schedule;
use gs_train::timestamp::Moment;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Settings of the anchors and their decoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorConfig {
    /// Side of the cells the first anchors stand on, world units; 0: the median squared distance of neighbours.
    pub voxel: f32,
    /// Every so many points are used.
    pub stride: u32,
    /// Gaussians per anchor, `k`.
    pub offsets: usize,
    /// Width of the feature, `C`.
    pub features: usize,
    /// Which anchors are decoded.
    pub filter: Filter,
    /// Which views of a batch are observed for growth and intervals.
    pub statistics: Statistics,
    /// Growth thresholds are for gradients of a mean loss over so many views.
    pub gradient_batch: u32,
}

/// What a body is built from.
pub struct Parts {
    /// Name of the method.
    pub name: &'static str,
    /// The plan of the run.
    pub schedule: Schedule,
    /// Anchors.
    pub anchors: AnchorConfig,
    /// Decoder.
    pub decoder: DecoderConfig,
    /// Growth and pruning.
    pub adapt: AdaptRules,
    /// Logits of motion per anchor, 0 to 2.
    pub dynamics: usize,
    /// What moves.
    pub motion: Motion,
    /// Penalty on the logits of motion.
    pub sparsity: Option<SparsityConfig>,
}

/// Anchors under training.
pub struct Anchored {
    name: &'static str,
    schedule: Schedule,
    config: AnchorConfig,
    rules: AdaptRules,
    sparsity: Option<SparsityConfig>,
    anchors: Anchors,
    decoder: Decoder,
    motion: Motion,
    adapt: Adapt,
    /// Side of the first cells, one value: growth needs the same in a run that is taken up again.
    voxel: Vec<f32>,
    /// Farthest any splat has been moved or grown by LGD, world units, one value.
    reach: Vec<f32>,
    diagonal: f32,
    seed: u64,
    /// Training views: public code stores a row of appearance for each.
    cameras: u32,
    step: u32,
    /// Views of the present step that were drawn.
    drawn: u32,
    tape: Tape,
    cache: Cache,
    told: Vec<Value>,
}

impl Anchored {
    /// The first anchors of a scene.
    ///
    /// # Errors
    /// If the schedule, a setting or the first points cannot be used.
    pub fn new(parts: Parts, scene: &SceneInfo) -> Result<Self, MethodError> {
        parts.schedule.check()?;
        let wrong = |why: String| MethodError::Config { method: parts.name, why };
        let AnchorConfig { voxel, stride, offsets, features, .. } = parts.anchors;
        if parts.anchors.gradient_batch == 0 {
            return Err(wrong("anchors.gradient_batch = 0: at least 1 view".into()));
        }
        parts.adapt.check().map_err(|e| wrong(format!("adapt: {e}")))?;
        let shape = AnchorShape { offsets, features, dynamics: parts.dynamics };
        let decoder = Decoder::new(&parts.decoder, shape, scene.seed).map_err(|e| wrong(e.to_string()))?;
        let init = AnchorInit { voxel, stride, max_anchors: parts.adapt.max_anchors };
        let first = gs_anchor::anchors_from_points(&scene.points.positions, shape, &init)
            .map_err(|e| MethodError::Scene(e.to_string()))?;
        Ok(Self {
            name: parts.name,
            schedule: parts.schedule,
            config: parts.anchors,
            rules: parts.adapt,
            sparsity: parts.sparsity,
            adapt: Adapt::new(&first.anchors),
            anchors: first.anchors,
            decoder,
            motion: parts.motion,
            voxel: vec![first.voxel],
            reach: vec![0.0],
            diagonal: scene.bounds[0].distance(scene.bounds[1]),
            seed: scene.seed,
            cameras: scene.views,
            step: 0,
            drawn: 0,
            tape: Tape::default(),
            cache: Cache::default(),
            told: Vec::new(),
        })
    }

    /// The same state with scratch of its own.
    fn copy(&self) -> Self {
        Self {
            schedule: self.schedule.clone(),
            config: self.config.clone(),
            rules: self.rules.clone(),
            anchors: self.anchors.clone(),
            decoder: self.decoder.clone(),
            motion: self.motion.clone(),
            adapt: self.adapt.clone(),
            voxel: self.voxel.clone(),
            reach: self.reach.clone(),
            tape: Tape::default(),
            cache: Cache::default(),
            told: Vec::new(),
            ..*self
        }
    }

    fn dynamic(&self) -> bool {
        self.schedule.dynamic(self.step)
    }

    fn clock(&self) -> u32 {
        self.schedule.position(self.step).clock
    }

    /// Views observed per step.
    fn observed(&self) -> u32 {
        match self.config.statistics {
            Statistics::All => self.schedule.batch,
            Statistics::Last => 1,
        }
    }

    fn grow(&mut self, step: u32) -> Adapted {
        let at = AdaptAt {
            step,
            clock: self.clock(),
            seed: self.seed,
            voxel: self.voxel[0],
            diagonal: self.diagonal,
            views_per_step: self.observed(),
        };
        let grown = match self.adapt.adapt(&self.rules, &at, &mut self.anchors) {
            Ok(grown) => grown,
            // Statistics and anchors are edited together.
            Err(e) => unreachable!("{e}"),
        };
        if grown.added + grown.pruned > 0 {
            self.told.push(json!({"step": step, "anchors": self.anchors.len(), "grown": &grown}));
        }
        Adapted { cloned: grown.added, pruned: grown.pruned, ..Adapted::default() }
    }

    fn move_boundaries(&mut self, step: u32) {
        let clock = self.clock();
        let Some(intervals) = self.motion.intervals.as_mut() else { return };
        if let Some(adjustment) = intervals.adjust(clock, step) {
            self.told.push(json!({"step": step, "starts": intervals.starts.value, "intervals": adjustment}));
        }
    }
}

impl Params for Anchored {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.anchors.visit(f);
        self.decoder.visit(f);
        self.motion.visit(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.cache.forget();
        self.anchors.visit_mut(f);
        self.decoder.visit_mut(f);
        self.motion.visit_mut(f);
    }
}

impl Method for Anchored {
    fn name(&self) -> &'static str {
        self.name
    }

    fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    fn set_step(&mut self, step: u32) {
        self.step = step;
        self.drawn = 0;
        self.cache.forget();
    }

    fn splats(&self, at: &Moment, camera: &Camera) -> Splats {
        self.seen_by(at.t, camera)
    }

    fn step(&mut self, at: &Moment, camera: &Camera, draw: &mut dyn FnMut(&Splats, &mut SplatsGrad)) {
        self.forward(at.t, camera);
        let tape = &mut self.tape;
        tape.d_splats.reset(&tape.splats);
        draw(&tape.splats, &mut tape.d_splats);
        self.backward();
    }

    fn penalties(&mut self, step: u32) -> Vec<(&'static str, f32)> {
        if !self.schedule.dynamic(step) {
            return Vec::new();
        }
        let mut penalties = self.motion.regularise();
        if let Some(SparsityConfig { kind, weight }) = self.sparsity.filter(|s| s.weight > 0.0) {
            penalties.push(("motion", kind.penalise(&mut self.anchors, weight)));
        }
        penalties
    }

    fn observe(&mut self, at: &Moment, seen: &ScreenStats, camera: &Camera) {
        self.drawn += 1;
        if self.config.statistics == Statistics::Last && self.drawn < self.schedule.batch {
            return;
        }
        let clock = self.clock();
        let weight = 1.0 / self.config.gradient_batch as f32;
        if self.rules.observes_at(clock) {
            let decoded = &self.tape.decoded;
            self.adapt.observe(&AnchorView {
                visible: &decoded.visible,
                activations: &decoded.activations,
                rows: &decoded.rows,
                grad_means2d: &seen.grad_means2d,
                radii: &seen.radii,
                width: camera.width,
                height: camera.height,
                weight,
            });
        }
        if self.dynamic() {
            self.motion.observe(clock, at.t, seen, camera);
        }
    }

    fn adapt(&mut self, step: u32) -> Adapted {
        let adapted = self.grow(step);
        if self.schedule.dynamic(step) {
            self.move_boundaries(step);
        }
        if self.schedule.position(step + 1).fresh {
            self.adapt.clear(self.anchors.len());
        }
        self.cache.forget();
        adapted
    }

    fn warnings(&self) -> Vec<String> {
        self.motion.intervals.iter().filter_map(Intervals::warning).collect()
    }

    fn journal(&mut self) -> Vec<Value> {
        std::mem::take(&mut self.told)
    }

    fn stages(&self, at: &Moment, camera: &Camera) -> Vec<StageView> {
        self.staged(at.t, camera)
    }

    fn tracked(&self, at: &Moment, camera: &Camera) -> Splats {
        self.every_splat(at.t, camera)
    }

    /// `global`: whether the anchor moves between intervals; `local`: how much its offsets, feature and scales change;
    /// one value per splat of [`Method::tracked`].
    fn quantities(&self, _at: &Moment) -> Vec<Quantity> {
        let factors = if self.dynamic() { self.motion.factors(&self.anchors) } else { Vec::new() };
        let k = self.config.offsets;
        let spread = |values: Vec<f32>| values.into_iter().flat_map(|v| std::iter::repeat_n(v, k)).collect();
        factors.into_iter().map(|(name, values)| Quantity::share(name, spread(values))).collect()
    }

    /// `anchor`: what belongs together; `interval`: which one the moment lies in, where there are any.
    fn overlays(&self, at: &Moment) -> Vec<Overlay> {
        let of_anchor = (0..self.len() / self.config.offsets).map(|i| label_color(i as u32 + 1));
        let k = self.config.offsets;
        let colors = of_anchor.flat_map(|c| std::iter::repeat_n(c, k)).collect();
        let anchor = Overlay { name: "anchor", colors, meaning: "the Gaussians of an anchor share a colour" };
        let interval = self.motion.intervals.as_ref().filter(|_| self.dynamic()).map(|intervals| {
            let color = label_color(intervals.locate(at.t.normalised) as u32 + 1);
            Overlay {
                name: "interval",
                colors: vec![color; self.len()],
                meaning: "every interval of time has a colour",
            }
        });
        let quantities = self.quantities(at);
        quantities.iter().map(Quantity::overlay).chain([anchor]).chain(interval).collect()
    }

    fn storage(&self) -> Option<StorageTable> {
        Some(StorageTable::of(&StorageSizes {
            anchors: self.anchors.len(),
            shape: self.anchors.shape(),
            decoder: self.decoder.config().clone(),
            global: self.motion.gad.as_ref().map(|gad| gad.config().net.clone()),
            local: self.motion.lgd.as_ref().map(|lgd| lgd.net_config()),
            cameras: self.cameras as usize,
            segments: self.motion.intervals.as_ref().map_or(0, Intervals::len),
        }))
    }

    fn folded(&self, config: &toml::Table) -> Option<(toml::Table, Box<dyn Method>)> {
        let mut config = config.clone();
        config.get_mut("decoder")?.as_table_mut()?.insert("appearance".into(), 0.into());
        let folded = Self { decoder: self.decoder.folded(), ..self.copy() };
        Some((config, Box::new(folded)))
    }

    fn resting(&self, options: &RestOptions<'_>) -> Option<(Box<dyn Method>, RestReport)> {
        let (rest, report) = self.rest(options)?;
        Some((Box::new(Self { cache: Cache::resting(rest), ..self.copy() }), report))
    }

    fn lattice(&self) -> Option<(&'static str, f32)> {
        Some(("anchors.positions", self.voxel[0]))
    }

    fn columns(&self) -> Vec<Column<'_>> {
        let rows = self.adapt.columns().map(|(name, width, values)| Column { name, row_width: Some(width), values });
        let fixed = |(name, values)| Column { name, row_width: None, values };
        let intervals = self.motion.intervals.iter().flat_map(|i| i.columns());
        let own = [("anchors.voxel", &self.voxel), ("anchors.reach", &self.reach)];
        rows.into_iter().chain(own.into_iter().chain(intervals).map(fixed)).collect()
    }

    fn columns_mut(&mut self) -> Vec<ColumnMut<'_>> {
        let rows =
            self.adapt.columns_mut().map(|(name, width, values)| ColumnMut { name, row_width: Some(width), values });
        let fixed = |(name, values)| ColumnMut { name, row_width: None, values };
        let intervals = self.motion.intervals.iter_mut().flat_map(|i| i.columns_mut());
        let own = [("anchors.voxel", &mut self.voxel), ("anchors.reach", &mut self.reach)];
        rows.into_iter().chain(own.into_iter().chain(intervals).map(fixed)).collect()
    }

    fn len(&self) -> usize {
        self.anchors.len() * self.config.offsets
    }

    fn growth(&self) -> Option<Growth> {
        let AdaptRules { from, until, max_anchors, .. } = self.rules;
        Some(Growth { most: max_anchors as usize * self.config.offsets, from, until })
    }
}
