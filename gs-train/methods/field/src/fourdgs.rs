//! 4D Gaussian Splatting (Wu et al. 2024): a canonical cloud moved by a HexPlane field, after a static coarse stage.

use crate::deformed::Deformed;
use gs_deform::field::anneal::Anneal;
use gs_deform::{Aabb, FourDgsConfig, HexPlaneField};
use gs_train::canonical::Canonical;
use gs_train::layers::{BASE, CLOUD, CLOUD_FAST, CLOUD_TINY, PLANES, PLANES_FAST, PLANES_TINY, STILL};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, parse_config};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use gs_train::still::training::StillConfig;
use serde::{Deserialize, Serialize};

const CAPTURES: &str = include_str!("fourdgs.captures.toml");

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "fourdgs",
    about: "4D Gaussian Splatting: a cloud moved by six feature planes over space and time (Wu et al. 2024)",
    defaults: &[BASE, CLOUD, STILL, PLANES, include_str!("fourdgs.toml")],
    presets: &[
        ("paper", &[]),
        ("hypernerf", &[CAPTURES, include_str!("fourdgs.hypernerf.toml")]),
        ("neu3d", &[CAPTURES, include_str!("fourdgs.neu3d.toml")]),
        ("fast", &[CLOUD_FAST, PLANES_FAST, include_str!("fourdgs.fast.toml")]),
        ("tiny", &[CLOUD_TINY, PLANES_TINY, include_str!("fourdgs.tiny.toml")]),
    ],
    domains: &[],
    needs_avatar: false,
    grows: None,
    effective: None,
    build,
};

/// Settings of `fourdgs`, the sections of its TOML file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where the first points come from.
    pub init: InitConfig,
    /// The canonical cloud at its beginning.
    pub cloud: CloudConfig,
    /// The planes cover the box of the first points, enlarged on every side by this share of its diagonal.
    pub margin: f32,
    /// Feature planes, decoder and heads of the field.
    pub field: FourDgsConfig,
    /// Splats that hardly move, left out of the field while training.
    #[serde(default)]
    pub still: StillConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let mut config: Config = parse_config(ENTRY.name, table)?;
    let wrong = |e: gs_deform::DeformError| MethodError::Config { method: ENTRY.name, why: e.to_string() };
    let [min, max] = scene.bounds;
    config.field = config.field.for_moments(scene.moments());
    let margin = config.margin * min.distance(max);
    let aabb = Aabb::new(min - margin, max + margin).map_err(wrong)?;
    scene.admit(ENTRY.name, &[config.field.param_count()])?;
    let field = HexPlaneField::new("field", &config.field, aabb, scene.seed).map_err(wrong)?;
    let canonical = Canonical::new(&config.cloud, &mut config.schedule, scene)?;
    let no_anneal = Anneal { strength: 0.0, ..Anneal::default() };
    let method = Deformed::new(canonical, field, no_anneal, scene.views).resting(ENTRY.name, config.still, scene)?;
    Model::new(ENTRY.name, method, config.schedule)
}
