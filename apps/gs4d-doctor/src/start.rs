//! Checks of the initial points and of the scene box.

use super::{Finding, Verdict};
use glam::Vec3;
use gs_data::{Dataset, StartFrom};

/// Share of points in the frame of training views: above the first points are good, below the second they are wrong.
const GOOD_SHARE: f64 = 0.9;
const BAD_SHARE: f64 = 0.5;
/// Largest share of points outside the box that is not reported.
const MAX_OUTSIDE: f64 = 0.02;
/// Fewest points to start training from.
const MIN_POINTS: usize = 50;

/// Checks points and box.
pub(super) fn check(data: &Dataset) -> Vec<Finding> {
    let mut out = vec![points(data)];
    out.push(bound(data));
    out
}

fn points(data: &Dataset) -> Finding {
    let init = format!("gs4d init {}", data.root.display());
    let Some(points) = data.points.as_ref().filter(|p| !p.positions.is_empty()) else {
        let sources = StartFrom::ALL.iter().filter(|f| **f != StartFrom::Random);
        let found = sources.clone().find(|f| data.start(Some(**f), 200, 0).is_ok());
        return match found {
            Some(StartFrom::Hull) => Finding::ok("init", "no points; the visual hull of alpha or masks gives them"),
            Some(from) => {
                let what = format!("no points; {} gives some", from.name());
                Finding::new("init", "init.missing", Verdict::Warning, what)
                    .fix(format!("{init} --from {}", from.name()))
            }
            None => {
                let what = "no points, no depth, no silhouettes: training begins with random points in the box";
                Finding::new("init", "init.random", Verdict::Warning, what)
                    .fix(format!("reconstruct points with COLMAP, or {init} --from random --bound SIDE"))
            }
        };
    };
    let (count, seen) = (points.positions.len(), data.seen_share(&points.positions));
    let text = format!("{count} points, {:.0} % of them in the frame of two training views", 100.0 * seen);
    if seen < BAD_SHARE {
        let what = format!("{text}: they are in another frame or scale than the poses");
        let fix = format!("export points and poses together; or begin without them: {init} --from random");
        return Finding::new("init", "init.frame", Verdict::Problem, what).fix(fix);
    }
    if count < MIN_POINTS {
        return Finding::new("init", "init.few", Verdict::Warning, text).fix(format!("{init} --points 20000"));
    }
    if seen < GOOD_SHARE {
        let what = format!("{text}; the others begin unseen");
        return Finding::new("init", "init.unseen", Verdict::Note, what);
    }
    Finding::ok("init", text)
}

fn bound(data: &Dataset) -> Finding {
    let [low, high] = data.scene_bounds();
    let inside = |p: &Vec3| p.cmpge(low).all() && p.cmple(high).all();
    let size = high - low;
    let text = format!("{low:.2} to {high:.2}");
    let points = data.points.as_ref().map_or(&[][..], |p| &p.positions);
    let out = points.iter().filter(|p| !inside(p)).count() as f64 / points.len().max(1) as f64;
    let largest = points.iter().map(|p| p.abs().max_element()).fold(0.0, f32::max);
    if out > MAX_OUTSIDE {
        let what = format!("{:.0} % of the points lie outside the box {text}", 100.0 * out);
        let fix = format!(
            "gs4d init {} --bound {:.2} (the farthest point is {largest:.2} from the origin)",
            data.root.display(),
            1.05 * largest
        );
        return Finding::new("bound", "bound.points", Verdict::Warning, what).fix(fix);
    }
    if !seen(data, 0.5 * (low + high)) {
        let what = format!("no training view looks at the middle of the box {text}");
        let fix = format!("gs4d init {} --bound SIDE, or recentre the poses", data.root.display());
        return Finding::new("bound", "bound.unseen", Verdict::Problem, what).fix(fix);
    }
    if size.max_element() > 100.0 * size.min_element() {
        return Finding::new("bound", "bound.flat", Verdict::Note, format!("{text}: a very flat box"));
    }
    Finding::ok("bound", text)
}

/// Whether training views have a point in their frame.
fn seen(data: &Dataset, p: Vec3) -> bool {
    data.seen_share(&[p]) > 0.0
}
