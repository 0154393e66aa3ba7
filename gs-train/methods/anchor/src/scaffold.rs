//! Scaffold-GS (Lu et al. 2024) without time: anchors decoded as a camera sees them.

use crate::anchored::{AnchorConfig, Anchored, Motion, Parts};
use gs_anchor::{AnchorDensifyRules, AnchorShape, DecoderConfig};
use gs_train::domains::{Domain, interval, length, within};
use gs_train::layers::BASE;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{Grows, MethodEntry, parse_config, section};
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// Settings of anchors, beneath those of [`modec`](super::modec), too.
pub(super) const SETTINGS: &str = include_str!("scaffold.toml");
/// The same of the preset `fast`.
pub(super) const FAST: &str = include_str!("scaffold.fast.toml");
/// The same of the preset `tiny`.
pub(super) const TINY: &str = include_str!("scaffold.tiny.toml");

/// Domains of the settings of anchors, their growth, their intervals and their motion.
pub(super) const DOMAINS: &[Domain] = &[
    within("anchors.direction_within", 0.0, 180.0),
    within("anchors.features", 1.0, 1024.0),
    within("anchors.gradient_batch", 1.0, 65_536.0),
    within("anchors.offsets", 1.0, 64.0),
    within("anchors.stride", 1.0, 1e9),
    within("anchors.voxel", 0.0, 1e6),
    within("decoder.appearance", 0.0, 1024.0),
    within("adapt.coarsest", 1.0, 1_048_576.0),
    interval("adapt.every"),
    within("adapt.extent_cap_log", -80.0, 80.0),
    length("adapt.from", 0.0),
    within("adapt.grad", 0.0, 1e6),
    within("adapt.hierarchy", 1.0, 1024.0),
    within("adapt.levels", 1.0, 8.0),
    within("adapt.max_anchors", 1.0, (1u32 << 26) as f64),
    within("adapt.min_opacity", 0.0, 1e3),
    length("adapt.observe_from", 0.0),
    within("adapt.success", 0.0, 1.0),
    length("adapt.until", 0.0),
    length("intervals.from", 0.0),
    length("intervals.period", 1.0),
    within("intervals.segments", 1.0, 4096.0),
    within("intervals.step", 0.0, 0.5),
    within("intervals.tau", -1e3, 1e3),
    length("intervals.until", 0.0),
    within("dynamics.threshold", 0.0, 1.0),
    within("gad.change_l2", 0.0, 1e4),
    within("hash.lambda_s", 0.0, 1e4),
    within("hash.lambda_t", 0.0, 1e4),
    within("logits", 1.0, 2.0),
    within("sparsity.weight", 0.0, 1e4),
];

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "scaffold",
    about: "Scaffold-GS: anchors decoded as a camera sees them, one scaffold for all times (Lu et al. 2024)",
    defaults: &[BASE, SETTINGS],
    presets: &[("paper", &[]), ("fast", &[FAST]), ("tiny", &[TINY])],
    domains: DOMAINS,
    needs_avatar: false,
    grows: Some(grows),
    effective: None,
    build,
};

/// When anchors grow and are pruned.
pub(super) fn grows(config: &toml::Table) -> Result<Grows, MethodError> {
    let rules: AnchorDensifyRules = section("anchors", config, "adapt")?;
    Ok(Box::new(move |clock| rules.grows_at(clock)))
}

/// Settings of `scaffold`, the sections of its TOML file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where the first points come from.
    pub init: InitConfig,
    /// Anchors, their features and their statistics.
    pub anchors: AnchorConfig,
    /// The networks from anchors to Gaussians.
    pub decoder: DecoderConfig,
    /// Growth and pruning of anchors.
    pub adapt: AnchorDensifyRules,
    /// The plan of the run.
    pub schedule: Schedule,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let config: Config = parse_config(ENTRY.name, table)?;
    let AnchorConfig { offsets, features, .. } = config.anchors;
    let shape = AnchorShape { offsets, features, dynamics: 0 };
    let decoder = config.anchors.decoder(config.decoder, scene);
    scene.admit(ENTRY.name, &[decoder.param_count(shape)])?;
    let parts = Parts {
        name: ENTRY.name,
        anchors: config.anchors,
        decoder,
        adapt: config.adapt,
        dynamics: 0,
        motion: Motion::default(),
        sparsity: None,
        dilation: config.schedule.dilation,
    };
    Model::new(ENTRY.name, Anchored::new(parts, scene)?, config.schedule)
}
