//! tOF: how far the motion of a predicted video is from that of the true one, in pixels.
//!
//! For consecutive frames of each video the [`flow`](crate::flow) is estimated, and
//! ```text
//! tOF_i = mean over pixels of |flow(truth_{i−1} → truth_i) − flow(pred_{i−1} → pred_i)|₂,   tOF = mean over i
//! ```
//! The published script leaves out the first and last two frames (pairs `i = 3 … n − 3`, frames counted from 0) and the
//! border: kept are `32⌊n/32⌋` pixels of a side, less 32 where fewer than 16 would go, in the middle. Both are switches,
//! as papers seldom say whether they kept them. (It is called an L1 error in places; the script takes the 2-norm.)
//!
//! Frames must follow each other in time from one camera: flow between views far apart is noise.
//!
//! Chu, Xie, Mayer, Leal-Taixé, Thuerey, *Learning temporal coherence via self-supervision for GAN-based video
//! generation* (TecoGAN), 2020.

use gs_core::Image;

use crate::error::{MetricError, check_pair};
use crate::flow::{Expansion, Farneback, Flow, end_point_error};

/// Frames left out at both ends of a trimmed video.
const TRIMMED: usize = 2;
/// Sides are cut to a multiple of this.
const BLOCK: usize = 32;
/// At least so many pixels go from a cropped side.
const MARGIN: usize = 16;

/// What is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TofOptions {
    /// Leave out the first and last two frames.
    pub trim: bool,
    /// Leave out the border.
    pub crop: bool,
}

impl Default for TofOptions {
    /// Both, as published.
    fn default() -> Self {
        Self { trim: true, crop: true }
    }
}

/// The score of a video.
#[derive(Clone, Debug, PartialEq)]
pub struct TofScore {
    /// Pixels, mean over pairs.
    pub mean: f64,
    /// `(i, tOF_i)` of the pairs `(i − 1, i)` that count, in order.
    pub pairs: Vec<(usize, f64)>,
}

/// Takes a video frame by frame. Memory is that of two frames, however long it is.
#[derive(Debug, Default)]
pub struct Tof {
    options: TofOptions,
    estimate: Farneback,
    /// Predicted and true frame before, expanded; those of now.
    before: [Expansion; 2],
    now: [Expansion; 2],
    flows: [Flow; 2],
    /// Frames seen.
    frames: usize,
    size: Option<(usize, usize)>,
    pairs: Vec<(usize, f64)>,
}

impl Tof {
    /// A video with these switches.
    pub fn new(options: TofOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// The next predicted frame and its truth, `[H, W, 1 or 3]` in `[0, 1]`.
    ///
    /// # Errors
    /// Different sizes (of the two, or from the frame before), 2 or 4 channels, values that are not finite, or sides below
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
            for (image, expansion) in [pred, truth].into_iter().zip(&mut self.now) {
                self.estimate.expand(image, expansion)?;
            }
        }
        if at > skipped {
            for k in 0..2 {
                self.estimate.between(&self.before[k], &self.now[k], &mut self.flows[k])?;
            }
            let [p, t] = [0, 1].map(|k| self.flows[k].crop(area.0.clone(), area.1.clone()));
            self.pairs.push((at, end_point_error(&p, &t)?));
        }
        std::mem::swap(&mut self.before, &mut self.now);
        self.frames += 1;
        Ok(())
    }

    /// The score of all frames added.
    ///
    /// # Errors
    /// If no pair is left: below 2 frames, or below 6 where ends are left out.
    pub fn finish(mut self) -> Result<TofScore, MetricError> {
        let (skipped, need) = if self.options.trim { (TRIMMED, 2 * TRIMMED + 2) } else { (0, 2) };
        if self.frames < need {
            return Err(MetricError::TooFewFrames { metric: "tOF", got: self.frames, need });
        }
        self.pairs.retain(|(i, _)| i + skipped < self.frames);
        let mean = self.pairs.iter().map(|p| p.1).sum::<f64>() / self.pairs.len() as f64;
        Ok(TofScore { mean, pairs: self.pairs })
    }
}

/// The columns and rows that are kept.
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
    fn the_crop_is_that_of_the_script() {
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
    fn ends_and_borders_may_stay() {
        let whole = TofOptions { trim: false, crop: false };
        let all = score(4, whole, 1.5, 1.0).unwrap();
        assert_eq!(all.pairs.iter().map(|p| p.0).collect::<Vec<_>>(), [1, 2, 3]);
        let trimmed = score(7, TofOptions { crop: false, ..TofOptions::default() }, 1.5, 1.0).unwrap();
        let same = score(7, whole, 1.5, 1.0).unwrap();
        assert_eq!(trimmed.pairs[..], same.pairs[2..4], "a pair is the same whatever its neighbours");
    }

    #[test]
    fn what_cannot_be_scored_says_so() {
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
