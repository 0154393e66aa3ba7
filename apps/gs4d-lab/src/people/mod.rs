//! Experiments on avatars (method `dut`): quality of the unprojected textures, and of the method under poses, views, motion or
//! light that differ from the training data.
//!
//! An experiment generates a synthetic capture of the built-in person or of a character file (the *film*), or uses the data of
//! a run. Texture experiments train nothing: ground truth is the template's colour at each texel, on the true surface.
//! Experiments on the method need a run, or train one.

mod learning;
mod loose;
mod pose;
mod region;
mod subject;
mod table;
#[cfg(test)]
mod tests;
mod texture;
mod topo;
mod trained;
mod views;
mod visibility;

pub use table::{Cell, Chart, Findings, Head, WriteError};
pub use trained::{Recipe, Trained};

use subject::Subject;

use gs_data::DataError;
use gs_method_texel::FrameError;
use gs_method_texel::METHODS;
use gs_synth::avatar::{AvatarOptions, Light};
use gs_texel::surface::MeshError;
use gs_texel::texels::TexelError;
use gs_texel::unproject::UnprojectError;
use gs_train::evaluate::EvalError;
use gs_train::method::MethodError;
use gs_train::registry::Registry;
use gs_train::trainer::TrainError;
use gs4d_run::RunError;
use std::path::PathBuf;

/// The avatar methods.
fn registry() -> Registry {
    Registry::new(METHODS.to_vec())
}

/// Whether an experiment uses a trained method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Training {
    /// Never.
    None,
    /// With a run or a recipe there are more columns.
    Optional,
    /// It needs a run or a recipe.
    Required,
}

/// An experiment of `gs4d lab`.
pub struct Experiment {
    /// Name on the command line and of the output files.
    pub name: &'static str,
    /// One line for the list of experiments.
    pub about: &'static str,
    /// Whether it uses a trained method.
    pub training: Training,
    /// The character to film where none is named, as [`AvatarOptions::template`].
    pub template: &'static str,
    run: fn(&Setup, &mut Log<'_>) -> Result<Findings, LabError>,
}

/// Receives one line of text for each part of an experiment.
pub type Log<'a> = dyn FnMut(&str) + 'a;

/// The character of most experiments.
const PERSON: &str = "builtin:person";

/// All experiments.
pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "tex",
        about: "sizes of textures: error, time, bytes; with --steps what the method makes of each",
        training: Training::Optional,
        template: PERSON,
        run: texture::sizes,
    },
    Experiment {
        name: "motion",
        about: "an elbow that is 0 to 60 degrees wrong, in all frames and growing from frame to frame",
        training: Training::Optional,
        template: PERSON,
        run: pose::motion,
    },
    Experiment {
        name: "mocap",
        about: "noise on every joint",
        training: Training::Optional,
        template: PERSON,
        run: pose::mocap,
    },
    Experiment {
        name: "views",
        about: "1 to 8 conditioning cameras, and one of them left out",
        training: Training::Optional,
        template: PERSON,
        run: views::views,
    },
    Experiment {
        name: "vis",
        about: "rules of visibility: texture, false visible, false hidden, time",
        training: Training::None,
        template: PERSON,
        run: visibility::rules,
    },
    Experiment {
        name: "thresholds",
        about: "least cosine and depth tolerance of the four-tap rule",
        training: Training::None,
        template: PERSON,
        run: visibility::thresholds,
    },
    Experiment {
        name: "loose",
        about: "clothing that swings beside the pose: without offsets, with GeoNet's, on the true surface",
        training: Training::Optional,
        template: "builtin:gown",
        run: loose::loose,
    },
    Experiment {
        name: "topo",
        about: "a hand that touches the body and leaves it: both textures, and with --steps the images there",
        training: Training::Optional,
        template: PERSON,
        run: topo::topo,
    },
    Experiment {
        name: "ood",
        about: "a motion never learnt from",
        training: Training::Required,
        template: PERSON,
        run: learning::unseen_motion,
    },
    Experiment {
        name: "light",
        about: "a light never learnt from, and a few steps of learning under it",
        training: Training::Required,
        template: PERSON,
        run: learning::other_light,
    },
    Experiment {
        name: "ablate",
        about: "parts left out: of a run at render time, with --steps in training",
        training: Training::Required,
        template: PERSON,
        run: learning::parts,
    },
];

impl Experiment {
    /// Finds an experiment by name.
    pub fn find(name: &str) -> Option<&'static Self> {
        EXPERIMENTS.iter().find(|e| e.name == name)
    }

    /// Runs the experiment.
    ///
    /// # Errors
    /// [`LabError::NeedsTraining`] without the run or recipe it requires; any error of the data, the run or the training.
    pub fn run(&self, setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
        if self.training == Training::Required && setup.run.is_none() && setup.recipe.is_none() {
            return Err(LabError::NeedsTraining(self.name));
        }
        (self.run)(setup, log)
    }
}

/// Data, method and options of an experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The synthetic capture that is generated when there is no `run`.
    pub film: AvatarOptions,
    /// Folder of a run of the method `dut`; its data replace `film`.
    pub run: Option<PathBuf>,
    /// How to train when there is no `run`, or several settings are compared.
    pub recipe: Option<Recipe>,
    /// Most frames evaluated, evenly spread over those with test views. Default: 4.
    pub frames: usize,
    /// Texels per side of the unprojected textures. Default: 256.
    pub texels: usize,
    /// Texels per side compared by `tex`.
    pub sizes: Vec<usize>,
    /// The joint rotated by `motion`, and the fore arm of `topo`; `None`: the left forearm, found by its name.
    pub joint: Option<String>,
    /// The motion clip tested by `ood`; `None`: the first that is not the film's.
    pub other_clip: Option<String>,
    /// The light tested by `light`.
    pub other_light: Light,
    /// Fine-tuning steps of `light` under that light. Default: 100.
    pub tuning: u32,
}

impl Default for Setup {
    fn default() -> Self {
        let film = AvatarOptions { frames: 16, test_every: 4, ..AvatarOptions::default() };
        Self {
            film,
            run: None,
            recipe: None,
            frames: 4,
            texels: 256,
            sizes: vec![64, 128, 256, 512],
            joint: None,
            other_clip: None,
            other_light: Light { direction: [-1.0, 0.5, -0.4], ambient: 0.35, shadows: true },
            tuning: 100,
        }
    }
}

/// Why an experiment failed.
#[derive(Debug, thiserror::Error)]
pub enum LabError {
    /// The experiment needs a run or a recipe.
    #[error("the experiment {0} needs a trained method")]
    NeedsTraining(&'static str),
    /// No joint or motion clip of that name.
    #[error("{what} `{asked}` is not there; there are {known}")]
    Unknown {
        /// Kind of item, for example `the joint`.
        what: &'static str,
        /// The name asked for.
        asked: String,
        /// The available names.
        known: String,
    },
    /// The run or its data do not suit the experiment.
    #[error("{0}")]
    Unfit(String),
    /// The dataset or its images cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The run cannot be opened, or its settings are invalid.
    #[error(transparent)]
    Run(Box<RunError>),
    /// The method cannot be built or evaluated.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Training failed.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// Scoring failed.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// A frame cannot be computed.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The template has no atlas, or its texels overlap.
    #[error("template: {0}")]
    Texels(#[from] TexelError),
    /// The template's faces are invalid.
    #[error("template: {0}")]
    Mesh(#[from] MeshError),
    /// Unprojection failed.
    #[error(transparent)]
    Unproject(#[from] UnprojectError),
}

impl From<RunError> for LabError {
    fn from(e: RunError) -> Self {
        Self::Run(Box::new(e))
    }
}
