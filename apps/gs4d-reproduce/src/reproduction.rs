//! A table under the conditions of a machine: which scenes are there, and the contest of each.

use crate::beside::Beside;
use crate::outcome::Outcome;
use crate::sets::{Absence, DataSet, Generated};
use crate::table::{Scene, Table, TableEntry, TableError};
use gs_data::DataError;
use gs_train::registry::Registry;
use gs4d_lab::contest::{Contest, Entry, Length, Results};
use std::path::PathBuf;

/// How a table is run.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// Folders below which scenes are looked for.
    pub data: Vec<PathBuf>,
    /// Names of scenes, those of the paper or generated ones; empty: those of the paper that are there, and the generated ones if none is.
    pub scenes: Vec<String>,
    /// Names of the entries that are run; empty: all that gs4d has. The others are compared with the first.
    pub entries: Vec<String>,
    /// Everything runs once with each.
    pub seeds: Vec<u64>,
    /// Preset of every entry; `None`: that of its published recipe.
    pub preset: Option<String>,
    /// Length of every trial.
    pub length: Length,
    /// `data.scale` in place of that of the table, (0, 1].
    pub scale: Option<f64>,
    /// Settings of all trials, `KEY=VALUE`.
    pub sets: Vec<String>,
    /// Folder of generated scenes (`data`), trials (`SCENE/ENTRY/seed-N`) and results.
    pub root: PathBuf,
}

/// A scene that is run.
#[derive(Clone, Debug, PartialEq)]
pub enum Chosen {
    /// One of the paper's, in this folder.
    Published(Scene, PathBuf),
    /// One that stands in.
    Generated(Generated),
}

impl Chosen {
    /// Name of the scene.
    pub fn name(&self) -> &str {
        match self {
            Self::Published(scene, _) => &scene.name,
            Self::Generated(generated) => generated.name(),
        }
    }

    /// Whether it stands in for the paper's.
    pub(crate) fn is_generated(&self) -> bool {
        matches!(self, Self::Generated(_))
    }
}

/// A table and the scenes it is run on.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// The table.
    pub table: Table,
    /// Its data set.
    pub set: DataSet,
    /// How it is run.
    pub conditions: Conditions,
    /// The scenes that are run.
    pub scenes: Vec<Chosen>,
    /// The scenes of the paper that are not there, and what is in their place.
    pub absent: Vec<(String, Absence)>,
}

/// Why a table cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum ReproduceError {
    /// A file of this crate is wrong, or there is no such table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Another command makes the table.
    #[error("no training makes this table; its command is {0}")]
    Command(String),
    /// A scene was asked for that the table does not have.
    #[error("the table has no scene `{name}`; it has {known}")]
    UnknownScene {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// An entry was asked for that the table does not have, or gs4d does not.
    #[error("the table has no entry `{name}` that gs4d can run; it has {known}")]
    UnknownEntry {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// A scene was asked for that is not there.
    #[error("the scene {name} is not there: {absence}; it comes from {from} and is {layout}")]
    AbsentScene {
        /// The name asked for.
        name: String,
        /// What is in its place.
        absence: Box<Absence>,
        /// Where it comes from.
        from: String,
        /// Its files.
        layout: String,
    },
    /// A scene is named twice.
    #[error("the scene {name} is named twice, and its runs would count as two")]
    Twice {
        /// The name.
        name: String,
    },
    /// A generated scene cannot be written.
    #[error(transparent)]
    Data(#[from] DataError),
}

impl Reproduction {
    /// Chooses the scenes; nothing is written.
    ///
    /// # Errors
    /// A table of another command; a scene or an entry that is unknown or absent.
    pub fn new(mut table: Table, conditions: Conditions) -> Result<Self, ReproduceError> {
        let set = match (&table.data, &table.command) {
            (Some(data), None) => DataSet::find(data)?,
            (_, command) => return Err(ReproduceError::Command(command.clone().unwrap_or_default())),
        };
        keep_entries(&mut table, &conditions.entries)?;
        let asked = &conditions.scenes;
        if let Some(k) = (0..asked.len()).find(|&k| asked[..k].contains(&asked[k])) {
            return Err(ReproduceError::Twice { name: asked[k].clone() });
        }
        let (mut here, mut absent) = (Vec::new(), Vec::new());
        for scene in &table.scenes {
            match set.folder(scene, &conditions.data) {
                Ok(folder) => here.push(Chosen::Published(scene.clone(), folder)),
                Err(absence) => absent.push((scene.name.clone(), absence)),
            }
        }
        let generated = || set.generated.iter().cloned().map(Chosen::Generated);
        let scenes = if conditions.scenes.is_empty() {
            if here.is_empty() { generated().collect() } else { here }
        } else {
            let all: Vec<Chosen> = here.into_iter().chain(generated()).collect();
            conditions.scenes.iter().map(|name| chosen(name, &all, &absent, &set)).collect::<Result<_, _>>()?
        };
        Ok(Self { table, set, conditions, scenes, absent })
    }

    /// Writes the generated scenes among the chosen ones that are not written yet; the folders that hold another scene than this version
    /// generates.
    ///
    /// # Errors
    /// If one cannot be written.
    pub fn prepare(&self) -> Result<Vec<PathBuf>, DataError> {
        let (root, mut others) = (self.conditions.root.join("data"), Vec::new());
        for scene in &self.scenes {
            if let Chosen::Generated(generated) = scene {
                let folder = generated.write(&root)?;
                others.extend((!generated.is_in(&folder)).then_some(folder));
            }
        }
        Ok(others)
    }

    /// One contest a scene, in the order of the scenes.
    ///
    /// # Errors
    /// [`TableError::Wrong`].
    pub fn contests(&self, registry: &Registry) -> Result<Vec<Contest>, TableError> {
        self.scenes.iter().map(|scene| self.contest(scene, registry)).collect()
    }

    fn contest(&self, scene: &Chosen, registry: &Registry) -> Result<Contest, TableError> {
        let Conditions { seeds, length, scale, sets, root, .. } = &self.conditions;
        let of_table = self.table.sets.iter();
        let (data, own): (_, Vec<String>) = match scene {
            Chosen::Published(s, folder) => (folder.clone(), of_table.chain(&s.sets).cloned().collect()),
            Chosen::Generated(generated) => {
                let of_method = of_table.filter(|set| !set.starts_with("data."));
                (root.join("data").join(generated.name()), of_method.cloned().collect())
            }
        };
        let scale = scale.map(|s| format!("data.scale={s}"));
        Ok(Contest {
            registry: registry.clone(),
            data,
            root: root.join(scene.name()),
            preset: "fast".to_owned(),
            entries: self.entries(scene)?,
            seeds: seeds.clone(),
            length: *length,
            sets: own.into_iter().chain(scale).chain(sets.iter().cloned()).collect(),
        })
    }

    /// The entries of the contest of a scene, in the order of [`Table::runnable`].
    fn entries(&self, scene: &Chosen) -> Result<Vec<Entry>, TableError> {
        let Conditions { preset, length, .. } = &self.conditions;
        let as_published = preset.is_none() && *length == Length::Recipe;
        let own = |e: &TableEntry| match scene {
            Chosen::Published(scene, _) => {
                let recipe = if as_published { e.recipe(scene) } else { &[] };
                scene.own.get(&e.name).into_iter().flatten().chain(recipe).cloned().collect()
            }
            Chosen::Generated(_) => Vec::new(),
        };
        let preset = |e: &TableEntry| preset.clone().unwrap_or_else(|| e.preset.clone());
        let wrong = |why| TableError::Wrong { name: self.table.full_name(), why };
        self.table.runnable().map(|e| e.contest_entry(&preset(e), &own(e)).map_err(wrong)).collect()
    }

    /// Our figures beside the published ones, from the results of [`Self::contests`] and the scores beside them.
    pub fn outcome(&self, results: &[Results], beside: &Beside) -> Outcome {
        Outcome::of(self, results, beside)
    }
}

/// The scene of this name.
fn chosen(name: &str, all: &[Chosen], absent: &[(String, Absence)], set: &DataSet) -> Result<Chosen, ReproduceError> {
    if let Some(scene) = all.iter().find(|c| c.name() == name) {
        return Ok(scene.clone());
    }
    if let Some((name, absence)) = absent.iter().find(|(absent, _)| absent == name) {
        let (name, from, layout) = (name.clone(), set.from.clone(), set.layout.clone());
        return Err(ReproduceError::AbsentScene { name, absence: Box::new(absence.clone()), from, layout });
    }
    let known = absent.iter().map(|(name, _)| name.as_str()).chain(all.iter().map(Chosen::name));
    Err(ReproduceError::UnknownScene { name: name.to_owned(), known: known.collect::<Vec<_>>().join(", ") })
}

/// Keeps the named entries, all if none is named.
fn keep_entries(table: &mut Table, names: &[String]) -> Result<(), ReproduceError> {
    let known = || table.runnable().map(|e| e.name.as_str());
    if let Some(name) = names.iter().find(|n| !known().any(|k| k == *n)) {
        let known = known().collect::<Vec<_>>().join(", ");
        return Err(ReproduceError::UnknownEntry { name: name.clone(), known });
    }
    if !names.is_empty() {
        table.entries.retain(|e| names.contains(&e.name));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conditions(root: &std::path::Path) -> Conditions {
        Conditions {
            data: vec![root.join("captures")],
            scenes: Vec::new(),
            entries: Vec::new(),
            seeds: vec![0, 1],
            preset: Some("tiny".into()),
            length: Length::Steps(3),
            scale: Some(0.5),
            sets: vec!["run.log_every=1".into()],
            root: root.join("out"),
        }
    }

    /// A folder that the reader of a set takes for a scene, and that no reader can open.
    fn folder(root: &std::path::Path, name: &str, set: &str) {
        crate::sets::tests::look_like(&root.join("captures").join(name), set);
    }

    #[test]
    fn scenes_that_are_there_are_run_and_generated_ones_where_none_is() {
        let root = tempfile::tempdir().unwrap();
        let table = || Table::find("fags", "dnerf").unwrap();
        let without = Reproduction::new(table(), conditions(root.path())).unwrap();
        assert_eq!((without.scenes.len(), without.absent.len()), (9, 7));
        assert!(without.scenes.iter().all(|s| matches!(s, Chosen::Generated(_))));

        folder(root.path(), "hook", "dnerf");
        let with = Reproduction::new(table(), conditions(root.path())).unwrap();
        assert_eq!((with.scenes[0].name(), with.scenes.len(), with.absent.len()), ("hook", 1, 6));
        let contests = with.contests(gs_methods::registry()).unwrap();
        assert_eq!(contests[0].data, root.path().join("captures/hook"));
        assert_eq!(contests[0].sets, ["schedule.background=black", "data.scale=0.5", "run.log_every=1"]);
        // Generated scenes have the table's settings but for those of its data.
        let object = Table::find("trace", "ablation-object").unwrap();
        assert!(object.sets.contains(&"data.scale=0.5".to_owned()));
        let plain = Conditions { scale: None, ..conditions(root.path()) };
        let generated = Reproduction::new(object, plain).unwrap().contests(gs_methods::registry()).unwrap();
        assert_eq!(generated[0].sets, ["physics.refit=false", "run.log_every=1"]);
        let labels: Vec<&str> = contests[0].entries.iter().map(|e| e.label.as_str()).collect();
        let fags = "fags:tiny field.gate.on=true schedule.lambda_fre=0.3";
        assert_eq!(labels, [fags, "grid4d:tiny", "fourdgs:tiny", "defgs:tiny"]);
    }

    #[test]
    fn a_scene_that_is_asked_for_must_be_there() {
        let root = tempfile::tempdir().unwrap();
        let of = |name: &str| {
            let scenes = vec![name.to_owned()];
            Reproduction::new(Table::find("fags", "dnerf").unwrap(), Conditions { scenes, ..conditions(root.path()) })
        };
        assert_eq!(of("waves-b").unwrap().scenes[0].name(), "waves-b");
        let absent = of("trex").unwrap_err().to_string();
        assert!(absent.contains("not below --data") && absent.contains("github.com/albertpumarola/D-NeRF"), "{absent}");
        std::fs::create_dir_all(root.path().join("captures/trex")).unwrap();
        let empty = of("trex").unwrap_err().to_string();
        assert!(empty.contains("captures/trex holds no data set of the layout blender"), "{empty}");
        let entries = |name: &str| {
            let entries = vec![name.to_owned()];
            Reproduction::new(Table::find("fags", "dnerf").unwrap(), Conditions { entries, ..conditions(root.path()) })
        };
        assert_eq!(entries("Grid4D").unwrap().table.entries.len(), 1);
        let other = entries("SC-GS").unwrap_err().to_string();
        assert!(other.contains("`SC-GS`") && other.contains("FAGS, Grid4D, 4D-GS"), "{other}");
        let unknown = of("tyrannosaur").unwrap_err().to_string();
        assert!(unknown.contains("trex") && unknown.contains("sheet-a"), "{unknown}");
    }

    #[test]
    fn the_published_recipe_is_a_preset_of_each_entry() {
        let root = tempfile::tempdir().unwrap();
        let published = Conditions { preset: None, ..conditions(root.path()) };
        let table = Reproduction::new(Table::find("fags", "neu3d").unwrap(), published).unwrap();
        let labels = table.entries(&table.scenes[0]).unwrap().into_iter().map(|e| e.label).collect::<Vec<_>>();
        let fags = "fags:neu3d field.gate.on=true schedule.lambda_fre=0.3";
        assert_eq!(labels, [fags, "grid4d:neu3d", "fourdgs:neu3d"]);

        folder(root.path(), "broom", "hypernerf");
        let labels = |preset: Option<&str>, length: Length| -> Vec<String> {
            let own = Conditions { preset: preset.map(str::to_owned), length, ..conditions(root.path()) };
            let table = Reproduction::new(Table::find("fags", "hypernerf-vrig").unwrap(), own).unwrap();
            table.entries(&table.scenes[0]).unwrap().into_iter().map(|e| e.label).collect()
        };
        let published = labels(None, Length::Recipe);
        let with_recipe = |label: &str| label.contains("field.bound=0.8 ") && label.contains("warm_up.steps=0 ");
        assert!(
            with_recipe(&published[0]) && with_recipe(&published[1]) && published[2] == "fourdgs:hypernerf",
            "{published:?}"
        );
        for labels in [labels(Some("fast"), Length::Recipe), labels(None, Length::Steps(100))] {
            assert!(
                !labels.iter().any(|l| l.contains("field.bound")),
                "lengths of the recipe are not those of this run"
            );
        }
    }

    #[test]
    fn a_scene_is_named_once() {
        let root = tempfile::tempdir().unwrap();
        let twice = Conditions { scenes: vec!["sheet-a".into(), "sheet-a".into()], ..conditions(root.path()) };
        let refused = Reproduction::new(Table::find("fags", "ablation").unwrap(), twice).err();
        assert!(matches!(refused, Some(ReproduceError::Twice { name }) if name == "sheet-a"));
    }

    #[test]
    fn a_scene_has_settings_of_its_own_for_one_entry() {
        let root = tempfile::tempdir().unwrap();
        folder(root.path(), "skating", "nvfi-real");
        let table = Reproduction::new(Table::find("trace", "real").unwrap(), conditions(root.path())).unwrap();
        let contest = table.contests(gs_methods::registry()).unwrap().remove(0);
        assert_eq!(contest.entries[0].label, "trace:tiny physics.back_frames=6.0 physics.start=0.467");
        assert_eq!(contest.entries[3].label, "defgs:tiny");
    }

    #[test]
    fn a_table_of_another_command_names_it() {
        let root = tempfile::tempdir().unwrap();
        for (paper, table, command) in
            [("dut", "runtime", "gs4d bench RUN"), ("trace", "continual", "gs4d continual DATA")]
        {
            let error = Reproduction::new(Table::find(paper, table).unwrap(), conditions(root.path())).unwrap_err();
            assert!(error.to_string().contains(command), "{error}");
        }
    }
}
