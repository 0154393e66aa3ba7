//! Checks of poses: by matched corners, which must lie on their epipolar lines and in front of both cameras, and by silhouettes, which
//! the visual hull must cover.
//!
//! Random matches are within the tolerance in one or two cases of a hundred, so a much larger share supports the poses. The same share under
//! other readings of the poses ([`PoseReading`]) and other focal lengths tells which fits best. Where things move or texture repeats,
//! matches disagree with sound poses as well: a view is flagged only if another pose explains it ([`CornerFit`], [`HullFit`]), and
//! faults put into the data's own poses tell what such a test can find there.

use super::corner_fit::{CornerFit, Elsewhere};
use super::epipolar::Pair;
use super::hull_fit::{Found, HullFit, Wrong};
use super::matching::Matches;
use super::pose_readings::PoseReading;
use super::silhouettes::Silhouettes;
use super::views::Views;
use super::{Figure, Finding, Verdict, figures, median, rig};
use glam::DVec2;
use gs_core::{Camera, Image};
use gs_data::{Dataset, ImageCache, Split, geometry::focus};
use std::collections::BTreeMap;

/// Fewest matches for a verdict on all views.
const MIN_PAIRS: usize = 60;
/// Share of matches that agree: above the first poses are good, below the second those of a static scene are wrong.
const GOOD_SHARE: f64 = 0.45;
const BAD_SHARE: f64 = 0.2;
/// Fewest matches of the median pair of a static scene whose poses are called wrong: fewer may all be chance.
const MIN_PAIR_MATCHES: usize = 15;
/// Factors on the focal length that are tried.
const FOCAL_FACTORS: [f64; 10] = [0.5, 0.6, 0.7, 0.77, 0.84, 1.2, 1.3, 1.45, 1.7, 2.0];
/// Another reading or focal length must have at least this share of the matches,
const MIN_OTHER_SHARE: f64 = 0.3;
/// and so many times as many as now: of readings, and of focal lengths, whose matches are also compared one by one.
const READING_GAIN: f64 = 2.0;
const FOCAL_GAIN: f64 = 1.15;
/// Standard deviations by which more matches are won than lost.
const FOCAL_DEVIATIONS: f64 = 6.0;
/// Share of the faults tried that must be found before the check is said to find them.
const SURE: f64 = 0.9;
/// Turns that are tried, degrees.
const TURNS: [f64; 3] = [3.0, 5.0, 10.0];
/// Most flagged views that are shown.
const MAX_SHOWN: usize = 6;

/// A view by split and index.
type Place = (Split, usize);

/// Checks poses; returns figures of matched images and of flagged views.
pub(super) fn check(
    data: &Dataset,
    small_images: &ImageCache,
    silhouettes: Option<&Silhouettes>,
) -> (Vec<Finding>, Vec<Figure>) {
    let mut findings = rig::check(data);
    let views = Views::of(data);
    let middle = focus(&data.train);
    let matches = Matches::find(views.list(data), small_images, middle);
    let whole = matches.findings(small_images.scale(), data.dynamic);
    let by_silhouettes = silhouettes.map_or(Vec::new(), Silhouettes::findings);
    let wrong = |f: &Finding| f.verdict == Verdict::Problem;
    if whole.iter().chain(&by_silhouettes).any(wrong) {
        // Views mean nothing one by one where all are wrong.
        findings.extend(whole);
        findings.extend(by_silhouettes);
        return (findings, matches.figure(None, small_images).into_iter().collect());
    }
    let singles = Singles {
        data,
        views: &views,
        corners: CornerFit::new(&matches, middle, data.dynamic),
        hull: silhouettes.and_then(|s| Some((s, HullFit::of(s)?))),
    };
    let (flagged, doubt) = singles.flagged();
    // Silhouettes may settle what corners cannot.
    let settled = by_silhouettes.iter().any(|f| f.verdict == Verdict::Ok);
    findings.extend(whole.into_iter().filter(|f| f.verdict == Verdict::Ok || !settled));
    findings.extend(by_silhouettes);
    let mut shown: Vec<Figure> = flagged
        .keys()
        .take(MAX_SHOWN)
        .filter_map(|p| singles.figure(*p, &flagged[p], &matches, small_images))
        .collect();
    findings.extend(doubt);
    findings.extend(singles.finding(&flagged));
    findings.push(singles.power(&matches));
    findings.extend(axes(data, &matches, silhouettes));
    shown.extend(matches.figure(None, small_images));
    (findings, shown)
}

/// A note where camera axes of the other convention would not be told from right ones.
fn axes(data: &Dataset, matches: &Matches<'_>, silhouettes: Option<&Silhouettes>) -> Option<Finding> {
    if matches.tells_axes() || silhouettes.is_some_and(|s| s.tells_axes(data)) {
        return None;
    }
    let what = "whether camera axes are those of the convention that the layout has cannot be told from these images: too few \
                matched corners agree with any poses, and no silhouettes settle it";
    let fix = "look at a short training: under wrong axes (y and z the other way) nothing of the scene appears";
    Some(Finding::new("poses", "poses.axes", Verdict::Note, what).fix(fix))
}

/// What is held against single views.
struct Singles<'a, 'm, 'v> {
    data: &'a Dataset,
    views: &'a Views,
    corners: CornerFit<'m, 'v>,
    hull: Option<(&'a Silhouettes, HullFit<'a>)>,
}

impl Singles<'_, '_, '_> {
    fn name(&self, (split, index): Place) -> &str {
        &self.data.views(split)[index].name
    }

    /// Reasons by view, and a finding where so many are flagged that single views cannot be the fault.
    fn flagged(&self) -> (BTreeMap<Place, Vec<String>>, Option<Finding>) {
        let mut out: BTreeMap<Place, Vec<String>> = BTreeMap::new();
        let by_hull = self.hull.iter().flat_map(|(s, hull)| hull.wrong().into_iter().map(move |wrong| (*s, wrong)));
        for (s, wrong) in by_hull {
            let place = |k: usize| (s.shapes[k].0, s.shapes[k].1.index);
            match wrong {
                Wrong::Exchanged(i, j) => {
                    let [a, b] = [i, j].map(place);
                    out.entry(a).or_default().push(format!("has the pose of {}", self.name(b)));
                    out.entry(b).or_default().push(format!("has the pose of {}", self.name(a)));
                }
                Wrong::Turned(k, by) => {
                    out.entry(place(k)).or_default().push(format!("looks about {by:.0} degrees elsewhere"));
                }
                Wrong::Foreign(k) => {
                    out.entry(place(k)).or_default().push("shows something that the others do not".to_owned());
                }
            }
        }
        let mut wrong = self.corners.wrong();
        // Corners of what moves agree with another pose, too, but such a view fits the hull.
        wrong.elsewhere.retain(|e| self.doubted_by_hull(self.views.0[e.view]));
        if wrong.doubts_all(self.views.0.len()) {
            let what = format!(
                "the corners of {} of {} views agree with other poses than their own: the poses are not those of these images",
                wrong.elsewhere.len(),
                wrong.examined
            );
            let fix = "check that images and poses are in the same order, or reconstruct the poses again";
            return (out, Some(Finding::new("poses", "poses.disagree", Verdict::Problem, what).fix(fix)));
        }
        for Elsewhere { view, shares: [own, other], degrees } in wrong.elsewhere {
            let why = format!(
                "{:.0} % of its corners agree with its pose, {:.0} % with one turned by {degrees:.0} degrees",
                100.0 * own,
                100.0 * other
            );
            out.entry(self.views.0[view]).or_default().push(why);
        }
        (out, None)
    }

    fn doubted_by_hull(&self, place: Place) -> bool {
        let Some((s, hull)) = &self.hull else { return true };
        let shape = s.shapes.iter().position(|(split, h)| (*split, h.index) == place);
        shape.is_none_or(|k| hull.is_doubtful(k))
    }

    fn finding(&self, flagged: &BTreeMap<Place, Vec<String>>) -> Option<Finding> {
        if flagged.is_empty() {
            return None;
        }
        let split = |s: Split| match s {
            Split::Train => "",
            Split::Val => " (validation)",
            Split::Test | Split::Extrapolate => " (test)",
        };
        let places = flagged.iter().map(|(p, why)| format!("{}{}: {}", self.name(*p), split(p.0), why.join(", and ")));
        let what = match flagged.len() {
            1 => "the image of 1 view does not fit its pose".to_owned(),
            n => format!("the images of {n} views do not fit their poses"),
        };
        let fix = "compare the images with the figures; correct these poses, or remove these views from the file";
        Some(Finding::new("poses", "poses.view", Verdict::Problem, what).at(places).fix(fix))
    }

    /// What these checks would find, by faults put into the data's own poses.
    fn power(&self, matches: &Matches<'_>) -> Finding {
        let by_either = |degrees: f64| {
            let hull = self.hull.as_ref().map_or(Found::default(), |(_, h)| h.turns_found(degrees));
            let corners = self.corners.turns_found(degrees);
            if hull.share() > corners.share() { hull } else { corners }
        };
        let turns = TURNS.map(by_either);
        let turned = turns.iter().any(|found| found.share() >= SURE);
        let mut faults: Vec<String> =
            TURNS.iter().zip(turns).map(|(d, found)| found.text(&format!("turned by {d} degrees"))).collect();
        if let Some((_, hull)) = &self.hull {
            faults.push(hull.exchanges_found().text("exchanged for another"));
            faults.push(hull.foreign_found().text("of an image of something else"));
        }
        let focal = matches.focal_found();
        let focal = if focal { "would" } else { "would not" };
        let of = [Split::Train, Split::Val, Split::Test].map(|s| self.data.views(s).len()).iter().sum::<usize>();
        let compared = self.views.0.len().min(self.hull.as_ref().map_or(usize::MAX, |(_, h)| h.count()));
        let compared = if compared < of { format!("; {compared} of {of} views are compared") } else { String::new() };
        let text = format!(
            "a single pose would be found wrong if {}; focal lengths off by a fifth {focal}{compared}",
            faults.join(", ")
        );
        if turned {
            return Finding::new("poses", "poses.power", Verdict::Ok, text);
        }
        Finding::new(
            "poses",
            "poses.unsure",
            Verdict::Note,
            format!("single wrong poses cannot be told from these images: {text}"),
        )
        .fix("look at the report's worst views after a short training: a view whose pose is wrong is among them")
    }

    /// A flagged view against what the others say.
    fn figure(&self, place: Place, why: &[String], matches: &Matches<'_>, small_images: &ImageCache) -> Option<Figure> {
        let caption = |how: &str| format!("{}: {} ({how})", self.name(place), why.join(", and "));
        let of_hull = self.hull.as_ref().map(|(s, _)| *s);
        let shape = of_hull.and_then(|s| Some((s, &s.shapes.iter().find(|(split, h)| (*split, h.index) == place)?.1)));
        if let Some((s, shape)) = shape {
            let image = figures::beside_hull(&shape.image, &s.carved.render(&shape.camera));
            return Some(Figure {
                topic: "poses",
                caption: caption("left the image, right what the others show from its pose"),
                image,
            });
        }
        let view = self.views.0.iter().position(|p| *p == place)?;
        let mut figure = matches.figure(Some(view), small_images)?;
        figure.caption = caption("corners and their partners: red ones disagree with its pose");
        Some(figure)
    }
}

impl Found {
    /// For example `turned by 5 degrees (12 of 12 tried)`.
    fn text(self, what: &str) -> String {
        format!("{what} ({} of {} tried)", self.found, self.tried)
    }
}

impl Matches<'_> {
    fn share(&self, camera: &dyn Fn(&Camera) -> Camera) -> f64 {
        share(self.errors(camera).iter().flatten(), self.tolerance)
    }

    /// Findings on all poses together.
    fn findings(&self, scale: f64, dynamic: bool) -> Vec<Finding> {
        let count = self.count();
        if count < MIN_PAIRS {
            let what =
                format!("only {count} corners have a partner in a neighbouring image: poses cannot be checked by them");
            return vec![Finding::new("poses", "poses.unchecked", Verdict::Note, what)];
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
        if let Some((what, other, fix)) = self.better_reading(now).or_else(|| self.better_focal(&errors)) {
            let code = if what.starts_with("focal") { "poses.focal" } else { "poses.convention" };
            let what = format!("{text}; with {what} it would be {:.0} %", 100.0 * other);
            return vec![Finding::new("poses", code, Verdict::Problem, what).fix(fix)];
        }
        if now >= GOOD_SHARE {
            return vec![Finding::ok("poses", text)];
        }
        let counts: Vec<f64> = self.pairs.iter().map(|p| p.points.len() as f64).collect();
        if now < BAD_SHARE && !dynamic && median(&counts) >= MIN_PAIR_MATCHES as f64 {
            let fix =
                "check at the pair of images below: if lines miss what they should meet, reconstruct the poses again";
            return vec![Finding::new("poses", "poses.disagree", Verdict::Problem, text).fix(fix)];
        }
        let what = format!(
            "{text}; what moves, and what repeats, never agrees: corners say nothing against the poses, and little for them"
        );
        vec![Finding::new("poses", "poses.corners", Verdict::Note, what)]
    }

    /// Another reading of the poses that explains far more: what, its share, and what to do.
    fn better_reading(&self, now: f64) -> Option<(String, f64, String)> {
        let of = PoseReading::ALL.iter().map(|s| (self.share(&|c| s.camera(c)), s));
        let (other, s) = of.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (other >= MIN_OTHER_SHARE && other > READING_GAIN * now)
            .then(|| (format!("poses {}", s.what()), other, s.fix().to_owned()))
    }

    /// Another focal length that explains more, counted match by match (McNemar 1947).
    fn better_focal(&self, errors: &[Vec<f64>]) -> Option<(String, f64, String)> {
        let of = FOCAL_FACTORS.into_iter().map(|f| (self.with_focal(f), f));
        let of = of.map(|(e, f)| (share(e.iter().flatten(), self.tolerance), f, e));
        let (other, f, there) = of.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (other >= MIN_OTHER_SHARE && self.clearly_more(errors, &there)).then(|| {
            let what = format!("focal lengths of {f} times what they are");
            (what, other, "check the focal length, or the field of view and the size of image it belongs to".to_owned())
        })
    }

    fn with_focal(&self, f: f64) -> Vec<Vec<f64>> {
        self.errors(&|c| Camera { fx: f * c.fx, fy: f * c.fy, ..c.clone() })
    }

    /// Whether `there` has clearly more matches that agree than `here`.
    fn clearly_more(&self, here: &[Vec<f64>], there: &[Vec<f64>]) -> bool {
        let [mut won, mut lost, mut kept] = [0.0; 3];
        for (a, b) in here.iter().flatten().zip(there.iter().flatten()) {
            match (*a < self.tolerance, *b < self.tolerance) {
                (false, true) => won += 1.0,
                (true, false) => lost += 1.0,
                (true, true) => kept += 1.0,
                (false, false) => {}
            }
        }
        won - lost > FOCAL_DEVIATIONS * f64::sqrt(won + lost) && won + kept > FOCAL_GAIN * (lost + kept)
    }

    /// Whether camera axes of the other convention would be told as such, the poses being right.
    fn tells_axes(&self) -> bool {
        let [right, flipped] = [self.share(&|c| c.clone()), self.share(&|c| PoseReading::Flipped.camera(c))];
        self.count() >= MIN_PAIRS && right >= MIN_OTHER_SHARE && right > READING_GAIN * flipped
    }

    /// Whether focal lengths a fifth too long or too short would be found.
    fn focal_found(&self) -> bool {
        let right = self.errors(&|c| c.clone());
        share(right.iter().flatten(), self.tolerance) >= MIN_OTHER_SHARE
            && [1.2, 1.0 / 1.2].into_iter().all(|f| self.clearly_more(&self.with_focal(f), &right))
    }

    /// The pair with the most matches, of a view or of all, coloured by whether they agree.
    fn figure(&self, view: Option<usize>, small_images: &ImageCache) -> Option<Figure> {
        let pairs = self.pairs.iter().filter(|m| view.is_none_or(|v| m.views.contains(&v)));
        let best = pairs.max_by_key(|m| m.points.len()).filter(|m| m.points.len() >= 8)?;
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

#[cfg(test)]
mod tests {
    use super::super::matching::Match;
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_data::View;

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
        let matches = Matches::of_points(views.iter().collect(), cameras, pairs);
        matches.findings(1.0, false).remove(0)
    }

    #[test]
    fn mistakes_are_told_by_their_kind() {
        assert_eq!(finding(|_, c| c.clone()).verdict, Verdict::Ok);
        let focal = finding(|_, c| Camera { fx: c.fx / 1.7, fy: c.fy / 1.7, ..c.clone() });
        assert!(focal.code == "poses.focal" && focal.what.contains("1.7 times"), "{focal:?}");
        for s in PoseReading::ALL {
            assert_eq!(finding(|_, c| s.camera(c)).code, "poses.convention", "{s:?}");
        }
    }

    #[test]
    fn a_view_that_its_matches_place_elsewhere_is_told() {
        let turned = |degrees: f64| DMat3::from_rotation_y(degrees.to_radians());
        let mistake = |k: usize, c: &Camera| {
            let turned = turned(6.0);
            let there = Camera { rotation: turned * c.rotation, translation: turned * c.translation, ..c.clone() };
            if k == 2 { there } else { c.clone() }
        };
        let (views, cameras, pairs) = seen(mistake);
        let matches = Matches::of_points(views.iter().collect(), cameras, pairs);
        let fit = CornerFit::new(&matches, DVec3::new(0.0, 0.3, 0.4), false);
        let wrong = fit.wrong_among(&|i| matches.of_view(i));
        assert_eq!(wrong.iter().map(|w| w.view).collect::<Vec<_>>(), [2]);
        assert!(wrong[0].shares[1] > 0.95 && (wrong[0].degrees - 6.0).abs() < 0.1, "{wrong:?}");
    }
}
