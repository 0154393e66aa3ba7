//! Scaffold-GS (Lu et al. 2024) without time: anchors decoded as a camera sees them.

use crate::anchored::{AnchorConfig, Anchored, Motion, Parts};
use gs_anchor::{AnchorDensifyRules, DecoderConfig};
use gs_train::layers::BASE;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, parse_config};
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// Settings of anchors, beneath those of [`modec`](super::modec), too.
pub(super) const SETTINGS: &str = include_str!("scaffold.toml");
/// The same of the preset `fast`.
pub(super) const FAST: &str = include_str!("scaffold.fast.toml");
/// The same of the preset `tiny`.
pub(super) const TINY: &str = include_str!("scaffold.tiny.toml");

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "scaffold",
    about: "Scaffold-GS: anchors decoded as a camera sees them, one scaffold for all times (Lu et al. 2024)",
    defaults: &[BASE, SETTINGS],
    presets: &[("paper", &[]), ("fast", &[FAST]), ("tiny", &[TINY])],
    needs_avatar: false,
    build,
};

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
    let parts = Parts {
        name: ENTRY.name,
        anchors: config.anchors,
        decoder: config.decoder,
        adapt: config.adapt,
        dynamics: 0,
        motion: Motion::default(),
        sparsity: None,
    };
    Model::new(ENTRY.name, Anchored::new(parts, scene)?, config.schedule)
}
