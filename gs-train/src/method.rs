//! What a method must provide: a moving scene under training.
//!
//! The trainer, checkpoints, evaluation and the viewer see a method only through [`Method`] and [`MethodEntry`]. A step of
//! training calls, in this order:
//!
//! ```text
//! begin_step → step, once per view (splats → render → backward; regularisers with the last view) → Adam → end_step
//! ```

use crate::capabilities::Capabilities;
use crate::densify::DensifyStats;
use crate::model::Model;
use crate::schedule::{ScheduleError, complete_rates};
use crate::step::StepCtx;
use crate::timestamp::Timestamp;
use gs_core::{Camera, Params, Splats, SplatsGrad, SplatsRef};
use gs_data::Dataset;
use gs_data::avatar::AvatarScene;
use gs_raster::ScreenStats;
use std::path::PathBuf;
use std::sync::Arc;

pub use crate::scene::{InitConfig, SceneInfo};

/// A dynamic scene under training. Parameters are visited through [`Params`], other state through [`Buffers`]. After a
/// change of either from outside, [`Self::begin_step`] is called before anything else.
pub trait Method: Params + Buffers + Send + Sync {
    /// Step `at.step` is about to be made, or was the last one made. Whatever depends on the step, such as the SH degree or
    /// whether the deformation field takes part, follows from it; caches of earlier parameters are dropped.
    fn begin_step(&mut self, at: &StepCtx);

    /// The splats at a timestamp as `camera` sees them, without gradients.
    ///
    /// # Errors
    /// If an input of the method cannot be read.
    fn splats(&self, at: &Timestamp, camera: &Camera) -> Result<Splats, MethodError>;

    /// Forward and backward of one training view: builds the splats, hands them to `render`, and adds what comes back to the
    /// gradient of every parameter. With the last view of a step, regularisers add theirs. A view may be left unrendered.
    ///
    /// Returns the regularisers, weights applied, by name.
    ///
    /// # Errors
    /// Those of `render`, and of inputs that cannot be read. The parameters are to be thrown away.
    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError>;

    /// After the optimiser's update: densification, and whatever else follows from the step's statistics.
    ///
    /// # Errors
    /// If an input of the method cannot be read.
    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        Ok(StepEvents::default())
    }

    /// Number of splats, at most (an anchor counts with all it can be decoded to).
    fn splat_count(&self) -> usize;

    /// What this method offers beyond training and rendering.
    fn capabilities(&self) -> Capabilities<'_> {
        Capabilities::default()
    }
}

/// A loss value by name, weight applied.
pub type LossValue = (&'static str, f32);

/// One training view, as a method sees it.
#[derive(Clone, Copy, Debug)]
pub struct ViewCtx<'a> {
    /// When the image was taken.
    pub at: Timestamp,
    /// The camera, at the size of the training image.
    pub camera: &'a Camera,
    /// Whether this is the last view of the step.
    pub last: bool,
}

/// Renders the splats of a training view, compares them with the ground-truth image, and pulls the loss back to the splats.
pub trait RenderView {
    /// Writes the cotangents of every column of `splats` into `grad`, whatever it held. The statistics are of the loss of
    /// this view alone.
    ///
    /// # Errors
    /// If the ground truth cannot be read, or the loss is not finite.
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError>;
}

/// What followed from a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepEvents {
    /// Splats cloned, split and pruned.
    pub densified: DensifyStats,
    /// Events worth keeping (an interval boundary that moved, say): one JSON object each, with its `step`.
    pub log: Vec<serde_json::Value>,
}

/// State of a method that is not a parameter (statistics of densification, say). It is kept in checkpoints.
pub trait Buffers {
    /// Calls `f` on every buffer, in a fixed order.
    fn buffers(&self, _f: &mut dyn FnMut(Buffer<'_>)) {}

    /// The same, to be restored. Buffers with rows may have any length before; afterwards they must fit the parameters.
    fn buffers_mut(&mut self, _f: &mut dyn FnMut(BufferMut<'_>)) {}
}

/// A named buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Buffer<'a> {
    /// Dotted name, unique within a method.
    pub name: &'static str,
    /// `Some(w)`: `w` values per row of the row blocks; `None`: any number of values.
    pub row_width: Option<usize>,
    /// The values.
    pub values: &'a Vec<f32>,
}

/// A [`Buffer`] to be restored.
#[derive(Debug)]
pub struct BufferMut<'a> {
    /// Dotted name, unique within a method.
    pub name: &'static str,
    /// As in [`Buffer`].
    pub row_width: Option<usize>,
    /// The values.
    pub values: &'a mut Vec<f32>,
}

/// A method that cannot be built, trained or rendered.
#[derive(Debug, thiserror::Error)]
pub enum MethodError {
    /// No method of that name.
    #[error("there is no method `{name}`; choose one of {known}")]
    Unknown {
        /// Name asked for.
        name: String,
        /// Names there are.
        known: String,
    },
    /// The configuration does not fit the method.
    #[error("configuration of method `{method}`: {why}")]
    Config {
        /// Name of the method.
        method: &'static str,
        /// What is wrong, and where.
        why: String,
    },
    /// The schedule cannot be followed.
    #[error(transparent)]
    Schedule(#[from] ScheduleError),
    /// The initial points cannot be used.
    #[error(transparent)]
    Cloud(#[from] gs_core::cloud::CloudError),
    /// The images the first points are carved from cannot be read.
    #[error(transparent)]
    Data(Box<gs_data::DataError>),
    /// The data show no person with a template.
    #[error(
        "method `{method}` needs a filmed person with template and poses (layout avatar), and {} holds none; make one \
         with `gs4d synth avatar`, or choose another method",
        if folder.as_os_str().is_empty() { "the data set".into() } else { folder.display().to_string() }
    )]
    NoAvatar {
        /// Name of the method.
        method: &'static str,
        /// The folder of the data.
        folder: PathBuf,
    },
    /// A timestamp cannot be made into splats: an input image that cannot be read, say.
    #[error("{0}")]
    Render(String),
    /// The image loss of a training view is not finite or not defined.
    #[error(transparent)]
    Loss(Box<gs_metrics::MetricError>),
    /// Row blocks that belong together do not fit each other.
    #[error(transparent)]
    Rows(#[from] gs_core::param::RowEditError),
    /// The scene or its initial points cannot be used.
    #[error("scene: {0}")]
    Scene(String),
}

impl From<gs_data::DataError> for MethodError {
    fn from(e: gs_data::DataError) -> Self {
        Self::Data(Box::new(e))
    }
}

impl From<gs_metrics::MetricError> for MethodError {
    fn from(e: gs_metrics::MetricError) -> Self {
        Self::Loss(Box::new(e))
    }
}

/// Builds a method for a scene from a resolved configuration.
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
    /// Presets: name and layers that differ from the defaults and from each other.
    pub presets: &'static [(&'static str, &'static [&'static str])],
    /// Whether it can be built only for a filmed person: [`SceneInfo::avatar`].
    pub needs_avatar: bool,
    /// Builds the method for a scene from a resolved configuration.
    pub build: Build,
}

impl MethodEntry {
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

    /// The defaults overlaid with a preset.
    ///
    /// # Errors
    /// As [`Self::preset`].
    pub fn config(&self, preset: &str) -> Result<toml::Table, MethodError> {
        let mut config = self.published()?;
        overlay(&mut config, self.preset(preset)?);
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
pub fn parse_config<C: serde::de::DeserializeOwned>(
    method: &'static str,
    table: &toml::Table,
) -> Result<C, MethodError> {
    table.clone().try_into().map_err(|e: toml::de::Error| MethodError::Config { method, why: e.to_string() })
}

/// Reads one section of a configuration.
pub fn section<C: serde::de::DeserializeOwned>(
    method: &'static str,
    config: &toml::Table,
    name: &str,
) -> Result<C, MethodError> {
    let missing = || MethodError::Config { method, why: format!("section `{name}` is missing") };
    parse_config(method, config.get(name).and_then(toml::Value::as_table).ok_or_else(missing)?)
}
