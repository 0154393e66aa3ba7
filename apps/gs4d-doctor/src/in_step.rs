//! Whether cameras at rest run in step: each sees the others' changes, some moments earlier or later if its clock is off.
//!
//! Of many images a sample is read, in which consecutive moments are rare: then the images of a window of moments are read.

use super::images::ImageChecks;
use super::{Finding, Setting, Verdict, median};
use gs_core::Camera;
use gs_data::{Dataset, Split, TimeShift, View};
use std::collections::BTreeMap;
use std::ops::Range;

/// Fewest images of a camera at rest.
const MIN_IMAGES: usize = 4;
/// Most images, and pixels of all of them, that are read in addition to a sample.
const MAX_IMAGES: usize = 1500;
const MAX_PIXELS: usize = 3_000_000_000;
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
/// What to do where images do not tell.
const CLAP: &str = "if cameras were not triggered together, hold a clap or a flash against their frames";

/// Cameras at rest that have images of the same moments.
struct Rig {
    /// Split and index of the views of each camera, in order of time.
    cameras: Vec<Vec<Place>>,
}

/// Split and index of a view.
type Place = (Split, usize);

impl Rig {
    /// The cameras whose moments most of them have; none of fewer than two.
    fn of(data: &Dataset) -> Option<Self> {
        let mut at_rest: BTreeMap<[u64; 3], Vec<Place>> = BTreeMap::new();
        for split in Split::ALL {
            for (i, v) in data.views(split).iter().enumerate() {
                at_rest.entry(v.camera.position().to_array().map(f64::to_bits)).or_default().push((split, i));
            }
        }
        let time = |&(split, i): &Place| data.views(split)[i].time.normalised;
        let mut of_times: BTreeMap<Vec<u32>, Vec<Vec<Place>>> = BTreeMap::new();
        for mut places in at_rest.into_values().filter(|p| p.len() >= MIN_IMAGES) {
            places.sort_by(|a, b| time(a).total_cmp(&time(b)));
            of_times.entry(places.iter().map(|p| time(p).to_bits()).collect()).or_default().push(places);
        }
        let cameras = of_times.into_values().max_by_key(Vec::len)?;
        (cameras.len() >= 2).then_some(Self { cameras })
    }

    fn moments(&self) -> usize {
        self.cameras[0].len()
    }

    /// The moments that are compared: all whose images were read; else so many in the middle that reading them takes a bounded time.
    fn window(&self, data: &Dataset, whole: bool) -> Range<usize> {
        let all = self.moments();
        let pixels = |c: &Camera| c.width as usize * c.height as usize;
        let of_moment: usize = self.cameras.iter().map(|p| pixels(&data.views(p[0].0)[p[0].1].camera)).sum();
        let most = (MAX_IMAGES / self.cameras.len()).min(MAX_PIXELS / of_moment.max(1));
        let count = if whole { all } else { all.min(most) };
        let start = (all - count) / 2;
        start..start + count
    }
}

/// Cameras that run early or late, and what the check can find; a note where it cannot tell.
pub(super) fn check(data: &Dataset, checked: &ImageChecks) -> (Option<Finding>, Option<Finding>) {
    let unsure = |why: &str, fix: &str| {
        let what = format!("whether cameras run in step cannot be told from these images: {why}");
        (None, Some(Finding::new("time", "time.unsure", Verdict::Note, what).fix(fix)))
    };
    let Some(rig) = Rig::of(data) else {
        return if several(data) { unsure("no two cameras have images of the same times", CLAP) } else { (None, None) };
    };
    let (count, moments) = (rig.cameras.len(), rig.moments());
    if count < MIN_CAMERAS || moments < MIN_TIMES {
        let why = format!(
            "{count} cameras at rest have {moments} moments in common, and {MIN_CAMERAS} with {MIN_TIMES} are needed"
        );
        return unsure(&why, CLAP);
    }
    let window = rig.window(data, checked.is_whole());
    if window.len() < MIN_TIMES {
        return unsure(&format!("{} would have to be read", count * moments), "--all reads them");
    }
    let Some(clocks) = Clocks::of(data, checked, &rig, window.clone()) else {
        return unsure("too many of them cannot be read", "repair the images that are named above");
    };
    let part = if window.len() < moments {
        format!("; {} of {moments} moments are compared, --all compares all", window.len())
    } else {
        String::new()
    };
    clocks.findings(&part)
}

/// Whether two cameras or more took training images of several times each.
fn several(data: &Dataset) -> bool {
    let mut of_camera: BTreeMap<u32, usize> = BTreeMap::new();
    data.train.iter().for_each(|v| *of_camera.entry(v.camera_id).or_default() += 1);
    of_camera.values().filter(|n| **n >= MIN_TIMES).count() > 1
}

/// How much the images of cameras change over the same time steps.
struct Clocks<'a> {
    /// The first view of each camera.
    views: Vec<&'a View>,
    changes: Vec<Vec<f64>>,
    /// Whether they film a person, by numbered frames.
    film: bool,
}

impl<'a> Clocks<'a> {
    /// The cameras of a rig whose images in a window of moments can be read; none if they are too few.
    fn of(data: &'a Dataset, checked: &ImageChecks, rig: &Rig, window: Range<usize>) -> Option<Self> {
        let wanted: Vec<Place> = rig.cameras.iter().flat_map(|c| &c[window.clone()]).copied().collect();
        let thumbs = checked.thumbnails(data, &wanted);
        let rows = rig.cameras.iter().zip(thumbs.chunks(window.len()));
        let row = |(places, thumbs): (&Vec<Place>, &[Option<Vec<f32>>])| {
            let thumbs: Vec<&[f32]> = thumbs.iter().map(Option::as_deref).collect::<Option<_>>()?;
            Some((&data.views(places[0].0)[places[0].1], changes(&thumbs)))
        };
        let (views, changes): (Vec<&View>, Vec<Vec<f64>>) = rows.filter_map(row).unzip();
        (changes.len() >= MIN_CAMERAS).then_some(Self { views, changes, film: data.avatar.is_some() })
    }

    /// Cameras that see the same changes as the others, some time steps earlier or later, and what the check can find. None is
    /// flagged where it would find few of the shifts that are put into the data's own times.
    fn findings(&self, part: &str) -> (Option<Finding>, Option<Finding>) {
        let late = lags(&self.changes);
        let sound: Vec<usize> = (0..self.changes.len()).filter(|k| late.iter().all(|l| l.0 != *k)).collect();
        let tried = |lag: isize| sound.iter().filter(|k| self.found(**k, lag)).count();
        let (n, counts) = (sound.len(), [-4, -2, 2, 4].map(tried));
        let text = format!(
            "a camera 2 moments late or early would be found in {} of {} tries, 4 moments in {} of {}{part}",
            counts[1] + counts[2],
            2 * n,
            counts[0] + counts[3],
            2 * n
        );
        let few = late.len() as f64 <= MAX_LATE * self.changes.len() as f64;
        if !(few && counts.iter().sum::<usize>() as f64 >= SURE * (4 * n) as f64) {
            let what = format!("whether cameras run in step cannot be told from these images: {text}");
            let unsure = Finding::new("time", "time.unsure", Verdict::Note, what);
            return (None, Some(unsure.fix(CLAP)));
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
            let late_cameras = Finding::new("time", "time.late", Verdict::Warning, what).at(late.iter().map(name));
            if self.film {
                let fix = "renumber the images of these cameras: a film has no data.time_shift";
                return late_cameras.fix(fix);
            }
            let fix = format!("--set data.time_shift={shift}, or --fix, which adds it to the shifts in scene.toml");
            late_cameras.fix(fix).setting(Some(Setting::Shift(shift)))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::images;
    use crate::sample::Sample;
    use gs_synth::{SynthOptions, generate};

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

    /// More images than are read at once, of which camera 2 has those of three moments before.
    fn late() -> Dataset {
        let options = SynthOptions { size: 64, cameras: 11, moments: 28, held_out: 1, ..SynthOptions::default() };
        let mut data = generate("reach", &options).expect("scene").dataset;
        let views = data.train.iter_mut().chain(&mut data.extrapolate);
        let mut own: Vec<_> = views.filter(|v| v.camera_id == 2).collect();
        own.sort_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
        for k in (3..own.len()).rev() {
            own[k].image = own[k - 3].image.clone();
        }
        data
    }

    fn checked(data: &Dataset) -> (Option<Finding>, Option<Finding>) {
        let sample = Sample::of(data, false);
        assert!(sample.views.len() < sample.total);
        check(data, &images::check(data, &sample, None, &|_, _| ()))
    }

    #[test]
    fn of_many_images_those_of_consecutive_moments_are_read() {
        let mut data = late();
        let (found, power) = checked(&data);
        let found = found.expect("late");
        assert!(
            found.code == "time.late" && found.places.len() == 1 && found.places[0].starts_with("camera 2 ("),
            "{found:?}"
        );
        assert!(found.places[0].ends_with("+3 moments") && power.is_some_and(|p| !p.what.contains("--all")));
        // Images so large that few moments can be read.
        let sized = |data: &mut Dataset, side: u32| {
            let lists = [&mut data.train, &mut data.val, &mut data.test, &mut data.extrapolate];
            lists.into_iter().flatten().for_each(|v| (v.camera.width, v.camera.height) = (side, side));
        };
        sized(&mut data, 3500);
        let rig = Rig::of(&data).expect("rig");
        assert_eq!((rig.cameras.len(), rig.moments(), rig.window(&data, true)), (12, 28, 0..28));
        assert_eq!(rig.window(&data, false), 4..24);
        sized(&mut data, 6000);
        let (found, unsure) = checked(&data);
        let unsure = unsure.expect("said");
        assert!(found.is_none() && unsure.what.contains("336") && unsure.fix.is_some_and(|f| f.contains("--all")));
    }
}
