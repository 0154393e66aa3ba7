//! Checks of poses by silhouettes: the visual hull carved by alpha or masks must cover each silhouette. Under wrong poses the
//! hull is empty or in the wrong place.

use super::pose_readings::PoseReading;
use super::{Finding, Verdict, median};
use glam::{DMat3, DQuat, DVec3};
use gs_core::Camera;
use gs_data::hull::{Carved, Silhouette, carve};
use gs_data::{Dataset, ImageCache, Split};
use rayon::prelude::*;

/// Share of the views that must agree on a hull cell: lower than for initial points, so that a few wrong views do not empty
/// the hull but show up as outliers.
const AGREEMENT: f64 = 0.8;
/// Mean covered share of silhouettes: above the first poses are good, below the second they are wrong.
const GOOD_SHARE: f64 = 0.8;
const BAD_SHARE: f64 = 0.5;
/// Median share of an image that outlines of an object fill at most.
const MOST_FILLED: f64 = 0.8;
/// Another reading of the poses must cover so much more.
const MIN_READING_GAIN: f64 = 0.25;

/// The visual hull and its fit to each silhouette.
pub(super) struct Silhouettes {
    /// The hull's cells and the silhouettes that carved them.
    pub(super) carved: Carved,
    /// Split and silhouette of the views: those that carved, then held-out ones.
    pub(super) shapes: Vec<(Split, Silhouette)>,
    /// Share of each silhouette that carved which the hull covers.
    fits: Vec<f64>,
    /// The reading of the poses that covers more, if there is one, and the share it covers.
    better: Option<(PoseReading, f64)>,
}

/// Carves the training views; none where they have neither alpha nor masks. `images` may hold reduced images.
pub(super) fn check(data: &Dataset, images: Option<&ImageCache>) -> Option<Silhouettes> {
    let carved = carve(data, AGREEMENT, images).ok().flatten()?;
    // Masks of what must not count, or alpha that is 1, are no outlines of an object.
    let filled = |s: &Silhouette| {
        let inside = s.inside();
        inside.iter().filter(|i| **i).count() as f64 / inside.len().max(1) as f64
    };
    if median(&carved.silhouettes.par_iter().map(filled).collect::<Vec<_>>()) > MOST_FILLED {
        return None;
    }
    let mut shapes: Vec<(Split, Silhouette)> = carved.silhouettes.iter().map(|s| (Split::Train, s.clone())).collect();
    for split in [Split::Val, Split::Test] {
        let views = data.views(split);
        if views.iter().any(|v| data.has_alpha || v.mask.is_some()) {
            shapes.extend(carved.silhouettes_of(views, images).unwrap_or_default().into_iter().map(|s| (split, s)));
        }
    }
    let fits = covered(&carved);
    let now = mean(&fits);
    let mut better: Option<(PoseReading, f64)> = None;
    if now < GOOD_SHARE {
        for (s, other) in PoseReading::ALL.map(|s| (s, share_under(&carved, data, s))) {
            if other > better.map_or(now.max(BAD_SHARE), |b| b.1) {
                better = Some((s, other));
            }
        }
    }
    let better = better.filter(|b| b.1 > now + MIN_READING_GAIN);
    Some(Silhouettes { carved, shapes, fits, better })
}

/// The mean covered share of the silhouettes if the poses were read in another way.
fn share_under(carved: &Carved, data: &Dataset, reading: PoseReading) -> f64 {
    mean(&covered(&carved.under(data, AGREEMENT, |c| reading.camera(c))))
}

/// The share of each silhouette that the projected hull covers; 1 for an empty one.
fn covered(carved: &Carved) -> Vec<f64> {
    let share = |s: &Silhouette| {
        let (inside, cover) = (s.inside(), carved.cover(&s.camera));
        let both = inside.iter().zip(&cover).filter(|(s, c)| **s && **c).count();
        match inside.iter().filter(|s| **s).count() {
            0 => 1.0,
            n => both as f64 / n as f64,
        }
    };
    carved.silhouettes.par_iter().map(share).collect()
}

impl Silhouettes {
    /// Findings on all poses together.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let (share, count) = (mean(&self.fits), self.fits.len());
        let text = format!("what {count} silhouettes carve fills {:.0} % of each, in the mean", 100.0 * share);
        if let Some((s, other)) = self.better {
            let what = format!("{text}; with poses {} it would be {:.0} %", s.what(), 100.0 * other);
            return vec![Finding::new("poses", "poses.convention", Verdict::Problem, what).fix(s.fix())];
        }
        if share >= GOOD_SHARE {
            return vec![Finding::ok("poses", text)];
        }
        let verdict = if share < BAD_SHARE { Verdict::Problem } else { Verdict::Warning };
        let what = format!("{text}: poses, focal length, box or alpha do not belong together");
        let fix = "compare the figures of the hull with the images; check alpha and the units of the poses, or set \
                   the box: gs4d init DATA --bound HALF (half of its side)";
        vec![Finding::new("poses", "poses.silhouettes", verdict, what).fix(fix)]
    }

    /// Whether camera axes of the other convention would be told as such, the poses of `data` being right.
    pub(super) fn tells_axes(&self, data: &Dataset) -> bool {
        let right = mean(&self.fits);
        if right <= BAD_SHARE {
            return false;
        }
        let flipped = share_under(&self.carved, data, PoseReading::Flipped);
        flipped < GOOD_SHARE && right > flipped + MIN_READING_GAIN
    }
}

/// A camera turned about its own centre by a rotation vector in its axes, radians.
pub(super) fn turn(c: &Camera, vector: DVec3) -> Camera {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(vector));
    Camera { rotation: turn * c.rotation, translation: turn * c.translation, ..c.clone() }
}

fn mean(shares: &[f64]) -> f64 {
    shares.iter().sum::<f64>() / shares.len().max(1) as f64
}
