//! Folders that are copied from generated scenes and then broken.

use glam::DMat4;
use gs_core::Image;
use gs_core::io::images::{load_image, save_png};
use gs_data::{DataOptions, Dataset, StartFrom, write_start};
use gs_synth::{self as synth, SynthOptions};
use gs4d_doctor::{CheckOptions, Checkup, examine};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// A folder with a generated scene.
pub struct Folder(tempfile::TempDir);

impl Folder {
    /// A copy of a scene made once; `static-opaque`, `balls-opaque` and `falling-opaque` are those scenes without alpha.
    pub fn of(scene: &'static str) -> Self {
        // A static is never dropped: its folder stays in that of the build.
        static MADE: OnceLock<tempfile::TempDir> = OnceLock::new();
        let all = MADE.get_or_init(|| {
            let dir = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("folder");
            let still = SynthOptions::of_views(96, 60, 4);
            synth::write(&dir.path().join("static"), "static", &still, false).expect("scene");
            synth::write(&dir.path().join("balls"), "balls", &still, false).expect("scene");
            let rig = SynthOptions { size: 96, cameras: 8, moments: 12, ..Default::default() };
            synth::write(&dir.path().join("falling"), "falling", &rig, false).expect("scene");
            let rig = SynthOptions { size: 64, cameras: 6, moments: 28, ..Default::default() };
            synth::write(&dir.path().join("reach"), "reach", &rig, false).expect("scene");
            for scene in ["static", "balls", "falling"] {
                opaque(&dir.path().join(scene), &dir.path().join(format!("{scene}-opaque")));
            }
            dir
        });
        let copy = tempfile::tempdir().expect("folder");
        copy_all(&all.path().join(scene), copy.path());
        Self(copy)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Changes `transforms_{split}.json`.
    pub fn edit(&self, split: &str, change: impl Fn(&mut Value)) {
        let file = self.path(&format!("transforms_{split}.json"));
        let mut v: Value = serde_json::from_str(&std::fs::read_to_string(&file).expect("file")).expect("JSON");
        change(&mut v);
        std::fs::write(&file, v.to_string()).expect("written");
    }

    /// Changes every camera-to-world matrix of all splits.
    pub fn poses(&self, change: impl Fn(usize, DMat4) -> DMat4) {
        for split in ["train", "val", "test"] {
            if self.path(&format!("transforms_{split}.json")).exists() {
                self.edit(split, |v| {
                    for (k, f) in v["frames"].as_array_mut().expect("frames").iter_mut().enumerate() {
                        f["transform_matrix"] = rows(change(k, matrix(&f["transform_matrix"])));
                    }
                });
            }
        }
    }

    /// The image of training view `k`.
    pub fn photo(&self, k: usize) -> PathBuf {
        let frames = self.frames();
        let path = self.path(frames[k]["file_path"].as_str().expect("path").trim_start_matches("./"));
        if path.exists() { path } else { path.with_extension("png") }
    }

    /// Changes an image.
    pub fn paint(&self, k: usize, change: impl Fn(&Image) -> Image) {
        let file = self.photo(k);
        let image = load_image(&file, &Default::default()).expect("image");
        save_png(&file, &change(&image), true).expect("written");
    }

    /// Views of the training file.
    pub fn frames(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.path("transforms_train.json")).expect("file");
        let v: Value = serde_json::from_str(&text).expect("JSON");
        v["frames"].as_array().expect("frames").clone()
    }

    /// Where it is.
    pub fn dir(&self) -> &Path {
        self.0.path()
    }

    pub fn look(&self) -> Checkup {
        examine(self.0.path(), &CheckOptions::default())
    }
}

pub fn copy_all(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("folder");
    for entry in std::fs::read_dir(from).expect("list") {
        let entry = entry.expect("entry");
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_all(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).expect("copy");
        }
    }
}

/// A copy over black, without alpha, with points of its hull: no silhouettes, and nothing else at fault.
fn opaque(from: &Path, to: &Path) {
    copy_all(from, to);
    let start = Dataset::open(from, &DataOptions::default()).expect("data").start(Some(StartFrom::Hull), 500, 0);
    write_start(to, &start.expect("points"), false).expect("written");
    for split in ["train", "val", "test"].map(|s| to.join(s)).iter().filter(|s| s.exists()) {
        let files = std::fs::read_dir(split).expect("list").map(|e| e.expect("entry").path());
        for file in files.collect::<Vec<_>>() {
            let image = load_image(&file, &Default::default()).expect("image");
            let pixels = image.data.as_chunks::<4>().0.iter();
            let data = pixels.flat_map(|p| [p[0] * p[3], p[1] * p[3], p[2] * p[3]]).collect();
            save_png(&file, &Image { channels: 3, data, ..image }, true).expect("written");
        }
    }
}

pub fn matrix(v: &Value) -> DMat4 {
    let at = |i: usize, j: usize| v[i][j].as_f64().expect("number");
    DMat4::from_cols_array(&std::array::from_fn(|k| at(k % 4, k / 4)))
}

pub fn rows(m: DMat4) -> Value {
    let r = m.transpose().to_cols_array_2d();
    json!(r)
}

pub fn each(image: &Image, f: impl Fn(usize, usize, &[f32]) -> Vec<f32>) -> Image {
    let at = |k: usize| f(k % image.width, k / image.width, &image.data[k * image.channels..(k + 1) * image.channels]);
    let data = (0..image.width * image.height).flat_map(at).collect();
    Image { data, ..image.clone() }
}

pub fn blurred(image: &Image) -> Image {
    let (w, h, c) = (image.width as isize, image.height as isize, image.channels);
    each(image, |x, y, own| {
        let mut sum = vec![0.0; c];
        for k in 0..81 {
            let at = |v: usize, d: isize, n: isize| (v as isize + d).clamp(0, n - 1) as usize;
            let (i, j) = (at(x, k % 9 - 4, w), at(y, k / 9 - 4, h));
            sum.iter_mut().zip(image.pixel(i, j)).for_each(|(s, v)| *s += v / 81.0);
        }
        sum[c - 1] = own[c - 1];
        sum
    })
}
