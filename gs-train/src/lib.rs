//! From images to a moving scene: data sets, generated scenes, methods, training, scores and runs.
//!
//! ```text
//! data set → moment → splats → frame → loss → gradients → parameters
//! ```
//! * [`data`]: readers (D-NeRF/Blender, nerfstudio, COLMAP, HyperNeRF, LLFF/Neu3D), lazily decoded images; [`synth`]:
//!   scenes with exact truth.
//! * [`avatar`]: filmed people, with template, poses and inputs.
//! * [`methods`]: one file a method; [`schedule`], [`density`], [`adam`], [`loss`]: what training is made of.
//! * [`trainer`]: one step, and the whole state in and out; [`guard`]: gradients that are not finite.
//! * [`evaluate`], [`compare`], [`folders`], [`temporal`], [`inspect`], [`report`], [`contest`], [`sweep`]: what came of it.
//! * [`forecast`], [`continual`]: what comes after the last training time, once and while that time moves on.
//! * [`analysis`]: what else can be said of a scene: quantities, motion, economy.
//! * [`glmd`]: what each stage of a model moves, in pictures and numbers; [`segment`]: the rigid parts of a scene.
//! * [`doctor`]: what is wrong with a data set, before it is trained on.
//! * [`physics_check`]: motions that were learnt against the truth of a generated scene.
//! * [`config`], [`checkpoint`], [`run`]: settings that know their source, atomic checkpoints, run folders.
//! * [`storage`], [`compact`]: what a scene weighs, and a file of it in fewer bytes; [`export`]: files for other programs.
//!
//! # Promises
//! A run is a function of data, configuration and seed: the same bits for any number of threads and after any
//! interruption. Nothing is overwritten unless asked. Gradients that are not finite are refused, counted and named.
//!
//! # What it leaves out
//! Several views per step, camera refinement, masks while training, downloading of data.

pub mod adam;
pub mod analysis;
pub mod avatar;
pub mod bench;
pub mod checkpoint;
pub mod compact;
pub mod compare;
pub mod config;
pub mod contest;
pub mod continual;
pub mod data;
pub mod density;
pub mod doctor;
pub mod evaluate;
pub mod export;
pub mod folders;
pub mod forecast;
pub mod glmd;
pub mod guard;
pub mod inspect;
pub mod lab;
pub mod loss;
pub mod methods;
pub mod moment;
pub mod physics_check;
pub mod report;
pub mod run;
pub mod schedule;
pub mod segment;
pub mod storage;
pub mod sweep;
pub mod synth;
pub mod temporal;
pub mod track;
pub mod trainer;
