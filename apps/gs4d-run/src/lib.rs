//! A run: settings resolved from all their sources, a folder on disk, the training loop, and what it leaves behind.
//!
//! * [`settings`], [`config`]: every value knows its source; [`folder`], [`provenance`]: the run folder.
//! * [`training`], [`flight`]: the loop with log, checkpoints and live evaluation; [`opened`]: a run read back.
//! * [`compact`]: a scene in fewer bytes; [`compare`]: runs of the same data beside each other.

pub mod compact;
pub mod compare;
pub mod config;
mod error;
pub mod flight;
pub mod folder;
pub mod opened;
pub mod orbit;
pub mod overlays;
pub mod provenance;
pub mod settings;
pub mod shown;
pub mod speed;
pub mod summary;
pub mod training;
pub mod work;

pub use error::RunError;
pub use folder::RunFolder;
pub use opened::OpenRun;
pub use settings::{Request, Resolved};
pub use training::{Outcome, Progress, Training};
