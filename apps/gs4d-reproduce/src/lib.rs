//! The tables of the four papers, as data that anyone can run.
//!
//! * A [`Table`] is one TOML file in `tables/`: its scenes, its methods with their settings, the protocol, the published figures and where
//!   they are printed. [`Table::all`] lists them.
//! * A [`Reproduction`] is a table under the [`Conditions`] of a machine: scenes that are there ([`DataSet`]), or generated ones in their
//!   place, seeds, preset, length. It is one [`gs4d_lab::contest::Contest`] a scene: it can be interrupted, planned and collected.
//! * [`Beside`] holds what training does not score: LPIPS with the user's weights, tOF.
//! * An [`Outcome`] holds our figures beside the published ones, the paper's order of methods with paired differences, and what was not
//!   run; [`page`] shows it.
//! * [`nightly`] runs the tables on which the papers' orders rest, small enough for a night, and sums up what was found.
//! * [`documents`] says which tables of the documents name a preset that has changed since they were measured.
//!
//! ```
//! use gs4d_reproduce::Table;
//!
//! let table = Table::find("fags", "dnerf")?;
//! let mutant = table.scenes.iter().find(|s| s.name == "mutant").unwrap();
//! assert_eq!(table.published(mutant, "FAGS", 0), Some(44.16)); // PSNR, dB
//! # Ok::<(), gs4d_reproduce::TableError>(())
//! ```
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

mod beside;
mod column;
pub mod documents;
mod network;
pub mod nightly;
mod outcome;
pub mod page;
mod reproduction;
mod sets;
mod table;

pub use beside::{Beside, carry_columns};
pub use column::{Column, Less, Measure, PsnrMean, Score};
pub use network::Network;
pub use nightly::Nightly;
pub use outcome::{EntryOutcome, NotRun, Order, Outcome, PublishedMean, SceneOutcome, Value, Verdict};
pub use reproduction::{Chosen, Conditions, ReproduceError, Reproduction};
pub use sets::{Absence, DataSet, Generated, GeneratedFilm, GeneratedScene};
pub use table::{Scene, Table, TableEntry, TableError};
