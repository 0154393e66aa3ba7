//! Avatars, bounds, initial clouds, camera motion and rigs of data sets.

mod arrivals;
mod avatar;
mod avatar_faults;
mod avatar_layout;
mod film;
mod geometry;
mod initial;
mod motion;
mod rig;
mod start;
