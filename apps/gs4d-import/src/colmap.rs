//! Calls of COLMAP (Schönberger and Frahm 2016). Option names are those of the version that is installed: its help is asked.

use crate::error::ImportError;
use crate::frames::{IMAGES, clear, create};
use crate::program::{COLMAP, Call, Runner, Sink};
use gs_core::io::write_file;
use gs_data::{DataError, Reconstruction};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Camera models that gs4d can undistort, by COLMAP's names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum CameraModel {
    /// One focal length.
    SimplePinhole,
    /// Two focal lengths.
    Pinhole,
    /// One focal length, `k1`.
    SimpleRadial,
    /// One focal length, `k1 k2`.
    Radial,
    /// Two focal lengths, `k1 k2 p1 p2`.
    Opencv,
    /// A fisheye: one focal length, `k1 k2`.
    RadialFisheye,
    /// A fisheye: two focal lengths, `k1 k2 k3 k4`, which only a wide view determines.
    OpencvFisheye,
}

impl CameraModel {
    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::Opencv => "OPENCV",
            Self::RadialFisheye => "RADIAL_FISHEYE",
            Self::OpencvFisheye => "OPENCV_FISHEYE",
        }
    }

    /// Parameters without distortion for a horizontal field of view, degrees.
    fn parameters(self, [width, height]: [u32; 2], fov: f64) -> String {
        let [w, h] = [width, height].map(f64::from);
        let half = 0.5 * fov.to_radians();
        let fisheye = matches!(self, Self::RadialFisheye | Self::OpencvFisheye);
        let f = 0.5 * w / if fisheye { half } else { half.tan() };
        let (focal, distortion) = match self {
            Self::SimplePinhole => (1, 0),
            Self::Pinhole => (2, 0),
            Self::SimpleRadial => (1, 1),
            Self::Radial | Self::RadialFisheye => (1, 2),
            Self::Opencv | Self::OpencvFisheye => (2, 4),
        };
        let mut all = vec![f; focal];
        all.extend([0.5 * w, 0.5 * h]);
        all.resize(focal + 2 + distortion, 0.0);
        all.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
    }
}

/// What the calls share.
pub(crate) struct Colmap<'a> {
    pub(crate) runner: &'a Runner<'a>,
    /// The data set: the folder of every call.
    pub(crate) data: &'a Path,
    pub(crate) gpu: bool,
    pub(crate) threads: Option<usize>,
}

/// Images that one call of the extractor takes: those of one lens.
pub(crate) struct Lot {
    pub(crate) names: Vec<String>,
    pub(crate) size: [u32; 2],
    /// Number of their camera in the database, if it has it already.
    pub(crate) existing: Option<u32>,
}

/// How features are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Features {
    pub(crate) model: CameraModel,
    /// Known horizontal field of view, degrees.
    pub(crate) fov: Option<f64>,
    /// Affine shapes and pooled sizes (DSP-SIFT): slower, matches over wider angles.
    pub(crate) wide: bool,
}

/// Which images are matched with each other.
pub(crate) enum Pairs {
    All,
    /// Each with so many that follow it in order of names.
    Following(usize),
    /// Two names on a line.
    Listed(Vec<String>),
}

/// Paths from the data set.
const DATABASE: &str = "import/database.db";
const LIST: &str = "import/list.txt";
const SPARSE: &str = "import/sparse";
const REGISTERED: &str = "import/registered";

/// What a mapper says at last that found no images to begin with: COLMAP 3, COLMAP 4.
const NO_MODEL: [&str; 2] = ["failed to create sparse model", "Failed to create any sparse model"];

/// Hears how many of how many.
pub(crate) type Tell<'a> = &'a mut dyn FnMut(usize, Option<usize>);

impl Colmap<'_> {
    /// The option of a command that its help has, of several names over versions.
    fn help(&self, command: &str) -> Result<String, ImportError> {
        let mut text = String::new();
        let call = Call::new(COLMAP, self.data, format!("list the options of {command}")).args([command, "--help"]);
        match self.runner.run(call, Sink::Lines(&mut |line| text.extend([line, "\n"]))) {
            // Some versions call it a failure to be asked for help.
            Ok(()) | Err(ImportError::Failed { .. }) => Ok(text),
            Err(e) => Err(e),
        }
    }

    /// Runs a command with fixed arguments and those of the wanted options that its version has.
    fn step(
        &self,
        command: &str,
        task: &str,
        fixed: &[&str],
        wanted: &[(&str, String)],
        tell: Tell<'_>,
    ) -> Result<(), ImportError> {
        let help = self.help(command)?;
        let mut call = Call::new(COLMAP, self.data, task).args([command]).args(fixed.iter().copied());
        for (names, value) in wanted {
            let known = names.split('|').map(|n| format!("--{n}")).find(|n| has_word(&help, n));
            call = call.args(known.into_iter().flat_map(|name| [name, value.clone()]));
        }
        let mut done = 0;
        let mut each = |line: &str| {
            if let Some((at, of)) = counted(line) {
                tell(at, Some(of));
            } else if line.contains("Registering image #") {
                done += 1;
                tell(done, None);
            }
        };
        self.runner.run(call, Sink::Lines(&mut each))
    }

    /// Options for the processor or the graphics card, of extractors and matchers.
    fn device(&self, kind: &str) -> Vec<(&'static str, String)> {
        let (gpu, threads) = match kind {
            "extraction" => (
                "FeatureExtraction.use_gpu|SiftExtraction.use_gpu",
                "FeatureExtraction.num_threads|SiftExtraction.num_threads",
            ),
            _ => {
                ("FeatureMatching.use_gpu|SiftMatching.use_gpu", "FeatureMatching.num_threads|SiftMatching.num_threads")
            }
        };
        let mut options = vec![(gpu, u8::from(self.gpu).to_string())];
        options.extend(self.threads.map(|n| (threads, n.to_string())));
        options
    }

    /// Finds features; every lot gets a camera of its own in the database.
    pub(crate) fn extract(&self, lots: &[Lot], features: Features, tell: Tell<'_>) -> Result<(), ImportError> {
        let all: usize = lots.iter().map(|l| l.names.len()).sum();
        let mut before = 0;
        for lot in lots {
            self.write_list(&lot.names)?;
            let mut wanted = self.device("extraction");
            if let Some(fov) = features.fov {
                wanted.push(("ImageReader.camera_params", features.model.parameters(lot.size, fov)));
            }
            if features.wide {
                wanted.push(("SiftExtraction.estimate_affine_shape", "1".to_owned()));
                wanted.push(("SiftExtraction.domain_size_pooling", "1".to_owned()));
            }
            if let Some(camera) = lot.existing {
                wanted.push(("ImageReader.existing_camera_id", camera.to_string()));
            }
            let fixed = [
                "--database_path",
                DATABASE,
                "--image_path",
                IMAGES,
                "--image_list_path",
                LIST,
                "--ImageReader.camera_model",
                features.model.name(),
                "--ImageReader.single_camera",
                "1",
            ];
            let mut heard = |at: usize, _: Option<usize>| tell(before + at, Some(all));
            self.step("feature_extractor", "find features", &fixed, &wanted, &mut heard)?;
            before += lot.names.len();
        }
        Ok(())
    }

    /// Matches images; `guided` searches again along epipolar lines.
    pub(crate) fn match_images(&self, pairs: &Pairs, guided: bool, tell: Tell<'_>) -> Result<(), ImportError> {
        let mut wanted = self.device("matching");
        if guided {
            wanted.push(("FeatureMatching.guided_matching|SiftMatching.guided_matching", "1".to_owned()));
        }
        let mut fixed = vec!["--database_path", DATABASE];
        let command = match pairs {
            Pairs::All => "exhaustive_matcher",
            Pairs::Following(n) => {
                wanted.push(("SequentialMatching.overlap", n.to_string()));
                "sequential_matcher"
            }
            Pairs::Listed(pairs) => {
                self.write_list(pairs)?;
                fixed.extend(["--match_list_path", LIST, "--match_type", "pairs"]);
                "matches_importer"
            }
        };
        self.step(command, "match images", &fixed, &wanted, tell)
    }

    /// Reconstructs; the largest model, or none where no images fit together.
    pub(crate) fn map(&self, known_focal: bool, tell: Tell<'_>) -> Result<Option<Model>, ImportError> {
        clear(&self.data.join(SPARSE))?;
        create(&self.data.join(SPARSE))?;
        let mut wanted =
            vec![("Mapper.min_model_size", "2".to_owned()), ("Mapper.tri_ignore_two_view_tracks", "0".to_owned())];
        if known_focal {
            wanted.push(("Mapper.ba_refine_focal_length", "0".to_owned()));
        }
        wanted.extend(self.threads.map(|n| ("Mapper.num_threads", n.to_string())));
        let fixed = ["--database_path", DATABASE, "--image_path", IMAGES, "--output_path", SPARSE];
        match self.step("mapper", "reconstruct the cameras", &fixed, &wanted, tell) {
            Ok(()) => self.largest(),
            Err(ImportError::Failed { tail, .. })
                if tail.iter().any(|line| NO_MODEL.iter().any(|said| line.contains(said))) =>
            {
                Ok(None)
            }
            Err(e) => Err(e),
        }
    }

    fn largest(&self) -> Result<Option<Model>, ImportError> {
        let mut best: Option<Model> = None;
        for k in 0.. {
            let folder = format!("{SPARSE}/{k}");
            if !self.data.join(&folder).is_dir() {
                break;
            }
            let read = Reconstruction::read(&self.data.join(&folder))?;
            if best.as_ref().is_none_or(|b| b.read.images.len() < read.images.len()) {
                best = Some(Model { folder, read });
            }
        }
        Ok(best)
    }

    /// Places further images of the database in a model.
    pub(crate) fn register(&self, model: &Model, tell: Tell<'_>) -> Result<Model, ImportError> {
        clear(&self.data.join(REGISTERED))?;
        create(&self.data.join(REGISTERED))?;
        let fixed = ["--database_path", DATABASE, "--input_path", &model.folder, "--output_path", REGISTERED];
        self.step("image_registrator", "place further images", &fixed, &[], tell)?;
        let read = Reconstruction::read(&self.data.join(REGISTERED))?;
        // The points are those that were there before.
        Ok(Model { folder: REGISTERED.to_owned(), read })
    }

    /// Mean reprojection error of a model, pixels; none if this version does not say it.
    pub(crate) fn error_of(&self, model: &Model) -> Result<Option<f64>, ImportError> {
        let mut found = None;
        let call = Call::new(COLMAP, self.data, "measure the model").args(["model_analyzer", "--path", &model.folder]);
        let mut each = |line: &str| found = found.or_else(|| reprojection(line));
        match self.runner.run(call, Sink::Lines(&mut each)) {
            Ok(()) | Err(ImportError::Failed { .. }) => Ok(found),
            Err(e) => Err(e),
        }
    }

    fn write_list(&self, lines: &[String]) -> Result<(), ImportError> {
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        Ok(write_file(&self.data.join(LIST), true, |out| out.write_all(text.as_bytes()))?)
    }

    /// Forgets all features and matches.
    pub(crate) fn forget(&self) -> Result<(), ImportError> {
        for end in ["", "-wal", "-shm", "-journal"] {
            let file: PathBuf = self.data.join(format!("{DATABASE}{end}"));
            match std::fs::remove_file(&file) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(ImportError::os("remove", &file)(e)),
                _ => {}
            }
        }
        Ok(())
    }
}

/// A reconstruction and its folder, from the data set.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    folder: String,
    pub(crate) read: Reconstruction,
}

impl Model {
    /// The reconstruction that an earlier call left in a folder of the data set.
    pub(crate) fn open(data: &Path, folder: &str) -> Result<Self, DataError> {
        Ok(Self { folder: folder.to_owned(), read: Reconstruction::read(&data.join(folder))? })
    }

    /// Its folder, from the data set.
    pub(crate) fn folder(&self) -> &str {
        &self.folder
    }
}

/// Whether a text has this word, ended by a space or a line break.
fn has_word(text: &str, word: &str) -> bool {
    text.split_whitespace().any(|w| w == word)
}

/// `[3/24]`: three of 24.
fn counted(line: &str) -> Option<(usize, usize)> {
    let inside = line.rsplit_once('[')?.1.split_once(']')?.0;
    let (at, of) = inside.split(',').next()?.split_once('/')?;
    Some((at.trim().parse().ok()?, of.trim().parse().ok()?))
}

fn reprojection(line: &str) -> Option<f64> {
    let value = line.split("Mean reprojection error:").nth(1)?.trim().trim_end_matches("px");
    value.parse().ok().filter(|v: &f64| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_several_versions_are_understood() {
        assert_eq!(counted("Processed file [3/24]"), Some((3, 24)));
        assert_eq!(counted("I20260301 12:00:00.1 77 feature_extraction.cc:258] Processed file [3/24]"), Some((3, 24)));
        assert_eq!(counted("Matching block [1/2, 1/2] in 0.4s"), Some((1, 2)));
        assert_eq!(counted("Elapsed time: 0.1 [minutes]"), None);
        assert_eq!(reprojection("Mean reprojection error: 0.512px"), Some(0.512));
        assert_eq!(reprojection("I20 model.cc:7] Mean reprojection error: 0.5px"), Some(0.5));
        assert_eq!(reprojection("Mean reprojection error: -nanpx"), None);
        assert!(has_word("  --SiftExtraction.use_gpu arg (=1)", "--SiftExtraction.use_gpu"));
        assert!(!has_word("  --SiftExtraction.use_gpu2 arg", "--SiftExtraction.use_gpu"));
    }

    #[test]
    fn a_known_field_of_view_is_a_focal_length() {
        assert_eq!(CameraModel::SimpleRadial.parameters([200, 100], 90.0), "100.00000000000001,100,50,0");
        let all = CameraModel::Opencv.parameters([200, 100], 90.0);
        assert_eq!(all.split(',').count(), 8);
        let fisheye = CameraModel::RadialFisheye.parameters([200, 100], 90.0);
        let fisheye: Vec<f64> = fisheye.split(',').map(|v| v.parse().unwrap()).collect();
        assert!((fisheye[0] * std::f64::consts::FRAC_PI_4 - 100.0).abs() < 1e-9, "half the angle on half the width");
        assert_eq!(fisheye[1..], [100.0, 50.0, 0.0, 0.0]);
        assert_eq!(serde_json::to_value(CameraModel::SimplePinhole).unwrap(), CameraModel::SimplePinhole.name());
    }
}
