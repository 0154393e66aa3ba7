//! Deformable 3D Gaussians with the velocity field of NVFi: TRACE's baseline DefGS_nvfi, trained as TRACE is
//! ([`advected`](crate::advected)), with NVFi's physics-informed loss on the velocity.

use crate::advected::{Advected, PhysicsConfig};
use crate::layers::{PHYSICS, PHYSICS_FAST, PHYSICS_TINY, TRACE_NETWORK};
use crate::trace::DOMAINS;
use gs_deform::{DefGsConfig, DefMlp};
use gs_physics::{VelocityConfig, VelocityField};
use gs_train::canonical::Canonical;
use gs_train::layers::{
    BASE, CLOUD, CLOUD_FAST, CLOUD_TINY, DEFORMED, FOLLOW, MOTION_FAST, NETWORK, NETWORK_FAST, NETWORK_TINY,
};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, parse_config};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "defgs-nvfi",
    about: "DefGS with NVFi's velocity field and its physics-informed loss: a baseline of TRACE (Li et al. 2025)",
    defaults: &[BASE, CLOUD, DEFORMED, FOLLOW, NETWORK, PHYSICS, TRACE_NETWORK, include_str!("defgs_nvfi.toml")],
    presets: &[
        ("paper", &[]),
        ("fast", &[CLOUD_FAST, NETWORK_FAST, MOTION_FAST, PHYSICS_FAST, include_str!("defgs_nvfi.fast.toml")]),
        ("tiny", &[CLOUD_TINY, NETWORK_TINY, PHYSICS_TINY, include_str!("defgs_nvfi.tiny.toml")]),
    ],
    domains: DOMAINS,
    needs_avatar: false,
    grows: None,
    effective: None,
    build,
};

/// Settings of `defgs-nvfi`, the sections of its TOML file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where the first points come from.
    pub init: InitConfig,
    /// The canonical cloud at its beginning.
    pub cloud: CloudConfig,
    /// The deformation network of place and time.
    pub field: DefGsConfig,
    /// The velocity field that carries splats from frame to frame.
    pub velocity: VelocityConfig,
    /// When the velocity field acts, and how far.
    pub physics: PhysicsConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let mut config: Config = parse_config(ENTRY.name, table)?;
    let wrong = |why: String| MethodError::Config { method: ENTRY.name, why };
    scene.admit(ENTRY.name, &[config.field.param_count(), config.velocity.param_count()])?;
    let field = DefMlp::new(&config.field, scene.seed).map_err(|e| wrong(e.to_string()))?;
    let step = config.physics.step(scene);
    let velocity = VelocityField::new(&config.velocity, scene.bounds, step, scene.seed);
    let velocity = velocity.map_err(|e| wrong(e.to_string()))?;
    let canonical = Canonical::new(&config.cloud, &mut config.schedule, scene)?;
    let method = Advected::new(canonical, field, velocity, config.physics, scene).map_err(wrong)?;
    Model::new(ENTRY.name, method, config.schedule)
}
