//! Avatars, bounds, initial clouds, camera motion and rigs of data sets.

mod arrivals;
mod avatar;
mod geometry;
mod initial;
mod motion;
mod rig;
mod start;
