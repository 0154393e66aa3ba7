//! 3D Gaussian Splatting without time (Kerbl et al. 2023): the canonical cloud is the scene.

use gs_core::{Camera, Param, Params, Splats, SplatsGrad};
use gs_raster::ScreenStats;
use gs_train::canonical::Canonical;
use gs_train::densify::Adapted;
use gs_train::kernel::kernel_quantities;
use gs_train::method::{Column, ColumnMut, Method, MethodEntry, MethodError, Quantity, parse_config};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use gs_train::timestamp::Moment;
use serde::{Deserialize, Serialize};

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "static3d",
    about: "3D Gaussian Splatting: one cloud for all times (Kerbl et al. 2023)",
    defaults: include_str!("static3d.toml"),
    presets: &[
        ("paper", ""),
        ("fast", include_str!("static3d.fast.toml")),
        ("tiny", include_str!("static3d.tiny.toml")),
    ],
    needs_avatar: false,
    build,
};

/// The configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticConfig {
    /// Where the first points come from.
    pub init: InitConfig,
    /// The cloud.
    pub cloud: CloudConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

struct Static3d {
    canonical: Canonical,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Box<dyn Method>, MethodError> {
    let config: StaticConfig = parse_config(ENTRY.name, table)?;
    Ok(Box::new(Static3d { canonical: Canonical::new(&config.cloud, config.schedule, scene)? }))
}

impl Params for Static3d {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.canonical.cloud.visit(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.canonical.cloud.visit_mut(f);
    }
}

impl Method for Static3d {
    fn name(&self) -> &'static str {
        ENTRY.name
    }

    fn schedule(&self) -> &Schedule {
        &self.canonical.schedule
    }

    fn set_step(&mut self, step: u32) {
        self.canonical.set_step(step);
    }

    fn splats(&self, _at: &Moment, _camera: &Camera) -> Splats {
        self.canonical.activated()
    }

    fn step(&mut self, _at: &Moment, _camera: &Camera, draw: &mut dyn FnMut(&Splats, &mut SplatsGrad)) {
        self.canonical.forward();
        draw(&self.canonical.splats, &mut self.canonical.d_splats);
        self.canonical.backward();
    }

    fn observe(&mut self, _at: &Moment, seen: &ScreenStats, camera: &Camera) {
        self.canonical.observe(seen, camera);
    }

    fn adapt(&mut self, step: u32) -> Adapted {
        self.canonical.adapt(step)
    }

    fn quantities(&self, _at: &Moment) -> Vec<Quantity> {
        kernel_quantities(&self.canonical.activated().kernel)
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
