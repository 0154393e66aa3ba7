//! Grid4D with the kernel of Deformable Radial Kernels: one acutance per splat (the baseline "Grid4D + DRK" of FAGS).
//! Settings and body are those of [`grid4d`](super::grid4d).

use crate::grid4d::{PRESETS, build_as};
use gs_train::method::{MethodEntry, MethodError, SceneInfo};
use gs_train::model::Model;

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "drk",
    about: "Grid4D with the acutance of Deformable Radial Kernels",
    defaults: concat!(include_str!("drk.parts.toml"), include_str!("grid4d.toml")),
    presets: PRESETS,
    needs_avatar: false,
    build,
};

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    build_as(ENTRY.name, table, scene)
}
