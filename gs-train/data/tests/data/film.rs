//! A small film of a person that tests look at, and one on the disk that they damage.

use gs_data::avatar::AvatarScene;
use gs_data::{DataError, DataOptions, Dataset, ImageCache, ImageU8, View};
use gs_synth::avatar::{AvatarOptions, generate, write};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use tempfile::TempDir;

pub(crate) fn small() -> AvatarOptions {
    AvatarOptions { per_ring: 8, rings: 2, frames: 5, size: 40, points: 400, ..AvatarOptions::default() }
}

/// A film that several tests look at.
pub(crate) fn film() -> &'static Dataset {
    static FILM: OnceLock<Dataset> = OnceLock::new();
    FILM.get_or_init(|| generate(&AvatarOptions { size: 96, ..small() }).unwrap())
}

pub(crate) fn scene(data: &Dataset) -> &AvatarScene {
    data.avatar.as_ref().unwrap()
}

pub(crate) fn pixels(view: &View) -> Arc<ImageU8> {
    ImageCache::new(0, 1.0).get(view).unwrap()
}

pub(crate) fn open(dir: &Path) -> Result<Dataset, DataError> {
    Dataset::open(dir, &DataOptions::default())
}

/// A film on the disk that tests damage.
pub(crate) struct Broken {
    pub(crate) dir: TempDir,
    scene: Value,
    pub(crate) cameras: Value,
}

impl Broken {
    pub(crate) fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let options =
            AvatarOptions { per_ring: 4, rings: 1, frames: 3, size: 16, points: 10, ..AvatarOptions::default() };
        write(dir.path(), &options, false, false).unwrap();
        let read = |name: &str| serde_json::from_slice(&std::fs::read(dir.path().join(name)).unwrap()).unwrap();
        Self { scene: read("scene.json"), cameras: read("cameras.json"), dir }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn put(&self, name: &str, text: impl AsRef<[u8]>) -> &Self {
        std::fs::write(self.path(name), text).unwrap();
        self
    }

    pub(crate) fn open_with(&self, options: &DataOptions) -> Result<Dataset, DataError> {
        Dataset::open(self.dir.path(), options)
    }

    /// The fault of `scene.json` with one field changed.
    pub(crate) fn scene(&self, key: &str, value: Value) -> DataError {
        let mut scene = self.scene.clone();
        scene[key] = value;
        self.put("scene.json", scene.to_string());
        let e = open(self.dir.path()).unwrap_err();
        self.put("scene.json", self.scene.to_string());
        e
    }

    /// The fault of `cameras.json` with one field of camera 1 changed.
    pub(crate) fn camera(&self, key: &str, value: Value) -> DataError {
        let mut cameras = self.cameras.clone();
        cameras[1][key] = value;
        self.put("cameras.json", cameras.to_string().replace("\"<NaN>\"", "NaN"));
        let e = open(self.dir.path()).unwrap_err();
        self.put("cameras.json", self.cameras.to_string());
        e
    }
}

/// The report of a fault must name these.
pub(crate) fn names(e: &DataError, code: &str, words: &[&str]) {
    let report = e.report();
    assert_eq!(e.code(), code, "{report}");
    words.iter().for_each(|w| assert!(report.contains(w), "`{w}` is not in: {report}"));
}
