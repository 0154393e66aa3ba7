//! The cloud of Gaussians that several methods share, with its densification.

use crate::densify::{Densify, DensifyContext, DensifyRules, DensifyStats, GaussianRows, GrowthLimits};
use crate::method::{Buffer, BufferMut, MethodError, MovedCloud};
use crate::scene::{self, CloudConfig, SceneInfo};
use crate::schedule::{Background, Schedule};
use crate::step::StepCtx;
use gs_core::param::RowEditError;
use gs_core::{Camera, Cloud, Param, RowEdit, Splats, SplatsGrad, Time};
use gs_raster::ScreenStats;
use std::any::Any;

/// A canonical cloud under training, with the scratch of one step.
#[derive(Clone, Debug)]
pub struct Canonical {
    /// The raw Gaussians.
    pub cloud: Cloud,
    /// Statistics of densification, one row per Gaussian.
    pub densify: Densify,
    /// The activated cloud in the present step.
    pub splats: Splats,
    /// The cotangents of `splats`.
    pub d_splats: SplatsGrad,
    /// The present step.
    pub at: StepCtx,
    /// Whether `splats` are not yet those of the present parameters.
    stale: bool,
    rules: DensifyRules,
    white: bool,
    extent: f32,
    seed: u64,
}

impl Canonical {
    /// The initial cloud of a scene. Kernel parameters that do not learn, or not yet, are held back in `schedule`.
    ///
    /// # Errors
    /// If the initial points cannot be used.
    pub fn new(config: &CloudConfig, schedule: &mut Schedule, scene: &SceneInfo) -> Result<Self, MethodError> {
        schedule.check()?;
        config.kernel.hold_back(&mut schedule.lr);
        let (points, most) = (scene.points.positions.len(), schedule.density.max_splats);
        if points > most as usize {
            let why =
                format!("{points} initial points (init.points) are more than schedule.density.max_splats = {most}");
            return Err(MethodError::Scene(why));
        }
        let cloud = scene::cloud(&scene.points, config)?;
        let densify = Densify::new(cloud.len());
        let (splats, d_splats, at) = Default::default();
        let stale = true;
        let (rules, white) = (schedule.density.clone(), schedule.background == Background::White);
        Ok(Self { cloud, densify, splats, d_splats, at, stale, rules, white, extent: scene.extent, seed: scene.seed })
    }

    /// The seed of the run.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The canonical splats, colours up to the SH degree of the present step.
    pub fn activated(&self) -> Splats {
        let mut splats = Splats::default();
        self.cloud.activate(self.sh_degree(), &mut splats);
        splats
    }

    /// A step is about to be made, or was the last one made: [`Self::splats`] are of earlier parameters.
    pub fn begin_step(&mut self, at: &StepCtx) {
        self.at = at.clone();
        self.stale = true;
    }

    /// Activates the present parameters into [`Self::splats`], once for all views of a step.
    pub fn forward(&mut self) {
        if std::mem::take(&mut self.stale) {
            let degree = self.sh_degree();
            self.cloud.activate(degree, &mut self.splats);
        }
    }

    /// Pulls [`Self::d_splats`] into the gradients of the cloud.
    pub fn backward(&mut self) {
        self.cloud.activate_backward(&self.splats, &self.d_splats);
    }

    /// Adds the screen statistics of a view of the present step.
    pub fn accumulate(&mut self, stats: &ScreenStats, camera: &Camera) {
        if self.densifies() {
            self.densify.accumulate(stats, camera.width, camera.height);
        }
    }

    /// Clones, splits, prunes and resets when the rules say so. Before a stage with a clock of its own the statistics are
    /// cleared.
    ///
    /// # Errors
    /// If the blocks of the cloud do not have the same rows.
    pub fn densify(&mut self) -> Result<DensifyStats, RowEditError> {
        self.densify_with(&mut [], &mut [])
    }

    /// The same for a method with row blocks, or columns of given width, of its own beside the cloud: all are edited together. In a
    /// block, a copy or child takes over the values of its parent; in a column it finds zeros.
    ///
    /// # Errors
    /// If a block has no rows, or fewer than the cloud.
    pub fn densify_with(
        &mut self,
        blocks: &mut [&mut Param],
        columns: &mut [(&mut Vec<f32>, usize)],
    ) -> Result<DensifyStats, RowEditError> {
        let mut stats = DensifyStats::default();
        if self.edits() {
            let at = DensifyContext {
                step: self.at.step,
                clock: self.at.clock,
                extent: self.extent,
                seed: self.seed,
                white: self.white,
            };
            let mut rows = CloudAnd { cloud: &mut self.cloud, blocks, columns };
            stats = self.densify.densify(&self.rules, &at, &mut rows)?;
        }
        if self.at.ends_clock {
            self.densify.clear(self.cloud.len());
        }
        Ok(stats)
    }

    /// The step begun, moved by a field as it is at `time` ([`Method::moved_cloud`](crate::method::Method::moved_cloud)).
    pub fn moved_by<'a>(&'a self, field: Option<&'a dyn Any>, time: Time) -> MovedCloud<'a> {
        let Self { at, cloud, .. } = self;
        let resets = self.edits() && self.rules.resets_at(at.clock, self.white);
        let edits = self.needs_whole_rows() || resets || at.ends_clock;
        let moves = at.dynamic && field.is_some();
        let (sh_degree, counts, keeps_sizes) = (self.sh_degree(), self.densifies(), at.deform_only);
        MovedCloud { cloud, sh_degree, field, moves, keeps_sizes, time, counts, edits }
    }

    /// Whether a block takes part in the step begun: what moves the cloud does not while it stands still, and what changes sizes does
    /// not while they are kept ([`StepCtx::keep_sizes`]): Adam would count steps without a gradient.
    pub fn takes_part(&self, parameter: &str) -> bool {
        let learns = self.at.dynamic || parameter.starts_with("cloud.");
        learns && !(self.at.deform_only && parameter.starts_with("field.scales."))
    }

    /// The rules of densification.
    pub fn rules(&self) -> &DensifyRules {
        &self.rules
    }

    /// The bounds of densification.
    pub fn growth(&self) -> GrowthLimits {
        self.rules.growth()
    }

    /// Whether [`Self::densify`] is going to read the statistics or edit rows.
    pub fn needs_whole_rows(&self) -> bool {
        self.edits() && self.rules.grows_at(self.at.clock)
    }

    /// The statistics of densification, for checkpoints.
    pub fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        let buffer = |(name, merge, values)| Buffer { name, row_width: Some(1), merge, values };
        self.densify.columns().into_iter().for_each(|column| f(buffer(column)));
    }

    /// The same, to be restored.
    pub fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        let buffer = |(name, merge, values)| BufferMut { name, row_width: Some(1), merge, values };
        self.densify.columns_mut().into_iter().for_each(|column| f(buffer(column)));
    }

    /// Whether the rules may edit rows in the present step.
    fn edits(&self) -> bool {
        self.rules.edits_at(self.at.clock, self.at.deform_only, self.at.ends_stage)
    }

    fn densifies(&self) -> bool {
        self.at.clock < self.rules.until && !self.at.deform_only
    }

    fn sh_degree(&self) -> u8 {
        self.at.sh_degree.min(self.cloud.sh_degree())
    }
}

/// A cloud and other row blocks of the same Gaussians.
struct CloudAnd<'a, 'b, 'c> {
    cloud: &'a mut Cloud,
    blocks: &'a mut [&'b mut Param],
    columns: &'a mut [(&'c mut Vec<f32>, usize)],
}

impl GaussianRows for CloudAnd<'_, '_, '_> {
    fn cloud(&self) -> &Cloud {
        self.cloud
    }

    fn cloud_mut(&mut self) -> &mut Cloud {
        self.cloud
    }

    fn edit(&mut self, edit: &RowEdit) -> Result<(), RowEditError> {
        let mut all = self.cloud.blocks_mut();
        all.extend(self.blocks.iter_mut().map(|p| &mut **p));
        edit.apply(&mut all)?;
        self.columns.iter_mut().for_each(|(column, width)| **column = edit.apply_to_column(column, *width));
        Ok(())
    }
}
