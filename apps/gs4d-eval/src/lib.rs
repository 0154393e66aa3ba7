//! Evaluation of trained scenes: scores of image folders, forecasts, segments, tracks, and export to other formats.
//!
//! * [`folders`], [`compare`], [`temporal`]: given images against ground truth, frame by frame and over time.
//! * [`covisible`]: masks of what training images show of held-out views.
//! * [`forecast`]: frames past the last training time; [`physics_check`]: learnt motion against known twists.
//! * [`moments`]: the times at which a scene was seen, over all splits.
//! * [`layers`]: colours per splat that are drawn in place of the scene's own.
//! * [`segment`]: rigid parts; [`track`]: the path of one part; [`stage_motion`]: what each stage of a method moves.
//! * [`export`]: plain splats per timestamp (`.ply`, `.splat`, `.spz`, `.glb`) and the PSNR this costs.
//! * [`spread`]: mean and standard deviation of scores.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

pub mod compare;
pub mod covisible;
pub mod export;
pub mod folders;
pub mod forecast;
pub mod layers;
pub mod moments;
pub mod particles;
pub mod physics_check;
pub mod segment;
pub mod spread;
pub mod stage_motion;
pub mod temporal;
pub mod track;

/// A view as it is rendered: with the camera and time that were learnt for it, where cameras were refined.
pub type Placing<'a> = dyn Fn(&gs_data::View) -> gs_data::View + 'a;
