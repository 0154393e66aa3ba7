//! Checks of the initial points and of the scene box.

use super::silhouettes::Silhouettes;
use super::{Finding, Verdict};
use glam::Vec3;
use gs_data::{Dataset, StartFrom, shell_quoted};

/// Share of points in the frame of training views: above the first points are good, below the second they are wrong.
const GOOD_SHARE: f64 = 0.9;
const BAD_SHARE: f64 = 0.5;
/// Largest share of points outside the box that is not reported.
const MAX_OUTSIDE: f64 = 0.02;
/// Share of the box in the frame of two training views below which it lies elsewhere, and the cells of a side that tell it.
const LEAST_SEEN: f64 = 0.02;
const CELLS: usize = 5;
/// Fewest points to start training from.
const MIN_POINTS: usize = 50;

/// Checks points and box; `silhouettes` are those of the data.
pub(super) fn check(data: &Dataset, silhouettes: Option<&Silhouettes>) -> Vec<Finding> {
    vec![points(data, silhouettes), bound(data)]
}

fn points(data: &Dataset, silhouettes: Option<&Silhouettes>) -> Finding {
    let init = init(data);
    let Some(points) = data.points.as_ref().filter(|p| !p.positions.is_empty()) else {
        let sources = StartFrom::ALL.iter().filter(|f| **f != StartFrom::Random);
        let gives = |from: StartFrom| match (from, silhouettes) {
            (StartFrom::Hull, Some(s)) => s.carved.gives_points(data),
            _ => data.start(Some(from), 200, 0).is_ok(),
        };
        let found = sources.clone().find(|f| gives(**f));
        return match found {
            Some(StartFrom::Hull) => Finding::ok("init", "no points; the visual hull of alpha or masks gives them"),
            Some(from) => {
                let what = format!("no points; {} gives some", from.name());
                Finding::new("init", "init.missing", Verdict::Warning, what)
                    .fix(format!("{init} --from {}", from.name()))
            }
            None => {
                let what = "no points, no depth, no silhouettes: training begins with random points in the box";
                Finding::new("init", "init.random", Verdict::Warning, what).fix(format!(
                    "reconstruct points with COLMAP, or {init} --from random --bound HALF (half of its side)"
                ))
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
        return Finding::new("init", "init.few", Verdict::Warning, text)
            .fix(format!("{init} --from random, or --from hull where there are silhouettes"));
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
    // A box that is not given leaves out the farthest points, as it should.
    if data.bounds.is_some() && out > MAX_OUTSIDE {
        let what = format!("{:.0} % of the points lie outside the box {text}", 100.0 * out);
        let mut far: Vec<f32> = points.iter().map(|p| p.abs().max_element()).collect();
        far.sort_by(f32::total_cmp);
        let most = far[(far.len() * 99) / 100];
        let fix = format!("{} --bound {:.2} (99 % of the points lie in it)", init(data), 1.05 * most);
        return Finding::new("bound", "bound.points", Verdict::Warning, what).fix(fix);
    }
    if seen(data, [low, high]) < LEAST_SEEN {
        let what = format!("hardly any of the box {text} is in the frame of two training views");
        let fix = format!("{} --bound HALF (half of its side), or recentre the poses", init(data));
        return Finding::new("bound", "bound.unseen", Verdict::Problem, what).fix(fix);
    }
    if size.max_element() > 100.0 * size.min_element() {
        return Finding::new("bound", "bound.flat", Verdict::Note, format!("{text}: a very flat box"));
    }
    Finding::ok("bound", text)
}

/// Share of a box that two training views have in their frames, by the middles of its cells.
fn seen(data: &Dataset, [low, high]: [Vec3; 2]) -> f64 {
    let at = |k: usize| (k as f32 + 0.5) / CELLS as f32;
    let cell = |k: usize| low + (high - low) * Vec3::new(at(k % CELLS), at(k / CELLS % CELLS), at(k / CELLS / CELLS));
    data.seen_share(&(0..CELLS * CELLS * CELLS).map(cell).collect::<Vec<_>>())
}

/// The command that gives other points or another box; over points that are there already.
fn init(data: &Dataset) -> String {
    let force =
        if gs_data::has_start_points(&data.root).unwrap_or(false) || data.bounds.is_some() { " -f" } else { "" };
    format!("gs4d init {}{force}", shell_quoted(data.root.display().to_string()))
}
