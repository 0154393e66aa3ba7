//! Checks of a filmed person: the posed template must cover the silhouettes of its images.
//!
//! The distance of two silhouettes is the mean distance from the outline of each to that of the other, in metres at the depth
//! of the person. Outlines that are off everywhere mean another pose, scale or camera; the same measure with the poses
//! of other frames tells clocks, and by the joint that moves a part of the outline which joint is off.

mod compare;
mod outlines;
mod silhouette;

pub use outlines::{CameraOutlines, JointOutlines, Outlines};

use super::figures::tinted;
use super::{Figure, Finding, Verdict, median};
use compare::{Apart, Compared, SHIFTS, compare, later};
use glam::Vec3;
use gs_data::avatar::AvatarScene;
use gs_data::{Dataset, ImageCache};
use rayon::prelude::*;
use silhouette::{Drawn, Shown, compared, dominant, draw, silhouettes};
use std::collections::{BTreeMap, BTreeSet};

/// Mean distance of outlines, as a share of the template's size: up to the first it fits, above the second it does not.
const GOOD_SHARE: f64 = 0.01;
const BAD_SHARE: f64 = 0.03;
/// A joint is off if its part of the outline is farther than this share of the template's size, and farther than that of the
/// median joint by this factor.
const JOINT_SHARE: f64 = 0.015;
const ODD_JOINT: f64 = 3.0;
/// Another clock must bring the outlines nearer by this factor, and by this share of the template's size.
const CLEARLY: f64 = 0.6;
const CLEAR_SHARE: f64 = 0.003;
/// A camera is off if its outlines are farther apart than usual by this factor.
const ODD_CAMERA: f64 = 2.0;
/// Joints and views named.
const NAMED: usize = 3;

/// What the check found.
#[derive(Default)]
pub(super) struct Checked {
    pub(super) findings: Vec<Finding>,
    pub(super) figures: Vec<Figure>,
    /// None of data without a person, or without silhouettes.
    pub(super) outlines: Option<Outlines>,
}

/// Compares template and images; nothing of data without a person.
pub(super) fn check(data: &Dataset, small_images: &ImageCache) -> Checked {
    let Some(scene) = data.avatar.as_deref() else { return Checked::default() };
    let rows = compared(scene);
    let shown = silhouettes(data, scene, &rows, small_images);
    if shown.is_empty() {
        let what =
            "no image has alpha or a mask with an outline, so the template cannot be held against its silhouette";
        let fix = "add masks of the person, or images with alpha";
        let finding = Finding::new("template", "template.masks", Verdict::Warning, what).fix(fix);
        return Checked { findings: vec![finding], ..Checked::default() };
    }
    let check = Check::new(scene, &rows, shown);
    Checked { findings: check.findings(), figures: check.figures(), outlines: Some(check.outlines()) }
}

/// The comparison of all views at their own frames, and with the poses of other frames.
struct Check<'a> {
    scene: &'a AvatarScene,
    shown: Vec<Shown>,
    drawn: Vec<Drawn>,
    /// Per view.
    apart: Vec<Apart>,
    /// Per view, with the poses so many frames later ([`SHIFTS`]); infinite where there is no such frame.
    shifted: Vec<Vec<f64>>,
    /// Largest extent of the template, metres.
    size: f64,
}

impl<'a> Check<'a> {
    fn new(scene: &'a AvatarScene, rows: &[usize], shown: Vec<Shown>) -> Self {
        let (joints, count) = (dominant(scene), scene.frames.len());
        // Of a long film few poses are needed.
        let needed: BTreeSet<usize> =
            rows.iter().flat_map(|&row| SHIFTS.filter_map(move |by| later(row, by, count))).collect();
        let surfaces: BTreeMap<usize, Vec<Vec3>> =
            needed.into_par_iter().map(|row| (row, scene.posed(&scene.frames[row]))).collect();
        let of_camera = |views: &&[Shown]| {
            let draw = |row: usize| draw(scene, &surfaces[&row], &joints, &views[0].camera);
            compare(views, rows, count, draw)
        };
        let same = |a: &Shown, b: &Shown| a.camera_id == b.camera_id && a.camera == b.camera;
        let cameras: Vec<&[Shown]> = shown.chunk_by(same).collect();
        let all: Vec<Compared> = cameras.par_iter().flat_map_iter(of_camera).collect();
        let (drawn, (apart, shifted)): (Vec<_>, (Vec<_>, Vec<_>)) = all.into_iter().unzip();
        let rest = &scene.character.template.vertices;
        let (low, high) = rest.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let size = f64::from((high - low).max_element()).max(1e-6);
        Self { scene, shown, drawn, apart, shifted, size }
    }

    /// Means over the views of one camera, or of all.
    fn mean(&self, camera: Option<u32>, of: impl Fn(usize) -> f64) -> f64 {
        let views = (0..self.shown.len()).filter(|&k| camera.is_none_or(|c| self.shown[k].camera_id == c));
        let values: Vec<f64> = views.map(of).filter(|v| v.is_finite()).collect();
        values.iter().sum::<f64>() / values.len() as f64
    }

    fn cameras(&self) -> Vec<u32> {
        let mut ids: Vec<u32> = self.shown.iter().map(|s| s.camera_id).collect();
        ids.dedup();
        ids
    }

    /// The shift of poses that fits best, if it fits clearly better than none, with the distance then. Only views that have a
    /// frame at the shift are compared.
    fn clock(&self, camera: Option<u32>) -> Option<(isize, f64)> {
        let none = SHIFTS.clone().position(|by| by == 0)?;
        let fit = |(k, by): (usize, isize)| {
            let with = self.mean(camera, |v| self.shifted[v][k]);
            let without =
                self.mean(camera, |v| if self.shifted[v][k].is_finite() { self.shifted[v][none] } else { f64::NAN });
            (with < CLEARLY * without && without - with > CLEAR_SHARE * self.size).then_some((by, with))
        };
        SHIFTS.enumerate().filter_map(fit).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    fn findings(&self) -> Vec<Finding> {
        let away = self.drawn.iter().filter(|d| d.outline.is_empty()).count();
        if 2 * away > self.drawn.len() {
            let what = format!(
                "the posed template lies outside {away} of {} images, or fills them: its units or the place of its root are not those \
                 of the cameras",
                self.drawn.len()
            );
            let fix = "give template, poses and cameras in the same units, metres, and one frame of reference";
            return vec![Finding::new("template", "template.away", Verdict::Problem, what).fix(fix)];
        }
        let cameras = self.cameras();
        let late: Vec<(u32, isize)> =
            cameras.iter().filter_map(|&c| self.clock(Some(c)).map(|(by, _)| (c, by))).collect();
        if let Some(by) = self.clock(None).map(|c| c.0).or_else(|| self.common(&late)) {
            return vec![self.late(by)];
        }
        let mut out: Vec<Finding> = Vec::new();
        if !late.is_empty() {
            out.push(camera_clocks(&late));
        }
        let rest: Vec<u32> = cameras.into_iter().filter(|c| late.iter().all(|l| l.0 != *c)).collect();
        let of: Vec<f64> = rest.iter().map(|&c| self.mean(Some(c), |k| self.apart[k].mean)).collect();
        let usual = median(&of);
        let enough = rest.len() > 2;
        let is_odd = |far: f64| enough && far > ODD_CAMERA * usual && far > GOOD_SHARE * self.size;
        let (odd, sound): (Vec<_>, Vec<_>) = rest.into_iter().zip(of).partition(|c| is_odd(c.1));
        if !odd.is_empty() {
            out.push(odd_cameras(&odd, usual));
        }
        let sound: Vec<u32> = sound.into_iter().map(|c| c.0).collect();
        out.extend(self.fit(&sound));
        out
    }

    /// The shift of some cameras if it is one, and the others fit with it as well as without: they do not see what moves.
    fn common(&self, late: &[(u32, isize)]) -> Option<isize> {
        let by = late.first()?.1;
        let [with, without] = [by, 0].map(|by| SHIFTS.clone().position(|s| s == by));
        let (with, without) = (with?, without?);
        let fits = |camera: u32| {
            let mean = |k: usize| {
                self.mean(
                    Some(camera),
                    |v| if self.shifted[v][with].is_finite() { self.shifted[v][k] } else { f64::NAN },
                )
            };
            mean(with) <= mean(without) + 0.5 * CLEAR_SHARE * self.size
        };
        let same = late.len() > 1 && late.iter().all(|l| l.1 == by);
        (same && self.cameras().into_iter().all(fits)).then_some(by)
    }

    /// Poses of all cameras that belong to other frames.
    fn late(&self, by: isize) -> Finding {
        let then = SHIFTS.clone().position(|s| s == by).map_or(f64::NAN, |k| self.mean(None, |v| self.shifted[v][k]));
        let what = format!(
            "images show the pose of {} frame{} {}: outlines are {:.1} cm apart, and {:.1} cm with that pose",
            by.abs(),
            if by.abs() == 1 { "" } else { "s" },
            if by > 0 { "later" } else { "earlier" },
            100.0 * self.mean(None, |k| self.apart[k].mean),
            100.0 * then
        );
        let fix = "shift the poses against the images by that many frames; they were cut or trimmed differently";
        Finding::new("template", "template.time", Verdict::Problem, what).fix(fix)
    }

    /// The fit in some cameras, as a whole and by joint.
    fn fit(&self, cameras: &[u32]) -> Vec<Finding> {
        let views: Vec<usize> = (0..self.shown.len()).filter(|&k| cameras.contains(&self.shown[k].camera_id)).collect();
        if views.is_empty() {
            return Vec::new();
        }
        let mean = views.iter().map(|&k| self.apart[k].mean).sum::<f64>() / views.len() as f64;
        let share = mean / self.size;
        let text = format!(
            "outlines of the posed template and of {} images are {:.1} cm apart in the mean ({:.1} % of its size)",
            views.len(),
            100.0 * mean,
            100.0 * share
        );
        let joints = self.joints(&views);
        let fix = "compare the figures; correct the poses of these joints, the scale of the template or the calibration. Offsets \
                   learnt from images reach a few centimetres";
        if share > GOOD_SHARE {
            let verdict = if share > BAD_SHARE { Verdict::Problem } else { Verdict::Warning };
            let finding = Finding::new("template", "template.fit", verdict, text + &self.scale(&views));
            return vec![finding.at(self.named(&joints)).fix(fix)];
        }
        let usual = median(&joints.iter().map(|j| j.1).collect::<Vec<_>>());
        let odd = |j: &(u32, f64)| j.1 > JOINT_SHARE * self.size && j.1 > ODD_JOINT * usual;
        let odd: Vec<(u32, f64)> = joints.into_iter().filter(odd).collect();
        if odd.is_empty() {
            return vec![Finding::ok("template", text)];
        }
        let what = format!("{text}, but a part of it is farther off");
        vec![Finding::new("template", "template.joint", Verdict::Warning, what).at(self.named(&odd)).fix(fix)]
    }

    /// A sentence on the scale, where silhouettes are taller or shorter than the template's.
    fn scale(&self, views: &[usize]) -> String {
        let tall = self.taller(views);
        if (tall - 1.0).abs() > 0.04 {
            format!("; silhouettes are {tall:.2} times as tall as the template's")
        } else {
            String::new()
        }
    }

    /// Height of silhouettes over that of the template, the median over views.
    fn taller(&self, views: &[usize]) -> f64 {
        let height = |points: &mut dyn Iterator<Item = f64>| {
            let (low, high) = points.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
            high - low
        };
        let ratio = |&k: &usize| {
            let (s, d) = (&self.shown[k], &self.drawn[k]);
            height(&mut s.outline.iter().map(|p| p.y)) / height(&mut d.outline.iter().map(|p| p.0.y))
        };
        let ratios = views.iter().map(ratio).filter(|r| r.is_finite());
        median(&ratios.collect::<Vec<_>>())
    }

    /// How far each joint's part of the template's outline is from the image's in some views, metres, farthest first.
    fn joints(&self, views: &[usize]) -> Vec<(u32, f64)> {
        let mut sums: BTreeMap<u32, (f64, usize)> = BTreeMap::new();
        for (joint, far) in views.iter().flat_map(|&k| &self.apart[k].joints) {
            let (sum, count) = sums.entry(*joint).or_default();
            *sum += far;
            *count += 1;
        }
        let mut joints: Vec<(u32, f64)> = sums.into_iter().map(|(j, (sum, n))| (j, sum / n as f64)).collect();
        joints.sort_by(|a, b| b.1.total_cmp(&a.1));
        joints
    }

    /// The name of a joint, for people.
    fn name(&self, joint: u32) -> String {
        let skeleton = &self.scene.character.skeleton;
        let node = skeleton.joints.get(joint as usize).and_then(|j| skeleton.nodes.get(j.node as usize));
        node.map(|n| n.name.clone()).filter(|n| !n.is_empty()).unwrap_or_else(|| format!("joint {joint}"))
    }

    /// The first few joints with their distances, for people.
    fn named(&self, joints: &[(u32, f64)]) -> Vec<String> {
        let text = |&(joint, far): &(u32, f64)| format!("{}: {:.1} cm", self.name(joint), 100.0 * far);
        joints.iter().take(NAMED).map(text).collect()
    }

    /// The distances in every camera and of every joint.
    fn outlines(&self) -> Outlines {
        let of_camera = |camera: u32| CameraOutlines {
            camera,
            views: self.shown.iter().filter(|s| s.camera_id == camera).count(),
            metres: self.mean(Some(camera), |k| self.apart[k].mean),
        };
        let views: Vec<usize> = (0..self.shown.len()).collect();
        let joints = self.joints(&views).into_iter();
        Outlines {
            cameras: self.cameras().into_iter().map(of_camera).collect(),
            joints: joints.map(|(joint, metres)| JointOutlines { joint: self.name(joint), metres }).collect(),
        }
    }

    /// The views whose outlines are farthest apart.
    fn figures(&self) -> Vec<Figure> {
        let mut views: Vec<usize> = (0..self.shown.len()).collect();
        views.sort_by(|&a, &b| self.apart[b].mean.total_cmp(&self.apart[a].mean));
        let show = |k: usize| {
            let (s, d) = (&self.shown[k], &self.drawn[k]);
            let caption = format!(
                "{}, outlines {:.1} cm apart: green is template and image, red is seen and not covered by the template, blue the reverse",
                s.name,
                100.0 * self.apart[k].mean
            );
            Figure { topic: "template", caption, image: tinted(&s.image, d.covered.iter().copied()) }
        };
        views.into_iter().take(NAMED).map(show).collect()
    }
}

/// Cameras whose outlines are farther apart than usual.
fn odd_cameras(odd: &[(u32, f64)], usual: f64) -> Finding {
    let what = format!(
        "outlines of template and images are {:.1} cm apart in the median camera, but farther in some: their calibration is not \
         that of the others",
        100.0 * usual
    );
    let places = odd.iter().map(|(c, far)| format!("camera {c}: {:.1} cm", 100.0 * far));
    let finding = Finding::new("template", "template.camera", Verdict::Problem, what);
    finding.at(places).fix("calibrate these cameras again, or leave them out")
}

/// Cameras whose images are of other frames than those of the rest.
fn camera_clocks(late: &[(u32, isize)]) -> Finding {
    let what = format!(
        "{} of the cameras show the poses of other frames: their clocks are not that of the others",
        late.len()
    );
    let places = late.iter().map(|(c, by)| format!("camera {c}: {by:+} frames"));
    let finding = Finding::new("template", "template.clock", Verdict::Problem, what);
    finding.at(places).fix("renumber the images of these cameras, or leave them out")
}

#[cfg(test)]
mod tests;
