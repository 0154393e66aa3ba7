//! How far the outlines of an image and of the posed template are apart, with the pose of the own frame and with those of others.

use super::silhouette::{Drawn, Shown, nearest};
use glam::DVec2;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Frames by which poses may be early or late.
pub(super) const SHIFTS: std::ops::RangeInclusive<isize> = -4..=4;

/// How far the outlines of a view are apart, metres, and the same of parts of the template's outline by joint.
pub(super) struct Apart {
    pub(super) mean: f64,
    pub(super) joints: Vec<(u32, f64)>,
}

/// Of a view: the template with the pose of its own frame, how far apart they are, and how far with the poses of [`SHIFTS`].
pub(super) type Compared = (Drawn, (Apart, Vec<f64>));

/// Compares the views of one camera, ascending in their frames, of which there are `count`. `draw` gives the template with the
/// pose of a frame; it is asked once for each.
pub(super) fn compare(
    views: &[Shown],
    rows: &[usize],
    count: usize,
    draw: impl Fn(usize) -> Drawn + Sync,
) -> Vec<Compared> {
    let own: BTreeSet<usize> = views.iter().map(|s| rows[s.frame]).collect();
    let all: BTreeSet<usize> = own.iter().flat_map(|&row| SHIFTS.filter_map(move |by| later(row, by, count))).collect();
    let pose = |row: usize| {
        let drawn = draw(row);
        // Figures show the own frame alone.
        let covered = if own.contains(&row) { drawn.covered } else { Vec::new() };
        (row, Drawn { covered, ..drawn })
    };
    let poses: BTreeMap<usize, Drawn> = all.into_par_iter().map(pose).collect();
    let hold = |s: &Shown| {
        let row = rows[s.frame];
        let far = |row: usize| apart(s, &poses[&row]);
        let own = far(row);
        let at =
            |by: isize| if by == 0 { own.mean } else { later(row, by, count).map_or(f64::INFINITY, |r| far(r).mean) };
        let shifted = SHIFTS.map(at).collect::<Vec<f64>>();
        (own, shifted)
    };
    let held: Vec<(Apart, Vec<f64>)> = views.par_iter().map(hold).collect();
    poses.into_iter().filter(|(row, _)| own.contains(row)).map(|(_, drawn)| drawn).zip(held).collect()
}

/// The row of a frame so many frames later, if there is one among `count`.
pub(super) fn later(row: usize, by: isize, count: usize) -> Option<usize> {
    row.checked_add_signed(by).filter(|r| *r < count)
}

/// How far the outlines of image and template are apart. A template that is not in the frame is as far as the frame is wide.
/// A point of the image's outline counts for the joint of the nearest point of the template's.
fn apart(s: &Shown, d: &Drawn) -> Apart {
    if d.outline.is_empty() {
        return Apart { mean: d.pixel * f64::from(s.camera.width), joints: Vec::new() };
    }
    let points: Vec<DVec2> = d.outline.iter().map(|p| p.0).collect();
    let there = d.outline.iter().map(|(p, joint)| (*joint, nearest(*p, &s.outline).1));
    let back = s.outline.iter().map(|p| nearest(*p, &points)).map(|(k, far)| (d.outline[k].1, far));
    let mut joints: BTreeMap<u32, (f64, usize)> = BTreeMap::new();
    let mut means = [0.0; 2];
    let both = there.map(|p| (0, d.outline.len(), p)).chain(back.map(|p| (1, s.outline.len(), p)));
    for (way, count, (joint, far)) in both {
        means[way] += far * d.pixel / count as f64;
        let (sum, count) = joints.entry(joint).or_default();
        *sum += far * d.pixel;
        *count += 1;
    }
    let joints = joints.into_iter().map(|(joint, (sum, n))| (joint, sum / n as f64)).collect();
    Apart { mean: 0.5 * (means[0] + means[1]), joints }
}
