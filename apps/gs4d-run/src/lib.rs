//! Training runs: settings resolved from all sources, the run folder, the training loop, checkpoints and the report.
//!
//! * [`settings`], [`config`]: every value with its source; [`folder`]: the run folder.
//! * [`training`]: the loop with log, checkpoints and evaluations; [`opened`]: a run read back.
//! * [`orbit`], [`flight`]: camera paths.
//! * [`compact`]: a scene in fewer bytes; [`compare`]: runs on the same data, view by view.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

mod commands;
pub mod compact;
pub mod compare;
pub mod config;
mod elsewhere;
mod error;
pub mod flight;
pub mod folder;
mod kept;
mod log;
pub mod memory;
pub mod opened;
pub mod orbit;
mod overlays;
mod per_view;
mod placed;
pub mod provenance;
pub mod ranks;
mod saving;
mod score_table;
pub mod settings;
pub mod summary;
pub mod training;
mod work;

pub use elsewhere::Elsewhere;
pub use error::RunError;
pub use folder::RunFolder;
pub use gs_data::shell_quoted;
pub use kept::{Kept, SplitSizes};
pub use opened::{OpenRun, check_exists};
pub use placed::Placed;
pub use settings::{Request, Resolved};
pub use training::{Outcome, Progress, ResumeRequest, Scored, Stage, Training};
