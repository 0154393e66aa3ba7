//! 3D Gaussian Splatting without time (Kerbl et al. 2023): the canonical cloud is the scene.

use gs_core::{Camera, Param, Params, Splats};
use gs_train::canonical::Canonical;
use gs_train::capabilities::{Capabilities, Inspect, Quantity};
use gs_train::kernel::kernel_quantities;
use gs_train::layers::{BASE, CLOUD, CLOUD_FAST, CLOUD_TINY};
use gs_train::method::{
    Buffer, BufferMut, Buffers, LossValue, Method, MethodError, MovedCloud, RenderView, StepEvents, ViewCtx,
};
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, parse_config};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use gs_train::step::StepCtx;
use gs_train::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "static3d",
    about: "3D Gaussian Splatting: one cloud for all times (Kerbl et al. 2023)",
    defaults: &[BASE, CLOUD, include_str!("static3d.toml")],
    presets: &[
        ("paper", &[]),
        ("fast", &[CLOUD_FAST, include_str!("static3d.fast.toml")]),
        ("tiny", &[CLOUD_TINY, include_str!("static3d.tiny.toml")]),
    ],
    domains: &[],
    needs_avatar: false,
    grows: None,
    effective: None,
    build,
};

/// Settings of `static3d`, the sections of its TOML file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticConfig {
    /// Where the first points come from.
    pub init: InitConfig,
    /// The cloud at its beginning.
    pub cloud: CloudConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

struct Static3d {
    canonical: Canonical,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let StaticConfig { cloud, mut schedule, .. } = parse_config(ENTRY.name, table)?;
    let canonical = Canonical::new(&cloud, &mut schedule, scene)?;
    Model::new(ENTRY.name, Static3d { canonical }, schedule)
}

impl Params for Static3d {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.canonical.cloud.visit(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.canonical.cloud.visit_mut(f);
    }
}

impl Buffers for Static3d {
    fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        self.canonical.buffers(f);
    }

    fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        self.canonical.buffers_mut(f);
    }
}

impl Method for Static3d {
    fn begin_step(&mut self, at: &StepCtx) {
        self.canonical.begin_step(at);
    }

    fn splats(&self, _at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
        Ok(self.canonical.activated())
    }

    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        self.canonical.forward();
        let stats = render.render(self.canonical.splats.view(), &mut self.canonical.d_splats)?;
        self.canonical.backward();
        self.canonical.accumulate(stats, view.camera);
        Ok(Vec::new())
    }

    fn needs_whole_rows(&self) -> bool {
        self.canonical.needs_whole_rows()
    }

    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        Ok(StepEvents { densified: self.canonical.densify()?, log: Vec::new() })
    }

    fn moved_cloud(&self, view: &ViewCtx<'_>) -> Result<MovedCloud<'_>, &'static str> {
        Ok(self.canonical.moved_by(None, view.at.t))
    }

    fn splat_count(&self) -> usize {
        self.canonical.cloud.len()
    }

    fn capabilities(&self) -> Capabilities<'_> {
        Capabilities { inspect: Some(self), growth: Some(self.canonical.growth()), ..Capabilities::default() }
    }
}

impl Inspect for Static3d {
    fn quantities(&self, _at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        Ok(kernel_quantities(&self.canonical.activated().kernel))
    }
}
