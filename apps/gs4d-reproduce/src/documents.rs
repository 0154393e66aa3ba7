//! Tables of figures in the documents, and whether the presets they name are still what was measured.
//!
//! `docs/tables.toml` lists every table of figures in `README.md` and below `docs`: the file, how its head begins, the command, the commit and
//! the seeds. A table of trainings names their presets with a digest of their settings, and `docs/presets/METHOD-PRESET.toml` keeps them
//! (the output of `gs4d config METHOD --preset PRESET`, comments may be left out). [`check`] compares them with the presets of this program. A setting that
//! has another value now, or is gone, makes the table old. A setting that came later does not: it is added with a default that changes nothing.
//! A table that is known to be old names the preset in `older_than`, and its document the commit. Where the document says so, an entry has the kind of
//! scenes and how its cells show the spread of the seeds.

mod finding;
mod listed;
mod markdown;
mod presets;

pub use finding::Finding;
pub use listed::{Listed, Scenes, Spread};
pub use markdown::Found;

use gs_core::io::{IoError, Limits, read_text};
use gs_train::registry::Registry;
use gs4d_run::RunError;
use gs4d_run::config::ConfigError;
use markdown::tables;
use presets::Presets;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    table: Vec<Listed>,
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
    let mut old = Presets::new(root, registry);
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

#[cfg(test)]
mod tests {
    use super::presets::{digest, values};
    use super::*;
    use gs4d_run::settings::with_preset;
    use std::collections::BTreeMap;
    use std::fs;

    pub(super) const DOCUMENT: &str = "# A\n\n| method | PSNR |\n|---|---|\n| `fags` | 39.9 |\n| `grid4d` | **39.1** |\n\n| word | what |\n|---|---|\n| a | b |\n";

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
