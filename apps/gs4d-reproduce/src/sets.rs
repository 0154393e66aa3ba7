//! The papers' data sets: where a scene is looked for, and what stands in for a set that is not there.

use crate::table::{Scene, TableError};
use gs_core::io::disk;
use gs_data::DataError;
use gs_synth::SynthOptions;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A data set of a paper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataSet {
    /// What it is.
    pub title: String,
    /// Where it comes from.
    pub from: String,
    /// Its licence, as far as it is stated.
    pub licence: String,
    /// The files of a scene.
    pub layout: String,
    /// Names of folders that hold its scenes.
    pub folders: Vec<String>,
    /// Scenes that are run where none of its own is there. No setting was chosen on them.
    pub generated: Vec<Generated>,
}

/// A generated scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Generated {
    /// Name, and that of its folder.
    pub name: String,
    /// A scene of [`gs_synth::SCENES`].
    pub scene: String,
    /// Seed of the cameras.
    pub seed: u64,
    /// Variant of the scene.
    pub variant: u64,
    /// Side of the images, pixels.
    #[serde(default = "side")]
    pub size: u32,
    /// Number of static cameras; 0: one moving camera.
    #[serde(default)]
    pub cameras: u32,
}

fn side() -> u32 {
    160
}

impl DataSet {
    /// Every data set by name.
    ///
    /// # Errors
    /// [`TableError::Wrong`].
    pub fn all() -> Result<BTreeMap<String, Self>, TableError> {
        toml::from_str(include_str!("../tables/data.toml"))
            .map_err(|e: toml::de::Error| TableError::Wrong { name: "data".into(), why: e.to_string() })
    }

    /// The data set of a table.
    ///
    /// # Errors
    /// [`TableError::Wrong`] if there is none of that name.
    pub fn find(name: &str) -> Result<Self, TableError> {
        let absent = || TableError::Wrong { name: "data".into(), why: format!("there is no data set `{name}`") };
        Self::all()?.remove(name).ok_or_else(absent)
    }

    /// The folder of a scene below one of `roots`: `FOLDER/NAME` for the folders of this set, or `NAME`.
    pub fn folder(&self, scene: &Scene, roots: &[PathBuf]) -> Option<PathBuf> {
        let names = || std::iter::once(&scene.name).chain(&scene.also);
        let under = |root: &PathBuf| -> Vec<PathBuf> {
            let inner = self.folders.iter().map(|f| root.join(f)).chain([root.clone()]);
            inner.flat_map(|base| names().map(move |n| base.join(n))).collect()
        };
        roots.iter().flat_map(under).find(|path| path.is_dir())
    }
}

impl Generated {
    /// Its folder below `root`, written if it is not there: a folder that is there was written whole.
    ///
    /// # Errors
    /// If the scene cannot be made or written.
    pub fn write(&self, root: &Path) -> Result<PathBuf, DataError> {
        let folder = root.join(&self.name);
        if folder.is_dir() {
            return Ok(folder);
        }
        let partial = root.join(format!(".{}.partial", self.name));
        gs_synth::write(&partial, &self.scene, &self.options(), true)?;
        disk::rename(&partial, &folder).map_err(|source| DataError::Write { file: folder.clone(), source })?;
        Ok(folder)
    }

    /// How it is generated.
    pub fn options(&self) -> SynthOptions {
        let views = SynthOptions::of_views(self.size, 100, 20);
        SynthOptions { seed: self.seed, variant: self.variant, cameras: self.cameras, ..views }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Table;
    use std::collections::BTreeSet;

    #[test]
    fn every_set_has_three_generated_scenes_a_family_and_no_seed_serves_twice() {
        let all = DataSet::all().unwrap();
        let (mut seeds, mut names) = (BTreeSet::new(), BTreeSet::new());
        for (set, data) in &all {
            let mut families: BTreeMap<&str, usize> = BTreeMap::new();
            for scene in &data.generated {
                assert!(gs_synth::SCENES.iter().any(|s| s.name == scene.scene), "{set}: {}", scene.scene);
                assert!(seeds.insert(scene.seed) && names.insert(&scene.name), "{set}: {}", scene.name);
                *families.entry(&scene.scene).or_default() += 1;
            }
            assert!(!families.is_empty() && families.values().all(|n| *n >= 3), "{set}: {families:?}");
        }
        for name in Table::all().unwrap().into_iter().filter_map(|t| t.data) {
            assert!(all.contains_key(&name), "{name}");
        }
    }

    #[test]
    fn a_scene_is_found_by_its_names_in_the_folders_of_its_set() {
        let (root, set) = (tempfile::tempdir().unwrap(), DataSet::find("dnerf").unwrap());
        let table = Table::find("fags", "dnerf").unwrap();
        let mutant = table.scenes.iter().find(|s| s.name == "mutant").unwrap();
        let roots = [root.path().to_owned()];
        assert_eq!(set.folder(mutant, &roots), None);
        for place in ["dnerf_mutant_400", "data/mutant"] {
            std::fs::create_dir_all(root.path().join(place)).unwrap();
            assert_eq!(set.folder(mutant, &roots), Some(root.path().join(place)), "the folder of the set goes first");
        }
    }

    #[test]
    fn a_generated_scene_is_written_once() {
        let root = tempfile::tempdir().unwrap();
        let scene = Generated { size: 8, ..DataSet::find("dnerf").unwrap().generated.remove(0) };
        let folder = scene.write(root.path()).unwrap();
        let file = folder.join("transforms_train.json");
        std::fs::write(&file, "mine").unwrap();
        assert_eq!(scene.write(root.path()).unwrap(), folder);
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "mine");
    }
}
