//! TRACE (Li, Song and Yang 2025): every Gaussian is a rigid particle whose translation and rotation follow a learnt law.
//!
//! The deformation field of Deformable 3D Gaussians brings splats to a time near the image's, the law carries them
//! from there ([`advected`](crate::advected)); past the last field time the law alone rules. [`trace_4dgs`](super::trace_4dgs)
//! has the HexPlane of 4D Gaussian Splatting in its place.
//!
//! Parts to leave out, `ablate = "physics"`:
//!
//! | name | left out | row of the paper's Table 9 |
//! |---|---|---|
//! | `field` | the deformation field: the law carries splats from time 0 | no deformation |
//! | `physics` | rigid motion: free velocities and turns | no physics |
//! | `equivalent` | the equivalent form: centre, its velocity and acceleration are learnt | no equivalent form |
//!
//! Its other rows are settings: `physics.step_frames` and `law.order`.

use crate::advected::{Advected, PhysicsConfig};
use crate::layers::{LAW, LAW_FAST, LAW_TINY, PHYSICS, PHYSICS_FAST, PHYSICS_TINY, TRACE_NETWORK};
use gs_deform::{DefGsConfig, DefMlp, Field};
use gs_physics::{Law, LawConfig, LawForm};
use gs_train::ablate::{Ablations, Part, read_without};
use gs_train::canonical::Canonical;
use gs_train::domains::{Domain, within};
use gs_train::layers::{
    BASE, CLOUD, CLOUD_FAST, CLOUD_TINY, DEFORMED, FOLLOW, MOTION_FAST, NETWORK, NETWORK_FAST, NETWORK_TINY,
};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, write_config};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// Domains of the settings of laws, velocity fields and particles.
pub(super) const DOMAINS: &[Domain] = &[
    within("law.accel_clamp", 0.0, 1e6),
    within("law.bands", 0.0, 24.0),
    within("law.depth", 1.0, 64.0),
    within("law.gain", 1e-6, 1e6),
    within("law.head_start", 1e-6, 1e6),
    within("law.order", 1.0, 3.0),
    within("law.spin_gain", 1e-6, 1e6),
    within("law.spin_order", 0.0, 3.0),
    within("law.spin_up_weight", 0.0, 1e6),
    within("physics.back_frames", 0.0, 1e6),
    within("physics.bodies", 0.0, 1e6),
    within("physics.direct", 0.0, 1.0),
    within("physics.reach", 1.0, 1e6),
    within("physics.reach_until", 1e-9, 1e9),
    within("physics.settle", 0.0, 1.0),
    within("physics.settle_frames", 0.0, 1e6),
    within("physics.slack", 0.0, 1e6),
    within("physics.start", 0.0, 1.0),
    within("physics.step_frames", 1e-3, 1e6),
    within("velocity.bands", 0.0, 24.0),
    within("velocity.depth", 1.0, 64.0),
    within("velocity.divergence", 0.0, 1e6),
    within("velocity.points", 0.0, 16_777_216.0),
    within("velocity.transport", 0.0, 1e6),
];

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "trace",
    about: "TRACE: every Gaussian a rigid particle under a learnt law of motion; forecasts, segments (Li et al. 2025)",
    defaults: &[BASE, CLOUD, DEFORMED, FOLLOW, NETWORK, PHYSICS, TRACE_NETWORK, LAW],
    presets: &[
        ("paper", &[]),
        ("parity", &[include_str!("trace.parity.toml")]),
        ("fast", &[CLOUD_FAST, NETWORK_FAST, MOTION_FAST, PHYSICS_FAST, LAW_FAST]),
        ("tiny", &[CLOUD_TINY, NETWORK_TINY, PHYSICS_TINY, LAW_TINY]),
    ],
    domains: DOMAINS,
    needs_avatar: false,
    grows: None,
    effective: Some(effective),
    build,
};

/// The configuration; `F` is that of the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config<F> {
    /// Parts to leave out, for comparison.
    pub ablate: Ablations,
    /// The box of fields that have one is that of the first points, enlarged by this share of its diagonal.
    #[serde(default)]
    pub margin: f32,
    /// Where the first points come from.
    pub init: InitConfig,
    /// The canonical cloud at its beginning.
    pub cloud: CloudConfig,
    /// The deformation field up to the last observed time.
    pub field: F,
    /// The law of motion that carries splats.
    pub law: LawConfig,
    /// When the law of motion acts, and how far.
    pub physics: PhysicsConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

impl<F> Config<F> {
    /// What may be left out.
    fn parts() -> [Part<Self>; 3] {
        [
            ("field", |c| {
                c.physics.field = false;
                c.schedule.stages.values_mut().for_each(|stage| stage.field_alone = false);
            }),
            ("physics", |c| (c.law.form, c.physics.refit) = (LawForm::Free, false)),
            ("equivalent", |c| {
                // The gain counts for velocities; it would multiply the centre, too.
                (c.law.form, c.law.gain, c.physics.refit) = (LawForm::Centre15, 1.0, false);
            }),
        ]
    }
}

/// Reads the settings of TRACE on a field, without the parts they name.
fn read<C>(name: &'static str, table: &toml::Table) -> Result<Config<C>, MethodError>
where
    C: serde::de::DeserializeOwned + Clone + PartialEq,
{
    read_without(name, table, &Config::<C>::parts(), |c| &mut c.ablate)
}

/// The effective configuration of TRACE on a field: without the field it has no rates.
///
/// # Errors
/// If the configuration cannot be read, or names a part that cannot be left out.
pub(super) fn effective_on<C>(name: &'static str, table: &toml::Table) -> Result<toml::Table, MethodError>
where
    C: Serialize + serde::de::DeserializeOwned + Clone + PartialEq,
{
    let mut config: Config<C> = read(name, table)?;
    if !config.physics.field {
        config.schedule.lr.remove("field");
    }
    write_config(name, &config)
}

/// Builds TRACE on a field.
///
/// # Errors
/// If the configuration or the scene cannot be used.
pub(super) fn build_on<F, C>(
    name: &'static str,
    table: &toml::Table,
    scene: &SceneInfo,
    count: impl FnOnce(&C) -> u64,
    field: impl FnOnce(&Config<C>) -> Result<F, gs_deform::DeformError>,
) -> Result<Model, MethodError>
where
    F: Field + 'static,
    F::Tape: Sync,
    C: serde::de::DeserializeOwned + Clone + PartialEq,
{
    let mut config: Config<C> = read(name, table)?;
    let wrong = |why: String| MethodError::Config { method: name, why };
    scene.admit(name, &[count(&config.field), config.law.param_count()])?;
    let field = field(&config).map_err(|e| wrong(e.to_string()))?;
    let origin = 0.5 * (scene.bounds[0] + scene.bounds[1]);
    let step = config.physics.step(scene);
    let law = Law::new(&of_a_view(config.law, config.schedule.batch), origin, step, scene.seed)
        .map_err(|e| wrong(e.to_string()))?;
    let canonical = Canonical::new(&config.cloud, &mut config.schedule, scene)?;
    let method = Advected::new(canonical, field, law, config.physics, scene).map_err(wrong)?;
    Model::new(name, method, config.schedule)
}

/// The law as one of the views of a step sees it. Their image losses are averaged, so what each adds to the gradient for the law alone,
/// and the length at which its gradient is cut, have its share.
fn of_a_view(law: LawConfig, batch: u32) -> LawConfig {
    let share = 1.0 / batch.max(1) as f32;
    LawConfig { spin_up_weight: share * law.spin_up_weight, accel_clamp: share * law.accel_clamp, ..law }
}

fn effective(table: &toml::Table) -> Result<toml::Table, MethodError> {
    effective_on::<DefGsConfig>(ENTRY.name, table)
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let field = |c: &Config<DefGsConfig>| DefMlp::new(&c.field, scene.seed);
    build_on(ENTRY.name, table, scene, DefGsConfig::param_count, field)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace_4dgs;
    use gs_deform::FourDgsConfig;
    use gs_train::registry::own_settings;
    use serde::de::DeserializeOwned;
    use std::fmt::Debug;

    /// The configuration that names parts and the effective one are the same, but for the rates of a field that is left out.
    fn same_without_names<C>(entry: &MethodEntry)
    where
        C: Serialize + DeserializeOwned + Clone + PartialEq + Debug,
    {
        for (ablate, has_field) in [("", true), ("physics", true), ("equivalent", true), ("field, physics", false)] {
            let mut settings = own_settings(entry.config("tiny").unwrap());
            settings.insert("ablate".into(), ablate.into());
            let effective = effective_on::<C>(entry.name, &settings).unwrap();
            assert_eq!(effective["ablate"].as_str(), Some(""), "{}: {ablate}", entry.name);
            let mut config: Config<C> = read(entry.name, &settings).unwrap();
            config.schedule.lr.retain(|part, _| part != "field" || has_field);
            assert_eq!(read::<C>(entry.name, &effective).unwrap(), config, "{}: {ablate}", entry.name);
        }
    }

    #[test]
    fn effective_configurations_build_the_same_and_name_no_parts() {
        same_without_names::<DefGsConfig>(&ENTRY);
        same_without_names::<FourDgsConfig>(&trace_4dgs::ENTRY);
    }
}
