//! Times: where they come from, whether they are even, whether a camera took two pictures at once, whether one runs late.

use super::images::{Looked, Print};
use super::{Finding, Verdict, median};
use gs_data::{Dataset, Split, View};
use std::collections::BTreeMap;

/// A gap between moments is told above so many times the usual one.
const GAP: f64 = 3.0;
/// Times nearer than this are one moment, normalised.
const SAME: f32 = 1e-6;
/// Cameras with frozen pictures: this part of successive ones is the same.
const FROZEN: f64 = 0.5;
/// Cameras and steps between moments from which a camera that runs late can be told, and the moments it may be off.
const CAMERAS: usize = 4;
const MOMENTS: usize = 12;
const LAGS: isize = 4;
/// Least correlation with the other cameras when shifted, and how much larger it must be than unshifted.
const LIKE: f64 = 0.7;
const CLEARLY: f64 = 0.3;

/// Looks at times.
pub(super) fn look(data: &Dataset, looked: &Looked) -> Vec<Finding> {
    let mut moments: Vec<(f32, f64)> = data.train.iter().map(|v| (v.time.normalised, v.time.seconds)).collect();
    moments.sort_by(|a, b| a.0.total_cmp(&b.0));
    moments.dedup_by(|b, a| b.0 - a.0 < SAME);
    if !data.dynamic {
        let what = format!("{}; a method for moving scenes has nothing to move", data.time_source);
        let finding = Finding::new("time", "time.static", Verdict::Note, what);
        return vec![finding.fix("gs4d train DATA -m static3d, or give times: --set data.time_from=name")];
    }
    let strips = strips(data, looked);
    let mut out: Vec<Finding> =
        [gaps(&moments), at_once(data), frozen(&strips), late(&strips), outside(data)].into_iter().flatten().collect();
    let (first, last) = (moments[0].1, moments[moments.len() - 1].1);
    let text = format!("{}: {} moments of training from {first} to {last}", data.time_source, moments.len());
    if data.time_source.contains("order of file names") {
        let what = format!("{text}; the order of names is an assumption about the capture");
        out.insert(0, Finding::new("time", "time.assumed", Verdict::Note, what));
    } else if out.is_empty() {
        out.push(Finding::ok("time", text));
    }
    out
}

/// Moments that are missing.
fn gaps(moments: &[(f32, f64)]) -> Option<Finding> {
    let steps: Vec<f64> = moments.windows(2).map(|w| f64::from(w[1].0 - w[0].0)).collect();
    let usual = median(&steps);
    let wide = || moments.windows(2).zip(&steps).filter(|(_, s)| **s > GAP * usual);
    (moments.len() >= 8 && wide().next().is_some()).then(|| {
        let places = wide().map(|(w, s)| format!("{} to {} ({:.1} steps)", w[0].1, w[1].1, s / usual));
        let what = format!("{} gaps between training moments are more than {GAP} times the usual step", wide().count());
        Finding::new("time", "time.gap", Verdict::Warning, what)
            .at(places)
            .fix("nothing holds the scene in a gap: add views there, or expect guesses")
    })
}

/// Two pictures of one camera place at one moment.
fn at_once(data: &Dataset) -> Option<Finding> {
    let mut seen: BTreeMap<(u32, [u64; 3], u32), Vec<&str>> = BTreeMap::new();
    for v in &data.train {
        let place = v.camera.position().to_array().map(f64::to_bits);
        seen.entry((v.time.normalised.to_bits(), place, v.camera_id)).or_default().push(&v.name);
    }
    let pairs: Vec<String> = seen.values().filter(|l| l.len() > 1).map(|l| l.join(" = ")).collect();
    (!pairs.is_empty()).then(|| {
        let what = format!(
            "{} times a camera took two pictures at one moment: one of them has a wrong time or pose",
            pairs.len()
        );
        Finding::new("time", "time.twice", Verdict::Problem, what).at(pairs).fix("correct the times")
    })
}

/// The pictures of one place, in order of time.
struct Strip<'a> {
    views: Vec<&'a View>,
    hashes: Vec<u64>,
    thumbs: Vec<&'a [f32]>,
}

/// Strips of all places from which several pictures were taken.
fn strips<'a>(data: &'a Dataset, looked: &'a Looked) -> Vec<Strip<'a>> {
    let mut of_place: BTreeMap<[u64; 3], Vec<Print>> = BTreeMap::new();
    for print in looked.prints(data) {
        of_place.entry(print.view.camera.position().to_array().map(f64::to_bits)).or_default().push(print);
    }
    let strip = |mut list: Vec<Print<'a>>| {
        list.sort_by(|a, b| a.view.time.normalised.total_cmp(&b.view.time.normalised));
        Strip {
            views: list.iter().map(|p| p.view).collect(),
            hashes: list.iter().map(|p| p.hash).collect(),
            thumbs: list.iter().map(|p| p.thumb).collect(),
        }
    };
    of_place.into_values().filter(|l| l.len() >= 4).map(strip).collect()
}

/// Cameras whose pictures do not change while time passes.
fn frozen(strips: &[Strip<'_>]) -> Option<Finding> {
    let still = |s: &&Strip<'_>| {
        let same = s.hashes.windows(2).filter(|w| w[0] == w[1]).count();
        same as f64 > FROZEN * (s.hashes.len() - 1) as f64
    };
    let names: Vec<&str> = strips.iter().filter(still).map(|s| s.views[0].name.as_str()).collect();
    (!names.is_empty()).then(|| {
        let what = format!(
            "the pictures of {} cameras hardly change while time passes (each named by its first view)",
            names.len()
        );
        Finding::new("time", "time.frozen", Verdict::Warning, what).at(names).fix("check how the frames were extracted")
    })
}

/// Cameras that see what the others see, but some moments earlier or later.
fn late(strips: &[Strip<'_>]) -> Option<Finding> {
    let times = |s: &Strip<'_>| s.views.iter().map(|v| v.time.normalised.to_bits()).collect::<Vec<_>>();
    let first = strips.first().map(times)?;
    let together: Vec<&Strip<'_>> = strips.iter().filter(|s| times(s) == first).collect();
    let changes: Vec<Vec<f64>> = together.iter().map(|s| changes(&s.thumbs)).collect();
    let name = |(k, lag): (usize, isize)| format!("{} ({lag:+} moments)", together[k].views[0].name);
    let names: Vec<String> = lags(&changes).into_iter().map(name).collect();
    (!names.is_empty()).then(|| {
        let what = format!("{} cameras seem to run early or late (each named by its first view)", names.len());
        let fix = "shift their times by that many moments, and look again";
        Finding::new("time", "time.late", Verdict::Warning, what).at(names).fix(fix)
    })
}

/// How much a picture changes from each moment to the next, less the mean, of length 1.
fn changes(thumbs: &[&[f32]]) -> Vec<f64> {
    let change = |w: &[&[f32]]| w[0].iter().zip(w[1]).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
    normal(thumbs.windows(2).map(change).collect())
}

fn normal(mut values: Vec<f64>) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter_mut().for_each(|v| *v -= mean);
    let length = values.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
    values.iter_mut().for_each(|v| *v /= length);
    values
}

/// Rows that are like the mean of the others only when shifted, and by how much: positive is late.
fn lags(changes: &[Vec<f64>]) -> Vec<(usize, isize)> {
    let n = changes.first().map_or(0, Vec::len);
    if changes.len() < CAMERAS || n < MOMENTS {
        return Vec::new();
    }
    let others = |k: usize| {
        let sum = |i: usize| changes.iter().enumerate().filter(|(j, _)| *j != k).map(|(_, c)| c[i]).sum();
        normal((0..n).map(sum).collect())
    };
    let alike = |own: &[f64], others: &[f64], lag: isize| {
        let both = (0..n as isize).filter(|i| (0..n as isize).contains(&(i - lag)));
        let pair = both.map(|i| (own[i as usize], others[(i - lag) as usize]));
        let (mine, theirs): (Vec<f64>, Vec<f64>) = pair.unzip();
        normal(mine).iter().zip(normal(theirs)).map(|(a, b)| a * b).sum::<f64>()
    };
    let of = |k: usize| {
        let others = others(k);
        let at = |lag: isize| alike(&changes[k], &others, lag);
        let best = (-LAGS..=LAGS).max_by(|a, b| at(*a).total_cmp(&at(*b)))?;
        (best != 0 && at(best) > LIKE && at(best) > at(0) + CLEARLY).then_some((k, best))
    };
    (0..changes.len()).filter_map(of).collect()
}

/// Held-out views that lie outside the training span without being meant to.
fn outside(data: &Dataset) -> Option<Finding> {
    let last = data.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max);
    let late = |v: &&View| v.time.normalised > last + SAME || v.time.normalised < -SAME;
    let names: Vec<&str> =
        [Split::Val, Split::Test].iter().flat_map(|&s| data.views(s)).filter(late).map(|v| v.name.as_str()).collect();
    (!names.is_empty()).then(|| {
        let what = format!(
            "{} held-out views lie outside the training span: their scores would be of extrapolation",
            names.len()
        );
        let fix = "--set data.time_boundary=SHARE keeps them apart, and scores them as the future";
        Finding::new("time", "time.outside", Verdict::Warning, what).at(names).fix(fix)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_camera_is_told_from_its_fellows() {
        let bursts = |lag: isize| {
            let at = |i: isize| {
                (-(((i - lag - 9) as f64) / 1.5).powi(2)).exp() + 0.6 * (-(((i - lag - 20) as f64) / 2.0).powi(2)).exp()
            };
            normal((0..30).map(at).collect())
        };
        let mut rows = vec![bursts(0); 6];
        assert!(lags(&rows).is_empty());
        rows[2] = bursts(3);
        rows[5] = bursts(-2);
        assert_eq!(lags(&rows), [(2, 3), (5, -2)]);
        assert!(lags(&rows[..3]).is_empty(), "too few cameras");
        assert!(lags(&vec![normal(vec![1.0; 30]); 6]).is_empty(), "nothing changes");
    }
}
