//! A run: settings resolved from all their sources, a folder on the disk, the loop that trains, and what it leaves behind.

mod error;
pub mod flight;
pub mod folder;
pub mod needs;
pub mod opened;
pub mod orbit;
pub mod overlays;
pub mod picture;
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
