//! A viewer of moving splat scenes: the rasteriser of this machine renders, any browser displays.
//!
//! ```text
//! browser ── question (JSON) ──▶ guard ──▶ newest question ──▶ stage ──▶ image ──▶ browser
//! ```
//! * [`Stage`] holds the [`Show`]s: runs with their data, runs under training, splat files.
//! * [`start`] serves them: loopback, token, host and origin checks; a newer question replaces the one that waits.
//! * [`question`]: the messages of a browser and their limits; [`pose`]: poses of an avatar.
//! * [`picture`]: from a question to pixels: colours, depth, coverage, overlays of the method, ground-truth images, differences;
//!   [`style`]: splats, ellipsoids or points.
//! * [`Feed`]: a run while it trains; [`LiveFilm`]: a person whose frames arrive in a folder.
//!
//! A training must not suffer from those who watch it: at most 64 connections are open; a request has a time limit; one image
//! is rendered at a time and one is on its way to each browser; at most 64 MiB of images and as many of splats wait for slow readers.
//!
//! One page of plain HTML, script and style is embedded; nothing is loaded from elsewhere.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

mod arrows;
mod checkpoints;
mod choice;
mod client;
mod dropped;
mod guard;
mod legend;
mod live;
mod live_film;
mod outbox;
mod packing;
mod pick;
pub mod picture;
pub mod pose;
pub mod question;
mod requests;
mod routes;
mod scene;
mod server;
mod shot;
mod stage;
pub mod style;
mod turns;

pub use live::{Feed, THREAD_NAME};
pub use live_film::{LiveFilm, LiveFilmError, ShownFrame};
pub use packing::Packing;
pub use server::{Options, REQUEST_TIME, Server, start};
pub use stage::{Show, Stage};

/// Why a viewer cannot start.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// No port of the range is free.
    #[error("no free port from {first} to {last} on {host}: {source}")]
    Port {
        /// Address the server was to listen at.
        host: std::net::IpAddr,
        /// First port that was tried.
        first: u16,
        /// Last port that was tried.
        last: u16,
        /// Error of the last port.
        source: std::io::Error,
    },
    /// Threads of the server cannot be started.
    #[error("cannot start the server: {0}")]
    Threads(std::io::Error),
    /// The device that renders failed.
    #[error(transparent)]
    Device(#[from] gs_raster::DeviceError),
    /// The stage has no show.
    #[error("there is nothing to show: give a run or a splat file")]
    Nothing,
}
