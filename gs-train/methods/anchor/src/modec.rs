//! MoDec-GS (Kwak et al. 2025): anchors moved once per temporal interval (global anchor deformation, GAD), their Gaussians
//! once per frame (local Gaussian deformation, LGD), and intervals whose boundaries move (temporal interval adjustment, TIA).
//!
//! Parts to leave out, `ablate = "tia,lgd"`:
//!
//! | name | left out | row of the paper's table |
//! |---|---|---|
//! | `gad` | motion of the anchors | "explicit": one field moves the Gaussians |
//! | `lgd` | motion of the Gaussians | "GAD only" |
//! | `tia` | motion of the boundaries | without TIA |

use crate::anchored::{AnchorConfig, Anchored, Motion, Parts, Query, SparsityConfig};
use crate::scaffold::{self, DOMAINS};
use gs_anchor::gad::{Activation, Factor, GadHead};
use gs_anchor::{AnchorDensifyRules, AnchorShape, DecoderConfig, Gad, GadConfig, IntervalConfig, Intervals};
use gs_anchor::{Lgd, LgdConfig, LgdEncoder};
use gs_core::cast;
use gs_deform::Aabb;
use gs_train::ablate::{Ablations, Part, read_without};
use gs_train::layers::BASE;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::registry::{MethodEntry, write_config};
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// The line in the list of methods.
pub const ENTRY: MethodEntry = MethodEntry {
    name: "modec",
    about: "MoDec-GS: anchors moved per interval, their Gaussians per frame; small files (Kwak et al. 2025)",
    defaults: &[BASE, scaffold::SETTINGS, include_str!("modec.toml")],
    presets: &[
        ("paper", &[]),
        ("ref", &[include_str!("modec.ref.toml")]),
        ("dnerf", &[include_str!("presets/modec.dnerf.toml")]),
        ("hypernerf", &[include_str!("presets/modec.hypernerf.toml")]),
        ("iphone", &[include_str!("presets/modec.iphone.toml")]),
        ("nvidia", &[include_str!("presets/modec.nvidia.toml")]),
        ("neu3d", &[include_str!("presets/modec.neu3d.toml")]),
        ("panoptic", &[include_str!("presets/modec.panoptic.toml")]),
        ("fast", &[scaffold::FAST, include_str!("modec.fast.toml")]),
        ("tiny", &[scaffold::TINY, include_str!("modec.tiny.toml")]),
    ],
    domains: DOMAINS,
    needs_avatar: false,
    grows: Some(scaffold::grows),
    effective: Some(effective),
    build,
};

const PARTS: &[Part<Config>] =
    &[("gad", |c| c.global = false), ("lgd", |c| c.local = false), ("tia", |c| c.intervals.on &= !c.global)];

/// Settings of `modec`, the sections of its TOML file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Parts to leave out, for comparison.
    pub ablate: Ablations,
    /// The planes cover the box of the first points, enlarged on every side by this share of its diagonal.
    pub margin: f32,
    /// Where the first points come from.
    pub init: InitConfig,
    /// Anchors, their features and their statistics.
    pub anchors: AnchorConfig,
    /// The networks from anchors to Gaussians.
    pub decoder: DecoderConfig,
    /// Logits of motion per anchor: 1 (shared) or 2.
    pub logits: usize,
    /// The penalty on the logits of motion.
    pub sparsity: SparsityConfig,
    /// Whether anchors move, once per interval.
    pub global: bool,
    /// Whether Gaussians move, once per frame.
    pub local: bool,
    /// Global anchor deformation, once per interval.
    pub gad: GadConfig,
    /// Local Gaussian deformation, once per frame.
    pub lgd: LgdConfig,
    /// Where LGD is asked about a Gaussian.
    pub lgd_query: Query,
    /// Temporal intervals and when they are adjusted.
    pub intervals: IntervalConfig,
    /// Growth and pruning of anchors.
    pub adapt: AnchorDensifyRules,
    /// The plan of the run.
    pub schedule: Schedule,
}

/// Whether logits of motion can leave 0, where they begin. A relu has no slope there; tanh has one, but of a network that begins at zero there is nothing
/// yet to weigh, and without weight it stays at zero. A logit that a mask shares gets the mask's gradient, and a penalty moves any but those of a relu.
fn logits_can_learn(config: &Config) -> bool {
    let (dynamics, heads) = (config.gad.dynamics, &config.gad.heads);
    let moves = heads.contains(&GadHead::Positions);
    let factors = [(moves, dynamics.global), (heads.len() > usize::from(moves), dynamics.local)];
    let used = |factor| factors.contains(&(true, factor));
    let alone = used(Factor::Mul) && (config.logits == 2 || !used(Factor::Mask));
    let stuck = match dynamics.activation {
        Activation::Sigmoid => false,
        Activation::Relu => true,
        Activation::Tanh => config.gad.net.zero_init && config.sparsity.weight == 0.0,
    };
    !(alone && stuck)
}

/// Reads the settings, without the parts they name.
fn read(table: &toml::Table) -> Result<Config, MethodError> {
    read_without(ENTRY.name, table, PARTS, |c| &mut c.ablate)
}

/// The effective configuration: GAD, LGD, its encoder, intervals and logits have rates only where they are there.
fn effective(table: &toml::Table) -> Result<toml::Table, MethodError> {
    let mut config = read(table)?;
    let rates = &mut config.schedule.lr;
    if !config.global {
        rates.remove("gad");
        rates.remove("intervals");
        rates.get_mut("anchors").and_then(|anchors| anchors.remove("dynamics"));
    }
    if !config.local {
        rates.remove("lgd");
    }
    let other = if config.lgd.encoder == LgdEncoder::Planes { "grids" } else { "planes" };
    rates.get_mut("lgd").and_then(|lgd| lgd.remove(other));
    write_config(ENTRY.name, &config)
}

fn build(table: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
    let mut config = read(table)?;
    let wrong = |why: String| MethodError::Config { method: ENTRY.name, why };
    if !(1..=2).contains(&config.logits) {
        return Err(wrong(format!("logits = {}: 1 (shared) or 2", config.logits)));
    }
    if !(config.sparsity.weight >= 0.0 && config.sparsity.weight.is_finite()) {
        return Err(wrong(format!("sparsity.weight = {}: finite, not negative", config.sparsity.weight)));
    }
    if config.global && !logits_can_learn(&config) {
        let activation = format!("{:?}", config.gad.dynamics.activation).to_lowercase();
        return Err(wrong(format!(
            "gad.dynamics.activation = {activation}: its logits begin at 0 and stay there; sigmoid learns, relu where a mask shares the logit (logits = 1), tanh \
             also with gad.net.zero_init = false or sparsity.weight above 0"
        )));
    }
    if config.lgd.encoder == LgdEncoder::Hash && config.lgd_query == Query::Rest {
        return Err(wrong("lgd_query = rest: moved with lgd.encoder = hash, which is asked at the means".into()));
    }
    let [min, max] = scene.bounds;
    let margin = config.margin * min.distance(max);
    let aabb = Aabb::new(min - margin, max + margin).map_err(|e| wrong(e.to_string()))?;
    // Without GAD nothing depends on the intervals or the logits.
    let dynamics = if config.global { config.logits } else { 0 };
    let shape = AnchorShape { offsets: config.anchors.offsets, features: config.anchors.features, dynamics };
    let gad = if config.global { config.gad.param_count(shape) } else { 0 };
    config.lgd = config.lgd.for_moments(scene.moments());
    let frames = cast::to_u32(cast::to_usize(scene.moments().round()).max(1));
    let lgd = if config.local { config.lgd.param_count() } else { 0 };
    let decoder = config.anchors.decoder(config.decoder, scene);
    scene.admit(ENTRY.name, &[decoder.param_count(shape), gad, lgd])?;
    let field = |e: gs_deform::DeformError| MethodError::Config { method: ENTRY.name, why: e.to_string() };
    let gad = config.global.then(|| Gad::new(&config.gad, shape, aabb, scene.seed)).transpose().map_err(field)?;
    let lgd = config.local.then(|| Lgd::new(&config.lgd, aabb, scene.seed));
    let intervals = config.global.then(|| Intervals::new(&config.intervals, frames));
    let motion = Motion {
        gad,
        lgd: lgd.transpose().map_err(field)?,
        query: config.lgd_query,
        intervals: intervals.transpose().map_err(|e| MethodError::Config { method: ENTRY.name, why: e.to_string() })?,
    };
    let parts = Parts {
        name: ENTRY.name,
        anchors: config.anchors,
        decoder,
        adapt: config.adapt,
        dynamics,
        motion,
        sparsity: Some(config.sparsity),
        dilation: config.schedule.dilation,
    };
    Model::new(ENTRY.name, Anchored::new(parts, scene)?, config.schedule)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_train::registry::own_settings;

    #[test]
    fn effective_configurations_have_no_rates_of_what_they_leave_out_and_name_no_parts() {
        let cases: [(&str, &[&str]); 4] = [
            ("", &["lgd.grids"]),
            ("tia", &["lgd.grids"]),
            ("gad", &["lgd.grids", "gad.planes", "gad.all", "intervals.starts", "anchors.dynamics"]),
            ("lgd", &["lgd.grids", "lgd.planes", "lgd.all"]),
        ];
        for (ablate, without) in cases {
            let mut settings = own_settings(ENTRY.config("tiny").unwrap());
            settings.insert("ablate".into(), ablate.into());
            let effective = effective(&settings).unwrap();
            assert_eq!(effective["ablate"].as_str(), Some(""), "{ablate}");
            let mut config = read(&settings).unwrap();
            for (part, rates) in &mut config.schedule.lr {
                rates.retain(|name, _| !without.contains(&format!("{part}.{name}").as_str()));
            }
            config.schedule.lr.retain(|_, rates| !rates.is_empty());
            assert_eq!(read(&effective).unwrap(), config, "{ablate}");
        }
    }
}
