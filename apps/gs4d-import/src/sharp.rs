//! Frames that are worth nothing: blurred by the camera's motion, or the same as the one before.

use crate::error::ImportError;
use gs_data::decode::decode;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Frames on each side that a frame is compared with.
const NEIGHBOURS: usize = 5;
/// A frame with less than this share of its neighbours' median sharpness is blurred.
const BLURRED: f64 = 0.5;
/// A frame that differs from the one before by less than this share of what its neighbours differ by, while the frames just before and
/// after it differ by at least the other share, is a duplicate: a pause lasts longer.
const DUPLICATE: f64 = 0.1;
const GOING_ON: f64 = 0.5;
/// Frames decoded at a time.
const CHUNK: usize = 16;

/// Measures of a camera's frames, in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Measures {
    /// Variance of the Laplacian of brightness.
    pub(crate) sharpness: Vec<f64>,
    /// Mean change from the frame before, grey levels; 0 for the first.
    pub(crate) change: Vec<f64>,
}

/// Brightness of an image file, `[height, width]`, and its width. `max_bytes` bounds the memory of decoding.
fn grey(file: &Path, max_bytes: Option<u64>) -> Result<(Vec<f32>, usize), ImportError> {
    let image = decode(file, max_bytes)?;
    let brightness = |p: &[u8]| 0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2]);
    Ok((image.data.chunks_exact(4).map(brightness).collect(), image.width))
}

/// Variance of `4 p − left − right − above − below`.
fn sharpness(grey: &[f32], width: usize) -> f64 {
    let height = grey.len() / width.max(1);
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for y in 1..height.saturating_sub(1) {
        for at in y * width + 1..(y + 1) * width - 1 {
            let l = f64::from(4.0 * grey[at] - grey[at - 1] - grey[at + 1] - grey[at - width] - grey[at + width]);
            (n, sum, squares) = (n + 1.0, sum + l, squares + l * l);
        }
    }
    if n > 0.0 { squares / n - (sum / n) * (sum / n) } else { 0.0 }
}

/// Measures the frames of a camera; `max_bytes` bounds the memory for decoding one.
pub(crate) fn measure(
    files: &[PathBuf],
    max_bytes: Option<u64>,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(usize),
) -> Result<Measures, ImportError> {
    let mut measures = Measures::default();
    let mut before: Option<Vec<f32>> = None;
    for chunk in files.chunks(CHUNK) {
        if stop.load(Ordering::Relaxed) {
            return Err(ImportError::Stopped { task: "measuring the sharpness of frames".to_owned() });
        }
        let read: Vec<(Vec<f32>, f64)> = chunk
            .par_iter()
            .map(|file| grey(file, max_bytes).map(|(grey, width)| (sharpness(&grey, width), grey)).map(|(s, g)| (g, s)))
            .collect::<Result<_, ImportError>>()?;
        for (now, sharp) in read {
            let difference = |old: &Vec<f32>| {
                let sum: f64 = old.iter().zip(&now).map(|(a, b)| f64::from((a - b).abs())).sum();
                sum / now.len().max(1) as f64
            };
            measures.change.push(before.as_ref().map_or(0.0, difference));
            measures.sharpness.push(sharp);
            before = Some(now);
        }
        tell(measures.sharpness.len());
    }
    Ok(measures)
}

/// The median of the values around one, without it; none where there are too few.
fn around(values: &[f64], k: usize) -> Option<f64> {
    let range = k.saturating_sub(NEIGHBOURS)..(k + NEIGHBOURS + 1).min(values.len());
    let mut near: Vec<f64> = range.filter(|&j| j != k).map(|j| values[j]).collect();
    near.sort_by(f64::total_cmp);
    (near.len() >= 3).then(|| near[near.len() / 2])
}

/// Which frames are much less sharp than those around them.
pub(crate) fn blurred(sharpness: &[f64]) -> Vec<bool> {
    let is = |k: usize| around(sharpness, k).is_some_and(|usual| sharpness[k] < BLURRED * usual);
    (0..sharpness.len()).map(is).collect()
}

/// Which frames show what the one before them shows. Where nothing changes ever, none is.
pub(crate) fn duplicates(change: &[f64]) -> Vec<bool> {
    let later = change.get(1..).unwrap_or_default();
    let is = |k: usize| {
        let goes_on = |usual: f64| {
            [k.checked_sub(1), Some(k + 1)]
                .iter()
                .flatten()
                .all(|&j| later.get(j).is_none_or(|c| *c >= GOING_ON * usual))
        };
        around(later, k).is_some_and(|usual| later[k] < DUPLICATE * usual && goes_on(usual))
    };
    (0..change.len()).map(|k| k > 0 && is(k - 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_data::DataError;

    #[test]
    fn blurred_frames_differ_from_their_neighbours() {
        let mut sharp: Vec<f64> = (0..30).map(|k| 100.0 + 10.0 * f64::from(k)).collect();
        (sharp[0], sharp[7], sharp[20]) = (40.0, 60.0, 90.0);
        let found: Vec<usize> = blurred(&sharp).iter().enumerate().filter(|b| *b.1).map(|b| b.0).collect();
        assert_eq!(found, [0, 7, 20]);
        assert!(!blurred(&[5.0, 1.0, 5.0]).contains(&true), "too few to tell");
    }

    #[test]
    fn duplicates_differ_from_a_scene_at_rest() {
        let mut change = vec![0.0, 4.0, 4.2, 0.1, 3.9, 4.0, 0.0, 4.1, 4.0, 4.2];
        assert_eq!(duplicates(&change).iter().filter(|d| **d).count(), 2);
        assert!(duplicates(&change)[3] && duplicates(&change)[6]);
        (change[7], change[8]) = (0.1, 0.0);
        assert!(!duplicates(&change)[6..].contains(&true), "a pause");
        change.fill(0.0);
        assert!(!duplicates(&change).contains(&true), "nothing changes ever");
        assert!(!duplicates(&[]).contains(&true));
    }

    #[test]
    fn sharpness_falls_with_blur() {
        let dir = tempfile::tempdir().unwrap();
        let noise = |x: u32, y: u32| ((x * 7919 + y * 104_729).wrapping_mul(2_654_435_761) >> 24) as u8;
        let sharp = image::GrayImage::from_fn(40, 30, |x, y| image::Luma([noise(x / 2, y / 2)]));
        // A shutter that is open while the camera turns by five pixels.
        let blurred = image::GrayImage::from_fn(40, 30, |x, y| {
            let sum: u32 = (0..5).map(|k| u32::from(noise((x + k) / 2, y / 2))).sum();
            image::Luma([(sum / 5) as u8])
        });
        let files = [("a.png", &sharp), ("b.png", &blurred), ("c.png", &blurred)].map(|(name, picture)| {
            let file = dir.path().join(name);
            picture.save(&file).unwrap();
            file
        });
        let stop = AtomicBool::new(false);
        let m = measure(&files, None, &stop, &mut |_| {}).unwrap();
        assert!(m.sharpness[1] < 0.4 * m.sharpness[0], "{m:?}");
        assert!(m.change[0] == 0.0 && m.change[1] > 5.0 && m.change[2] == 0.0, "{m:?}");
        let e = measure(&files, Some(40 * 30 * 4 - 1), &stop, &mut |_| {}).unwrap_err();
        assert!(matches!(e, ImportError::Data(DataError::TooLarge { .. })), "{e}");
        stop.store(true, Ordering::Relaxed);
        assert!(matches!(measure(&files, None, &stop, &mut |_| {}), Err(ImportError::Stopped { .. })));
    }
}
