//! Checks of times: their source, gaps, two images of one camera at one time, frozen cameras.

use super::images::{Fingerprint, ImageChecks};
use super::{Finding, Verdict, in_step, median};
use gs_data::{Dataset, Split, View, moments};
use std::collections::BTreeMap;

/// A step between consecutive times above this multiple of the median step is reported as a gap.
const MAX_GAP: f64 = 3.0;
/// Times closer than this are equal, normalised.
const TIME_TOLERANCE: f32 = 1e-6;
/// Share of identical consecutive images above which a camera counts as frozen.
const FROZEN_SHARE: f64 = 0.5;

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
    let (late, power) = in_step::check(data, checked);
    let mut out: Vec<Finding> =
        [gaps(&moments_of(data)), at_once(data), frozen(&strips(data, checked)), late, outside(data)]
            .into_iter()
            .flatten()
            .collect();
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

/// The different moments of training, with the data's own time of one of their images each; cameras that are not quite together show one.
fn moments_of(data: &Dataset) -> Vec<(f32, f64)> {
    let seconds = data.train.iter().map(|v| v.time.seconds);
    let mut moments: Vec<(f32, f64)> = moments::of_views(&data.train).into_iter().zip(seconds).collect();
    moments.sort_by(|a, b| a.0.total_cmp(&b.0));
    moments.dedup_by(|b, a| b.0 - a.0 < TIME_TOLERANCE);
    moments
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
}

/// The strips of all positions with at least four images.
fn strips<'a>(data: &'a Dataset, checked: &'a ImageChecks) -> Vec<Strip<'a>> {
    let mut of_place: BTreeMap<[u64; 3], Vec<Fingerprint>> = BTreeMap::new();
    for print in checked.fingerprints(data) {
        of_place.entry(print.view.camera.position().to_array().map(f64::to_bits)).or_default().push(print);
    }
    let strip = |mut list: Vec<Fingerprint<'a>>| {
        list.sort_by(|a, b| a.view.time.normalised.total_cmp(&b.view.time.normalised));
        Strip { views: list.iter().map(|p| p.view).collect(), hashes: list.iter().map(|p| p.hash).collect() }
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
