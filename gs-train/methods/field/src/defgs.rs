//! Deformable 3D Gaussians (Yang et al. 2024): a canonical cloud moved by one wide network, after a static warm-up.

use crate::deformed::Deformed;
use gs_deform::field::anneal::Anneal;
use gs_deform::{DefGsConfig, DefMlp};
use gs_train::canonical::Canonical;
use gs_train::layers::{
    BASE, CLOUD, CLOUD_FAST, CLOUD_TINY, DEFORMED, FOLLOW, MOTION_FAST, NETWORK, NETWORK_FAST, NETWORK_TINY, STILL,
};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, parse_config};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use gs_train::still::training::StillConfig;
use serde::{Deserialize, Serialize};

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "defgs",
    about: "Deformable 3D Gaussians: a cloud moved by a network of place and time (Yang et al. 2024)",
    defaults: &[BASE, CLOUD, STILL, DEFORMED, FOLLOW, NETWORK, include_str!("defgs.toml")],
    presets: &[
        ("paper", &[]),
        ("hypernerf", &[include_str!("defgs.hypernerf.toml")]),
        ("fast", &[CLOUD_FAST, NETWORK_FAST, MOTION_FAST, include_str!("defgs.fast.toml")]),
        ("tiny", &[CLOUD_TINY, NETWORK_TINY, include_str!("defgs.tiny.toml")]),
    ],
    domains: &[],
    needs_avatar: false,
    grows: None,
    effective: None,
    build,
};

/// Settings of `defgs`, the sections of its TOML file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where the first points come from.
    pub init: InitConfig,
    /// The canonical cloud at its beginning.
    pub cloud: CloudConfig,
    /// Blur of training times (real captures only).
    pub anneal: Anneal,
    /// The deformation network of place and time.
    pub field: DefGsConfig,
    /// Splats that hardly move, left out of the field while training.
    #[serde(default)]
    pub still: StillConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let mut config: Config = parse_config(ENTRY.name, table)?;
    let wrong = |e: gs_deform::DeformError| MethodError::Config { method: ENTRY.name, why: e.to_string() };
    scene.admit(ENTRY.name, &[config.field.param_count()])?;
    let field = DefMlp::new(&config.field, scene.seed).map_err(wrong)?;
    let canonical = Canonical::new(&config.cloud, &mut config.schedule, scene)?;
    let method =
        Deformed::new(canonical, field, config.anneal, scene.views).resting(ENTRY.name, config.still, scene)?;
    Model::new(ENTRY.name, method, config.schedule)
}
