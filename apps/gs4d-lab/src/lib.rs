//! Experiments that take many trainings.
//!
//! * [`contest`]: methods or settings under equal conditions; [`sweep`]: one setting at several values.
//! * [`continual`]: training while more of a sequence arrives.
//! * [`people`]: filmed people: sizes, wrong poses, views, unseen motion and light, parts left out.
//! * [`glmd`]: what each stage of a method moves, in images and numbers (MoDec-GS, figures 8 and 9).
//! * [`bench`]: speed against error on this machine.

pub mod bench;
pub mod contest;
pub mod continual;
pub mod glmd;
pub mod people;
pub mod sweep;
