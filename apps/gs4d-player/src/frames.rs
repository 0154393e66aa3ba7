//! What a clip is made from: the splats of a scene at a list of times.

use crate::PlayerError;
use gs_core::{Camera, Splats, rot};

/// The splats of a scene at ascending times, the same rows at each.
#[derive(Clone, Debug)]
pub struct Frames {
    pub(crate) times: Vec<f32>,
    pub(crate) splats: Vec<Splats>,
    rows: Vec<usize>,
}

/// Opacity below which a splat changes no pixel.
pub(crate) const VISIBLE: f32 = 1.0 / 255.0;

impl Frames {
    /// Splats at normalised times, ascending; one set for each. Rows that are invisible at all times are left out.
    ///
    /// # Errors
    /// No frame, times that do not ascend, frames with other rows or another SH degree than the first.
    pub fn new(times: Vec<f32>, mut splats: Vec<Splats>) -> Result<Self, PlayerError> {
        let wrong = |frame, what: &str| PlayerError::Frames { frame, what: what.to_owned() };
        let Some(first) = splats.first() else { return Err(wrong(0, "there is no frame")) };
        if times.len() != splats.len() || times.len() > usize::from(u16::MAX) {
            return Err(wrong(0, "there must be one time for each frame, and at most 65 535"));
        }
        for k in 0..splats.len() {
            if !times[k].is_finite() || (k > 0 && times[k] <= times[k - 1]) {
                return Err(wrong(k, "the times must ascend"));
            }
            if splats[k].len() != first.len() || splats[k].color.width() != first.color.width() {
                return Err(wrong(k, "other splats, or another SH degree, than the first frame"));
            }
            splats[k].check().map_err(|e| PlayerError::Frames { frame: k, what: e.to_string() })?;
        }
        let seen: Vec<usize> = (0..first.len()).filter(|&i| splats.iter().any(|s| s.opacities[i] >= VISIBLE)).collect();
        if seen.is_empty() {
            return Err(wrong(0, "no splat is visible at any time"));
        }
        if seen.len() < first.len() {
            splats.iter_mut().for_each(|s| *s = s.rows(&seen));
        }
        Ok(Self { times, splats, rows: seen })
    }

    /// Normalised times.
    pub fn times(&self) -> &[f32] {
        &self.times
    }

    /// The splats of each time.
    pub fn splats(&self) -> &[Splats] {
        &self.splats
    }

    /// The rows of the scene that are kept, ascending: those that are visible at some time.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.middle().len()
    }

    /// Whether there are no splats; never, see [`Self::new`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The splats at the middle time.
    pub(crate) fn middle(&self) -> &Splats {
        &self.splats[self.splats.len() / 2]
    }
}

/// How far a clip may be from the scene: a share of the standard deviation of a splat in the image of the nearest camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance(pub f32);

impl Default for Tolerance {
    fn default() -> Self {
        Self(0.1)
    }
}

/// Least size of a Gaussian in an image, in pixels: the square root of the dilation 0.3 (Kerbl et al. 2023).
const BLUR: f32 = 0.547_722_6;
/// Nearest depth of a camera that counts.
const NEAR: f64 = 0.01;

/// The sizes of a splat that its tolerances follow from, world units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Size {
    /// Its least standard deviation, and that of a pixel at the nearest camera, together.
    pub(crate) least: f32,
    /// Its largest standard deviation.
    pub(crate) most: f32,
}

/// The size of each splat, the least over the frames, as the nearest of `cameras` sees it. Without cameras a pixel has no size.
pub(crate) fn sizes(frames: &Frames, cameras: &[Camera]) -> Vec<Size> {
    let pixel = |i: usize| {
        let means = frames.splats.iter().map(|s| s.means[i].as_dvec3());
        let depths = means.flat_map(|m| cameras.iter().map(move |c| (c.to_camera(m).z, c.fx.max(c.fy))));
        depths.filter(|(z, _)| *z > NEAR).map(|(z, focal)| z / focal).fold(f64::INFINITY, f64::min)
    };
    let mut pixels: Vec<f64> = (0..frames.len()).map(pixel).collect();
    // Behind all cameras: as large as elsewhere.
    let mut known: Vec<f64> = pixels.iter().copied().filter(|p| p.is_finite()).collect();
    known.sort_by(f64::total_cmp);
    let usual = known.get(known.len() / 2).copied().unwrap_or(0.0);
    pixels.iter_mut().filter(|p| !p.is_finite()).for_each(|p| *p = usual);
    let size = |(i, &pixel): (usize, &f64)| {
        let scales = || frames.splats.iter().map(|s| s.scales[i].abs());
        let least = scales().map(glam::Vec3::min_element).fold(f32::INFINITY, f32::min);
        let least = least.max(f32::MIN_POSITIVE).hypot(BLUR * gs_core::cast::to_f32(pixel));
        Size { least, most: scales().map(glam::Vec3::max_element).fold(least, f32::max) }
    };
    pixels.iter().enumerate().map(size).collect()
}

/// Unit quaternions of a splat over the frames, each with the sign that is nearer to the one before.
pub(crate) fn aligned(frames: &Frames, i: usize) -> Vec<f32> {
    let (mut out, mut last) = (Vec::new(), [1.0, 0.0, 0.0, 0.0]);
    for splats in &frames.splats {
        let unit = match rot::normalise(splats.quats[i]).wxyz {
            [0.0, 0.0, 0.0, 0.0] => last,
            q => q,
        };
        let same = unit.iter().zip(last).map(|(a, b)| a * b).sum::<f32>() >= 0.0;
        last = if same { unit } else { unit.map(|v| -v) };
        out.extend(last);
    }
    out
}

/// A coefficient of the colour of a splat, the mean over the frames.
pub(crate) fn mean_coefficient(frames: &Frames, i: usize, k: usize) -> f32 {
    let width = frames.middle().color.width();
    let sum: f32 = frames.splats.iter().map(|s| s.color.as_flat()[i * width + k]).sum();
    sum / frames.splats.len() as f32
}
