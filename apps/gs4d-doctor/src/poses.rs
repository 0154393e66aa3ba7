//! Checks of poses by matched corners: a match must lie on its epipolar line and in front of both cameras.
//!
//! With `E = [t]× R` from one camera to the other and `F = K₂⁻ᵀ E K₁⁻¹`, the error of a pair is Sampson's,
//! `(x₂ᵀ F x₁)² / (|F x₁|² + |Fᵀ x₂|²)` with the first two entries of the lines (Hartley and Zisserman, 11.4.3). Random matches are
//! within the tolerance in one or two cases of a hundred, so a much larger share supports the poses. The same share under
//! other readings of the poses ([`PoseReading`]) and other focal lengths tells which fits best.

use super::features::{Corner, corners, match_corners};
use super::pose_readings::PoseReading;
use super::silhouettes::Silhouettes;
use super::{Figure, Finding, Verdict, figures, luma, median};
use glam::{DMat3, DVec2, DVec3};
use gs_core::{Camera, Image};
use gs_data::{Dataset, ImageCache, View, geometry::focus};
use rayon::prelude::*;

/// Most views in which corners are detected.
const MAX_VIEWS: usize = 80;
/// Other views that each view is matched with.
const NEIGHBOURS: usize = 2;
/// Least angle between two cameras seen from the scene's centre, radians: closer pairs do not constrain translations.
const MIN_ANGLE: f64 = 0.035;
/// Largest error of a match that agrees with the poses: a share of the longer image side, and at least so many pixels.
const TOLERANCE_SHARE: f64 = 1.0 / 240.0;
const MIN_TOLERANCE: f64 = 0.8;
/// Largest angle between matched views, radians: patches seen from farther apart do not correlate.
const MAX_ANGLE: f64 = 0.6;
/// Least sine of the angle between two rays for a test of the side on which they meet.
const MIN_PARALLAX: f64 = 0.005;
/// Fewest matches for a verdict: on all views, and on one.
const MIN_PAIRS: usize = 60;
const MIN_VIEW_PAIRS: usize = 20;
/// Share of matches that agree: above the first poses are good, below the second they are wrong.
const GOOD_SHARE: f64 = 0.45;
const BAD_SHARE: f64 = 0.2;
/// Factors on the focal length that are tried.
const FOCAL_FACTORS: [f64; 8] = [0.5, 0.6, 0.7, 0.8, 1.25, 1.45, 1.7, 2.0];

/// Two views and the pixels of their matched corners.
struct Match {
    views: [usize; 2],
    points: Vec<[DVec2; 2]>,
}

/// All matches of a data set, in pixels of the reduced images.
struct Matches<'a> {
    views: Vec<&'a View>,
    cameras: Vec<Camera>,
    pairs: Vec<Match>,
    /// Largest error of a match that agrees, pixels.
    tolerance: f64,
}

/// Checks poses; returns one figure of matched images.
pub(super) fn check(
    data: &Dataset,
    small_images: &ImageCache,
    silhouettes: Option<&Silhouettes>,
) -> (Vec<Finding>, Vec<Figure>) {
    let mut findings = rig(data);
    let matches = Matches::find(data, small_images);
    let (found, unsure) = matches.findings(small_images.scale());
    let by_silhouettes = silhouettes.map_or(Vec::new(), Silhouettes::findings);
    // Silhouettes may settle what corners cannot.
    let sound = by_silhouettes.iter().any(|f| f.verdict == Verdict::Ok);
    if !(unsure && sound) {
        findings.extend(found);
    }
    findings.extend(by_silhouettes);
    (findings, matches.figure(small_images).into_iter().collect())
}

/// Checks of camera positions: spread, outliers, scale.
fn rig(data: &Dataset) -> Vec<Finding> {
    let centres: Vec<DVec3> = data.train.iter().map(|v| v.camera.position()).collect();
    let middle = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let away: Vec<f64> = centres.iter().map(|c| c.distance(middle)).collect();
    let (extent, usual) = (away.iter().copied().fold(0.0, f64::max), median(&away));
    let spread = |v: &[f64]| format!("{:.3}", v.iter().copied().fold(0.0, f64::max));
    let mut out = Vec::new();
    if extent < 1e-6 {
        let fix = "give images from several places; gs4d train learns no depth from one";
        out.push(
            Finding::new("poses", "poses.still", Verdict::Warning, "all training views are taken from one place")
                .fix(fix),
        );
    } else {
        let far: Vec<&str> = data
            .train
            .iter()
            .zip(&away)
            .filter(|(_, d)| **d > 8.0 * usual.max(1e-9))
            .map(|(v, _)| v.name.as_str())
            .collect();
        if !far.is_empty() && usual > 0.0 {
            let what = format!(
                "{} of {} cameras stand more than eight times farther out than usual ({} against {usual:.3})",
                far.len(),
                centres.len(),
                spread(&away)
            );
            let fix = "check the units of their translations, or remove these views";
            out.push(Finding::new("poses", "poses.far", Verdict::Problem, what).at(far).fix(fix));
        }
    }
    let size = data.scene_extent();
    if !(1e-3..=1e4).contains(&size) {
        let what = format!(
            "the cameras span {size:.3e} units: learning rates and the near plane are made for scenes of about 1 to 100"
        );
        out.push(
            Finding::new("poses", "poses.scale", Verdict::Warning, what)
                .fix("scale all translations and points by one factor"),
        );
    }
    out
}

impl<'a> Matches<'a> {
    fn find(data: &'a Dataset, small_images: &ImageCache) -> Self {
        let count = data.train.len().min(MAX_VIEWS);
        let views: Vec<&View> = (0..count).map(|k| &data.train[k * data.train.len() / count]).collect();
        let cameras: Vec<Camera> = views.iter().map(|v| small_images.camera(v)).collect();
        let found: Vec<Vec<Corner>> = views.par_iter().map(|v| corners_of(v, small_images)).collect();
        let mut wanted: Vec<[usize; 2]> = neighbours(&views, focus(&data.train));
        wanted.sort_unstable();
        wanted.dedup();
        let of = |views: [usize; 2]| {
            let [a, b] = views.map(|i| &found[i]);
            let at = |c: &Corner| DVec2::from(c.at);
            let points = match_corners(a, b).into_iter().map(|(i, j)| [at(&a[i]), at(&b[j])]).collect();
            Match { views, points }
        };
        let pairs = wanted.into_iter().map(of).collect();
        Self { tolerance: tolerance(&cameras), pairs, views, cameras }
    }

    fn count(&self) -> usize {
        self.pairs.iter().map(|p| p.points.len()).sum()
    }

    /// The error of each match under changed cameras; infinite behind one of them.
    fn errors(&self, camera: &dyn Fn(&Camera) -> Camera) -> Vec<Vec<f64>> {
        let cameras: Vec<Camera> = self.cameras.iter().map(camera).collect();
        let of = |m: &Match| {
            let [a, b] = m.views.map(|i| &cameras[i]);
            let pair = Pair::new(a, b);
            m.points.iter().map(|p| pair.error(*p)).collect()
        };
        self.pairs.iter().map(of).collect()
    }

    fn share(&self, camera: &dyn Fn(&Camera) -> Camera) -> f64 {
        share(self.errors(camera).iter().flatten(), self.tolerance)
    }

    /// Findings on the poses, and whether the matches were inconclusive.
    fn findings(&self, scale: f64) -> (Vec<Finding>, bool) {
        let count = self.count();
        if count < MIN_PAIRS {
            let what =
                format!("only {count} corners have a partner in a neighbouring image: poses cannot be checked by them");
            return (vec![Finding::new("poses", "poses.unchecked", Verdict::Note, what)], true);
        }
        let errors = self.errors(&|c| c.clone());
        let now = share(errors.iter().flatten(), self.tolerance);
        let near: Vec<f64> = errors.iter().flatten().copied().filter(|e| *e < self.tolerance).collect();
        let off = if near.is_empty() {
            String::new()
        } else {
            format!(", {:.2} px off (median of these, at full size)", median(&near) / scale)
        };
        let text = format!("{:.0} % of {count} matched corners agree with the poses{off}", 100.0 * now);
        let best = |list: Vec<(f64, String, String)>| list.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        let readings =
            PoseReading::ALL.iter().map(|s| (self.share(&|c| s.camera(c)), s.what().to_owned(), s.fix().to_owned()));
        let focal = |f: f64| {
            let other = self.share(&|c| Camera { fx: f * c.fx, fy: f * c.fy, ..c.clone() });
            let what = format!("and focal lengths of {f} times what they are");
            (other, what, "check the focal length, or the field of view and the size of image it belongs to".to_owned())
        };
        for (code, others, factor) in [
            ("poses.convention", best(readings.collect()), 2.0),
            ("poses.focal", best(FOCAL_FACTORS.into_iter().map(focal).collect()), 1.4),
        ] {
            if let Some((other, what, fix)) = others.filter(|o| o.0 >= 0.3 && o.0 > factor * now) {
                let what = format!("{text}; with poses {what} it would be {:.0} %", 100.0 * other);
                return (vec![Finding::new("poses", code, Verdict::Problem, what).fix(fix)], false);
            }
        }
        let wrong = self.wrong_views(&errors);
        if now >= GOOD_SHARE && !wrong.is_empty() {
            let what = format!(
                "{text}, but hardly any of {} views: their poses or times are not those of the others",
                wrong.len()
            );
            let finding = Finding::new("poses", "poses.view", Verdict::Problem, what);
            return (vec![finding.at(wrong).fix("correct these poses, or remove these views from the file")], false);
        }
        if now >= GOOD_SHARE {
            return (vec![Finding::ok("poses", text)], false);
        }
        let fix = "check at the pair of images below: if lines miss what they should meet, reconstruct the poses again";
        let verdict = if now < BAD_SHARE { Verdict::Problem } else { Verdict::Note };
        let why = if now < BAD_SHARE { "" } else { "; what moves, and what repeats, never agrees" };
        (vec![Finding::new("poses", "poses.disagree", verdict, text + why).fix(fix)], false)
    }

    /// Names of views whose matches all disagree although their neighbours agree with others.
    fn wrong_views(&self, errors: &[Vec<f64>]) -> Vec<String> {
        let mut sums = vec![(0usize, 0usize); self.views.len()];
        for (m, errors) in self.pairs.iter().zip(errors) {
            let near = errors.iter().filter(|e| **e < self.tolerance).count();
            for i in m.views {
                sums[i] = (sums[i].0 + near, sums[i].1 + errors.len());
            }
        }
        let of = |i: usize| sums[i].0 as f64 / sums[i].1.max(1) as f64;
        let bad = |i: usize| sums[i].1 >= MIN_VIEW_PAIRS && of(i) < 0.5 * BAD_SHARE;
        let has_good_neighbour = |i: usize| {
            let mut neighbours =
                self.pairs.iter().filter(|m| m.views.contains(&i)).map(|m| m.views[usize::from(m.views[0] == i)]);
            neighbours.any(|j| !bad(j))
        };
        (0..sums.len()).filter(|&i| bad(i) && has_good_neighbour(i)).map(|i| self.views[i].name.clone()).collect()
    }

    /// The pair with the most matches, coloured by whether they agree.
    fn figure(&self, small_images: &ImageCache) -> Option<Figure> {
        let best = self.pairs.iter().max_by_key(|m| m.points.len()).filter(|m| m.points.len() >= 8)?;
        let images: Vec<Image> = best
            .views
            .iter()
            .map(|&i| small_images.get(self.views[i]).map(|v| v.over([0.5; 3])))
            .collect::<Result<_, _>>()
            .ok()?;
        let pair = Pair::new(&self.cameras[best.views[0]], &self.cameras[best.views[1]]);
        let marks: Vec<([DVec2; 2], bool)> =
            best.points.iter().map(|p| (*p, pair.error(*p) < self.tolerance)).collect();
        let [a, b] = [0, 1].map(|k| self.views[best.views[k]].name.as_str());
        let agree = marks.iter().filter(|m| m.1).count();
        let caption = format!(
            "{a} and {b}: {agree} of {} matched corners agree with the poses (green), the others do not (red)",
            marks.len()
        );
        Some(Figure { topic: "poses", caption, image: figures::side_by_side(&images[0], &images[1], &marks) })
    }
}

fn share<'e>(errors: impl Iterator<Item = &'e f64>, tolerance: f64) -> f64 {
    let (mut near, mut all) = (0usize, 0usize);
    for e in errors {
        near += usize::from(*e < tolerance);
        all += 1;
    }
    near as f64 / all.max(1) as f64
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
fn neighbours(views: &[&View], middle: DVec3) -> Vec<[usize; 2]> {
    let towards: Vec<DVec3> = views.iter().map(|v| (v.camera.position() - middle).normalize_or_zero()).collect();
    let apart = |i: usize, j: usize| {
        let angle = towards[i].dot(towards[j]).clamp(-1.0, 1.0).acos();
        let turn = views[i].camera.rotation * views[j].camera.rotation.transpose();
        let turned = (0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0)).clamp(-1.0, 1.0).acos();
        let late = f64::from((views[i].time.normalised - views[j].time.normalised).abs());
        let near = if angle < MIN_ANGLE { 1.0 } else { 0.0 };
        let elsewhere = views[i].camera.position().distance(views[j].camera.position()) > 1e-6;
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

/// The epipolar geometry of two cameras.
struct Pair {
    fundamental: DMat3,
    rays: [DMat3; 2],
    turn: DMat3,
    shift: DVec3,
}

impl Pair {
    fn new(a: &Camera, b: &Camera) -> Self {
        let turn = b.rotation * a.rotation.transpose();
        let t = b.translation - turn * a.translation;
        let cross =
            DMat3::from_cols(DVec3::new(0.0, t.z, -t.y), DVec3::new(-t.z, 0.0, t.x), DVec3::new(t.y, -t.x, 0.0));
        let ray = |c: &Camera| {
            DMat3::from_cols(DVec3::X / c.fx, DVec3::Y / c.fy, DVec3::new(-c.cx / c.fx, -c.cy / c.fy, 1.0))
        };
        let rays = [ray(a), ray(b)];
        Self { fundamental: rays[1].transpose() * cross * turn * rays[0], rays, turn, shift: t }
    }

    /// Sampson distance, pixels; infinite if the point is behind a camera.
    fn error(&self, [a, b]: [DVec2; 2]) -> f64 {
        let (x, y) = (a.extend(1.0), b.extend(1.0));
        let (forth, back) = (self.fundamental * x, self.fundamental.transpose() * y);
        let lines = forth.truncate().length_squared() + back.truncate().length_squared();
        if lines < 1e-24 {
            return f64::INFINITY;
        }
        if self.behind(x, y) {
            return f64::INFINITY;
        }
        y.dot(forth).abs() / lines.sqrt()
    }

    /// Whether the rays of two pixels meet behind a camera, as far as they meet at all: `z₂ r₂ = z₁ R r₁ + t`.
    fn behind(&self, x: DVec3, y: DVec3) -> bool {
        let (p, q) = (self.turn * (self.rays[0] * x), self.rays[1] * y);
        let across = p.cross(q);
        if across.length() < MIN_PARALLAX * p.length() * q.length() {
            return false;
        }
        let depth = |other: DVec3| self.shift.cross(other).dot(across) / across.length_squared();
        // From z₁ p + t = z₂ q, crossed with q and with p.
        -depth(q) < 0.0 || -depth(p) < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras() -> [Camera; 2] {
        let look =
            |x: f64| Camera::look_at(200, 160, 0.9, DVec3::new(x, -5.0, 1.0), DVec3::new(0.0, 0.2, 0.1), DVec3::Z);
        [look(-0.6).unwrap(), look(0.7).unwrap()]
    }

    #[test]
    fn points_of_the_scene_agree_with_right_poses_alone() {
        let [a, b] = cameras();
        let points = (0..40).map(|k| {
            let p = DVec3::new((k % 5) as f64 - 2.0, (k % 7) as f64 * 0.4 - 1.2, (k % 3) as f64 * 0.7 - 0.7);
            [&a, &b].map(|c| c.to_pixel(c.to_camera(p)))
        });
        let points: Vec<[DVec2; 2]> = points.collect();
        let share = |pair: Pair| points.iter().filter(|p| pair.error(**p) < 2.0).count();
        assert_eq!(share(Pair::new(&a, &b)), 40);
        for s in PoseReading::ALL {
            let agree = share(Pair::new(&s.camera(&a), &s.camera(&b)));
            assert!(agree <= 20, "{s:?}: {agree}");
        }
        let pair = Pair::new(&a, &b);
        let moved = points.iter().map(|[p, q]| pair.error([*p, *q + DVec2::new(0.0, 3.0)]));
        assert!(moved.clone().all(|e| e > 1.0 && e < 3.1), "{:?}", moved.collect::<Vec<_>>());
    }

    /// Cameras in an arc whose images show the same random points, as they are and as a mistaken file has them.
    fn seen(mistake: impl Fn(usize, &Camera) -> Camera) -> (Vec<View>, Vec<Camera>, Vec<Match>) {
        let eye = |k: usize| DVec3::new((0.35 * k as f64).sin() * 2.0, -2.0 * (0.35 * k as f64).cos(), 0.3 * k as f64);
        let look = |k: usize| Camera::look_at(240, 200, 1.3, eye(k), DVec3::new(0.0, 0.3, 0.4), DVec3::Z).unwrap();
        let right: Vec<Camera> = (0..6).map(look).collect();
        let at = |k: usize, p: DVec3| right[k].to_pixel(right[k].to_camera(p));
        let pair = |i: usize, j: usize| {
            let mut r = gs_core::Rng::new(1, "test", i as u32, j as u64);
            let mut side = || f64::from(r.uniform()) * 2.0 - 1.0;
            let points = (0..30).map(|_| DVec3::new(side(), side(), side())).map(|p| [at(i, p), at(j, p)]).collect();
            Match { views: [i, j], points }
        };
        let pairs = (0..5).map(|k| pair(k, k + 1)).chain((0..4).map(|k| pair(k, k + 2))).collect();
        let wrong: Vec<Camera> = right.iter().enumerate().map(|(k, c)| mistake(k, c)).collect();
        let view = |(k, c): (usize, &Camera)| {
            let image = gs_data::ImageSource::File(std::path::PathBuf::new());
            View::new(format!("v{k}"), c.clone(), gs_core::Time::default(), image, 0)
        };
        (wrong.iter().enumerate().map(view).collect(), wrong, pairs)
    }

    #[track_caller]
    fn finding(mistake: impl Fn(usize, &Camera) -> Camera) -> Finding {
        let (views, cameras, pairs) = seen(mistake);
        let matches = Matches { views: views.iter().collect(), tolerance: tolerance(&cameras), cameras, pairs };
        matches.findings(1.0).0.remove(0)
    }

    #[test]
    fn mistakes_are_told_by_their_kind() {
        assert_eq!(finding(|_, c| c.clone()).verdict, Verdict::Ok);
        let focal = finding(|_, c| Camera { fx: c.fx / 1.7, fy: c.fy / 1.7, ..c.clone() });
        assert!(focal.code == "poses.focal" && focal.what.contains("1.7 times"), "{focal:?}");
        for s in PoseReading::ALL {
            assert_eq!(finding(|_, c| s.camera(c)).code, "poses.convention", "{s:?}");
        }
        let turned = glam::DMat3::from_rotation_z(0.5);
        let one =
            finding(|k, c| if k == 0 { Camera { rotation: turned * c.rotation, ..c.clone() } } else { c.clone() });
        assert!(one.code == "poses.view" && one.places == ["v0"], "{one:?}");
    }
}
