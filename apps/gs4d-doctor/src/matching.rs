//! Corners matched between views, and how many of the matches agree with cameras.

use super::epipolar::Pair;
use super::features::{Corner, corners, match_corners};
use super::luma;
use glam::{DVec2, DVec3};
use gs_core::{Camera, Image};
use gs_data::{ImageCache, View};
use rayon::prelude::*;

/// Distance below which two cameras are at one place, world units.
pub(super) const SAME_PLACE: f64 = 1e-6;
/// Other views that each view is matched with.
const NEIGHBOURS: usize = 4;
/// Most views that one is matched with to learn where it belongs.
const MAX_PARTNERS: usize = 64;
/// Least angle between two cameras seen from the scene's centre, radians: closer pairs do not constrain translations.
const MIN_ANGLE: f64 = 0.035;
/// Largest angle between matched views, radians: patches seen from farther apart do not correlate.
const MAX_ANGLE: f64 = 0.6;
/// Largest error of a match that agrees with the poses: a share of the longer image side, and at least so many pixels.
const TOLERANCE_SHARE: f64 = 1.0 / 240.0;
const MIN_TOLERANCE: f64 = 0.8;

/// Two views and the pixels of their matched corners.
#[derive(Clone, Debug)]
pub(super) struct Match {
    pub(super) views: [usize; 2],
    pub(super) points: Vec<[DVec2; 2]>,
}

impl Match {
    /// The other view and the matches, pixels of `view` first.
    fn seen_from(&self, view: usize) -> Option<(usize, Vec<[DVec2; 2]>)> {
        match self.views {
            [a, b] if a == view => Some((b, self.points.clone())),
            [a, b] if b == view => Some((a, self.points.iter().map(|[p, q]| [*q, *p]).collect())),
            _ => None,
        }
    }
}

/// Matches between neighbouring views, in pixels of the reduced images.
pub(super) struct Matches<'a> {
    pub(super) views: Vec<&'a View>,
    pub(super) cameras: Vec<Camera>,
    pub(super) pairs: Vec<Match>,
    /// Largest error of a match that agrees, pixels.
    pub(super) tolerance: f64,
    corners: Vec<Vec<Corner>>,
}

impl<'a> Matches<'a> {
    /// Matches each view with its nearest neighbours around `focus`, the point that cameras look at.
    pub(super) fn find(views: Vec<&'a View>, small_images: &ImageCache, focus: DVec3) -> Self {
        let cameras: Vec<Camera> = views.iter().map(|v| small_images.camera(v)).collect();
        let corners: Vec<Vec<Corner>> = views.par_iter().map(|v| corners_of(v, small_images)).collect();
        let mut wanted = neighbours(&views, focus);
        wanted.sort_unstable();
        wanted.dedup();
        let mut found = Self { tolerance: tolerance(&cameras), pairs: Vec::new(), views, cameras, corners };
        found.pairs = wanted.into_iter().map(|views| found.between(views)).collect();
        found
    }

    fn between(&self, views: [usize; 2]) -> Match {
        let [a, b] = views.map(|i| &self.corners[i]);
        let at = |c: &Corner| DVec2::from(c.at);
        let points = match_corners(a, b).into_iter().map(|(i, j)| [at(&a[i]), at(&b[j])]).collect();
        Match { views, points }
    }

    pub(super) fn count(&self) -> usize {
        self.pairs.iter().map(|p| p.points.len()).sum()
    }

    /// The error of each match under changed cameras, pixels; infinite behind one of them.
    pub(super) fn errors(&self, camera: &dyn Fn(&Camera) -> Camera) -> Vec<Vec<f64>> {
        let cameras: Vec<Camera> = self.cameras.iter().map(camera).collect();
        let of = |m: &Match| {
            let [a, b] = m.views.map(|i| &cameras[i]);
            let pair = Pair::new(a, b);
            m.points.iter().map(|p| pair.error(*p)).collect()
        };
        self.pairs.iter().map(of).collect()
    }

    /// Matches of a view with its neighbours: the neighbour, and pixels of the view first.
    pub(super) fn of_view(&self, view: usize) -> Vec<(usize, Vec<[DVec2; 2]>)> {
        self.pairs.iter().filter_map(|m| m.seen_from(view)).collect()
    }

    /// Matches of a view with views all around, wherever the poses put it.
    pub(super) fn with_all(&self, view: usize) -> Vec<(usize, Vec<[DVec2; 2]>)> {
        let others = gs_data::evenly(self.views.len(), MAX_PARTNERS).filter(|j| *j != view);
        others.map(|j| (j, self.between([view, j]).points)).collect()
    }
}

#[cfg(test)]
impl<'a> Matches<'a> {
    /// Matches that are known, of no images.
    pub(super) fn of_points(views: Vec<&'a View>, cameras: Vec<Camera>, pairs: Vec<Match>) -> Self {
        let corners = vec![Vec::new(); views.len()];
        Self { tolerance: tolerance(&cameras), pairs, views, cameras, corners }
    }
}

/// Largest error of a match that agrees, pixels, for these cameras.
fn tolerance(cameras: &[Camera]) -> f64 {
    let side = cameras.iter().map(|c| c.width.max(c.height)).max().unwrap_or(1);
    (TOLERANCE_SHARE * f64::from(side)).max(MIN_TOLERANCE)
}

/// The corners of a view's reduced image.
fn corners_of(v: &View, small_images: &ImageCache) -> Vec<Corner> {
    let Ok(image) = small_images.get(v) else { return Vec::new() };
    let over = image.over([0.5; 3]);
    let grey = over.data.as_chunks().0.iter().map(|p| luma(*p)).collect();
    let inside: Vec<bool> = image.data.chunks_exact(4).map(|p| p[3] > 200).collect();
    corners(&Image { width: over.width, height: over.height, channels: 1, data: grey }, &inside)
}

/// For each view the nearest others at another position, as ordered pairs.
fn neighbours(views: &[&View], focus: DVec3) -> Vec<[usize; 2]> {
    let towards: Vec<DVec3> = views.iter().map(|v| (v.camera.position() - focus).normalize_or_zero()).collect();
    let apart = |i: usize, j: usize| {
        let angle = towards[i].dot(towards[j]).clamp(-1.0, 1.0).acos();
        let turned = angle_between(&views[i].camera, &views[j].camera);
        let late = f64::from((views[i].time.normalised - views[j].time.normalised).abs());
        let near = if angle < MIN_ANGLE { 1.0 } else { 0.0 };
        let elsewhere = views[i].camera.position().distance(views[j].camera.position()) > SAME_PLACE;
        (elsewhere && angle.max(turned) < MAX_ANGLE).then_some(angle + turned + 3.0 * late + near)
    };
    let of = |i: usize| {
        let others = (0..views.len()).filter(|&j| j != i);
        let mut others: Vec<(f64, usize)> = others.filter_map(|j| Some((apart(i, j)?, j))).collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        others.into_iter().take(NEIGHBOURS).map(move |(_, j)| [i.min(j), i.max(j)])
    };
    (0..views.len()).flat_map(of).collect()
}

/// Angle by which one camera is turned against another, radians.
pub(super) fn angle_between(a: &Camera, b: &Camera) -> f64 {
    let turn = a.rotation * b.rotation.transpose();
    (0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0)).clamp(-1.0, 1.0).acos()
}
