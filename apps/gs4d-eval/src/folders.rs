//! Scores of a folder of images against a folder of truths.
//!
//! Images are taken in the order of the numbers in their names and belong together by name, or by their place in that order
//! where the names differ. Both are laid over one background and rounded as the protocol says; a score says which protocol it
//! is of ([`FolderScores::protocol`]). Memory is that of a few images, however many there are.

pub mod pictures;

use crate::compare::{Comparer, Metric, SetScores};
use gs_core::Image;
use gs_core::io::IoError;
use gs_metrics::{MetricError, Tof, TofScore};
pub use gs_metrics::{Quantise, TofOptions};
use pictures::{Pictures, mask, over};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// What is to be scored, and how.
#[derive(Clone, Debug)]
pub struct FolderTask {
    /// Folder of the images.
    pub pred: PathBuf,
    /// Folder of their truths.
    pub gt: PathBuf,
    /// Folder of masks: with it every image gets masked scores, too. It may hold more masks than there are images.
    pub mask: Option<PathBuf>,
    /// Scores of whole images.
    pub metrics: Vec<Metric>,
    /// Motion: the images are frames of one video.
    pub tof: Option<TofOptions>,
    /// Rounding to 8 bit; truths are rounded to the nearest step where it is not [`Quantise::None`].
    pub quantise: Quantise,
    /// Colour behind images with alpha.
    pub background: [f32; 3],
}

/// What a folder scored.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FolderScores {
    /// Scores of images and their means.
    #[serde(flatten)]
    pub images: SetScores,
    /// Motion, where asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tof: Option<VideoScore>,
    /// How the images were compared, in words.
    pub protocol: String,
}

/// The motion score of a video.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VideoScore {
    /// Pixels, mean over pairs.
    pub mean: f64,
    /// Each pair of consecutive frames that counts.
    pub pairs: Vec<PairScore>,
}

/// The motion score of one pair.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairScore {
    /// Place of the later frame, from 0.
    pub frame: usize,
    /// Its name.
    pub name: String,
    /// Pixels.
    pub tof: f64,
}

impl VideoScore {
    /// A score with the names of the frames.
    pub fn new<'a>(score: &TofScore, name: impl Fn(usize) -> &'a str) -> Self {
        let pair = |&(frame, tof): &(usize, f64)| PairScore { frame, name: name(frame).to_owned(), tof };
        Self { mean: score.mean, pairs: score.pairs.iter().map(pair).collect() }
    }
}

/// Why folders have no score.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// A folder cannot be listed.
    #[error("cannot list the folder {}: {source}", folder.display())]
    List {
        /// The folder.
        folder: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A folder without images.
    #[error("the folder holds no image (give {extensions} files)")]
    Empty {
        /// The folder.
        folder: PathBuf,
        /// What would be read.
        extensions: String,
    },
    /// Two files of the same name but for the extension.
    #[error("two images have the same name: {} and {}", first.display(), second.display())]
    Twins {
        /// One.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// Images without partners.
    #[error("{count} images have no partner: {named} (the folders hold {} and {} images)", counts[0], counts[1])]
    Unpaired {
        /// How many.
        count: usize,
        /// The first of them.
        named: String,
        /// The folder that lacks them.
        folder: PathBuf,
        /// Images in both folders.
        counts: [usize; 2],
    },
    /// A file that is no image the metrics take.
    #[error("{what}")]
    Image {
        /// The file.
        path: PathBuf,
        /// What it is.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A file that cannot be read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// A pair that cannot be compared.
    #[error("{source}")]
    Metric {
        /// The image.
        path: PathBuf,
        /// The metric's reason.
        source: MetricError,
    },
}

/// Scores the folders of a task.
///
/// # Errors
/// Folders that cannot be listed or paired, files that cannot be read, pairs that cannot be compared.
pub fn score(task: &FolderTask) -> Result<FolderScores, FolderError> {
    let (images, truths) = (Pictures::of(&task.pred)?, Pictures::of(&task.gt)?);
    let truths = images.partners(&truths, false)?;
    let masks = task.mask.as_deref().map(Pictures::of).transpose()?;
    let masks = masks.as_ref().map(|m| images.partners(m, true)).transpose()?;
    let mut comparer = Comparer::new(&task.metrics);
    let mut video = task.tof.map(Tof::new);
    for (i, (picture, truth)) in images.files().iter().zip(&truths).enumerate() {
        let (image, truth) = read_pair(task, &picture.path, &truth.path)?;
        let mask = masks.as_ref().map(|m| mask(&m[i].path)).transpose()?;
        let failed = |source| FolderError::Metric { path: picture.path.clone(), source };
        comparer.add(&picture.name, &image, &truth, mask.as_ref()).map_err(failed)?;
        video.as_mut().map_or(Ok(()), |v| v.add(&image, &truth)).map_err(failed)?;
    }
    let failed = |source| FolderError::Metric { path: task.pred.clone(), source };
    let tof = video.map(Tof::finish).transpose().map_err(failed)?;
    let tof = tof.map(|t| VideoScore::new(&t, |i| &images.files()[i].name));
    Ok(FolderScores { images: comparer.finish(), tof, protocol: protocol(task) })
}

fn read_pair(task: &FolderTask, pred: &Path, gt: &Path) -> Result<(Image, Image), FolderError> {
    let (mut image, mut truth) = (over(pred, task.background)?, over(gt, task.background)?);
    task.quantise.apply(&mut image);
    if task.quantise != Quantise::None {
        Quantise::Round.apply(&mut truth);
    }
    Ok((image, truth))
}

/// How the images are compared, in words.
fn protocol(task: &FolderTask) -> String {
    let quantised = match task.quantise {
        Quantise::None => "values as stored",
        Quantise::Round => "rounded to 8 bit",
        Quantise::Truncate => "images truncated and truths rounded to 8 bit",
    };
    let mut parts =
        vec![format!("data range 1, {quantised}; SSIM 11x11 with zero padding; perceptual_proxy is not LPIPS")];
    if task.mask.is_some() {
        parts.push("masked: PSNR over weighted pixels, SSIM by partial convolution (DyCheck)".to_owned());
    }
    parts.extend(task.tof.map(tof_protocol));
    parts.join("; ")
}

/// How motion is compared, in words.
pub fn tof_protocol(options: TofOptions) -> String {
    let ends = if options.trim { "without the first and last two frames" } else { "all frames" };
    let border = if options.crop { "without the border" } else { "whole frames" };
    format!("tof: mean distance of Farneback flows in pixels, {ends}, {border}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::io::images::save_png;

    /// Writes frames of a wave that moves by `speed`.
    fn video(folder: &Path, prefix: &str, n: usize, speed: f32) {
        std::fs::create_dir_all(folder).unwrap();
        for i in 0..n {
            let shift = i as f32 * speed;
            let value = |x: f32, y: f32| 0.5 + 0.2 * (0.4 * (x - shift)).sin() + 0.2 * (0.3 * y).cos();
            let data = (0..64 * 48).flat_map(|k| [value((k % 64) as f32, (k / 64) as f32); 3]).collect();
            let image = Image { width: 64, height: 48, channels: 3, data };
            save_png(&folder.join(format!("{prefix}{i}.png")), &image, false).unwrap();
        }
    }

    fn task(root: &Path) -> FolderTask {
        FolderTask {
            pred: root.join("pred"),
            gt: root.join("gt"),
            mask: None,
            metrics: vec![Metric::Psnr],
            tof: Some(TofOptions::default()),
            quantise: Quantise::Round,
            background: [0.0; 3],
        }
    }

    #[test]
    fn videos_are_paired_by_order_and_scored_by_motion() {
        let root = tempfile::tempdir().unwrap();
        video(&root.path().join("pred"), "render_", 12, 1.5);
        video(&root.path().join("gt"), "f", 12, 1.0);
        let got = score(&task(root.path())).unwrap();
        let tof = got.tof.unwrap();
        assert_eq!((tof.pairs.len(), tof.pairs[0].frame, tof.pairs[0].name.as_str()), (7, 3, "render_3"));
        assert!((tof.mean - 0.5).abs() < 0.1, "{}", tof.mean);
        assert_eq!(got.images.views[10].name, "render_10");
        assert!(got.protocol.contains("rounded to 8 bit") && got.protocol.contains("first and last two"));
        let whole = TofOptions { trim: false, crop: false };
        let all = score(&FolderTask { tof: Some(whole), ..task(root.path()) }).unwrap();
        assert_eq!(all.tof.unwrap().pairs.len(), 11);
    }

    #[test]
    fn what_cannot_be_scored_says_so() {
        let root = tempfile::tempdir().unwrap();
        video(&root.path().join("pred"), "a", 4, 1.0);
        video(&root.path().join("gt"), "a", 4, 1.0);
        let e = score(&task(root.path())).unwrap_err();
        assert!(e.to_string().contains("at least 6 frames"), "{e}");
        let missing = FolderTask { mask: Some(root.path().join("none")), ..task(root.path()) };
        assert!(matches!(score(&missing), Err(FolderError::List { .. })));
    }
}
