//! Checkpoints of other codes as scenes of gs4d.
//!
//! A checkpoint is first written as one safetensors file by `docs/guide/export_checkpoint.py`, where its code runs: the columns of
//! `point_cloud.ply` as `ply.NAME`, the networks under the names they have there, the settings (`cfg_args`) and the iteration in the
//! metadata. [`Scene::read`] turns it into the method, settings and tensors that gs4d has for the same scene:
//!
//! | code | method | what is left out |
//! |---|---|---|
//! | 4DGaussians (Wu et al. 2024) | `fourdgs` | opacities and colours that change with time are refused |
//! | Deformable-3D-GS (Yang et al. 2024) | `defgs` | 6-DoF deformation is refused |
//! | Grid4D (Xu et al. 2024) | `grid4d` | – |
//! | Scaffold-GS (Lu et al. 2024) | `scaffold` | one vector of appearance, the mean, stands for all cameras |
//! | TRACE (Li et al. 2025) | `trace` | when the field ends and how long a step is, which depends on the data; 6-DoF deformation is refused |
//!
//! Deformable-3D-GS and Grid4D hand the sum of a unit quaternion and its offset to a rasteriser that does not normalise it, which changes
//! the covariance where the sum is not of length 1. gs4d normalises, so there a splat that turns much has another shape.
//!
//! ```no_run
//! use gs4d_checkpoints::Scene;
//!
//! let scene = Scene::read(&std::fs::read("mutant.safetensors").unwrap())?;
//! println!("{}, iteration {}: {} rows for method {}", scene.code, scene.iteration, scene.rows, scene.method);
//! # Ok::<(), gs4d_checkpoints::CheckpointError>(())
//! ```
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

mod cloud;
mod deformable;
mod error;
mod file;
mod four_dgs;
mod grid4d;
mod hash_table;
mod scaffold;
mod trace;

pub use error::CheckpointError;

use file::Exported;
use glam::Vec3;

/// A scene that another code has trained, in the terms of gs4d.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Name of the code: `4DGaussians`, `Deformable-3D-GS`, `Grid4D`, `Scaffold-GS` or `TRACE`.
    pub code: &'static str,
    /// Iteration of the checkpoint.
    pub iteration: u64,
    /// The method that has this scene's parameters.
    pub method: &'static str,
    /// Number of Gaussians, or of anchors.
    pub rows: usize,
    /// Settings that differ from the method's preset `paper`, by dotted key.
    pub settings: Vec<(String, toml::Value)>,
    /// Every parameter of the method by its name, as a checkpoint of gs4d holds it.
    pub tensors: Vec<(String, Vec<f32>)>,
    /// Lower and upper corner of the box that the field covers, or of all rows; world units.
    pub bounds: [Vec3; 2],
    /// What the scene does not say, and what was done instead.
    pub notes: Vec<String>,
}

impl Scene {
    /// Reads an exported checkpoint.
    ///
    /// # Errors
    /// If the bytes are no such file, a tensor is missing or has another shape, or the checkpoint uses what gs4d's method does not have. Values that
    /// are not finite are found where the method is built.
    pub fn read(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let file = Exported::read(bytes)?;
        match file.code() {
            "4DGaussians" => four_dgs::scene(&file),
            "Deformable-3D-GS" => deformable::scene(&file),
            "Grid4D" => grid4d::scene(&file),
            "Scaffold-GS" => scaffold::scene(&file),
            "TRACE" => trace::scene(&file),
            other => Err(CheckpointError::Code(other.to_owned())),
        }
    }
}
