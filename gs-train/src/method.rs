//! Methods: a moving scene under training. One file is one method is one line in [`METHODS`].
//!
//! Trainer, checkpoint, evaluation, viewer and command line see a method only through [`MethodEntry`] and [`Method`].

use crate::densify::Adapted;
use crate::schedule::{Schedule, ScheduleError};
use crate::timestamp::Moment;
use glam::Vec3;
use gs_anchor::StorageTable;
use gs_core::{Camera, Params, Splats, SplatsGrad};
use gs_data::Dataset;
use gs_data::avatar::AvatarScene;
use gs_deform::field::grid4d::{StillOptions, StillReport};
use gs_physics::Motion;
use gs_raster::ScreenStats;
use std::path::PathBuf;
use std::sync::Arc;

use crate::palette::color_scale;
pub use crate::scene::{InitConfig, SceneInfo};

/// A colour per splat that shows something about it, drawn by the same rasteriser.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlay {
    /// `velocity`, `gate`, `segment`, …
    pub name: &'static str,
    /// One colour per splat of [`Method::tracked`] at the same moment, display-encoded, 0 to 1.
    pub colors: Vec<[f32; 3]>,
    /// What the colours say.
    pub meaning: &'static str,
}

/// A number about each splat.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// `lambda`, `beta`, `gate`, …
    pub name: &'static str,
    /// Its unit; empty for a pure number.
    pub unit: &'static str,
    /// The interval its colours and histograms span; from the smallest to the largest value if absent.
    pub range: Option<[f32; 2]>,
    /// One value per splat of [`Method::tracked`] at the same moment.
    pub values: Vec<f32>,
}

impl Quantity {
    /// A pure number in `[0, 1]`.
    pub fn share(name: &'static str, values: Vec<f32>) -> Self {
        Self { name, unit: "", range: Some([0.0, 1.0]), values }
    }

    /// The interval its colours and histograms span.
    pub fn span(&self) -> [f32; 2] {
        self.range.unwrap_or_else(|| {
            let whole = [f32::INFINITY, f32::NEG_INFINITY];
            let [low, high] = self.values.iter().fold(whole, |[a, b], &v| [a.min(v), b.max(v)]);
            if low < high { [low, high] } else { [low, low + 1.0] }
        })
    }

    /// The span on [`color_scale`].
    pub fn overlay(&self) -> Overlay {
        let [low, high] = self.span();
        let colors = self.values.iter().map(|v| color_scale((v - low) / (high - low))).collect();
        Overlay { name: self.name, colors, meaning: "dark blue is least, pale yellow most" }
    }
}

/// State of a method that is not a parameter: growth statistics, say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column<'a> {
    /// Dotted name, unique within a method.
    pub name: &'static str,
    /// `Some(w)`: `w` values per row of the row blocks; `None`: as many as there are.
    pub row_width: Option<usize>,
    /// The values.
    pub values: &'a Vec<f32>,
}

impl<'a> Column<'a> {
    /// One value per row.
    pub fn per_row((name, values): (&'static str, &'a Vec<f32>)) -> Self {
        Self { name, row_width: Some(1), values }
    }
}

/// A [`Column`] to be restored.
#[derive(Debug)]
pub struct ColumnMut<'a> {
    /// Dotted name, unique within a method.
    pub name: &'static str,
    /// As in [`Column`].
    pub row_width: Option<usize>,
    /// The values.
    pub values: &'a mut Vec<f32>,
}

impl<'a> ColumnMut<'a> {
    /// One value per row.
    pub fn per_row((name, values): (&'static str, &'a mut Vec<f32>)) -> Self {
        Self { name, row_width: Some(1), values }
    }
}

/// The scene part of the way to a moment.
#[derive(Clone, Debug, PartialEq)]
pub struct StageView {
    /// `canonical`, `global`, `local`, `full`.
    pub name: &'static str,
    /// What would be drawn at this stage.
    pub splats: Splats,
    /// Where the same splats were one stage earlier; absent in the first stage.
    pub before: Option<Vec<Vec3>>,
}

/// The splats of [`Method::tracked`] as rigid particles: where they are at one moment and how they move from there.
#[derive(Clone, Debug, PartialEq)]
pub struct Particles {
    /// The moment, normalised: the last one that the scene's deformation is asked for.
    pub at: f64,
    /// The splats at that moment.
    pub splats: Splats,
    /// How each moves from then on, per unit of normalised time.
    pub motions: Vec<Motion<f32>>,
    /// The origin that twists refer to, world units.
    pub origin: Vec3,
}

/// A filmed person that can be put into other poses than those it was filmed in.
pub trait Figure {
    /// The character and what was filmed of it.
    fn scene(&self) -> &AvatarScene;

    /// The splats that the images of a moment's frame give in the pose of that frame, carried by the skinning of another
    /// pose: looks stay those of the images.
    ///
    /// # Errors
    /// In words, if the images cannot be read or the pose does not fit.
    fn posed(&self, at: &Moment, pose: &gs_texel::Pose) -> Result<Splats, String>;
}

/// A dynamic scene under training.
pub trait Method: Params + Send + Sync {
    /// The name in [`METHODS`].
    fn name(&self) -> &'static str;

    /// Stages, learning rates by name, loss weights.
    fn schedule(&self) -> &Schedule;

    /// The clock: step `step` (from 1) is about to be made, or was the last one made. Whatever depends on the step, such
    /// as the SH degree or whether the field takes part, follows from it.
    fn set_step(&mut self, step: u32);

    /// The scene as `camera` would see it at this moment (no gradients kept).
    fn splats(&self, at: &Moment, camera: &Camera) -> Splats;

    /// The same on the way to a gradient: builds the splats, hands them to `draw`, which writes their cotangents into its
    /// second argument (all zero on entry), and adds what comes back into every `grad`.
    fn step(&mut self, at: &Moment, camera: &Camera, draw: &mut dyn FnMut(&Splats, &mut SplatsGrad));

    /// Regularisers that need no image: adds their gradients, gives their values with weights applied.
    fn penalties(&mut self, _step: u32) -> Vec<(&'static str, f32)> {
        Vec::new()
    }

    /// What a view told, once for each view of a step, after [`Method::step`] and before the optimiser's update. The
    /// gradients in `seen` are those of this view's loss alone.
    fn observe(&mut self, _at: &Moment, _seen: &ScreenStats, _camera: &Camera) {}

    /// Density control after the optimiser's update of step `step`, by what was observed.
    fn adapt(&mut self, _step: u32) -> Adapted {
        Adapted::default()
    }

    /// All splats there are, in the same order at every moment: [`Method::len`] of them, those that are not there at this
    /// moment with opacity 0. What `camera` is matters only where looks depend on the view.
    fn tracked(&self, at: &Moment, camera: &Camera) -> Splats {
        self.splats(at, camera)
    }

    /// The splats as particles whose motion the method has learnt, where it learns such a thing.
    fn particles(&self) -> Option<Particles> {
        None
    }

    /// The person, for a method that draws one who can be posed.
    fn figure(&self) -> Option<&dyn Figure> {
        None
    }

    /// Whether the present step looks at a photograph. One that does not has nothing to draw.
    fn looks(&self) -> bool {
        true
    }

    /// What went wrong when something was drawn or learnt: a file that cannot be read, say. What was drawn since is not to
    /// be believed.
    fn trouble(&self) -> Option<String> {
        None
    }

    /// What of its configuration will not do what it seems to, for people.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    /// What happened since the last call and is worth keeping (how interval boundaries moved, say); one line each,
    /// with its `step`.
    fn journal(&mut self) -> Vec<serde_json::Value> {
        Vec::new()
    }

    /// The stages a scene passes on its way to this moment, as `camera` sees them, the last being [`Method::splats`].
    fn stages(&self, at: &Moment, camera: &Camera) -> Vec<StageView> {
        vec![StageView { name: "full", splats: self.splats(at, camera), before: None }]
    }

    /// Numbers about each splat of [`Method::tracked`] at this moment that are worth looking at.
    fn quantities(&self, _at: &Moment) -> Vec<Quantity> {
        Vec::new()
    }

    /// What may be drawn over the scene at this moment: at least every quantity as a colour.
    fn overlays(&self, at: &Moment) -> Vec<Overlay> {
        self.quantities(at).iter().map(Quantity::overlay).collect()
    }

    /// What the scene takes on the disk by the rule of its paper, where there is one.
    fn storage(&self) -> Option<StorageTable> {
        None
    }

    /// The same scene for drawing alone, with what only training needs left out without changing a picture: its
    /// configuration, made of this one, and the method. None if there is nothing to leave out.
    fn folded(&self, _config: &toml::Table) -> Option<(toml::Table, Box<dyn Method>)> {
        None
    }

    /// The same scene for drawing alone with still parts left where they rest, an approximation, and what was left; any
    /// change of a parameter ends it. None if the method has no such way or nothing moves.
    fn resting(&self, _options: &RestOptions<'_>) -> Option<(Box<dyn Method>, RestReport)> {
        None
    }

    /// A block of rows whose values are whole multiples of a length, and that length, world units.
    fn lattice(&self) -> Option<(&'static str, f32)> {
        None
    }

    /// State that is not a parameter, for checkpoints.
    fn columns(&self) -> Vec<Column<'_>> {
        Vec::new()
    }

    /// The same, to be restored. Those with rows may have any length before; afterwards they must fit the parameters.
    fn columns_mut(&mut self) -> Vec<ColumnMut<'_>> {
        Vec::new()
    }

    /// Number of splats, at most (an anchor counts with all it can be decoded to).
    fn len(&self) -> usize;

    /// How far and when the number of splats grows; none if it stays.
    fn growth(&self) -> Option<Growth> {
        Some(self.schedule().density.growth())
    }

    /// Whether there is none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// What bounds the growth of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Growth {
    /// Splats, at most.
    pub most: usize,
    /// It grows after this step of the schedule's clock,
    pub from: u32,
    /// and before this one.
    pub until: u32,
}

/// What may be left where it rests.
#[derive(Clone, Copy, Debug)]
pub struct RestOptions<'a> {
    /// Tolerance of a centre in pixels, probe times, and the cameras that will be drawn from; with no camera nothing
    /// that moves is baked.
    pub still: StillOptions<'a>,
    /// Tolerance of scales and rotations, a share of them.
    pub shape: f32,
    /// Local factors below this count as zero where the global one is.
    pub weight: f32,
}

impl<'a> RestOptions<'a> {
    /// 0.05 pixels, 0.1 % and 1e-4, at 17 times.
    pub fn usual(cameras: &'a [Camera]) -> Self {
        Self { still: StillOptions { pixels: 0.05, probes: 17, cameras }, shape: 1e-3, weight: 1e-4 }
    }
}

/// What was left where it rests, and what it may cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestReport {
    /// Rows of all anchors, those baked, and the largest way of a centre among them.
    pub rows: StillReport,
    /// Largest change of shape among them, a share.
    pub shape: f32,
    /// Rows that were within the tolerances at the probe times but not between them; they are not baked.
    pub between: usize,
    /// Anchors that GAD is not asked about.
    pub anchors: usize,
}

/// A method that cannot be built.
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
    /// The photographs the first points are carved from cannot be read.
    #[error(transparent)]
    Data(#[from] gs_data::DataError),
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
    /// The scene or its initial points cannot be used.
    #[error("scene: {0}")]
    Scene(String),
}

/// Builds a method for a scene from a resolved configuration.
pub type Build = fn(&toml::Table, &SceneInfo) -> Result<Box<dyn Method>, MethodError>;

/// What everybody else knows of a method.
#[derive(Clone, Copy, Debug)]
pub struct MethodEntry {
    /// Short name, as in `--method`.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// The whole configuration as published, TOML; the source of a value stands behind it.
    pub defaults: &'static str,
    /// Presets: name and the values that differ from the defaults, TOML.
    pub presets: &'static [(&'static str, &'static str)],
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

    /// The defaults overlaid with a preset.
    ///
    /// # Errors
    /// If there is no such preset.
    pub fn config(&self, preset: &str) -> Result<toml::Table, MethodError> {
        let wrong = |why: String| MethodError::Config { method: self.name, why };
        let parse = |text: &str| text.parse::<toml::Table>().map_err(|e| wrong(e.to_string()));
        let mut config = parse(self.defaults)?;
        let Some((_, text)) = self.presets.iter().find(|p| p.0 == preset) else {
            let known: Vec<&str> = self.presets.iter().map(|p| p.0).collect();
            return Err(wrong(format!("there is no preset `{preset}`; choose one of {}", known.join(", "))));
        };
        overlay(&mut config, parse(text)?);
        Ok(config)
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
