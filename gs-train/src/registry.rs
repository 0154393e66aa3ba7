//! The methods a program offers, by name, with their settings.

use crate::cameras::CameraConfig;
use crate::domains::{self, Domain};
use crate::error::MethodError;
use crate::model::Model;
use crate::scene::SceneInfo;
use crate::schedule::complete_rates;
use gs_data::Dataset;
use gs_data::avatar::AvatarScene;
use std::sync::Arc;

/// A list of methods with different names. A program builds it from the crates it depends on and hands it to whatever builds
/// methods: the trainer, the loading of checkpoints, the resolution of settings.
#[derive(Clone, Debug, Default)]
pub struct Registry(Vec<MethodEntry>);

impl Registry {
    /// The methods in this order; of entries with the same name the last one counts.
    pub fn new(entries: Vec<MethodEntry>) -> Self {
        let mut list: Vec<MethodEntry> = Vec::new();
        for entry in entries {
            match list.iter_mut().find(|e| e.name == entry.name) {
                Some(old) => *old = entry,
                None => list.push(entry),
            }
        }
        Self(list)
    }

    /// The method of that name.
    ///
    /// # Errors
    /// If there is none; the error lists the names there are.
    pub fn find(&self, name: &str) -> Result<&MethodEntry, MethodError> {
        self.0.iter().find(|m| m.name == name).ok_or_else(|| {
            let known: Vec<&str> = self.0.iter().map(|m| m.name).collect();
            MethodError::Unknown { name: name.to_owned(), known: known.join(", ") }
        })
    }

    /// All methods, in the order they were given.
    pub fn iter(&self) -> std::slice::Iter<'_, MethodEntry> {
        self.0.iter()
    }
}

/// Registries are equal if they name the same methods in the same order.
impl PartialEq for Registry {
    fn eq(&self, other: &Self) -> bool {
        self.iter().map(|m| m.name).eq(other.iter().map(|m| m.name))
    }
}

impl<'a> IntoIterator for &'a Registry {
    type Item = &'a MethodEntry;
    type IntoIter = std::slice::Iter<'a, MethodEntry>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

/// The section of a configuration that is the trainer's alone.
const CAMERAS: &str = "cameras";

/// A resolved configuration without what is the trainer's alone: what [`MethodEntry::build`] gets, and a method parses.
pub fn own_settings(mut config: toml::Table) -> toml::Table {
    config.remove(CAMERAS);
    config
}

/// Whether rows grow and are pruned at a step of the schedule's clock, from 1.
pub type Grows = Box<dyn Fn(u32) -> bool>;

/// Reads the rules by which rows grow from a resolved configuration.
pub type ReadGrowth = fn(&toml::Table) -> Result<Grows, MethodError>;

/// Writes out the effective configuration, with which a run trains, from a resolved one, [`own_settings`]: settings in place of the parts
/// named in `ablate`, and no learning rates of fields, networks and features that are left out. Both build the same method.
pub type Effective = fn(&toml::Table) -> Result<toml::Table, MethodError>;

/// Builds a method for a scene from a resolved configuration, [`own_settings`].
pub type Build = fn(&toml::Table, &SceneInfo) -> Result<Model, MethodError>;

/// What everybody else knows of a method.
#[derive(Clone, Copy, Debug)]
pub struct MethodEntry {
    /// Short name, as in `--method`.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// The configuration as published: layers of TOML, each with what differs from those before it
    /// ([`layers`](crate::layers) has the shared ones). The source of a value stands behind it.
    pub defaults: &'static [&'static str],
    /// Presets: name and layers that differ from the defaults and from each other. They may set options of the data, too.
    pub presets: &'static [(&'static str, &'static [&'static str])],
    /// Domains of settings of its own, beside [`domains::SHARED`].
    pub domains: &'static [Domain],
    /// Whether it can be built only for a filmed person: [`SceneInfo::avatar`].
    pub needs_avatar: bool,
    /// When rows grow and are pruned; none where `[schedule.density]` alone says it.
    pub grows: Option<ReadGrowth>,
    /// How the effective configuration is written out; none where that is the resolved one as it stands.
    pub effective: Option<Effective>,
    /// Builds the method for a scene from a resolved configuration; [`Self::model`] checks the configuration first.
    pub build: Build,
}

impl MethodEntry {
    /// The method for a scene, from a resolved configuration. Section `[cameras]` is the trainer's, and no method sees it.
    ///
    /// # Errors
    /// A setting outside its domain, or those of [`Self::build`].
    pub fn model(&self, config: &toml::Table, scene: &SceneInfo) -> Result<Model, MethodError> {
        self.check(config)?;
        let cameras = match config.get(CAMERAS) {
            Some(toml::Value::Table(cameras)) => parse_config(self.name, cameras)?,
            _ => CameraConfig::default(),
        };
        let wrong = |why: String| MethodError::Config { method: self.name, why };
        cameras.check().map_err(wrong)?;
        Ok((self.build)(&own_settings(config.clone()), scene)?.with_cameras(cameras, Vec::new()))
    }

    /// Fails for the first number of a configuration outside its domain.
    ///
    /// # Errors
    /// [`MethodError::Domain`].
    pub fn check(&self, config: &toml::Table) -> Result<(), MethodError> {
        domains::check(self.name, config, self.domains)
    }

    /// The effective configuration: the method's own settings that a run trains with, once parts named in `ablate` of a resolved
    /// configuration are written out as settings.
    ///
    /// # Errors
    /// If the configuration cannot be read, or names a part in `ablate` that there is not, or that is left out already.
    pub fn effective(&self, config: &toml::Table) -> Result<toml::Table, MethodError> {
        let own = own_settings(config.clone());
        match self.effective {
            Some(effective) => effective(&own),
            None => Ok(own),
        }
    }

    /// The filmed person of a data set, if this method needs one.
    ///
    /// # Errors
    /// [`MethodError::NoAvatar`] if it does and the data bring none.
    pub fn avatar(&self, dataset: &Dataset) -> Result<Option<Arc<AvatarScene>>, MethodError> {
        match &dataset.avatar {
            None if self.needs_avatar => Err(MethodError::NoAvatar { method: self.name, folder: dataset.root.clone() }),
            avatar => Ok(avatar.clone().filter(|_| self.needs_avatar)),
        }
    }

    /// The whole configuration as published.
    ///
    /// # Errors
    /// If a layer is not TOML.
    pub fn published(&self) -> Result<toml::Table, MethodError> {
        let mut config = self.merged(self.defaults)?;
        complete_rates(&mut config);
        Ok(config)
    }

    /// The values of a preset that differ from the defaults.
    ///
    /// # Errors
    /// If there is no such preset (the error lists those there are), or a layer of it is not TOML.
    pub fn preset(&self, name: &str) -> Result<toml::Table, MethodError> {
        let found = self.presets.iter().find(|p| p.0 == name).ok_or_else(|| {
            let known: Vec<&str> = self.presets.iter().map(|p| p.0).collect();
            let why = format!("there is no preset `{name}`; choose one of {}", known.join(", "));
            MethodError::Config { method: self.name, why }
        });
        self.merged(found?.1)
    }

    /// The defaults overlaid with a preset. What it says of `data` is for the reader of data, and left out.
    ///
    /// # Errors
    /// As [`Self::preset`].
    pub fn config(&self, preset: &str) -> Result<toml::Table, MethodError> {
        let mut config = self.published()?;
        overlay(&mut config, self.preset(preset)?);
        config.remove("data");
        Ok(config)
    }

    fn merged(&self, layers: &[&str]) -> Result<toml::Table, MethodError> {
        let wrong = |e: toml::de::Error| MethodError::Config { method: self.name, why: e.to_string() };
        layers.iter().try_fold(toml::Table::new(), |mut under, layer| {
            overlay(&mut under, layer.parse().map_err(wrong)?);
            Ok(under)
        })
    }
}

/// Lays `over` on `under`, table by table.
pub fn overlay(under: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(toml::Value::Table(under)), toml::Value::Table(over)) => overlay(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}

/// Reads a method's configuration.
///
/// # Errors
/// A setting that is missing, unknown or of another type.
pub fn parse_config<C: serde::de::DeserializeOwned>(
    method: &'static str,
    table: &toml::Table,
) -> Result<C, MethodError> {
    table.clone().try_into().map_err(|e: toml::de::Error| MethodError::Config { method, why: e.to_string() })
}

/// Writes a method's configuration, the inverse of [`parse_config`].
///
/// # Errors
/// If it holds what TOML does not.
pub fn write_config<C: serde::Serialize>(method: &'static str, config: &C) -> Result<toml::Table, MethodError> {
    toml::Table::try_from(config).map_err(|e| MethodError::Config { method, why: e.to_string() })
}

/// Reads one section of a configuration.
///
/// # Errors
/// If it is missing, or those of [`parse_config`].
pub fn section<C: serde::de::DeserializeOwned>(
    method: &'static str,
    config: &toml::Table,
    name: &str,
) -> Result<C, MethodError> {
    let missing = || MethodError::Config { method, why: format!("section `{name}` is missing") };
    parse_config(method, config.get(name).and_then(toml::Value::as_table).ok_or_else(missing)?)
}
