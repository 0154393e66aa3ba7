//! FAGS, frequency-aware dynamic Gaussian splatting: Grid4D with a kernel whose fall-off is learnt, a Fourier branch, a
//! gate and a loss on amplitude spectra. Settings and body are those of [`grid4d`](super::grid4d).

use crate::grid4d::{DOMAINS, FAST_GRIDS, HYPERNERF, NEU3D, SETTINGS, TINY, build_as, effective_as};
use gs_train::layers::{BASE, CLOUD, CLOUD_FAST, DEFORMED, STILL};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::MethodEntry;
use gs_train::scene::SceneInfo;

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "fags",
    about: "FAGS: Grid4D with learnt fall-offs, a Fourier branch, a gate and a loss on spectra",
    defaults: &[BASE, CLOUD, STILL, DEFORMED, SETTINGS, include_str!("fags.toml")],
    presets: &[
        ("paper", &[]),
        ("fast", &[CLOUD_FAST, FAST_GRIDS, include_str!("fags.fast.toml")]),
        ("tiny", TINY),
        ("hypernerf", HYPERNERF),
        ("neu3d", NEU3D),
    ],
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
