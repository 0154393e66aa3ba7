//! Training of dynamic Gaussian splats: from images with timestamps to a scene that renders at any time.
//!
//! ```text
//! image, timestamp → splats → render → loss → gradients → parameters
//! ```
//! * [`method`]: what a method must provide ([`Method`](method::Method)); [`registry`]: the methods a program knows and their settings;
//!   methods are crates that depend on this one.
//! * [`trainer`]: one optimiser step and the whole state in and out; [`schedule`]: stages and learning rates; [`adam`];
//!   [`loss`]; [`densify`]: clone, split, prune; `non_finite`: gradients that are refused.
//! * [`canonical`], [`kernel`], [`scene`]: the cloud of Gaussians that several methods share, and what it starts from;
//!   [`layers`]: the settings that several methods share.
//! * `conformance` (cargo feature of that name): what every method must keep, as checks for its tests. `testkit` (the same): short runs.
//! * [`report`]: the section that a method adds to the report of a run.
//! * [`cameras`]: corrections of training cameras that are learnt with the scene.
//! * [`ranks`]: processes that make every step together, with the bits of one.
//! * [`checkpoint`], [`saved`]: atomic files of the whole state; [`evaluate`], [`renderer`]: scores and images of a method;
//!   [`device`]: what frames are rendered on.
//!
//! # Example
//! A data set, a method by its name, steps of training, an image at any time:
//! ```
//! use gs_synth::{SynthOptions, generate};
//! use gs_train::renderer::Renderer;
//! use gs_train::trainer::{TrainOptions, Trainer};
//! use std::sync::Arc;
//!
//! let scene = generate("balls", &SynthOptions::of_views(32, 8, 1))?;
//! let registry = gs_methods::registry();
//! let config = registry.find("fourdgs")?.config("tiny")?;
//! let data = Arc::new(scene.dataset);
//! let mut trainer = Trainer::new(registry, data.clone(), "fourdgs", &config, TrainOptions::default())?;
//! let loss = trainer.step()?.loss.total;
//! assert!(loss.is_finite() && trainer.steps_done() == 1);
//!
//! let model = trainer.model();
//! let image = Renderer::new(model.raster_options(model.background())).at(model, 0.5, &data.test[0].camera)?;
//! assert_eq!((image.width, image.height), (32, 32));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Conventions
//! Those of [`gs_core`] and [`gs_raster`]; times are [`gs_core::Time`]s, normalised as the data set says. A configuration is a resolved
//! [`toml::Table`]: that of a preset is [`MethodEntry::config`](registry::MethodEntry::config), and every setting is read from it once.
//!
//! # What it leaves out
//! Any method (`gs-methods`), reading of data (`gs-data`), run folders and their reports (`gs4d-run`), ranks on a network (`gs4d-mpi`).
//!
//! # Promises
//! A run is a function of data, configuration and seed: the same bits for any number of threads and ranks, and after any
//! interruption, on one instruction set and device. Gradients that are not finite are refused, counted and named.
#![warn(unreachable_pub)]

pub mod ablate;
pub mod adam;
pub mod cameras;
#[cfg(feature = "cloud")]
pub mod canonical;
pub mod capabilities;
pub mod checkpoint;
mod clocks;
#[cfg(feature = "conformance")]
pub mod conformance;
pub mod densify;
pub mod device;
pub mod domains;
pub mod error;
pub mod evaluate;
pub mod jumps;
pub mod kernel;
pub mod layers;
pub mod loss;
pub mod method;
pub mod model;
mod non_finite;
pub mod palette;
pub mod ranks;
pub mod registry;
pub mod renderer;
pub mod report;
pub mod saved;
pub mod scene;
pub mod schedule;
pub mod step;
pub mod still;
#[cfg(any(test, feature = "testkit", feature = "conformance"))]
pub mod testkit;
pub mod timeline;
pub mod timestamp;
pub mod trainer;
