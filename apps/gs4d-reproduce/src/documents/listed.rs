//! Tables of figures as `docs/tables.toml` lists them.

use super::finding::Finding;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A table of figures as `docs/tables.toml` lists it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Listed {
    /// The document, relative to the repository.
    pub file: String,
    /// How the first line of the table begins; one table of the document begins so.
    pub head: String,
    /// The command that measured it.
    pub command: String,
    /// The commit it was measured at, of several the oldest; where it was not written down, the first that has the figures.
    #[serde(default)]
    pub commit: Option<String>,
    /// Whether its figures follow from definitions: nothing was measured, and no commit is needed.
    #[serde(default)]
    pub exact: bool,
    /// Seeds of the runs; empty where nothing is drawn by chance.
    #[serde(default)]
    pub seeds: Vec<u64>,
    /// `METHOD:PRESET` and the digest of its settings.
    #[serde(default)]
    pub presets: BTreeMap<String, String>,
    /// `METHOD:PRESET` that the trainings had and that has changed since.
    #[serde(default)]
    pub older_than: Vec<String>,
    /// How the cells show the spread of the seeds; absent where they do not, where the rows differ, or where nothing is drawn by chance.
    #[serde(default)]
    pub spread: Option<Spread>,
    /// Which scenes its settings met before; absent where the document does not say.
    #[serde(default)]
    pub scenes: Option<Scenes>,
}

/// How cells show the spread of the seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Spread {
    /// A figure for each seed.
    #[serde(rename = "every seed")]
    EverySeed,
    /// ± one standard deviation.
    #[serde(rename = "standard deviation")]
    Deviation,
    /// ± half of an interval of 95 %.
    #[serde(rename = "95 %")]
    Interval,
    /// Not at all: every figure is of one run.
    #[serde(rename = "one run")]
    OneRun,
}

/// Which scenes the settings of a table met before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Scenes {
    /// Some were chosen on these.
    #[serde(rename = "tuning")]
    Tuning,
    /// None was chosen on these.
    #[serde(rename = "held out")]
    HeldOut,
    /// Of both kinds; the document says which rows are of which.
    #[serde(rename = "tuning and held out")]
    Both,
}

/// Words of commands that train or use a trained method. Crates below those of the methods have no presets.
const TRAININGS: [&str; 10] = [
    "gs4d train ",
    "gs4d compare ",
    "gs4d continual ",
    "gs4d reproduce ",
    "gs4d export ",
    "gs4d inspect ",
    "--example train_dut ",
    "--example scaling ",
    "-p gs-method-",
    "-p gs-train --test train ",
];

impl Listed {
    /// What is wrong with the entry itself; `document` is the text of its file.
    pub(super) fn faults(&self, document: &str) -> Vec<Finding> {
        let table = format!("{}: {}", self.file, self.head);
        let mut faults = Vec::new();
        if self.commit.is_none() && !self.exact {
            faults.push(Finding::NoCommit { table: table.clone() });
        }
        let trains = TRAININGS.iter().any(|words| self.command.contains(words));
        if trains && self.presets.is_empty() && self.older_than.is_empty() {
            faults.push(Finding::NoPreset { table: table.clone() });
        }
        if self.spread.is_some_and(|spread| (spread == Spread::OneRun) != (self.seeds.len() < 2)) {
            faults.push(Finding::NoSpread { table: table.clone() });
        }
        let commit = self.commit.clone().unwrap_or_default();
        if !self.older_than.is_empty() && !document.contains(&commit) {
            faults.push(Finding::Unsaid { table, commit });
        }
        faults
    }
}
