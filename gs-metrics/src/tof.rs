//! tOF: the distance between the optical flow of a rendered video and that of the ground-truth video, in pixels.
//!
//! With the [`flow`](crate::flow) between consecutive frames of each video,
//! ```text
//! tOF_i = mean over pixels of |flow(truth_{i−1} → truth_i) − flow(pred_{i−1} → pred_i)|₂,   tOF = mean over i
//! ```
//! The published script leaves out the first and last two frames (pairs `i = 3 … n − 3`, frames counted from 0) and the
//! border: it keeps the central `32⌊n/32⌋` pixels of a side of `n`, less 32 where fewer than 16 would be cut. Both are options
//! here, as papers seldom say what they did. (Some texts call tOF an L1 error; the script uses the 2-norm.)
//!
//! Frames must be consecutive in time and from one camera: flow between distant views is noise.
//!
//! Chu, Xie, Mayer, Leal-Taixé, Thuerey, *Learning temporal coherence via self-supervision for GAN-based video
//! generation* (TecoGAN), 2020.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::{Tof, TofOptions};
//! // A pattern that moves by 1.5 pixels a frame in the render and by 1 in the ground truth.
//! let frame = |shift: f32| {
//!     let value = |x: f32, y: f32| 0.5 + 0.2 * (0.31 * (x - shift)).sin() + 0.2 * (0.27 * y + 0.1 * (x - shift)).cos();
//!     let data = (0..64 * 48).map(|k| value((k % 64) as f32, (k / 64) as f32)).collect();
//!     Image { width: 64, height: 48, channels: 1, data }
//! };
//! let mut tof = Tof::new(TofOptions { trim: false, crop: true });
//! for i in 0..3 {
//!     tof.add(&frame(1.5 * i as f32), &frame(i as f32))?;
//! }
//! assert!((tof.finish()?.mean - 0.5).abs() < 0.05);
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use gs_core::Image;

use crate::error::{MetricError, check_pair};
use crate::flow::{Expansion, Farneback, Flow, end_point_error};

/// Frames left out at both ends of a trimmed video.
const TRIMMED: usize = 2;
/// Sides are cropped to a multiple of this, pixels.
const BLOCK: usize = 32;
/// Fewest pixels cut from a cropped side.
const MARGIN: usize = 16;

/// Frames and pixels left out of tOF; the default is that of the published script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TofOptions {
    /// Whether to leave out the first and last two frames; true by default.
    pub trim: bool,
    /// Whether to leave out the border of every frame; true by default.
    pub crop: bool,
}

impl Default for TofOptions {
    /// Both are left out, as in the published script.
    fn default() -> Self {
        Self { trim: true, crop: true }
    }
}

/// The score of a video.
#[derive(Clone, Debug, PartialEq)]
pub struct TofScore {
    /// Mean of `tOF_i` over the pairs, pixels.
    pub mean: f64,
    /// `(i, tOF_i)` of the pairs of frames `(i − 1, i)` that count, in order, pixels.
    pub pairs: Vec<(usize, f64)>,
}

/// Computes tOF frame by frame, in the memory of two frames.
#[derive(Debug, Default)]
pub struct Tof {
    options: TofOptions,
    estimate: Farneback,
    /// Expansions of the previous rendered and ground-truth frame.
    previous: [Expansion; 2],
    current: [Expansion; 2],
    flows: [Flow; 2],
    /// Number of frames added so far.
    frames: usize,
    /// Whether the next frame does not follow the last one.
    cut: bool,
    size: Option<(usize, usize)>,
    pairs: Vec<(usize, f64)>,
}

impl Tof {
    /// An evaluator without frames, with these options.
    pub fn new(options: TofOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Adds the next rendered frame and its ground-truth image, `[H, W, 1 or 3]` in `[0, 1]`.
    ///
    /// # Errors
    /// Different sizes (of the two, or from the previous frame), 2 or 4 channels, values that are not finite, or sides below
    /// 48 pixels where the border is left out.
    pub fn add(&mut self, pred: &Image, truth: &Image) -> Result<(), MetricError> {
        check_pair(pred, truth)?;
        let size = (pred.width, pred.height);
        if let Some(first) = self.size.filter(|first| *first != size) {
            let shape = |s: (usize, usize)| (s.0, s.1, pred.channels);
            return Err(MetricError::Shape { what: "frames of a video", first: shape(first), second: shape(size) });
        }
        self.size = Some(size);
        let area = if self.options.crop { cropped(size.0, size.1)? } else { (0..size.0, 0..size.1) };
        let at = self.frames;
        let skipped = if self.options.trim { TRIMMED } else { 0 };
        if at >= skipped {
            for (image, expansion) in [pred, truth].into_iter().zip(&mut self.current) {
                self.estimate.expand(image, expansion)?;
            }
        }
        let cut = std::mem::take(&mut self.cut);
        if at > skipped && !cut {
            for k in 0..2 {
                self.estimate.between(&self.previous[k], &self.current[k], &mut self.flows[k])?;
            }
            let [p, t] = [0, 1].map(|k| self.flows[k].crop(area.0.clone(), area.1.clone()));
            self.pairs.push((at, end_point_error(&p, &t)?));
        }
        std::mem::swap(&mut self.previous, &mut self.current);
        self.frames += 1;
        Ok(())
    }

    /// The next frame does not follow the last one in time: the two are no pair.
    pub fn cut(&mut self) {
        self.cut = true;
    }

    /// The score of all frames added.
    ///
    /// # Errors
    /// If no pair is left: fewer than 2 frames, or fewer than 6 with [`TofOptions::trim`], or cuts between all of them.
    pub fn finish(mut self) -> Result<TofScore, MetricError> {
        let (skipped, need) = if self.options.trim { (TRIMMED, 2 * TRIMMED + 2) } else { (0, 2) };
        self.pairs.retain(|(i, _)| i + skipped < self.frames);
        if self.frames < need || self.pairs.is_empty() {
            return Err(MetricError::TooFewFrames { metric: "tOF", got: self.frames, need });
        }
        let mean = self.pairs.iter().map(|p| p.1).sum::<f64>() / self.pairs.len() as f64;
        Ok(TofScore { mean, pairs: self.pairs })
    }
}

/// The columns and rows kept by [`TofOptions::crop`].
fn cropped(width: usize, height: usize) -> Result<(std::ops::Range<usize>, std::ops::Range<usize>), MetricError> {
    let side = |n: usize| {
        let whole = n / BLOCK * BLOCK;
        let kept = if whole + MARGIN > n { whole.saturating_sub(BLOCK) } else { whole };
        let first = (n - kept) / 2;
        first..first + kept
    };
    let (columns, rows) = (side(width), side(height));
    if columns.is_empty() || rows.is_empty() {
        let hint = "keep the border (no crop)";
        return Err(MetricError::TooSmall { metric: "cropped tOF", need: BLOCK + MARGIN, width, height, hint });
    }
    Ok((columns, rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wave that moves by `speed` pixels a frame.
    fn frame(i: usize, speed: f32) -> Image {
        let shift = i as f32 * speed;
        let value =
            |x: f32, y: f32| 0.5 + 0.2 * (0.31 * (x - shift)).sin() + 0.2 * (0.27 * y + 0.1 * (x - shift)).cos();
        let data = (0..64 * 56).map(|k| value((k % 64) as f32, (k / 64) as f32)).collect();
        Image { width: 64, height: 56, channels: 1, data }
    }

    fn score(n: usize, options: TofOptions, pred: f32, truth: f32) -> Result<TofScore, MetricError> {
        let mut tof = Tof::new(options);
        (0..n).try_for_each(|i| tof.add(&frame(i, pred), &frame(i, truth)))?;
        tof.finish()
    }

    #[test]
    fn the_crop_agrees_with_the_published_script() {
        for (n, kept) in [(48, 8..40), (64, 16..48), (79, 23..55), (80, 8..72), (360, 20..340), (640, 16..624)] {
            assert_eq!(cropped(n, n).unwrap(), (kept.clone(), kept), "{n}");
        }
        assert!(matches!(cropped(47, 100), Err(MetricError::TooSmall { need: 48, .. })));
    }

    #[test]
    fn equal_videos_score_zero_and_speeds_their_difference() {
        let same = score(8, TofOptions::default(), 1.0, 1.0).unwrap();
        assert_eq!((same.mean, same.pairs.iter().map(|p| p.0).collect::<Vec<_>>()), (0.0, vec![3, 4, 5]));
        let off = score(7, TofOptions::default(), 1.5, 1.0).unwrap();
        assert!((off.mean - 0.5).abs() < 0.05, "{off:?}");
    }

    #[test]
    fn ends_and_borders_are_kept_on_request() {
        let whole = TofOptions { trim: false, crop: false };
        let all = score(4, whole, 1.5, 1.0).unwrap();
        assert_eq!(all.pairs.iter().map(|p| p.0).collect::<Vec<_>>(), [1, 2, 3]);
        let trimmed = score(7, TofOptions { crop: false, ..TofOptions::default() }, 1.5, 1.0).unwrap();
        let same = score(7, whole, 1.5, 1.0).unwrap();
        assert_eq!(trimmed.pairs[..], same.pairs[2..4], "a pair does not depend on its neighbours");
    }

    #[test]
    fn frames_apart_are_no_pair() {
        let whole = TofOptions { trim: false, crop: false };
        let all = score(6, whole, 1.5, 1.0).unwrap();
        let cut_before = |cuts: &[usize]| {
            let mut tof = Tof::new(whole);
            for i in 0..6 {
                cuts.iter().filter(|cut| **cut == i).for_each(|_| tof.cut());
                tof.add(&frame(i, 1.5), &frame(i, 1.0)).unwrap();
            }
            tof.finish()
        };
        assert_eq!(cut_before(&[3]).unwrap().pairs, [&all.pairs[..2], &all.pairs[3..]].concat());
        assert_eq!(cut_before(&[0]).unwrap(), all, "nothing comes before the first");
        assert!(matches!(cut_before(&[1, 2, 3, 4, 5]), Err(MetricError::TooFewFrames { .. })));
    }

    #[test]
    fn bad_videos_are_errors() {
        let e = score(5, TofOptions::default(), 1.0, 1.0).unwrap_err();
        assert!(e.to_string().contains("at least 6 frames, 5"), "{e}");
        assert!(score(1, TofOptions { trim: false, crop: true }, 1.0, 1.0).is_err());
        let mut tof = Tof::new(TofOptions { trim: false, crop: true });
        tof.add(&frame(0, 1.0), &frame(0, 1.0)).unwrap();
        let other = Image::zeros(96, 96, 1);
        assert!(matches!(tof.add(&other, &other), Err(MetricError::Shape { what: "frames of a video", .. })));
        assert!(tof.add(&frame(1, 1.0), &other).is_err());
        let mut nan = frame(1, 1.0);
        nan.data[0] = f32::NAN;
        assert!(tof.add(&nan, &frame(1, 1.0)).is_err());
    }
}
