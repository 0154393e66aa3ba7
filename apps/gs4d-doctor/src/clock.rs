//! Checks of times: their source, gaps, two images of one camera at one time, frozen cameras, cameras whose clock is off.

use super::images::{Fingerprint, ImageChecks};
use super::{Finding, Setting, Verdict, median};
use gs_data::{Dataset, Split, TimeShift, View};
use std::collections::BTreeMap;

/// A step between consecutive times above this multiple of the median step is reported as a gap.
const MAX_GAP: f64 = 3.0;
/// Times closer than this are equal, normalised.
const TIME_TOLERANCE: f32 = 1e-6;
/// Share of identical consecutive images above which a camera counts as frozen.
const FROZEN_SHARE: f64 = 0.5;
/// Fewest cameras and time steps for the search of clock offsets; the largest offset that is told, and that is tried, in time steps.
const MIN_CAMERAS: usize = 4;
const MIN_TIMES: usize = 16;
const MAX_LAG: isize = 4;
const TRIED_LAG: isize = 7;
/// Least correlation with the other cameras at the best offset, and its least gain over that without offset, in all and in
/// each half of the sequence; and over any offset that is not beside the best one.
const MIN_CORRELATION: f64 = 0.7;
const MIN_GAIN: f64 = 0.3;
const MIN_HALF_GAIN: f64 = 0.15;
const MIN_LEAD: f64 = 0.1;
/// Share of the cameras whose shift must be found before any is flagged.
const SURE: f64 = 0.9;
/// Cameras that run late must be fewer than this share: the others say what the time is.
const MAX_LATE: f64 = 0.34;

/// Checks times.
pub(super) fn check(data: &Dataset, checked: &ImageChecks) -> Vec<Finding> {
    let mut times: Vec<(f32, f64)> = data.train.iter().map(|v| (v.time.normalised, v.time.seconds)).collect();
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    times.dedup_by(|b, a| b.0 - a.0 < TIME_TOLERANCE);
    if !data.dynamic {
        let what = format!("{}; a method for moving scenes has nothing to move", data.time_source);
        let finding = Finding::new("time", "time.static", Verdict::Note, what);
        return vec![finding.fix("gs4d train DATA -m static3d, or give times: --set data.time_from=name")];
    }
    let strips = strips(data, checked);
    let (late, power) = Clocks::of(&strips).map_or((None, None), |c| c.findings());
    let mut out: Vec<Finding> =
        [gaps(&times), at_once(data), frozen(&strips), late, outside(data)].into_iter().flatten().collect();
    let (first, last) = (times[0].1, times[times.len() - 1].1);
    let text = format!("{}: {} training times from {first} to {last}", data.time_source, times.len());
    if data.time_source.contains("order of file names") {
        let what = format!("{text}; the order of names is an assumption about the capture");
        out.insert(0, Finding::new("time", "time.assumed", Verdict::Note, what));
    } else if out.is_empty() {
        out.push(Finding::ok("time", text));
    }
    out.extend(power);
    out
}

/// Steps between training times that are much longer than usual.
fn gaps(times: &[(f32, f64)]) -> Option<Finding> {
    let steps: Vec<f64> = times.windows(2).map(|w| f64::from(w[1].0 - w[0].0)).collect();
    let usual = median(&steps);
    let wide = || times.windows(2).zip(&steps).filter(|(_, s)| **s > MAX_GAP * usual);
    (times.len() >= 8 && wide().next().is_some()).then(|| {
        let places = wide().map(|(w, s)| format!("{} to {} ({:.1} steps)", w[0].1, w[1].1, s / usual));
        let what =
            format!("{} gaps between training times are more than {MAX_GAP} times the usual step", wide().count());
        Finding::new("time", "time.gap", Verdict::Warning, what)
            .at(places)
            .fix("nothing holds the scene in a gap: add views there, or expect guesses")
    })
}

/// Several images of one camera position at one time.
fn at_once(data: &Dataset) -> Option<Finding> {
    let mut seen: BTreeMap<(u32, [u64; 3], u32), Vec<&str>> = BTreeMap::new();
    for v in &data.train {
        let place = v.camera.position().to_array().map(f64::to_bits);
        seen.entry((v.time.normalised.to_bits(), place, v.camera_id)).or_default().push(&v.name);
    }
    let pairs: Vec<String> = seen.values().filter(|l| l.len() > 1).map(|l| l.join(" = ")).collect();
    (!pairs.is_empty()).then(|| {
        let what =
            format!("{} times a camera took two images at one time: one of them has a wrong time or pose", pairs.len());
        Finding::new("time", "time.twice", Verdict::Problem, what).at(pairs).fix("correct the times")
    })
}

/// The images of one camera position, in order of time.
struct Strip<'a> {
    views: Vec<&'a View>,
    hashes: Vec<u64>,
    thumbs: Vec<&'a [f32]>,
}

/// The strips of all positions with at least four images.
fn strips<'a>(data: &'a Dataset, checked: &'a ImageChecks) -> Vec<Strip<'a>> {
    let mut of_place: BTreeMap<[u64; 3], Vec<Fingerprint>> = BTreeMap::new();
    for print in checked.fingerprints(data) {
        of_place.entry(print.view.camera.position().to_array().map(f64::to_bits)).or_default().push(print);
    }
    let strip = |mut list: Vec<Fingerprint<'a>>| {
        list.sort_by(|a, b| a.view.time.normalised.total_cmp(&b.view.time.normalised));
        Strip {
            views: list.iter().map(|p| p.view).collect(),
            hashes: list.iter().map(|p| p.hash).collect(),
            thumbs: list.iter().map(|p| p.thumb).collect(),
        }
    };
    of_place.into_values().filter(|l| l.len() >= 4).map(strip).collect()
}

/// Cameras whose images do not change over time.
fn frozen(strips: &[Strip<'_>]) -> Option<Finding> {
    let still = |s: &&Strip<'_>| {
        let same = s.hashes.windows(2).filter(|w| w[0] == w[1]).count();
        same as f64 > FROZEN_SHARE * (s.hashes.len() - 1) as f64
    };
    let names: Vec<&str> = strips.iter().filter(still).map(|s| s.views[0].name.as_str()).collect();
    (!names.is_empty()).then(|| {
        let what = format!(
            "the images of {} cameras hardly change while time passes (each named by its first view)",
            names.len()
        );
        Finding::new("time", "time.frozen", Verdict::Warning, what).at(names).fix("check how the frames were extracted")
    })
}

/// How much the images of cameras change over the same time steps.
struct Clocks<'a> {
    views: Vec<&'a View>,
    changes: Vec<Vec<f64>>,
}

impl<'a> Clocks<'a> {
    /// The cameras that have the times of the first one; none of too few cameras or times.
    fn of(strips: &[Strip<'a>]) -> Option<Self> {
        let times = |s: &Strip<'_>| s.views.iter().map(|v| v.time.normalised.to_bits()).collect::<Vec<_>>();
        let first = strips.first().map(times)?;
        let together: Vec<&Strip<'_>> = strips.iter().filter(|s| times(s) == first).collect();
        let changes: Vec<Vec<f64>> = together.iter().map(|s| changes(&s.thumbs)).collect();
        let enough = changes.len() >= MIN_CAMERAS && changes[0].len() + 1 >= MIN_TIMES;
        enough.then(|| Self { views: together.iter().map(|s| s.views[0]).collect(), changes })
    }

    /// Cameras that see the same changes as the others, some time steps earlier or later, and what the check can find. None is
    /// flagged where it would find few of the shifts that are put into the data's own times.
    fn findings(&self) -> (Option<Finding>, Option<Finding>) {
        let late = lags(&self.changes);
        let sound: Vec<usize> = (0..self.changes.len()).filter(|k| late.iter().all(|l| l.0 != *k)).collect();
        let tried = |lag: isize| sound.iter().filter(|k| self.found(**k, lag)).count();
        let (n, counts) = (sound.len(), [-4, -2, 2, 4].map(tried));
        let text = format!(
            "a camera 2 moments late or early would be found in {} of {} tries, 4 moments in {} of {}",
            counts[1] + counts[2],
            2 * n,
            counts[0] + counts[3],
            2 * n
        );
        let few = late.len() as f64 <= MAX_LATE * self.changes.len() as f64;
        if !(few && counts.iter().sum::<usize>() as f64 >= SURE * (4 * n) as f64) {
            let what = format!("whether cameras run in step cannot be told from these images: {text}");
            let unsure = Finding::new("time", "time.unsure", Verdict::Note, what);
            let fix = "if cameras were not triggered together, hold a clap or a flash against their frames";
            return (None, Some(unsure.fix(fix)));
        }
        let power = Finding::new("time", "time.power", Verdict::Ok, text);
        let name = |&(k, lag): &(usize, isize)| {
            let v = self.views[k];
            format!("camera {} ({}): {lag:+} moments", v.camera_id, v.name)
        };
        let shift = |&(k, lag): &(usize, isize)| Some((self.views[k].camera_id, i32::try_from(-lag).ok()?));
        let finding = (!late.is_empty()).then(|| {
            let shift = TimeShift(late.iter().filter_map(shift).collect());
            let what = format!("{} cameras run early or late (each named by its first view)", late.len());
            let fix = format!("--set data.time_shift={shift}");
            let finding = Finding::new("time", "time.late", Verdict::Warning, what).at(late.iter().map(name)).fix(fix);
            finding.setting(Some(Setting::Shift(shift)))
        });
        (finding, Some(power))
    }

    /// Whether a shift of a camera by so many steps would be found.
    fn found(&self, k: usize, lag: isize) -> bool {
        let mut changes = self.changes.clone();
        changes[k] = shifted(&changes[k], lag);
        lag_of(&changes, k) == Some(lag)
    }
}

/// A row of changes as a camera sees them that runs `lag` steps late; what it saw before is that of its first step.
fn shifted(changes: &[f64], lag: isize) -> Vec<f64> {
    let n = changes.len() as isize;
    normal((0..n).map(|i| changes[(i - lag).clamp(0, n - 1) as usize]).collect())
}

/// Change from each image to the next, brought to mean 0 and length 1.
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

/// Rows that correlate with the others only at an offset, and that offset in steps: positive is late.
fn lags(changes: &[Vec<f64>]) -> Vec<(usize, isize)> {
    (0..changes.len()).filter_map(|k| lag_of(changes, k).map(|lag| (k, lag))).collect()
}

/// The offset of a row, where all of it and both of its halves tell.
fn lag_of(changes: &[Vec<f64>], k: usize) -> Option<isize> {
    let n = changes[k].len();
    // The median of the others: one more may be late.
    let others: Vec<f64> = (0..n)
        .map(|i| median(&changes.iter().enumerate().filter(|(j, _)| *j != k).map(|(_, c)| c[i]).collect::<Vec<_>>()))
        .collect();
    let own = &changes[k];
    let at = |range: std::ops::Range<usize>, lag: isize| {
        let pairs = range.filter_map(|i| Some((own[i], *others.get(i.checked_add_signed(-lag)?)?)));
        let (mine, theirs): (Vec<f64>, Vec<f64>) = pairs.unzip();
        normal(mine).iter().zip(normal(theirs)).map(|(a, b)| a * b).sum::<f64>()
    };
    let whole = |lag: isize| at(0..n, lag);
    let best = (-TRIED_LAG..=TRIED_LAG).max_by(|a, b| whole(*a).total_cmp(&whole(*b)))?;
    let peak = whole(best);
    let lead = (-TRIED_LAG..=TRIED_LAG).filter(|l| (l - best).abs() > 1).all(|l| whole(l) < peak - MIN_LEAD);
    let halves = [0..n / 2, n / 2..n].into_iter().all(|half| at(half.clone(), best) > at(half, 0) + MIN_HALF_GAIN);
    let told = best != 0 && best.abs() <= MAX_LAG && peak > MIN_CORRELATION && peak > whole(0) + MIN_GAIN;
    (told && lead && halves).then_some(best)
}

/// Validation and test views outside the training span.
fn outside(data: &Dataset) -> Option<Finding> {
    let last = data.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max);
    let late = |v: &&View| v.time.normalised > last + TIME_TOLERANCE || v.time.normalised < -TIME_TOLERANCE;
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
        assert!(lags(&vec![normal(vec![1.0; 30]); 6]).is_empty(), "nothing changes");
    }
}
