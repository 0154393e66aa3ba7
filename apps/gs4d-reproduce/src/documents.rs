//! Tables of figures in the documents, and whether the presets they name are still what was measured.
//!
//! `docs/tables.toml` lists every table of figures in `README.md` and below `docs`: the file, how its head begins, the command, the commit and
//! the seeds. A table of trainings names their presets with a digest of their settings, and `docs/presets/METHOD-PRESET.toml` keeps them
//! (the output of `gs4d config METHOD --preset PRESET`, comments may be left out). [`check`] compares them with the presets of this program. A setting that
//! has another value now, or is gone, makes the table old. A setting that came later does not: it is added with a default that changes nothing.
//! A table that is known to be old names the preset in `older_than`, and its document the commit. Where the document says so, an entry has the kind of
//! scenes and how its cells show the spread of the seeds.

use gs_core::io::{IoError, Limits, read_text};
use gs_train::registry::Registry;
use gs4d_run::RunError;
use gs4d_run::config::{Config, ConfigError};
use gs4d_run::settings::with_preset;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

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
    fn faults(&self, document: &str) -> Vec<Finding> {
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    table: Vec<Listed>,
}

/// A table of a document.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Found {
    /// The document, relative to the repository.
    pub file: String,
    /// Line of its head, from 1.
    pub line: usize,
    /// The head as it stands.
    pub head: String,
    /// Cells of the rows below.
    pub rows: Vec<Vec<String>>,
}

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

/// The tables of figures, and what is wrong with them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Checked {
    /// As listed, each with the table of the document.
    pub tables: Vec<(Listed, Found)>,
    /// What is wrong.
    pub findings: Vec<Finding>,
}

/// Why tables cannot be checked.
#[derive(Debug, thiserror::Error)]
pub enum DocumentError {
    /// A file cannot be read.
    #[error(transparent)]
    Load(#[from] IoError),
    /// The list cannot be read.
    #[error("{}: {why}", .file.display())]
    List {
        /// Path of the list.
        file: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// Settings cannot be read.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A method or preset is not there.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Checks the documents of a repository.
///
/// # Errors
/// If the list, a document or a kept preset cannot be read, or a method or preset is not there.
pub fn check(root: &Path, registry: &Registry) -> Result<Checked, DocumentError> {
    let file = root.join("docs/tables.toml");
    let list: List = toml::from_str(&read(&file)?).map_err(|e| DocumentError::List { file, why: e.to_string() })?;
    let found = tables(root)?;
    let (mut checked, mut findings) = (Vec::new(), Vec::new());
    let mut old = Presets { root, registry, known: BTreeMap::new() };
    for listed in list.table {
        let begins = |t: &&Found| t.file == listed.file && t.head.starts_with(&listed.head);
        let these: Vec<&Found> = found.iter().filter(begins).collect();
        let document = read(&root.join(&listed.file)).unwrap_or_default();
        findings.extend(listed.faults(&document));
        listed.older_than.iter().try_for_each(|preset| old.exists(preset))?;
        for (preset, digest) in &listed.presets {
            if let Some(why) = old.difference(preset, digest)? {
                let table = format!("{}: {}", listed.file, listed.head);
                findings.push(Finding::Old { table, preset: preset.clone(), why });
            }
        }
        match these[..] {
            [one] => checked.push((listed, one.clone())),
            _ => findings.push(Finding::NotOne { number: these.len(), file: listed.file, head: listed.head }),
        }
    }
    let unlisted = found.iter().filter(|t| t.holds_figures() && !checked.iter().any(|(_, f)| f == *t));
    let unlisted =
        unlisted.map(|t| Finding::Unlisted { place: format!("{}:{}", t.file, t.line), head: t.head.clone() });
    findings.extend(unlisted);
    Ok(Checked { tables: checked, findings })
}

fn read(path: &Path) -> Result<String, IoError> {
    read_text(path, &Limits::default())
}

/// The tables of all documents.
fn tables(root: &Path) -> Result<Vec<Found>, DocumentError> {
    let mut all = Vec::new();
    for folder in ["", "docs", "docs/guide"] {
        let entries = std::fs::read_dir(root.join(folder)).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
        names.retain(|n| n.ends_with(".md") && (!folder.is_empty() || n == "README.md"));
        names.sort();
        for name in names {
            let file = if folder.is_empty() { name } else { format!("{folder}/{name}") };
            all.extend(of_text(&file, &read(&root.join(&file))?));
        }
    }
    Ok(all)
}

/// The tables of a Markdown text: a line of cells, a line of dashes, lines of cells.
fn of_text(file: &str, text: &str) -> Vec<Found> {
    let lines: Vec<&str> = text.lines().collect();
    let is_row = |k: usize| lines.get(k).is_some_and(|l| l.starts_with('|'));
    let is_rule = |k: usize| is_row(k) && lines[k].chars().all(|c| "|-: ".contains(c));
    let table = |k: usize| {
        let rows = (k + 2..).take_while(|j| is_row(*j)).map(|j| cells(lines[j])).collect();
        Found { file: file.to_owned(), line: k + 1, head: lines[k].to_owned(), rows }
    };
    (0..lines.len()).filter(|k| is_row(*k) && is_rule(k + 1)).map(table).collect()
}

fn cells(line: &str) -> Vec<String> {
    line.trim().trim_matches('|').split('|').map(|c| c.trim().to_owned()).collect()
}

impl Found {
    /// Whether most rows hold a cell with a figure, beside the first.
    fn holds_figures(&self) -> bool {
        let with = self.rows.iter().filter(|r| r.iter().skip(1).any(|c| holds_figure(c))).count();
        2 * with > self.rows.len()
    }
}

/// Whether a cell holds a figure, anywhere but in code.
fn holds_figure(cell: &str) -> bool {
    cell.split('`').step_by(2).flat_map(str::split_whitespace).any(is_figure)
}

/// Whether a word is a number with or without a sign and a symbol. A name (`3D`, `8th`) is none, a year neither.
fn is_figure(word: &str) -> bool {
    let word = word.trim_start_matches(['+', '−', '-', '±', '*', '<', '(', '≤', '≥', '≈']);
    let bare = word.trim_end_matches([',', '.', ';', ':', ')']);
    let year = bare.parse::<u64>().is_ok_and(|y| (1900..2100).contains(&y));
    let letter = |c: char| c.is_ascii_alphabetic() && c != 'e';
    word.starts_with(|c: char| c.is_ascii_digit()) && !word.contains(letter) && !year
}

/// Kept presets, read once.
struct Presets<'a> {
    root: &'a Path,
    registry: &'a Registry,
    known: BTreeMap<String, (String, Option<String>)>,
}

impl Presets<'_> {
    /// How `METHOD:PRESET` differs from what had this digest; `None` if it does not.
    fn difference(&mut self, preset: &str, digest: &str) -> Result<Option<String>, DocumentError> {
        if !self.known.contains_key(preset) {
            let state = self.state(preset)?;
            self.known.insert(preset.to_owned(), state);
        }
        let (kept, changed) = &self.known[preset];
        Ok(if kept == digest { changed.clone() } else { Some(format!("the kept settings have the digest {kept}")) })
    }

    /// Fails if there is no such preset.
    fn exists(&self, preset: &str) -> Result<(), DocumentError> {
        let (method, name) = named(preset);
        with_preset(self.registry, method, name)?;
        Ok(())
    }

    /// The digest of the kept settings, and how the present ones differ from them.
    fn state(&self, preset: &str) -> Result<(String, Option<String>), DocumentError> {
        let (method, name) = named(preset);
        let file = self.root.join(format!("docs/presets/{method}-{name}.toml"));
        let kept = values(&Config::of_toml(&read(&file)?)?);
        let now = values(&with_preset(self.registry, method, name)?);
        let differs = |(key, then): (&String, &String)| match now.get(key) {
            Some(now) if now == then => None,
            Some(now) => Some(format!("{key} was {then}, is {now}")),
            None => Some(format!("{key} is gone")),
        };
        let all: Vec<String> = kept.iter().filter_map(differs).collect();
        Ok((digest(&kept), (!all.is_empty()).then(|| all.join("; "))))
    }
}

/// Method and preset of `METHOD:PRESET`.
fn named(preset: &str) -> (&str, &str) {
    preset.split_once(':').unwrap_or((preset, "fast"))
}

/// The settings of a method by key, those of the run and of the data left out.
fn values(config: &Config) -> BTreeMap<String, String> {
    let own = config.iter().filter(|(key, _)| !key.starts_with("run.") && !key.starts_with("data."));
    own.map(|(key, setting)| (key.to_owned(), setting.value.to_string())).collect()
}

/// CRC-32 of the settings, eight hexadecimal digits.
fn digest(values: &BTreeMap<String, String>) -> String {
    let text: String = values.iter().map(|(key, value)| format!("{key}={value}\n")).collect();
    format!("{:08x}", crc32fast::hash(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    const DOCUMENT: &str = "# A\n\n| method | PSNR |\n|---|---|\n| `fags` | 39.9 |\n| `grid4d` | **39.1** |\n\n| word | what |\n|---|---|\n| a | b |\n";

    /// A repository with one document and a list.
    fn repository(list: &str) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir_all(root.path().join("docs/presets")).unwrap();
        fs::write(root.path().join("docs/a.md"), DOCUMENT).unwrap();
        fs::write(root.path().join("docs/tables.toml"), list).unwrap();
        root
    }

    fn findings(root: &Path) -> Vec<Finding> {
        check(root, gs_methods::registry()).unwrap().findings
    }

    fn listed(digest: &str) -> String {
        format!(
            "[[table]]\nfile = \"docs/a.md\"\nhead = \"| method |\"\ncommand = \"gs4d train\"\ncommit = \"0\"\nseeds = [0]\npresets = {{ \"fags:fast\" = \"{digest}\" }}\n"
        )
    }

    #[test]
    fn tables_are_read_with_their_rows() {
        let found = of_text("a.md", DOCUMENT);
        assert_eq!((found.len(), found[0].line, found[0].rows[1][1].as_str()), (2, 3, "**39.1**"));
        assert!(found[0].holds_figures() && !found[1].holds_figures());
    }

    #[test]
    fn a_figure_may_stand_anywhere_in_a_cell() {
        for cell in ["**39.1**", "−0.10 ± 0.26", "at most 72 more files", "its ratio within 3 %", "3e-6 of `f64`"] {
            assert!(holds_figure(cell), "{cell}");
        }
        for cell in ["`--size 128`", "Kerbl et al. 2023", "every 8th", "4K", "[below](#two-3)", "–", ""] {
            assert!(!holds_figure(cell), "{cell}");
        }
    }

    #[test]
    fn a_table_of_figures_must_be_listed_and_a_listed_one_must_be_there() {
        let root = repository("table = []");
        let Finding::Unlisted { place, .. } = &findings(root.path())[0] else { panic!("not unlisted") };
        assert_eq!(place, "docs/a.md:3");
        fs::write(root.path().join("docs/a.md"), "nothing").unwrap();
        fs::write(root.path().join("docs/tables.toml"), listed("0").split("presets").next().unwrap()).unwrap();
        assert!(matches!(findings(root.path())[..], [Finding::NotOne { number: 0, .. }]));
    }

    #[test]
    fn a_setting_that_changed_makes_a_table_old_and_one_that_came_later_does_not() {
        let registry = gs_methods::registry();
        let kept = values(&with_preset(registry, "fags", "fast").unwrap());
        let text =
            |values: &BTreeMap<String, String>| values.iter().map(|(k, v)| format!("{k} = {v}\n")).collect::<String>();
        let root = repository(&listed(&digest(&kept)));
        let file = root.path().join("docs/presets/fags-fast.toml");
        fs::write(&file, text(&kept)).unwrap();
        assert_eq!(findings(root.path()), []);

        let mut fewer = kept.clone();
        fewer.remove("still.pixels").unwrap();
        fs::write(&file, text(&fewer)).unwrap();
        fs::write(root.path().join("docs/tables.toml"), listed(&digest(&fewer))).unwrap();
        assert_eq!(findings(root.path()), []);

        let mut other = kept.clone();
        other.insert("still.pixels".into(), "7.5".into());
        other.insert("still.gone".into(), "1".into());
        fs::write(&file, text(&other)).unwrap();
        let old = findings(root.path())[0].to_string();
        assert!(old.contains("the kept settings have the digest"), "kept anew, not measured anew: {old}");
        fs::write(root.path().join("docs/tables.toml"), listed(&digest(&other))).unwrap();
        let old = findings(root.path())[0].to_string();
        assert!(old.contains("still.pixels was 7.5, is 0.0") && old.contains("still.gone is gone"), "{old}");
    }

    /// A list of one table.
    fn one(lines: &str) -> String {
        format!("[[table]]\nfile = \"docs/a.md\"\nhead = \"| method |\"\n{lines}\n")
    }

    #[test]
    fn what_was_measured_has_a_commit() {
        let found = |lines: &str| findings(repository(&one(lines)).path());
        let table = "docs/a.md: | method |".to_owned();
        assert_eq!(found("command = \"cargo bench\""), [Finding::NoCommit { table }]);
        assert_eq!(found("command = \"cargo bench\"\ncommit = \"abc1234\""), []);
        assert_eq!(found("command = \"by hand\"\nexact = true"), []);
    }

    #[test]
    fn trainings_name_their_presets() {
        for command in [
            "gs4d train DATA -m fags",
            "gs4d reproduce fags dnerf -o OUT",
            "cargo run --example train_dut -- tiny",
            "cargo bench -p gs-method-anchor",
        ] {
            let list = one(&format!("command = \"{command}\"\ncommit = \"abc1234\""));
            assert!(matches!(findings(repository(&list).path())[..], [Finding::NoPreset { .. }]), "{command}");
        }
    }

    #[test]
    fn a_spread_fits_its_number_of_seeds_and_scenes_are_of_named_kinds() {
        let checked = |lines: &str| {
            let list = one(&format!("command = \"cargo bench\"\ncommit = \"abc1234\"\n{lines}"));
            check(repository(&list).path(), gs_methods::registry())
        };
        let table = "docs/a.md: | method |".to_owned();
        let single = checked("seeds = [0]\nspread = \"every seed\"").unwrap();
        assert_eq!(single.findings, [Finding::NoSpread { table: table.clone() }]);
        let once = checked("seeds = [0]\nspread = \"one run\"\nscenes = \"tuning and held out\"").unwrap();
        assert_eq!(once.findings, []);
        let many = checked("seeds = [0, 1]\nspread = \"one run\"").unwrap();
        assert_eq!(many.findings, [Finding::NoSpread { table }]);
        let several = checked("seeds = [0, 1]\nspread = \"standard deviation\"\nscenes = \"held out\"").unwrap();
        assert_eq!(several.findings, []);
        let listed = &several.tables[0].0;
        assert_eq!((listed.spread, listed.scenes), (Some(Spread::Deviation), Some(Scenes::HeldOut)));
        assert!(checked("scenes = \"both\"").is_err(), "a kind that is none");
    }

    #[test]
    fn a_table_may_be_older_than_a_preset_where_its_document_says_so() {
        let list = one("command = \"gs4d train DATA -m fags\"\ncommit = \"abc1234\"\nolder_than = [\"fags:fast\"]");
        let root = repository(&list);
        let said = findings(root.path())[0].to_string();
        assert!(said.contains("does not name its commit abc1234"), "{said}");
        fs::write(root.path().join("docs/a.md"), format!("{DOCUMENT}\nMeasured at abc1234.\n")).unwrap();
        assert_eq!(findings(root.path()), []);
        fs::write(root.path().join("docs/tables.toml"), list.replace("fags:fast", "fags:nosuch")).unwrap();
        assert!(check(root.path(), gs_methods::registry()).is_err(), "there is no such preset");
    }

    /// The documents of this repository.
    #[test]
    fn no_table_here_is_older_than_its_preset() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let checked = check(&root, gs_methods::registry()).unwrap();
        let text: Vec<String> = checked.findings.iter().map(ToString::to_string).collect();
        assert!(text.is_empty(), "{}", text.join("\n"));
        assert!(checked.tables.len() > 20, "{}", checked.tables.len());
    }
}
