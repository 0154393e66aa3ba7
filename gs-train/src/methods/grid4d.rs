//! Grid4D (Xu et al. 2024): a canonical cloud moved by hash grids over space and over space and time. The common body of
//! [`fags`](super::fags), which adds a Fourier branch, a gate, a bent kernel and a loss on spectra, and of
//! [`drk`](super::drk), which adds another kernel: one structure of settings, one way to build.

use crate::methods::ablate::{Ablations, GRID4D};
use crate::methods::canonical::Canonical;
use crate::methods::deformed::Deformed;
use crate::methods::scene::{CloudConfig, InitConfig, SceneInfo};
use crate::methods::{Method, MethodEntry, MethodError, parse_config};
use crate::schedule::Schedule;
use gs_deform::field::anneal::Anneal;
use gs_deform::field::{Grid4dConfig, Grid4dField};
use serde::{Deserialize, Serialize};

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "grid4d",
    about: "Grid4D: a cloud moved by hash grids over space and time (Xu et al. 2024)",
    defaults: concat!(include_str!("grid4d.parts.toml"), include_str!("grid4d.toml")),
    presets: PRESETS,
    needs_avatar: false,
    build,
};

/// Presets of everything on this body: none of them touches what tells the methods apart.
pub(super) const PRESETS: &[(&str, &str)] = &[
    ("paper", ""),
    ("fast", include_str!("grid4d.fast.toml")),
    ("tiny", include_str!("grid4d.tiny.toml")),
    ("hypernerf", include_str!("grid4d.hypernerf.toml")),
    ("neu3d", include_str!("grid4d.neu3d.toml")),
];

/// Where `field.bound` is 0, half the side of the cube is the largest coordinate of a first point times this.
const ROOM: f32 = 1.2;

/// The configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Parts to leave out, for comparison.
    pub ablate: Ablations,
    /// The field's smoothness counts from this step of the run.
    pub smooth_from: u32,
    /// Where the first points come from.
    pub init: InitConfig,
    /// The cloud.
    pub cloud: CloudConfig,
    /// The field; a `bound` of 0 is replaced by one that holds the first points.
    pub field: Grid4dConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Box<dyn Method>, MethodError> {
    build_as(ENTRY.name, table, scene)
}

/// Builds whatever the configuration says, under the name of one of the methods on this body.
pub(super) fn build_as(
    name: &'static str,
    table: &toml::Table,
    scene: &SceneInfo,
) -> Result<Box<dyn Method>, MethodError> {
    let mut config: Config = parse_config(name, table)?;
    let wrong = |why: String| MethodError::Config { method: name, why };
    config.ablate.clone().apply(GRID4D, &mut config).map_err(wrong)?;
    if config.field.bound == 0.0 {
        config.field.bound =
            ROOM * scene.bounds.map(|corner| corner.abs().max_element()).into_iter().fold(0.0, f32::max);
    }
    let field = Grid4dField::new(&config.field, scene.seed).map_err(|e| wrong(e.to_string()))?;
    let canonical = Canonical::new(&config.cloud, config.schedule, scene)?;
    let still = Anneal { strength: 0.0, ..Anneal::default() };
    let method = Deformed::new(name, canonical, field, still, scene.views);
    Ok(Box::new(method.regularised_from(config.smooth_from)))
}
