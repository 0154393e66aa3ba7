//! A viewer of moving splat scenes: this machine's rasteriser draws, any browser shows.
//!
//! ```text
//! browser ── question (JSON) ──▶ guard ──▶ newest question ──▶ stage ──▶ picture ──▶ browser
//! ```
//! * [`stage`]: what can be seen: runs with their data, runs under training, splat files; [`scene`]: one state of one of
//!   them; [`checkpoints`]: earlier ones.
//! * [`question`]: what a browser may ask, and how little of it is believed.
//! * [`shot`]: a scene from a camera at a moment, with what is hidden and how a person is posed ([`pose`]).
//! * [`picture`]: a shot to pixels: colours, depth, coverage, overlays of the method, photographs, differences, with
//!   [`legend`]s; [`packing`]: as bytes.
//! * [`pick`]: which splats made a pixel, and where they go; [`arrows`]: where many go; [`choice`]: a box of them.
//! * [`server`]: loopback, token, host and origin checks; a newer question replaces the older one that waits.
//! * [`live`]: a run while it trains.
//!
//! One page of plain HTML, script and style is embedded; nothing is loaded from elsewhere.

pub mod arrows;
pub mod checkpoints;
pub mod choice;
pub mod guard;
pub mod legend;
pub mod live;
pub mod packing;
pub mod pick;
pub mod picture;
pub mod pose;
pub mod question;
pub mod scene;
pub mod server;
pub mod shot;
pub mod stage;

pub use live::Feed;
pub use packing::Packing;
pub use server::{Options, Server, start};
pub use stage::{Show, Stage};

/// What keeps the viewer from starting.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// No port was free.
    #[error("no free port from {first} to {last} on {host}: {source}")]
    Port {
        /// Address asked for.
        host: std::net::IpAddr,
        /// First port tried.
        first: u16,
        /// Last port tried.
        last: u16,
        /// What the system said of the last.
        source: std::io::Error,
    },
    /// The server's threads.
    #[error("cannot start the server: {0}")]
    Threads(std::io::Error),
    /// Nothing to show.
    #[error("there is nothing to show: give a run or a splat file")]
    Nothing,
}
