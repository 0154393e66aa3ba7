//! What is wrong with a table of figures, and how it is said.

use serde::Serialize;
use std::fmt;

/// What is wrong with a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Finding {
    /// A table of figures that the list does not have.
    Unlisted {
        /// `FILE:LINE`.
        place: String,
        /// Its head.
        head: String,
    },
    /// The list has a table that is not there, or several begin so.
    NotOne {
        /// As listed.
        file: String,
        /// As listed.
        head: String,
        /// Tables that begin so.
        number: usize,
    },
    /// A table without a commit that is not exact.
    NoCommit {
        /// `FILE: HEAD`.
        table: String,
    },
    /// A table of trainings without a preset.
    NoPreset {
        /// `FILE: HEAD`.
        table: String,
    },
    /// A table with a spread of fewer than two seeds, or of one run with several.
    NoSpread {
        /// `FILE: HEAD`.
        table: String,
    },
    /// The document of a table that is older than a preset does not name the commit.
    Unsaid {
        /// `FILE: HEAD`.
        table: String,
        /// As listed.
        commit: String,
    },
    /// A preset that a table names is not the one it was measured with.
    Old {
        /// `FILE: HEAD`.
        table: String,
        /// `METHOD:PRESET`.
        preset: String,
        /// What differs.
        why: String,
    },
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unlisted { place, head } => write!(f, "{place}: docs/tables.toml does not list the table {head}"),
            Self::NotOne { file, head, number } => {
                write!(f, "docs/tables.toml: {number} tables of {file} begin with {head}, not one")
            }
            Self::NoCommit { table } => write!(f, "{table}: no commit, and not marked as exact"),
            Self::NoPreset { table } => write!(f, "{table}: trainings without a preset"),
            Self::NoSpread { table } => write!(f, "{table}: its spread is not one of its number of seeds"),
            Self::Unsaid { table, commit } => {
                write!(f, "{table}: older than a preset, and the document does not name its commit {commit}")
            }
            Self::Old { table, preset, why } => write!(f, "{table}: {preset} has changed since it was measured: {why}"),
        }
    }
}
