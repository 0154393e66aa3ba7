//! Times: where they come from, whether they are even, whether a camera took two pictures at once, whether one runs late.

use super::images::Looked;
use super::silhouettes::median;
use super::{Finding, Verdict};
use crate::data::{Dataset, Split, View};
use std::collections::BTreeMap;

/// A gap between moments is told above so many times the usual one.
const GAP: f64 = 3.0;
/// Times nearer than this are one moment, normalised.
const SAME: f32 = 1e-6;
/// Cameras with frozen pictures: this part of successive ones is the same.
const FROZEN: f64 = 0.5;

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
    let mut out: Vec<Finding> =
        [gaps(&moments), at_once(data), frozen(data, looked), outside(data)].into_iter().flatten().collect();
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

/// Cameras whose pictures do not change while time passes.
fn frozen(data: &Dataset, looked: &Looked) -> Option<Finding> {
    let mut of_camera: BTreeMap<[u64; 3], Vec<(&View, u64)>> = BTreeMap::new();
    for (v, hash) in looked.hashes(data) {
        of_camera.entry(v.camera.position().to_array().map(f64::to_bits)).or_default().push((v, hash));
    }
    let still = |list: &mut Vec<(&View, u64)>| {
        list.sort_by(|a, b| a.0.time.normalised.total_cmp(&b.0.time.normalised));
        let same = list.windows(2).filter(|w| w[0].1 == w[1].1).count();
        list.len() >= 4 && same as f64 > FROZEN * (list.len() - 1) as f64
    };
    let names: Vec<String> = of_camera.values_mut().filter_map(|l| still(l).then(|| l[0].0.name.clone())).collect();
    (!names.is_empty()).then(|| {
        let what = format!(
            "the pictures of {} cameras hardly change while time passes (each named by its first view)",
            names.len()
        );
        Finding::new("time", "time.frozen", Verdict::Warning, what).at(names).fix("check how the frames were extracted")
    })
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
