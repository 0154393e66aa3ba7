//! Scores of a folder of images against a folder of ground truth.
//!
//! Images are sorted by the numbers in their names and paired by name, or by position where the names differ. Both are
//! composited over one background and rounded to 8 bit as the task says; the scores carry their protocol
//! ([`FolderScores::protocol`]). A few images are in memory at a time.

mod images;

use crate::compare::{Comparer, Metric, SetScores};
use gs_core::io::IoError;
pub use gs_metrics::{Lpips, LpipsRange, Quantise, TofOptions};
use gs_metrics::{MetricError, Tof, TofScore, half_size};
use images::{ImageFolder, Loaded, load_mask, load_over};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Folders to score, and how.
#[derive(Clone, Debug)]
pub struct FolderTask {
    /// Folder of the images to score.
    pub pred: PathBuf,
    /// Folder of their ground truth.
    pub gt: PathBuf,
    /// Folder of masks, for masked scores of every image. It may hold more masks than there are images.
    pub mask: Option<PathBuf>,
    /// Metrics that are computed over whole images.
    pub metrics: Vec<Metric>,
    /// LPIPS with these weights, if it is asked for.
    pub lpips: Option<Lpips>,
    /// Options of the temporal metric tOF, if the images are the frames of one video.
    pub tof: Option<TofOptions>,
    /// Quantisation of the images; unless it is [`Quantise::None`], ground truth is rounded to 8 bit.
    pub quantise: Quantise,
    /// Reduces images, ground truth and masks to half size before they are scored ([`half_size`]), after rounding; tOF is of full size.
    pub half: bool,
    /// Colour behind images with alpha, RGB in `[0, 1]`.
    pub background: [f32; 3],
}

/// The scores of a folder.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FolderScores {
    /// Scores of images and their means.
    #[serde(flatten)]
    pub images: SetScores,
    /// Temporal metric tOF; absent if not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tof: Option<VideoScore>,
    /// What images without alpha show where ground truth has transparent pixels; absent where it has none, or both have.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub behind: Option<Behind>,
    /// Conditions of the comparison, in words.
    pub protocol: String,
}

/// What images show where their ground truth is transparent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Behind {
    /// Number of such images.
    pub images: usize,
    /// Mean colour of their pixels there, RGB in `[0, 1]`.
    pub color: [f64; 3],
}

impl Behind {
    /// The largest difference of a channel to the colour that transparent pixels were put over.
    pub fn off(&self, background: [f32; 3]) -> f64 {
        self.color.iter().zip(background).map(|(c, b)| (c - f64::from(b)).abs()).fold(0.0, f64::max)
    }
}

/// Sums up what images show where their ground truth is transparent.
#[derive(Default)]
struct Behinds {
    images: usize,
    pixels: usize,
    sum: [f64; 3],
    /// Whether any image has transparent pixels.
    clear: bool,
}

impl Behinds {
    fn add(&mut self, image: &Loaded, truth: &Loaded) {
        self.clear |= !image.clear.is_empty() || !truth.clear.is_empty();
        if truth.clear.is_empty() || !image.clear.is_empty() {
            return;
        }
        self.images += 1;
        for (p, _) in image.image.data.chunks_exact(3).zip(&truth.clear).filter(|(_, clear)| **clear) {
            self.pixels += 1;
            self.sum.iter_mut().zip(p).for_each(|(s, v)| *s += f64::from(*v));
        }
    }

    fn finish(&self) -> Option<Behind> {
        let color = self.sum.map(|s| s / self.pixels.max(1) as f64);
        (self.pixels > 0).then_some(Behind { images: self.images, color })
    }
}

/// Temporal metric tOF of a video.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VideoScore {
    /// Mean of tOF over pairs, pixels.
    pub mean: f64,
    /// tOF of each pair of consecutive frames.
    pub pairs: Vec<PairScore>,
}

/// tOF of one pair of consecutive frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairScore {
    /// Index of the later frame, from 0.
    pub frame: usize,
    /// Name of the later frame.
    pub name: String,
    /// Mean distance between the flows of both videos, pixels.
    pub tof: f64,
}

impl VideoScore {
    /// Adds the names of frames to a score; `name` maps their index.
    pub fn new<'a>(score: &TofScore, name: impl Fn(usize) -> &'a str) -> Self {
        let pair = |&(frame, tof): &(usize, f64)| PairScore { frame, name: name(frame).to_owned(), tof };
        Self { mean: score.mean, pairs: score.pairs.iter().map(pair).collect() }
    }
}

/// Folders that cannot be scored.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// A folder cannot be listed.
    #[error("cannot list the folder {}: {source}", folder.display())]
    List {
        /// The folder that was to be listed.
        folder: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A folder holds no images.
    #[error("the folder holds no image (give {extensions} files)")]
    Empty {
        /// The folder without an image.
        folder: PathBuf,
        /// Extensions of the files that are read.
        extensions: String,
    },
    /// Two files have the same name apart from the extension.
    #[error("two images have the same name: {} and {}", first.display(), second.display())]
    SameName {
        /// The first file of that name.
        first: PathBuf,
        /// The second file of that name.
        second: PathBuf,
    },
    /// Images have no counterpart in the other folder.
    #[error("{count} images have no partner: {named} (the folders hold {} and {} images)", counts[0], counts[1])]
    Unpaired {
        /// Number of images without counterpart.
        count: usize,
        /// Names of the first of them.
        named: String,
        /// The folder that lacks them.
        folder: PathBuf,
        /// Number of images in each of the two folders.
        counts: [usize; 2],
    },
    /// A file is no image of 1, 3 or 4 channels.
    #[error("{what}")]
    Image {
        /// The file that was read.
        path: PathBuf,
        /// What it holds, in words.
        what: String,
        /// How to correct it, as advice.
        remedy: &'static str,
    },
    /// A file cannot be read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// A pair of images cannot be compared.
    #[error("{source}")]
    Metric {
        /// The image under test.
        path: PathBuf,
        /// Why the pair cannot be compared.
        source: MetricError,
    },
}

/// Scores the images of a folder against their ground truth.
///
/// # Errors
/// If a folder cannot be listed or paired, a file cannot be read, or a pair cannot be compared.
pub fn score(task: &FolderTask) -> Result<FolderScores, FolderError> {
    let (images, truths) = (ImageFolder::of(&task.pred)?, ImageFolder::of(&task.gt)?);
    let by_order = images.is_apart_from(&truths);
    let truths = images.partners(&truths, false)?;
    let masks = task.mask.as_deref().map(ImageFolder::of).transpose()?;
    let masks = masks.as_ref().map(|m| images.partners(m, true)).transpose()?;
    let mut comparer = Comparer::new(&task.metrics).with_lpips(task.lpips.clone());
    let mut video = task.tof.map(Tof::new);
    let mut behinds = Behinds::default();
    for (i, (image_file, truth)) in images.files().iter().zip(&truths).enumerate() {
        let [image, truth] = read_pair(task, &image_file.path, &truth.path)?;
        behinds.add(&image, &truth);
        let (mut image, mut truth) = (image.image, truth.image);
        let mut mask = masks.as_ref().map(|m| load_mask(&m[i].path)).transpose()?;
        let failed = |source| FolderError::Metric { path: image_file.path.clone(), source };
        video.as_mut().map_or(Ok(()), |v| v.add(&image, &truth)).map_err(failed)?;
        if task.half {
            (image, truth, mask) = (half_size(&image), half_size(&truth), mask.as_ref().map(half_size));
        }
        comparer.add(&image_file.name, &image, &truth, mask.as_ref()).map_err(failed)?;
    }
    let failed = |source| FolderError::Metric { path: task.pred.clone(), source };
    let tof = video.map(Tof::finish).transpose().map_err(failed)?;
    let tof = tof.map(|t| VideoScore::new(&t, |i| &images.files()[i].name));
    Ok(FolderScores {
        images: comparer.finish(),
        tof,
        behind: behinds.finish(),
        protocol: protocol(task, behinds.clear, by_order),
    })
}

fn read_pair(task: &FolderTask, pred: &Path, gt: &Path) -> Result<[Loaded; 2], FolderError> {
    let (mut image, mut truth) = (load_over(pred, task.background)?, load_over(gt, task.background)?);
    task.quantise.apply(&mut image.image);
    if task.quantise != Quantise::None {
        Quantise::Round.apply(&mut truth.image);
    }
    Ok([image, truth])
}

/// Conditions of the comparison, in words.
fn protocol(task: &FolderTask, clear: bool, by_order: bool) -> String {
    let quantised = match task.quantise {
        Quantise::None => "values as stored",
        Quantise::Round => "rounded to 8 bit",
        Quantise::Truncate => "images truncated and ground-truth images rounded to 8 bit",
    };
    let half = if task.half { ", reduced to half size by means of areas of 2x2 pixels" } else { "" };
    let mut parts =
        vec![format!("data range 1, {quantised}{half}; SSIM 11x11 with zero padding; perceptual_proxy is not LPIPS")];
    if by_order {
        parts.push(
            "images and ground-truth images have no name in common: paired in the order of their numbers".to_owned(),
        );
    }
    if clear {
        let [r, g, b] = task.background;
        parts.push(format!("transparent pixels over {r},{g},{b}"));
    }
    parts.extend(task.lpips.as_ref().map(|lpips| format!("lpips: weights {}", lpips.weights())));
    if task.mask.is_some() {
        parts.push(
            "masked: m-psnr over weighted pixels, m-ssim by partial convolution (DyCheck); f-psnr over the whole frame with the eroded \
             mask, box-ssim 7x7 in the mask's box"
                .to_owned(),
        );
    }
    parts.extend(task.tof.map(tof_protocol));
    parts.join("; ")
}

/// Conditions of tOF, in words.
pub fn tof_protocol(options: TofOptions) -> String {
    let ends = if options.trim { "without the first and last two frames" } else { "all frames" };
    let border = if options.crop { "without the border" } else { "whole frames" };
    format!("tof: mean distance of Farneback flows in pixels, {ends}, {border}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Image;
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
            lpips: None,
            tof: Some(TofOptions::default()),
            quantise: Quantise::Round,
            half: false,
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
    fn motion_is_that_of_quantised_images() {
        let root = tempfile::tempdir().unwrap();
        let (pred, gt) = (root.path().join("pred"), root.path().join("gt"));
        video(&pred, "a", 6, 1.5);
        video(&gt, "a", 6, 1.0);
        let tof = |pred: &Path, quantise| {
            let options = TofOptions { trim: false, crop: false };
            let task = FolderTask { pred: pred.to_owned(), tof: Some(options), quantise, ..task(root.path()) };
            score(&task).unwrap().tof.unwrap().mean
        };
        // The same frames, each value off by up to a third of a step of 8 bit.
        let finer = root.path().join("finer");
        std::fs::create_dir(&finer).unwrap();
        for k in 0..6 {
            let mut image = load_over(&pred.join(format!("a{k}.png")), [0.0; 3]).unwrap().image;
            let off = |i: usize| ((i * 7919 % 101) as f32 / 50.0 - 1.0) / 3.0 / 255.0;
            image.data.iter_mut().enumerate().for_each(|(i, v)| *v += off(i));
            gs_core::io::exr::save(&finer.join(format!("a{k}.exr")), &image, false).unwrap();
        }
        let rounded = tof(&pred, Quantise::None);
        assert_eq!(tof(&finer, Quantise::Round), rounded);
        assert_ne!(tof(&finer, Quantise::Truncate), rounded);
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

    #[test]
    fn what_stands_where_truth_is_transparent_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let (pred, gt) = (dir.path().join("pred"), dir.path().join("gt"));
        for folder in [&pred, &gt] {
            std::fs::create_dir(folder).unwrap();
        }
        let truth = [0.2, 0.4, 0.6, 1.0, 0.0, 0.0, 0.0, 0.0].repeat(72);
        let truth = Image { width: 12, height: 12, channels: 4, data: truth };
        save_png(&gt.join("a.png"), &truth, false).unwrap();
        let over_white = [0.2, 0.4, 0.6, 1.0, 1.0, 1.0].repeat(72);
        let over_white = Image { width: 12, height: 12, channels: 3, data: over_white };
        save_png(&pred.join("a.png"), &over_white, false).unwrap();
        let scored = |background: [f32; 3], gt: &Path| {
            let metrics = vec![Metric::Psnr];
            let (pred, gt) = (pred.clone(), gt.to_owned());
            let task = FolderTask { pred, gt, metrics, background, tof: None, ..task(dir.path()) };
            score(&task).unwrap()
        };
        let black = scored([0.0; 3], &gt);
        let behind = black.behind.unwrap();
        assert!(behind.images == 1 && behind.color == [1.0; 3] && behind.off([0.0; 3]) > 0.99, "{behind:?}");
        assert!(black.protocol.contains("transparent pixels over 0,0,0"), "{}", black.protocol);
        let white = scored([1.0; 3], &gt);
        assert!(white.behind.unwrap().off([1.0; 3]) == 0.0 && white.images.perfect_views == 1);
        assert!(scored([0.0; 3], &pred).behind.is_none(), "nothing is transparent");
    }
}
