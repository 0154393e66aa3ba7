//! Experiments about filmed people: what the textures that cameras give are worth, and what a method makes of them when
//! poses, views, motion or light are not those it learnt from.
//!
//! An experiment films the built-in person (or a character from a file), or takes the film of a run. Those about textures
//! train nothing: the truth is the template's own colour at each texel, on the surface that the pictures show. Those about
//! the method need a run, or train one.

mod learning;
mod pose;
mod subject;
mod table;
mod texture;
mod trained;
mod views;
mod visibility;

pub use subject::Subject;
pub use table::{Cell, Chart, Findings, Head, WriteError};
pub use trained::{Recipe, Trained};

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

/// The methods that draw people.
fn registry() -> Registry {
    Registry::new(METHODS.to_vec())
}

/// What an experiment has to do with training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Training {
    /// Nothing.
    None,
    /// With a run it says more.
    Welcome,
    /// It needs a run, or trains.
    Needed,
}

/// An experiment.
pub struct Experiment {
    /// Its name.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// What it has to do with training.
    pub training: Training,
    run: fn(&Setup, &mut Tell<'_>) -> Result<Findings, LabError>,
}

/// Where an experiment says what it does.
pub type Tell<'a> = dyn FnMut(&str) + 'a;

/// The experiments there are.
pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "tex",
        about: "sizes of textures: error, time, bytes; with --steps what the method makes of each",
        training: Training::Welcome,
        run: texture::sizes,
    },
    Experiment {
        name: "motion",
        about: "an elbow that is 0 to 60 degrees wrong, in all frames and growing from frame to frame",
        training: Training::Welcome,
        run: pose::motion,
    },
    Experiment { name: "mocap", about: "noise on every joint", training: Training::Welcome, run: pose::mocap },
    Experiment {
        name: "views",
        about: "1 to 8 conditioning cameras, and one of them left out",
        training: Training::Welcome,
        run: views::views,
    },
    Experiment {
        name: "vis",
        about: "rules of visibility: texture, false visible, false hidden, time",
        training: Training::None,
        run: visibility::rules,
    },
    Experiment {
        name: "thresholds",
        about: "least cosine and depth tolerance of the four-tap rule",
        training: Training::None,
        run: visibility::thresholds,
    },
    Experiment {
        name: "ood",
        about: "a motion never learnt from",
        training: Training::Needed,
        run: learning::unseen_motion,
    },
    Experiment {
        name: "light",
        about: "a light never learnt from, and a few steps of learning under it",
        training: Training::Needed,
        run: learning::other_light,
    },
    Experiment {
        name: "ablate",
        about: "parts left out: of a run when drawing, with --steps when learning",
        training: Training::Needed,
        run: learning::parts,
    },
];

impl Experiment {
    /// The experiment of that name.
    pub fn find(name: &str) -> Option<&'static Self> {
        EXPERIMENTS.iter().find(|e| e.name == name)
    }

    /// Makes it.
    ///
    /// # Errors
    /// If it lacks a run or steps, or film, run or training fail.
    pub fn run(&self, setup: &Setup, tell: &mut Tell<'_>) -> Result<Findings, LabError> {
        if self.training == Training::Needed && setup.run.is_none() && setup.recipe.is_none() {
            return Err(LabError::NeedsTraining(self.name));
        }
        (self.run)(setup, tell)
    }
}

/// What experiments are made with.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// What is filmed where no run brings its film along.
    pub film: AvatarOptions,
    /// A run of the method `dut`.
    pub run: Option<PathBuf>,
    /// How to train where there is no run, or several are to be compared.
    pub recipe: Option<Recipe>,
    /// Frames looked at, at most, evenly spread.
    pub frames: usize,
    /// Texels per side of the textures unprojected.
    pub texels: usize,
    /// Texels per side that `tex` compares.
    pub sizes: Vec<usize>,
    /// The joint that `motion` turns; none: the left fore arm by its name.
    pub joint: Option<String>,
    /// The motion that `ood` tests on; none: another than the film's.
    pub other_clip: Option<String>,
    /// The light that `light` tests under.
    pub other_light: Light,
    /// Steps that `light` goes on learning under it.
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
            other_light: Light { direction: [-1.0, 0.5, -0.4], ambient: 0.35 },
            tuning: 100,
        }
    }
}

/// Why an experiment was not made.
#[derive(Debug, thiserror::Error)]
pub enum LabError {
    /// It is about a method that has learnt something.
    #[error("the experiment {0} needs a trained method")]
    NeedsTraining(&'static str),
    /// A choice that the film does not have.
    #[error("{what} `{asked}` is not there; there are {known}")]
    Unknown {
        /// What was to be chosen.
        what: &'static str,
        /// The choice.
        asked: String,
        /// What there is.
        known: String,
    },
    /// The experiment cannot be made with this run or film.
    #[error("{0}")]
    Unfit(String),
    /// Film or pictures.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The run.
    #[error(transparent)]
    Run(Box<RunError>),
    /// The method.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Training.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// Scores.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// A frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The template's texels.
    #[error("template: {0}")]
    Texels(#[from] TexelError),
    /// The template's faces.
    #[error("template: {0}")]
    Mesh(#[from] MeshError),
    /// Unprojection.
    #[error(transparent)]
    Unproject(#[from] UnprojectError),
}

impl From<RunError> for LabError {
    fn from(e: RunError) -> Self {
        Self::Run(Box::new(e))
    }
}
