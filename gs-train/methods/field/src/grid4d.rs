//! Grid4D (Xu et al. 2024): a canonical cloud moved by hash grids over space and over space and time. The common body of
//! [`fags`](super::fags), which adds a Fourier branch, a gate, a bent kernel and a loss on spectra, and of
//! [`acutance`](super::acutance), which adds another kernel: one structure of settings, one way to build.

use crate::deformed::Deformed;
use gs_deform::field::anneal::Anneal;
use gs_deform::field::{Grid4dConfig, Grid4dField};
use gs_train::ablate::{Ablations, Part, read_without};
use gs_train::canonical::Canonical;
use gs_train::domains::{Domain, length, within};
use gs_train::kernel::KernelKind;
use gs_train::layers::{BASE, CLOUD, CLOUD_FAST, CLOUD_TINY, DEFORMED, STILL};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, write_config};
use gs_train::scene::{CloudConfig, InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use gs_train::still::training::StillConfig;
use serde::{Deserialize, Serialize};

/// Domains of the settings of the box, Fourier branch, gate and smoothness.
pub(super) const DOMAINS: &[Domain] = &[
    within("field.bound", 0.0, 1e6),
    within("fourier.gamma_max", 1.0, 1024.0),
    within("fourier.gain", 1e-6, 1e3),
    within("gate.start", 0.0, 1.0),
    within("smooth.eps", 0.0, 1e3),
    within("smooth.eps_t", 0.0, 1e3),
    within("smooth.lambda_s", 0.0, 1e4),
    within("smooth.lambda_t", 0.0, 1e4),
    within("smooth.share", 0.0, 1.0),
    length("smooth_from", 0.0),
];

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "grid4d",
    about: "Grid4D: a cloud moved by hash grids over space and time (Xu et al. 2024)",
    defaults: &[BASE, CLOUD, STILL, DEFORMED, SETTINGS],
    presets: PRESETS,
    domains: DOMAINS,
    needs_avatar: false,
    grows: None,
    effective: Some(effective),
    build,
};

/// Presets of everything on this body: none of them touches what tells the methods apart.
pub(super) const PRESETS: &[(&str, &[&str])] =
    &[("paper", &[]), ("fast", &[CLOUD_FAST, FAST_GRIDS]), ("tiny", TINY), ("hypernerf", HYPERNERF), ("neu3d", NEU3D)];

/// What `fast` sets of this body.
pub(super) const FAST_GRIDS: &str = include_str!("grid4d.fast.toml");
pub(super) const TINY: &[&str] = &[CLOUD_TINY, include_str!("grid4d.tiny.toml")];
pub(super) const HYPERNERF: &[&str] = &[CAPTURES, include_str!("grid4d.hypernerf.toml")];
pub(super) const NEU3D: &[&str] = &[CAPTURES, include_str!("grid4d.neu3d.toml")];

/// What the presets for real captures share.
const CAPTURES: &str = include_str!("grid4d.captures.toml");

/// Settings of this body.
pub(super) const SETTINGS: &str = include_str!("grid4d.toml");

/// Parts that may be left out of every method on this body, by the names of the table of FAGS:
///
/// | name | left out | how |
/// |---|---|---|
/// | `fdgk` | the learnt kernel profile | Gaussian splats |
/// | `hfe` | the Fourier branch | `field.fourier.on = false` |
/// | `gate` | the gate, `η = 1` | `field.gate.on = false` |
/// | `fre` | the amplitude-spectrum loss | `schedule.lambda_fre = 0` |
/// | `lambda` | λ per splat | one λ that all splats share, learnt (`λ = ½` would be `fdgk`, whatever β is) |
/// | `beta` | β per splat | `β = ½` |
///
/// The first four together make `fags` the method `grid4d`.
pub(super) const GRID4D: &[Part<Config>] = &[
    ("fdgk", |c| c.cloud.kernel.kind = KernelKind::Gaussian),
    ("hfe", |c| c.field.fourier.on = false),
    ("gate", |c| c.field.gate.on = false),
    ("fre", |c| c.schedule.lambda_fre = 0.0),
    ("lambda", |c| c.cloud.kernel.shared_lambda |= c.cloud.kernel.kind == KernelKind::Frequency),
    ("beta", |c| c.cloud.kernel.learn_beta &= c.cloud.kernel.kind != KernelKind::Frequency),
];

/// Where `field.bound` is 0, half the side of the cube is the largest coordinate of a first point times this.
const ROOM: f32 = 1.2;

/// Settings of `grid4d`, `fags` and `acutance`, the sections of their TOML files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Parts to leave out, for comparison.
    pub ablate: Ablations,
    /// The field's smoothness counts from this step of the run.
    pub smooth_from: u32,
    /// Where the first points come from.
    pub init: InitConfig,
    /// The canonical cloud at its beginning, with its kernel.
    pub cloud: CloudConfig,
    /// The field; a `bound` of 0 is replaced by one that holds the first points.
    pub field: Grid4dConfig,
    /// Splats that hardly move, left out of the field while training.
    #[serde(default)]
    pub still: StillConfig,
    /// The plan of the run.
    pub schedule: Schedule,
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    build_as(ENTRY.name, table, scene)
}

fn effective(table: &toml::Table) -> Result<toml::Table, MethodError> {
    effective_as(ENTRY.name, table)
}

/// Reads the settings of one of the methods on this body, without the parts they name.
fn read(name: &'static str, table: &toml::Table) -> Result<Config, MethodError> {
    read_without(name, table, GRID4D, |c| &mut c.ablate)
}

/// The effective configuration of one of the methods on this body.
pub(super) fn effective_as(name: &'static str, table: &toml::Table) -> Result<toml::Table, MethodError> {
    write_config(name, &read(name, table)?)
}

/// Builds whatever the configuration says, under the name of one of the methods on this body.
pub(super) fn build_as(name: &'static str, table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let mut config = read(name, table)?;
    let wrong = |why: String| MethodError::Config { method: name, why };
    if config.field.bound == 0.0 {
        config.field.bound =
            ROOM * scene.bounds.map(|corner| corner.abs().max_element()).into_iter().fold(0.0, f32::max);
    }
    scene.admit(name, &[config.field.param_count()])?;
    let field = Grid4dField::new(&config.field, scene.seed).map_err(|e| wrong(e.to_string()))?;
    let canonical = Canonical::new(&config.cloud, &mut config.schedule, scene)?;
    let no_anneal = Anneal { strength: 0.0, ..Anneal::default() };
    let method = Deformed::new(canonical, field, no_anneal, scene.views).resting(name, config.still, scene)?;
    let method = method.regularised_from(config.smooth_from);
    Model::new(name, method, config.schedule)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::METHODS;
    use gs_train::registry::{own_settings, parse_config};

    fn settings(method: &'static str, ablate: &str) -> toml::Table {
        let mut table = own_settings(METHODS.iter().find(|m| m.name == method).unwrap().config("tiny").unwrap());
        table.insert("ablate".into(), ablate.into());
        table
    }

    fn config(method: &'static str, ablate: &str) -> Config {
        read(method, &settings(method, ablate)).unwrap()
    }

    #[test]
    fn without_its_parts_fags_is_grid4d() {
        assert_eq!(config("fags", "fdgk, hfe,gate,fre"), config("grid4d", ""));
        assert_ne!(config("fags", ""), config("grid4d", ""));
        let named: Config = parse_config("fags", &settings("fags", "fdgk, hfe,gate,fre")).unwrap();
        assert_eq!(String::from(named.ablate), "fdgk,hfe,gate,fre");
    }

    #[test]
    fn effective_configurations_build_the_same_and_name_no_parts() {
        for ablate in ["", "fdgk,gate", "lambda,beta,hfe,fre"] {
            let effective = effective_as("fags", &settings("fags", ablate)).unwrap();
            assert_eq!(effective["ablate"].as_str(), Some(""), "{ablate}");
            assert_eq!(read("fags", &effective).unwrap(), config("fags", ablate), "{ablate}");
        }
    }

    #[test]
    fn lambda_and_beta_are_left_out_each_for_itself() {
        let kernel = |ablate| config("fags", ablate).cloud.kernel;
        let full = kernel("");
        assert_eq!(kernel("lambda"), gs_train::kernel::KernelConfig { shared_lambda: true, ..full });
        assert_eq!(kernel("beta"), gs_train::kernel::KernelConfig { learn_beta: false, ..full });
    }

    #[test]
    fn unknown_parts_are_refused_with_the_known_ones() {
        let mut fags = config("fags", "");
        let error = Ablations::from("gate,fdkg".to_owned()).apply(GRID4D, &mut fags).unwrap_err();
        assert!(error.contains("`fdkg`") && error.contains("fdgk, hfe, gate"), "{error}");
        assert_eq!(Ablations::from(String::new()), Ablations::default());
    }
}
