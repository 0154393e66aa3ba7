//! Grid4D with a sharpness per splat, the acutance of Deformable Radial Kernels (Huang et al. 2024). Their kernel has, beside it, radial
//! bases with a length and an angle each and a blend of norms: this is a reduction, not the baseline "Grid4D + DRK" of FAGS.
//! Settings and body are those of [`grid4d`](super::grid4d).

use crate::grid4d::{DOMAINS, PRESETS, SETTINGS, build_as, effective_as};
use gs_train::layers::{BASE, CLOUD, DEFORMED, STILL};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::MethodEntry;
use gs_train::scene::SceneInfo;

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "acutance",
    about: "Grid4D with a sharpness (acutance) per splat: a reduction of Deformable Radial Kernels",
    defaults: &[BASE, CLOUD, STILL, DEFORMED, SETTINGS, include_str!("acutance.toml")],
    presets: PRESETS,
    domains: DOMAINS,
    needs_avatar: false,
    grows: None,
    effective: Some(effective),
    build,
};

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    build_as(ENTRY.name, table, scene)
}

fn effective(table: &toml::Table) -> Result<toml::Table, MethodError> {
    effective_as(ENTRY.name, table)
}
