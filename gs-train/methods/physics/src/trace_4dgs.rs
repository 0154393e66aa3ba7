//! TRACE on the HexPlane field of 4D Gaussian Splatting (the row TRACE_4dgs of its tables); see [`trace`](super::trace).

use crate::layers::{LAW, LAW_FAST, LAW_TINY, PHYSICS, PHYSICS_FAST, PHYSICS_TINY};
use crate::trace::{Config, DOMAINS, build_on, effective_on};
use gs_deform::{Aabb, FourDgsConfig, HexPlaneField};
use gs_train::layers::{
    BASE, CLOUD, CLOUD_FAST, CLOUD_TINY, DEFORMED, FOLLOW, MOTION_FAST, PLANES, PLANES_FAST, PLANES_TINY,
};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::MethodEntry;
use gs_train::scene::SceneInfo;

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "trace-4dgs",
    about: "TRACE's law of motion beside the feature planes of 4D Gaussian Splatting (Li et al. 2025)",
    defaults: &[BASE, CLOUD, DEFORMED, FOLLOW, PLANES, PHYSICS, LAW, include_str!("trace_4dgs.toml")],
    presets: &[
        ("paper", &[]),
        ("fast", &[CLOUD_FAST, PLANES_FAST, MOTION_FAST, PHYSICS_FAST, LAW_FAST, include_str!("trace_4dgs.fast.toml")]),
        ("tiny", &[CLOUD_TINY, PLANES_TINY, PHYSICS_TINY, LAW_TINY, include_str!("trace_4dgs.tiny.toml")]),
    ],
    domains: DOMAINS,
    needs_avatar: false,
    grows: None,
    effective: Some(effective),
    build,
};

fn effective(table: &toml::Table) -> Result<toml::Table, MethodError> {
    effective_on::<FourDgsConfig>(ENTRY.name, table)
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let shape = |field: &FourDgsConfig| field.clone().for_moments(scene.moments());
    let count = |field: &FourDgsConfig| shape(field).param_count();
    build_on(ENTRY.name, table, scene, count, |c: &Config<FourDgsConfig>| {
        let [min, max] = scene.bounds;
        let margin = c.margin * min.distance(max);
        let aabb = Aabb::new(min - margin, max + margin)?;
        HexPlaneField::new("field", &shape(&c.field), aabb, scene.seed)
    })
}
