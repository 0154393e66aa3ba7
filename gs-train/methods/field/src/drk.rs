//! Grid4D with the kernel of Deformable Radial Kernels: one acutance per splat (the baseline "Grid4D + DRK" of FAGS).
//! Settings and body are those of [`grid4d`](super::grid4d).

use crate::grid4d::{DOMAINS, PRESETS, SETTINGS, build_as};
use gs_train::layers::{BASE, CLOUD, DEFORMED};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::MethodEntry;
use gs_train::scene::SceneInfo;

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "drk",
    about: "Grid4D with the acutance of Deformable Radial Kernels",
    defaults: &[BASE, CLOUD, DEFORMED, SETTINGS, include_str!("drk.toml")],
    presets: PRESETS,
    domains: DOMAINS,
    needs_avatar: false,
    build,
};

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    build_as(ENTRY.name, table, scene)
}
