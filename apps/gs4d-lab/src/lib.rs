//! Experiments over many training runs.
//!
//! * [`contest`]: methods or settings under equal conditions; [`sweep`]: contests of one setting at several values.
//! * [`continual`]: training while more of a sequence arrives.
//! * [`people`]: avatars (method `dut`): texture sizes, visibility, wrong poses, fewer views, contact, loose clothing, unseen motion
//!   and light, ablations.
//! * [`glmd`]: the motion added by each stage of a method, in images and numbers (MoDec-GS, figures 8 and 9).
//! * [`mod@bench`]: speed against error on this machine.
#![warn(unreachable_pub)]

pub mod bench;
pub mod contest;
pub mod continual;
pub mod glmd;
pub mod people;
pub mod sweep;
mod text;

pub use text::aligned;
