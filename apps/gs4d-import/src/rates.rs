//! At which times frames are taken: one rate for all videos, the part that all of them show.

use crate::error::ImportError;
use crate::probe::Video;
use gs_core::cast::to_usize;
use serde::{Deserialize, Serialize};

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Taking {
    /// Frames per second; none: those of the slowest video.
    pub fps: Option<f64>,
    /// Most frames per camera; beyond, every second, third … of them is taken.
    pub max_frames: u32,
    /// Seconds left out at the beginning of what all videos show.
    pub start: f64,
    /// Seconds that are taken; none: to the end.
    pub duration: Option<f64>,
}

/// The frames that are taken: the `k`-th of a video is the one shown at `begins + k / fps` seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// Frames per second.
    pub fps: f64,
    /// Frames per camera.
    pub frames: usize,
    /// The first frame's time in each video, seconds.
    pub begins: Vec<f64>,
    /// Of so many frames one is taken; `fps · every` is at most the slowest video's rate.
    pub every: usize,
}

/// Least frames.
const FEWEST: usize = 2;

/// The frames of videos whose clocks differ: what is seen at time `t` of the first is seen at `t + offsets[c]` of video `c`.
///
/// # Errors
/// [`ImportError::Cameras`] if the videos show nothing together, or the rate is above that of a video.
pub(crate) fn cut(videos: &[Video], offsets: &[f64], taking: &Taking) -> Result<Cut, ImportError> {
    let wrong = |what: String, fix: &str| ImportError::Cameras { what, fix: fix.to_owned() };
    let slowest = videos.iter().map(|v| v.fps).fold(f64::INFINITY, f64::min);
    let fps = taking.fps.unwrap_or(slowest);
    if fps > slowest * 1.001 {
        let what = format!("{fps} frames per second are asked for, and a video has {slowest:.3}");
        return Err(wrong(what, "frames would be there twice: give a lower --fps, or none"));
    }
    let first = offsets.iter().copied().fold(f64::INFINITY, f64::min);
    let begins: Vec<f64> = offsets.iter().map(|o| o - first + taking.start).collect();
    let left = videos.iter().zip(&begins).map(|(v, b)| v.seconds - b).fold(f64::INFINITY, f64::min);
    let length = taking.duration.map_or(left, |d| d.min(left));
    // The last frame is shown until the video ends; lengths are rounded.
    let all = to_usize((length * fps + 1e-3).max(0.0));
    let thinned = all.div_ceil(taking.max_frames.max(1) as usize).max(1);
    let frames = all.div_ceil(thinned);
    let fps = fps / thinned as f64;
    // Frames at a multiple of the rate are nearer to their times than what is picked at a low rate.
    let every = to_usize(slowest * 1.001 / fps).max(1);
    if frames < FEWEST {
        let what =
            format!("the videos show {:.2} s together from {} s on: {frames} frames", left.max(0.0), taking.start);
        return Err(wrong(what, "give a smaller --start, a longer --duration, a higher --fps, or other --offsets"));
    }
    Ok(Cut { fps, frames, begins, every })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn video(fps: f64, seconds: f64) -> Video {
        Video { size: [64, 48], fps, seconds }
    }

    const ALL: Taking = Taking { fps: None, max_frames: 300, start: 0.0, duration: None };

    #[test]
    fn the_slowest_video_gives_the_rate_and_the_shortest_the_end() {
        let both = [video(60.0, 5.0), video(30.0, 4.0)];
        let c = cut(&both, &[0.0, 0.0], &ALL).unwrap();
        assert_eq!((c.fps, c.frames, c.begins, c.every), (30.0, 120, vec![0.0, 0.0], 1));
        // The second camera was switched on a second before the first.
        let c = cut(&both, &[0.0, 1.0], &ALL).unwrap();
        assert_eq!((c.frames, c.begins), (90, vec![0.0, 1.0]));
        let c = cut(&both, &[0.0, -0.5], &Taking { start: 1.0, duration: Some(2.0), ..ALL }).unwrap();
        assert_eq!((c.frames, c.begins), (60, vec![1.5, 1.0]));
    }

    #[test]
    fn long_videos_are_thinned_evenly() {
        let c = cut(&[video(30.0, 21.0)], &[0.0], &ALL).unwrap();
        assert_eq!((c.every, c.fps, c.frames), (3, 10.0, 210));
        let c = cut(&[video(30.0, 10.0)], &[0.0], &Taking { max_frames: 7, ..ALL }).unwrap();
        assert!(c.frames <= 7 && c.frames >= 6, "{c:?}");
        let c = cut(&[video(30.0, 4.0)], &[0.0], &Taking { fps: Some(4.0), ..ALL }).unwrap();
        assert_eq!((c.fps, c.frames, c.every), (4.0, 16, 7));
    }

    #[test]
    fn impossible_cuts_are_refused() {
        for (taking, word) in [
            (Taking { fps: Some(50.0), ..ALL }, "50 frames"),
            (Taking { start: 9.0, ..ALL }, "0.00 s together"),
            (Taking { duration: Some(0.01), ..ALL }, "0 frames"),
        ] {
            let e = cut(&[video(30.0, 4.0)], &[0.0], &taking).unwrap_err().to_string();
            assert!(e.contains(word), "{e}");
        }
    }
}
