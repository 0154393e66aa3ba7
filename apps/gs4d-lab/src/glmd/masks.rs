//! Masks of the moving object.

use std::path::Path;

use gs_core::{Camera, Image};
use gs_metrics::flow::Flow;

use super::GlmdError;
use gs_data::DataError;
use gs_data::decode::decode;
use gs_synth::Truth;
use gs_synth::body::MotionClass;
use gs4d_eval::forecast::Clock;

/// Source of the object masks.
#[derive(Clone, Debug)]
pub enum Masks {
    /// One mask `[H, W, 1]` with values 0 or 1 for all times, or one per time.
    Given(Vec<Image>),
    /// The rigidly moving bodies of a generated scene, and the clock of the data, which is the scene's; none where that is the normalised time.
    Truth(Box<Truth>, Option<Clock>),
    /// Pixels where the model's first flow is at least half of its 95th percentile. Ratios are then above 1 by construction.
    Threshold,
}

impl Masks {
    /// Reads the PNG files of a folder in the order of their names; red values of 128 or more are the object.
    ///
    /// # Errors
    /// If the folder cannot be listed or holds no PNG file, or one cannot be read.
    pub fn of_folder(folder: &Path) -> Result<Self, DataError> {
        let refused = |e| DataError::read(folder, e);
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(refused)? {
            let path = entry.map_err(refused)?.path();
            if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
                files.push(path);
            }
        }
        files.sort();
        if files.is_empty() {
            let (name, value) = ("mask", folder.display().to_string());
            return Err(DataError::Option { name, value, rule: "a folder of PNG files".into() });
        }
        let read = |file: &std::path::PathBuf| {
            let image = decode(file, None)?;
            let data = image.data.chunks_exact(4).map(|p| f32::from(p[0] >= 128)).collect();
            Ok(Image { width: image.width, height: image.height, channels: 1, data })
        };
        Ok(Self::Given(files.iter().map(read).collect::<Result<_, DataError>>()?))
    }

    /// Description of the source, for the report.
    pub fn source(&self) -> &'static str {
        match self {
            Self::Given(_) => "given",
            Self::Truth(..) => "rigid bodies of the generated scene",
            Self::Threshold => "threshold of the model's first flow: ratios above 1 by construction",
        }
    }

    /// Checks the number of masks and their size against the camera.
    pub(super) fn check(&self, camera: &Camera, times: usize) -> Result<(), GlmdError> {
        let Self::Given(masks) = self else { return Ok(()) };
        if masks.len() != 1 && masks.len() != times {
            let text = format!("{} masks for {times} moments: give one for all, or one for each", masks.len());
            return Err(GlmdError::Mask(text));
        }
        let want = (camera.width as usize, camera.height as usize, 1);
        match masks.iter().position(|m| m.shape() != want) {
            Some(k) => {
                let (w, h, _) = masks[k].shape();
                Err(GlmdError::Mask(format!("mask {k} has {w}x{h} pixels, the camera {}x{}", want.0, want.1)))
            }
            None => Ok(()),
        }
    }

    /// The mask `[H, W, 1]` at the `k`-th time; `first` is the flow of the model's first stage.
    pub(super) fn at(&self, k: usize, time: f32, camera: &Camera, first: &Flow) -> Image {
        match self {
            Self::Given(all) => all[k.min(all.len() - 1)].clone(),
            Self::Truth(truth, clock) => {
                truth.mask(camera, Clock::time(*clock, f64::from(time)).seconds, MotionClass::Global)
            }
            Self::Threshold => {
                let lengths = first.magnitudes();
                let mut sorted = lengths.clone();
                sorted.sort_unstable_by(f32::total_cmp);
                let half = 0.5 * sorted[(sorted.len() * 95 / 100).min(sorted.len() - 1)];
                let data = lengths.iter().map(|l| f32::from(*l >= half && half > 0.0)).collect();
                Image { width: first.width, height: first.height, channels: 1, data }
            }
        }
    }
}
