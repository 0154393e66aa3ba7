//! What is fuzzed.

mod avatars;
mod characters;
mod checkpoints;
mod folders;
mod images;
mod layouts;
mod settings;
mod splats;

use crate::case::Case;
use gs_core::Rng;
use std::path::Path;

pub type Error = Box<dyn std::error::Error + Send + Sync>;

/// A reader, or a chain of them.
pub struct Target {
    pub name: &'static str,
    /// Share of the time: slow readers have more, so that they see as many inputs.
    pub share: u32,
    /// Good inputs. What they need beside them is written into the folder.
    pub seeds: fn(&Path) -> Result<Vec<Case>, Error>,
    /// Repairs checksums and lengths of a mutated input, so that readers go on behind them.
    pub repair: fn(&mut Case, &mut Rng),
    /// Reads an input, and holds what was read against what the reader promises: a panic is a fault of either.
    pub run: fn(&Case, &Path) -> Result<(), String>,
}

/// All targets.
pub fn all() -> Vec<Target> {
    [
        splats::targets(),
        images::targets(),
        layouts::targets(),
        characters::targets(),
        avatars::targets(),
        checkpoints::targets(),
        settings::targets(),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// For formats without checksums.
fn as_it_is(_: &mut Case, _: &mut Rng) {}

/// What a writer writes.
fn written<E: Into<Error>>(write: impl FnOnce(&mut Vec<u8>) -> Result<(), E>) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    write(&mut bytes).map_err(Into::into)?;
    Ok(bytes)
}
