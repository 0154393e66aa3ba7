//! The viewer's server, live runs and poses.

mod live;
mod live_film;
mod posing;
mod server;
#[path = "../support/mod.rs"]
mod support;
