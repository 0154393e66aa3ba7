//! What every method with a canonical cloud shares: the cloud, its schedule and its density control.

use crate::densify::{Adapted, Density, DensityContext};
use crate::method::MethodError;
use crate::scene;
use crate::scene::{CloudConfig, SceneInfo};
use crate::schedule::{Background, Schedule};
use gs_core::{Camera, Cloud, Splats, SplatsGrad};
use gs_raster::ScreenStats;

/// A canonical cloud under training, with the scratch of one step.
#[derive(Debug)]
pub struct Canonical {
    /// The raw Gaussians.
    pub cloud: Cloud,
    /// The plan of the run.
    pub schedule: Schedule,
    /// Growth statistics.
    pub density: Density,
    /// The cloud made drawable, in the present step.
    pub splats: Splats,
    /// The cotangents of `splats`.
    pub d_splats: SplatsGrad,
    extent: f32,
    seed: u64,
    step: u32,
}

impl Canonical {
    /// The initial cloud of a scene.
    ///
    /// # Errors
    /// If the schedule or the initial points cannot be used.
    pub fn new(config: &CloudConfig, mut schedule: Schedule, scene: &SceneInfo) -> Result<Self, MethodError> {
        schedule.check()?;
        config.kernel.hold_back(&mut schedule);
        let cloud = scene::cloud(&scene.points, config)?;
        let density = Density::new(cloud.len());
        let (splats, d_splats) = Default::default();
        Ok(Self { cloud, schedule, density, splats, d_splats, extent: scene.extent, seed: scene.seed, step: 0 })
    }

    /// The step about to be made.
    pub fn set_step(&mut self, step: u32) {
        self.step = step;
    }

    /// The step about to be made.
    pub fn step(&self) -> u32 {
        self.step
    }

    /// The seed of the run.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Whether the field takes part in the present step.
    pub fn dynamic(&self) -> bool {
        self.schedule.dynamic(self.step)
    }

    /// The canonical splats, colours up to the SH degree of the present step.
    pub fn activated(&self) -> Splats {
        let mut splats = Splats::default();
        self.cloud.activate(self.sh_degree(), &mut splats);
        splats
    }

    /// Makes [`Self::splats`] of the present parameters, and [`Self::d_splats`] zero.
    pub fn forward(&mut self) {
        let degree = self.sh_degree();
        self.cloud.activate(degree, &mut self.splats);
        self.d_splats.reset(&self.splats);
    }

    /// Pulls [`Self::d_splats`] into the gradients of the cloud.
    pub fn backward(&mut self) {
        self.cloud.activate_backward(&self.splats, &self.d_splats);
    }

    /// Adds what a view of the present step has seen to the growth statistics.
    pub fn observe(&mut self, seen: &ScreenStats, camera: &Camera) {
        if self.grows(self.step) {
            self.density.observe(seen, camera.width, camera.height);
        }
    }

    /// Clones, splits, prunes and resets when the schedule says so. Before a stage with a clock of its own the growth
    /// statistics begin anew.
    pub fn adapt(&mut self, step: u32) -> Adapted {
        let adapted = self.adapt_cloud(step);
        if self.schedule.position(step + 1).fresh {
            self.density.clear(self.cloud.len());
        }
        adapted
    }

    fn adapt_cloud(&mut self, step: u32) -> Adapted {
        if !self.grows(step) {
            return Adapted::default();
        }
        let rules = &self.schedule.density;
        let at = DensityContext {
            step,
            clock: self.schedule.position(step).clock,
            extent: self.extent,
            seed: self.seed,
            white: self.schedule.background == Background::White,
        };
        self.density.adapt(rules, &at, &mut self.cloud)
    }

    /// Whether density control acts in a step.
    fn grows(&self, step: u32) -> bool {
        self.schedule.position(step).clock < self.schedule.density.until && !self.schedule.field_alone(step)
    }

    fn sh_degree(&self) -> u8 {
        self.schedule.sh_degree(self.step, self.cloud.sh_degree())
    }
}
