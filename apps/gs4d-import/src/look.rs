//! A first look at a video, small and grey: whether its background stands still, and how much changes from frame to frame.

use crate::error::ImportError;
use crate::probe::{Video, input};
use crate::program::{Call, FFMPEG, Runner, Sink};
use gs_core::cast::{to_u32, to_usize};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Longer side of the grey images, pixels.
const SIDE: f64 = 240.0;
/// Side of the blocks whose means are compared from frame to frame, pixels.
const BLOCK: usize = 4;
/// A change of a block's mean below this is noise, grey levels of 255.
const NOISE: f64 = 2.0;
/// Images compared with each other for the background.
const SAMPLES: usize = 12;
/// Least mean gradient of a pixel that could show a motion; most that a pixel at rest differs from its median; share of the images
/// in which it must.
const MIN_GRADIENT: f64 = 12.0;
const MAX_CHANGE: u8 = 10;
const MIN_AGREEING: f64 = 0.7;

/// What a look at a video gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Look {
    /// Mean change of brightness from each frame to the next, grey levels of 255, noise taken off.
    pub changes: Vec<f64>,
    /// Share of the pixels with texture that show the same thing over the whole video, 0..1; none where there is no texture.
    pub still: Option<f64>,
}

/// Images as they come.
struct Watch {
    size: [usize; 2],
    /// Every so many-th image is kept.
    stride: usize,
    seen: usize,
    kept: Vec<Vec<u8>>,
    blocks: Vec<f64>,
    changes: Vec<f64>,
}

impl Watch {
    fn new(size: [usize; 2], expected: usize) -> Self {
        let stride = (expected / SAMPLES).max(1);
        Self { size, stride, seen: 0, kept: Vec::new(), blocks: Vec::new(), changes: Vec::new() }
    }

    fn frame(&mut self, pixels: &[u8]) {
        if self.seen.is_multiple_of(self.stride) && self.kept.len() <= SAMPLES {
            self.kept.push(pixels.to_vec());
        }
        self.seen += 1;
        let blocks = self.means(pixels);
        if !self.blocks.is_empty() {
            let change = |(a, b): (&f64, &f64)| ((a - b).abs() - NOISE).max(0.0);
            let all: f64 = blocks.iter().zip(&self.blocks).map(change).sum();
            self.changes.push(all / blocks.len() as f64);
        }
        self.blocks = blocks;
    }

    fn means(&self, pixels: &[u8]) -> Vec<f64> {
        let [width, height] = self.size;
        let (columns, rows) = (width / BLOCK, height / BLOCK);
        let mut sums = vec![0.0; columns * rows];
        for (y, row) in pixels.chunks_exact(width).take(rows * BLOCK).enumerate() {
            for (x, &value) in row[..columns * BLOCK].iter().enumerate() {
                sums[y / BLOCK * columns + x / BLOCK] += f64::from(value);
            }
        }
        let area = (BLOCK * BLOCK) as f64;
        sums.iter_mut().for_each(|s| *s /= area);
        sums
    }

    fn finish(self) -> Look {
        Look { still: still(&self.kept, self.size), changes: self.changes }
    }
}

/// Share of textured pixels that show one thing in most images.
fn still(images: &[Vec<u8>], [width, height]: [usize; 2]) -> Option<f64> {
    if images.len() < 3 {
        return None;
    }
    let gradient = |image: &[u8], at: usize| {
        f64::from(image[at + 1].abs_diff(image[at - 1])) + f64::from(image[at + width].abs_diff(image[at - width]))
    };
    let (mut textured, mut at_rest) = (0usize, 0usize);
    for y in 1..height.saturating_sub(1) {
        for at in y * width + 1..(y + 1) * width - 1 {
            let mean = images.iter().map(|i| gradient(i, at)).sum::<f64>() / images.len() as f64;
            if mean < MIN_GRADIENT {
                continue;
            }
            let mut values: Vec<u8> = images.iter().map(|i| i[at]).collect();
            values.sort_unstable();
            let median = values[values.len() / 2];
            let agreeing = values.iter().filter(|v| v.abs_diff(median) <= MAX_CHANGE).count();
            textured += 1;
            at_rest += usize::from(agreeing as f64 >= MIN_AGREEING * values.len() as f64);
        }
    }
    (textured * 100 >= width * height).then(|| at_rest as f64 / textured as f64)
}

/// Looks at a video at a rate, frames per second; `tell` hears how many frames were seen.
pub(crate) fn look(
    runner: &Runner<'_>,
    path: &Path,
    video: &Video,
    fps: f64,
    tell: &mut dyn FnMut(usize),
) -> Result<Look, ImportError> {
    let longer = f64::from(video.size[0].max(video.size[1]));
    let shrunk = |side: u32| to_usize((f64::from(side) * SIDE / longer / 4.0).round()).max(1) * 4;
    let size = video.size.map(shrunk);
    let filter = format!("fps={fps},scale={}:{}:flags=area", size[0], size[1]);
    let call = Call::new(FFMPEG, ".", format!("decode {}", path.display()))
        .args(["-nostdin", "-hide_banner", "-loglevel", "error", "-i"])
        .args([input(path)])
        .args(["-map", "0:v:0", "-vf", &filter, "-pix_fmt", "gray", "-f", "rawvideo", "pipe:1"]);
    let mut watch = Watch::new(size, to_usize(video.seconds * fps));
    let (mut pending, whole) = (Vec::new(), size[0] * size[1]);
    let mut take = |bytes: &[u8]| {
        pending.extend_from_slice(bytes);
        let complete = pending.len() / whole * whole;
        pending[..complete].chunks_exact(whole).for_each(|frame| watch.frame(frame));
        pending.drain(..complete);
        tell(watch.seen);
    };
    runner.run(call, Sink::Bytes(&mut take))?;
    if watch.seen == 0 {
        return Err(ImportError::Input {
            what: "not one frame could be decoded".to_owned(),
            path: path.to_path_buf(),
            why: "a video without frames shows nothing",
            fix: "play it with ffplay, or convert it: ffmpeg -i VIDEO new.mp4".to_owned(),
        });
    }
    Ok(watch.finish())
}

/// What the cameras do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rig {
    /// Every camera stands still.
    Fixed,
    /// Cameras move.
    Moving,
}

/// Share of pixels at rest from which on a camera stands still, and up to which it moves.
const STANDS: f64 = 0.5;
const MOVES: f64 = 0.25;

/// What the cameras of videos do, and the sentence that says why.
///
/// # Errors
/// [`ImportError::Cameras`] where that is not known.
pub(crate) fn decide(looks: &[Look]) -> Result<(Rig, String), ImportError> {
    let shares: Vec<f64> = looks.iter().filter_map(|l| l.still).collect();
    let percent: Vec<String> = looks
        .iter()
        .map(|l| l.still.map_or("none".to_owned(), |s| format!("{} %", to_u32(to_usize(100.0 * s + 0.5)))))
        .collect();
    let why = format!("textured pixels that stay as they are over the whole video: {}", percent.join(", "));
    if shares.len() == looks.len() && shares.iter().all(|s| *s >= STANDS) {
        return Ok((Rig::Fixed, why));
    }
    if !shares.is_empty() && shares.iter().all(|s| *s <= MOVES) {
        return Ok((Rig::Moving, why));
    }
    Err(ImportError::Cameras {
        what: format!("whether the cameras stand still is not known ({why})"),
        fix: "say it: --rig fixed where every camera stands still, --rig moving where they move".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of blocks of three pixels, moved by `shift`, with a bright square at `ball`.
    fn image(shift: usize, ball: usize) -> Vec<u8> {
        let noise = |x: usize, y: usize| (((x / 3 * 7919 + y / 3 * 104_729) * 2_654_435_761) >> 7) as u8;
        let at = |k: usize| {
            let (x, y) = (k % 60, k / 60);
            if x.abs_diff(ball) < 6 && y.abs_diff(20) < 6 { 255 } else { noise(x + shift, y) }
        };
        (0..60 * 40).map(at).collect()
    }

    fn watched(frames: impl Iterator<Item = Vec<u8>>) -> Look {
        let mut watch = Watch::new([60, 40], 24);
        frames.for_each(|f| watch.frame(&f));
        watch.finish()
    }

    #[test]
    fn a_camera_that_moves_differs_from_one_that_stands() {
        let standing = watched((0..24).map(|k| image(0, 8 + 2 * k)));
        let moving = watched((0..24).map(|k| image(2 * k, 30)));
        assert!(standing.still.unwrap() > 0.8 && moving.still.unwrap() < 0.2, "{standing:?} {moving:?}");
        assert_eq!((standing.changes.len(), moving.changes.len()), (23, 23));
        assert_eq!(decide(&[standing.clone(), standing.clone()]).unwrap().0, Rig::Fixed);
        assert_eq!(decide(std::slice::from_ref(&moving)).unwrap().0, Rig::Moving);
        let e = decide(&[standing, moving]).unwrap_err().to_string();
        assert!(e.contains("is not known") && e.contains(" %, "), "{e}");
        assert_eq!(watched((0..24).map(|_| vec![7; 60 * 40])).still, None, "nothing to see");
    }

    #[test]
    fn changes_are_those_of_what_moves() {
        let frozen = watched((0..24).map(|_| image(0, 20)));
        assert!(frozen.changes.iter().all(|c| *c == 0.0));
        let jump = watched((0..24).map(|k| image(0, if k < 12 { 20 } else { 44 })));
        assert!(jump.changes.iter().enumerate().all(|(k, c)| (*c > 1.0) == (k == 11)), "{:?}", jump.changes);
    }
}
