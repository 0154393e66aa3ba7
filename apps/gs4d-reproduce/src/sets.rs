//! The papers' data sets: where a scene is looked for, and what stands in for a set that is not there.

use crate::table::{Scene, TableError};
use gs_core::io::disk;
use gs_data::DataError;
use gs_synth::SynthOptions;
use gs_synth::avatar::{self, AvatarOptions};
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
    /// Name of the reader of its scenes in [`gs_data::LAYOUTS`].
    pub reader: String,
    /// The files of a scene, as that reader reads them.
    pub layout: String,
    /// Names of folders that hold its scenes.
    pub folders: Vec<String>,
    /// Scenes that are run where none of its own is there. No setting was chosen on them.
    pub generated: Vec<Generated>,
}

/// A generated scene, or a film of a person where a method needs one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Generated {
    /// A scene of [`gs_synth::SCENES`].
    Scene(GeneratedScene),
    /// A film of [`gs_synth::avatar`].
    Film(GeneratedFilm),
}

/// A generated scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeneratedScene {
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

/// A generated film of a person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeneratedFilm {
    /// Name, and that of its folder.
    pub name: String,
    /// Character, motion, cameras and images; what is not named is as [`AvatarOptions::default`] has it.
    pub film: AvatarOptions,
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

    /// The folder of a scene below one of `roots`: `FOLDER/NAME` for the folders of this set, or `NAME`, in which the set's reader
    /// finds a data set. Only file names are looked at, and of JSON files the keys that decide.
    ///
    /// # Errors
    /// What is there instead.
    pub fn folder(&self, scene: &Scene, roots: &[PathBuf]) -> Result<PathBuf, Absence> {
        let names = || std::iter::once(&scene.name).chain(&scene.also);
        let under = |root: &PathBuf| -> Vec<PathBuf> {
            let inner = self.folders.iter().map(|f| root.join(f)).chain([root.clone()]);
            inner.flat_map(|base| names().map(move |n| base.join(n))).collect()
        };
        let mut absence = Absence::NotThere;
        for folder in roots.iter().flat_map(under).filter(|path| path.is_dir()) {
            let found = gs_data::detect(&folder).map(|layout| layout.name);
            if found == Some(self.reader.as_str()) {
                return Ok(folder);
            }
            if absence == Absence::NotThere {
                absence = Absence::Other { folder, reader: self.reader.clone(), found };
            }
        }
        Err(absence)
    }
}

/// What is in the place of a scene that is not there.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Absence {
    /// No folder of its name.
    #[error("not below --data")]
    NotThere,
    /// A folder of its name that its reader does not read.
    #[error(
        "{} holds no data set of the layout {reader}{}",
        folder.display(),
        found.map_or(String::new(), |found| format!(", but one of {found}"))
    )]
    Other {
        /// The folder.
        folder: PathBuf,
        /// The layout that was looked for.
        reader: String,
        /// The layout that it has, if any.
        found: Option<&'static str>,
    },
}

impl Generated {
    /// Name, and that of its folder.
    pub fn name(&self) -> &str {
        match self {
            Self::Scene(scene) => &scene.name,
            Self::Film(film) => &film.name,
        }
    }

    /// Its folder below `root`, written if it is not there: a folder that is there was written whole.
    ///
    /// # Errors
    /// If the scene cannot be made or written.
    pub fn write(&self, root: &Path) -> Result<PathBuf, DataError> {
        let folder = root.join(self.name());
        if folder.is_dir() {
            return Ok(folder);
        }
        let partial = root.join(format!(".{}.{}.partial", self.name(), std::process::id()));
        match self {
            Self::Scene(scene) => gs_synth::write(&partial, &scene.scene, &scene.options(), true).map(drop),
            Self::Film(film) => avatar::write(&partial, &film.film, false, true).map(drop),
        }?;
        match disk::rename(&partial, &folder) {
            // Another process wrote it meanwhile.
            Err(_) if folder.is_dir() => std::fs::remove_dir_all(&partial),
            renamed => renamed,
        }
        .map_err(|source| DataError::Write { file: folder.clone(), source })?;
        Ok(folder)
    }

    /// Whether a folder holds this scene, made with these options.
    pub fn is_in(&self, folder: &Path) -> bool {
        match self {
            Self::Scene(scene) => scene.is_in(folder),
            Self::Film(film) => film.is_in(folder),
        }
    }
}

impl GeneratedScene {
    fn is_in(&self, folder: &Path) -> bool {
        let made = gs_synth::truth(&self.scene, &self.options()).ok();
        let same = |(there, made): (gs_synth::Truth, gs_synth::Truth)| {
            there.scene() == made.scene() && there.options() == made.options()
        };
        gs_synth::truth_of(folder).zip(made).is_some_and(same)
    }

    /// How it is generated.
    pub fn options(&self) -> SynthOptions {
        let views = SynthOptions::of_views(self.size, 100, 20);
        SynthOptions { seed: self.seed, variant: self.variant, cameras: self.cameras, ..views }
    }
}

impl GeneratedFilm {
    fn is_in(&self, folder: &Path) -> bool {
        let there = avatar::options_of(folder).ok().flatten();
        // A folder states the layout of the atlas that was chosen for the template.
        there.is_some_and(|there| there == AvatarOptions { atlas: there.atlas, ..self.film.clone() })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Table;
    use gs_data::avatar::{BUILTIN, builtin};
    use std::collections::BTreeSet;
    use std::fs;

    /// Files by which the reader of a set knows a scene, and what the hint calls them.
    fn files(set: &str) -> &'static [(&'static str, &'static str)] {
        match set {
            "dnerf" | "particlenerf" => &[("transforms_train.json", "transforms_{train,val,test}.json")],
            "hypernerf" | "iphone" => &[
                ("dataset.json", "{scene,metadata,dataset}.json"),
                ("metadata.json", "{scene,metadata,dataset}.json"),
                ("camera/0.json", "camera/ID.json"),
                ("rgb/2x/0.png", "rgb/2x/ID.png"),
            ],
            "nvidia" => &[
                ("dense/sparse/cameras.bin", "dense/sparse/{cameras,images,points3D}.bin"),
                ("dense/sparse/images.bin", "dense/sparse/{cameras,images,points3D}.bin"),
                ("dense/images/0.jpg", "dense/images/"),
            ],
            "neu3d" => &[("poses_bounds.npy", "poses_bounds.npy"), ("cam00/images/0000.png", "camNN/images/0000.png")],
            "panoptic" => &[("train_meta.json", "{train,test}_meta.json"), ("ims/0/0.jpg", "ims/CAMERA/FRAME.jpg")],
            "nvfi-object" | "nvfi-indoor" | "nvfi-real" | "multipart" => &[
                ("transforms_train.json", "transforms_{train,val,test}.json"),
                ("transforms_test.json", "transforms_{train,val,test}.json"),
            ],
            "people" => &[("scene.json", "scene.json"), ("cameras.json", "cameras.json")],
            other => panic!("no files of {other}"),
        }
    }

    /// Makes a folder that the reader of a set takes for a scene.
    pub(crate) fn look_like(folder: &Path, set: &str) {
        for (name, _) in files(set) {
            let file = folder.join(name);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            let time = if name.contains("test") { 0.9 } else { 0.5 };
            let text =
                format!("{{\"frames\": [{{\"file_path\": \"a\", \"transform_matrix\": [], \"time\": {time}}}]}}");
            fs::write(file, text).unwrap();
        }
    }

    #[test]
    fn every_set_has_three_generated_scenes_a_family_and_no_seed_serves_twice() {
        let all = DataSet::all().unwrap();
        let (mut seeds, mut names, mut clips) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
        for (set, data) in &all {
            let mut families: BTreeMap<&str, usize> = BTreeMap::new();
            for generated in &data.generated {
                let name = generated.name();
                let (family, seed) = match generated {
                    Generated::Scene(scene) => {
                        assert!(gs_synth::SCENES.iter().any(|s| s.name == scene.scene), "{set}: {name}");
                        (&scene.scene, scene.seed)
                    }
                    Generated::Film(GeneratedFilm { film, .. }) => {
                        let template = film.template.strip_prefix(BUILTIN).and_then(builtin).unwrap();
                        let clip = film.clip.as_deref().unwrap();
                        assert!(template.clip(clip).is_some(), "{set}: {name}");
                        assert!(clips.insert((&film.template, clip)), "{set}: {name} has the motion of another film");
                        (&film.template, film.seed)
                    }
                };
                assert!(seeds.insert(seed) && names.insert(name), "{set}: {name}");
                *families.entry(family).or_default() += 1;
            }
            assert!(!families.is_empty() && families.values().all(|n| *n >= 3), "{set}: {families:?}");
        }
        for name in Table::all().unwrap().into_iter().filter_map(|t| t.data) {
            assert!(all.contains_key(&name), "{name}");
        }
    }

    /// The layout that a hint names is one that the reader of the set detects.
    #[test]
    fn every_hint_is_what_its_reader_reads() {
        for (name, set) in DataSet::all().unwrap() {
            let root = tempfile::tempdir().unwrap();
            look_like(root.path(), &name);
            assert_eq!(gs_data::detect(root.path()).map(|l| l.name), Some(set.reader.as_str()), "{name}");
            for (_, called) in files(&name) {
                assert!(set.layout.contains(called), "{name}: {called} is not in {}", set.layout);
            }
        }
    }

    #[test]
    fn a_scene_is_found_by_its_names_in_the_folders_of_its_set() {
        let (root, set) = (tempfile::tempdir().unwrap(), DataSet::find("dnerf").unwrap());
        let table = Table::find("fags", "dnerf").unwrap();
        let mutant = table.scenes.iter().find(|s| s.name == "mutant").unwrap();
        let roots = [root.path().to_owned()];
        assert_eq!(set.folder(mutant, &roots), Err(Absence::NotThere));
        for place in ["mutant", "data/mutant"] {
            look_like(&root.path().join(place), "dnerf");
            assert_eq!(set.folder(mutant, &roots), Ok(root.path().join(place)), "the folder of the set goes first");
        }
    }

    #[test]
    fn a_folder_without_the_files_of_its_reader_is_no_scene() {
        let (root, set) = (tempfile::tempdir().unwrap(), DataSet::find("dnerf").unwrap());
        let table = Table::find("fags", "dnerf").unwrap();
        let hook = table.scenes.iter().find(|s| s.name == "hook").unwrap();
        let roots = [root.path().to_owned()];
        let why = || set.folder(hook, &roots).unwrap_err().to_string();
        fs::create_dir_all(root.path().join("data/hook")).unwrap();
        assert!(why().ends_with("data/hook holds no data set of the layout blender"), "{}", why());
        look_like(&root.path().join("data/hook"), "panoptic");
        assert!(why().ends_with("of the layout blender, but one of panoptic"), "{}", why());
        look_like(&root.path().join("hook"), "dnerf");
        assert_eq!(set.folder(hook, &roots), Ok(root.path().join("hook")), "the next place counts");
    }

    /// What a set has generated first, small.
    fn small(set: &str) -> Generated {
        match DataSet::find(set).unwrap().generated.remove(0) {
            Generated::Scene(scene) => Generated::Scene(GeneratedScene { size: 8, ..scene }),
            Generated::Film(GeneratedFilm { name, film }) => {
                let film = AvatarOptions { size: 8, per_ring: 4, rings: 1, frames: 2, points: 10, ..film };
                Generated::Film(GeneratedFilm { name, film })
            }
        }
    }

    /// The same with another scene or another motion.
    fn other(generated: Generated) -> Generated {
        match generated {
            Generated::Scene(scene) => Generated::Scene(GeneratedScene { variant: scene.variant + 1, ..scene }),
            Generated::Film(GeneratedFilm { name, film }) => {
                let film = AvatarOptions { clip: Some("touch".into()), ..film };
                Generated::Film(GeneratedFilm { name, film })
            }
        }
    }

    #[test]
    fn what_is_generated_is_written_once() {
        for (set, name) in [("dnerf", "transforms_train.json"), ("people", "cameras.json")] {
            let (root, scene) = (tempfile::tempdir().unwrap(), small(set));
            let folder = scene.write(root.path()).unwrap();
            assert_eq!(gs_data::detect(&folder).map(|l| l.name), Some(DataSet::find(set).unwrap().reader.as_str()));
            let file = folder.join(name);
            fs::write(&file, "mine").unwrap();
            assert_eq!(scene.write(root.path()).unwrap(), folder);
            assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
            assert_eq!(fs::read_dir(root.path()).unwrap().count(), 1);
            assert!(scene.is_in(&folder) && !scene.is_in(root.path()), "{set}");
            assert!(!other(scene).is_in(&folder), "{set}: another scene");
        }
    }
}
