//! Anchors decoded as a camera sees them, and moved in two stages: the common body of Scaffold-GS and MoDec-GS.
//!
//! ```text
//! anchors → GAD(t_c) → local anchors → visible → decode → LGD(t) → splats at t → draw
//! ```
//! and back the same way. `t_c` is the canonical time of the interval that holds `t`, or local anchors of several such times are
//! blended. A scene at rest, and every stage that
//! is not dynamic, has neither GAD nor LGD. What a camera cannot see is not decoded; the image is the same.

mod forward;
mod inference;
mod key_frames;
mod motion;
mod rest;

pub use forward::{Filter, Statistics};
pub use motion::{Motion, Query, SparsityConfig};

use crate::journal::Journal;
use forward::Tape;
use gs_anchor::{
    AnchorDensify, AnchorDensifyRules, AnchorDensifyStep, AnchorInit, AnchorShape, AnchorView, Anchors, Decoder,
    DecoderConfig, Gad, GadHead, HeadInputs, Intervals, Lgd, StorageSizes, StorageTable,
};
use gs_core::{Camera, Param, Params, Splats, cast};
use gs_raster::ScreenStats;
use gs_train::capabilities::{
    Bake, Capabilities, FreezeOptions, FreezeReport, Inspect, Overlay, PaperStorage, PaperStorageRow, Quantity,
    StageView,
};
use gs_train::densify::{DensifyStats, GrowthLimits};
use gs_train::method::{
    Buffer, BufferMut, Buffers, LossValue, Merge, Method, MethodError, RenderView, StepEvents, ViewCtx,
};
use gs_train::palette::label_color;
use gs_train::report::Section;
use gs_train::scene::SceneInfo;
use gs_train::step::StepCtx;
use gs_train::timestamp::Timestamp;
use inference::Cache;
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
    /// Gaussians `k` that every anchor decodes to.
    pub offsets: usize,
    /// Width of the feature, `C`.
    pub features: usize,
    /// Which anchors are decoded for a frame.
    pub filter: Filter,
    /// Which views of a batch are observed for growth and intervals.
    pub statistics: Statistics,
    /// Growth thresholds are for gradients of a mean loss over so many views.
    pub gradient_batch: u32,
    /// Degrees. Heads of opacity and covariance take the direction only where training cameras are nearer than this to each other
    /// ([`SceneInfo::view_spacing`]): from far between they learn each view by heart. 180: always, as published.
    pub direction_within: f32,
}

impl AnchorConfig {
    /// The decoder's settings for the cameras of a scene.
    pub(super) fn decoder(&self, config: DecoderConfig, scene: &SceneInfo) -> DecoderConfig {
        if scene.view_spacing <= self.direction_within {
            return config;
        }
        let direction = HeadInputs { color: config.direction.color, ..HeadInputs::NONE };
        DecoderConfig { direction, ..config }
    }
}

/// What a body is built from.
pub struct Parts {
    /// Name of the method, for errors.
    pub name: &'static str,
    /// Settings of the anchors and of their statistics.
    pub anchors: AnchorConfig,
    /// Settings of the networks from anchors to Gaussians.
    pub decoder: DecoderConfig,
    /// Thresholds and steps of growth and pruning.
    pub adapt: AnchorDensifyRules,
    /// Logits of motion per anchor, 0 to 2.
    pub dynamics: usize,
    /// What moves, anchors and Gaussians, and by which networks.
    pub motion: Motion,
    /// Penalty on the logits of motion.
    pub sparsity: Option<SparsityConfig>,
    /// What rendering adds to the diagonal of projected covariances, pixels²: that of the schedule.
    pub dilation: f64,
}

/// The body of both methods: anchors, decoder and motion under training.
pub struct Anchored {
    config: AnchorConfig,
    rules: AnchorDensifyRules,
    sparsity: Option<SparsityConfig>,
    anchors: Anchors,
    decoder: Decoder,
    motion: Motion,
    adapt: AnchorDensify,
    /// Side of the first cells, one value: growth needs the same in a run that is taken up again.
    voxel: Vec<f32>,
    /// Farthest any splat has been moved or grown by LGD, world units, one value.
    reach: Vec<f32>,
    diagonal: f32,
    seed: u64,
    dilation: f64,
    /// Training views: public code stores a row of appearance for each.
    cameras: u32,
    at: StepCtx,
    tape: Tape,
    cache: Cache,
    events: Vec<Value>,
}

impl Anchored {
    /// The first anchors of a scene.
    ///
    /// # Errors
    /// If a setting or the first points cannot be used.
    pub fn new(parts: Parts, scene: &SceneInfo) -> Result<Self, MethodError> {
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
            config: parts.anchors,
            rules: parts.adapt,
            sparsity: parts.sparsity,
            adapt: AnchorDensify::new(&first.anchors),
            anchors: first.anchors,
            decoder,
            motion: parts.motion,
            voxel: vec![first.voxel],
            reach: vec![0.0],
            diagonal: scene.bounds[0].distance(scene.bounds[1]),
            seed: scene.seed,
            dilation: parts.dilation,
            cameras: scene.views,
            at: StepCtx::default(),
            tape: Tape::default(),
            cache: Cache::default(),
            events: Vec::new(),
        })
    }

    /// The same state with scratch of its own.
    fn copy(&self) -> Self {
        Self {
            config: self.config.clone(),
            rules: self.rules.clone(),
            anchors: self.anchors.clone(),
            decoder: self.decoder.clone(),
            motion: self.motion.clone(),
            adapt: self.adapt.clone(),
            voxel: self.voxel.clone(),
            reach: self.reach.clone(),
            at: self.at.clone(),
            tape: Tape::default(),
            cache: Cache::default(),
            events: Vec::new(),
            ..*self
        }
    }

    fn dynamic(&self) -> bool {
        self.at.dynamic
    }

    /// Views observed per step.
    fn observed(&self) -> u32 {
        match self.config.statistics {
            Statistics::All => self.at.batch,
            Statistics::Last => 1,
        }
    }

    fn grow(&mut self) -> DensifyStats {
        let step = self.at.step;
        let at = AnchorDensifyStep {
            step,
            clock: self.at.clock,
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
            self.events.push(json!({"step": step, "anchors": self.anchors.len(), "grown": &grown}));
        }
        DensifyStats { cloned: grown.added, pruned: grown.pruned, ..DensifyStats::default() }
    }

    fn move_boundaries(&mut self) {
        let step = self.at.step;
        let clock = self.at.clock;
        let Some(intervals) = self.motion.intervals.as_mut() else { return };
        if let Some(adjustment) = intervals.adjust(clock, step) {
            self.events.push(json!({"step": step, "starts": intervals.starts.value, "intervals": adjustment}));
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
        self.anchors.visit_mut(f);
        self.decoder.visit_mut(f);
        self.motion.visit_mut(f);
    }
}

impl Buffers for Anchored {
    fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        let rows = self.adapt.columns();
        let of_rows = |(name, width, values)| Buffer { name, row_width: Some(width), merge: Merge::Sum, values };
        rows.into_iter().for_each(|column| f(of_rows(column)));
        let intervals = self.motion.intervals.iter().flat_map(|i| i.columns());
        let own = [("anchors.voxel", Merge::Keep, &self.voxel), ("anchors.reach", Merge::Max, &self.reach)];
        let all = own.into_iter().chain(intervals.map(|(name, values)| (name, Merge::Sum, values)));
        all.for_each(|(name, merge, values)| f(Buffer { name, row_width: None, merge, values }));
    }

    fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        let rows = self.adapt.columns_mut();
        let of_rows = |(name, width, values)| BufferMut { name, row_width: Some(width), merge: Merge::Sum, values };
        rows.into_iter().for_each(|column| f(of_rows(column)));
        let intervals = self.motion.intervals.iter_mut().flat_map(|i| i.columns_mut());
        let own = [("anchors.voxel", Merge::Keep, &mut self.voxel), ("anchors.reach", Merge::Max, &mut self.reach)];
        let all = own.into_iter().chain(intervals.map(|(name, values)| (name, Merge::Sum, values)));
        all.for_each(|(name, merge, values)| f(BufferMut { name, row_width: None, merge, values }));
    }
}

/// How the names of blocks begin that take part only where anchors move.
const MOTION: [&str; 4] = ["gad.", "lgd.", "intervals.", "anchors.dynamics"];

impl Method for Anchored {
    fn begin_step(&mut self, at: &StepCtx) {
        self.at = at.clone();
        self.cache.forget();
    }

    fn splats(&self, at: &Timestamp, camera: &Camera) -> Result<Splats, MethodError> {
        Ok(self.seen_by(at.t, camera))
    }

    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        self.forward(view.at.t, view.camera);
        let (splats, d_splats) = self.tape.rendered();
        let stats = render.render(splats, d_splats)?;
        let penalty = self.backward();
        self.accumulate(view, stats);
        Ok(penalty.into_iter().collect())
    }

    fn regularise(&mut self, last: &Timestamp) -> Vec<LossValue> {
        if !self.at.dynamic {
            return Vec::new();
        }
        let mut terms = self.motion.regularise(&self.anchors, last.t, self.at.step);
        if let Some(SparsityConfig { kind, weight }) = self.sparsity.filter(|s| s.weight > 0.0) {
            terms.push(("motion", kind.penalise(&mut self.anchors, weight)));
        }
        terms
    }

    fn takes_part(&self, parameter: &str) -> bool {
        self.at.dynamic || !MOTION.iter().any(|name| parameter.starts_with(name))
    }

    fn needs_whole_rows(&self) -> bool {
        self.rules.grows_at(self.at.clock)
    }

    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        let densified = self.grow();
        if self.at.dynamic {
            self.move_boundaries();
        }
        if self.at.ends_clock {
            self.adapt.clear(self.anchors.len());
        }
        self.cache.forget();
        Ok(StepEvents { densified, log: std::mem::take(&mut self.events) })
    }

    fn splat_count(&self) -> usize {
        self.anchors.len() * self.config.offsets
    }

    fn capabilities(&self) -> Capabilities<'_> {
        let AnchorDensifyRules { from, until, max_anchors, .. } = self.rules;
        let growth = Some(GrowthLimits { most: max_anchors as usize * self.config.offsets, from, until });
        Capabilities { inspect: Some(self), bake: Some(self), growth, ..Capabilities::default() }
    }
}

impl Anchored {
    /// Statistics of densification and of intervals, from one view.
    fn accumulate(&mut self, view: &ViewCtx<'_>, stats: &ScreenStats) {
        if self.config.statistics == Statistics::Last && !view.last {
            return;
        }
        let (clock, camera) = (self.at.clock, view.camera);
        let weight = 1.0 / self.config.gradient_batch as f32;
        if self.rules.observes_at(clock) {
            let decoded = &self.tape.decoded;
            self.adapt.observe(&AnchorView {
                visible: &decoded.visible,
                activations: &decoded.activations,
                rows: &decoded.rows,
                grad_means2d: &stats.grad_means2d,
                radii: &stats.radii,
                width: camera.width,
                height: camera.height,
                weight,
            });
        }
        if self.at.dynamic {
            self.motion.observe(clock, view.at.t, stats, camera);
        }
    }
}

impl Inspect for Anchored {
    fn all_splats(&self, at: &Timestamp, camera: &Camera) -> Result<Splats, MethodError> {
        Ok(self.every_splat(at.t, camera))
    }

    fn stages(&self, at: &Timestamp, camera: &Camera) -> Result<Vec<StageView>, MethodError> {
        Ok(self.staged(at.t, camera))
    }

    /// `global`: whether the anchor moves between intervals; `local`: how much its offsets, feature and scales change.
    fn quantities(&self, _at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        let factors = if self.at.dynamic { self.motion.factors(&self.anchors) } else { Vec::new() };
        let k = self.config.offsets;
        let spread = |values: Vec<f32>| values.into_iter().flat_map(|v| std::iter::repeat_n(v, k)).collect();
        Ok(factors.into_iter().map(|(name, values)| Quantity::share(name, spread(values))).collect())
    }

    /// `anchor`: Gaussians of one anchor; `interval`: which one the timestamp lies in, where there are any.
    fn overlays(&self, at: &Timestamp) -> Result<Vec<Overlay>, MethodError> {
        let k = self.config.offsets;
        let colors =
            (0..self.anchors.len()).flat_map(|i| std::iter::repeat_n(label_color(cast::to_u32(i) + 1), k)).collect();
        let anchor = Overlay { name: "anchor", colors, meaning: "the Gaussians of an anchor share a colour" };
        let interval = self.motion.intervals.as_ref().filter(|_| self.at.dynamic).map(|intervals| {
            let color = label_color(cast::to_u32(intervals.locate(at.t.normalised)) + 1);
            let colors = vec![color; self.splat_count()];
            Overlay { name: "interval", colors, meaning: "every interval of time has a colour" }
        });
        let quantities = self.quantities(at)?;
        Ok(quantities.iter().map(Quantity::overlay).chain([anchor]).chain(interval).collect())
    }

    fn borders(&self) -> Vec<f32> {
        let intervals = self.motion.intervals.as_ref().filter(|_| self.at.dynamic);
        intervals.map_or_else(Vec::new, |i| i.starts.value[1..].to_vec())
    }

    fn warnings(&self) -> Vec<String> {
        let gad = self.motion.gad.iter().map(Gad::config);
        let idle = gad
            .filter(|c| c.change_l2 > 0.0 && c.heads == [GadHead::Positions])
            .map(|_| "gad.change_l2 has no effect: gad.heads has positions only, which are not penalised".to_owned());
        self.motion.intervals.iter().filter_map(Intervals::warning).chain(idle).collect()
    }

    fn paper_storage(&self) -> Option<PaperStorage> {
        let shape = self.anchors.shape();
        let table = StorageTable::of(&StorageSizes {
            anchors: self.anchors.len(),
            shape,
            decoder: self.decoder.config().clone(),
            global: self.motion.gad.as_ref().map(|gad| (gad.config().net.clone(), gad.config().head_widths(shape))),
            local: self.motion.lgd.as_ref().and_then(|lgd| Some((lgd.net_config()?, lgd.head_widths()))),
            local_hash: self.motion.lgd.as_ref().and_then(Lgd::hash_values),
            cameras: self.cameras as usize,
            segments: self.motion.intervals.as_ref().map_or(0, Intervals::len),
        });
        let row = |r: gs_anchor::storage::StorageRow| PaperStorageRow {
            block: r.block,
            paper_values: r.paper_values,
            needed_values: r.needed_values,
        };
        Some(PaperStorage {
            rows: table.rows.into_iter().map(row).collect(),
            unused: table.leftovers.into_iter().map(|l| (l.block, l.bytes)).collect(),
        })
    }

    fn report_section(&self, events: &[Value]) -> Result<Option<Section>, MethodError> {
        Ok(Journal::of(events).section())
    }
}

impl Bake for Anchored {
    fn fold(&self, config: &toml::Table) -> Option<(toml::Table, Box<dyn Method>)> {
        let mut config = config.clone();
        config.get_mut("decoder")?.as_table_mut()?.insert("appearance".into(), 0.into());
        let folded = Self { decoder: self.decoder.folded(), ..self.copy() };
        Some((config, Box::new(folded)))
    }

    fn freeze_static(&self, options: &FreezeOptions<'_>) -> Option<(Box<dyn Method>, FreezeReport)> {
        let (rest, report) = self.rest(options)?;
        Some((Box::new(Self { cache: Cache::resting(rest), ..self.copy() }), report))
    }

    fn quantization_step(&self) -> Option<(&'static str, f32)> {
        Some(("anchors.positions", self.voxel[0]))
    }
}
