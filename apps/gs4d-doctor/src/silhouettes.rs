//! Checks of poses by silhouettes: the visual hull carved by alpha or masks must cover each silhouette. Under wrong poses the
//! hull is empty or in the wrong place.

use super::pose_readings::PoseReading;
use super::{Finding, MAX_PLACES, Verdict, median};
use glam::{DMat3, DQuat, DVec3};
use gs_core::Camera;
use gs_data::hull::{Carved, Silhouette, carve};
use gs_data::{DataError, Dataset, ImageCache, ImageSource, Split, View};
use rayon::prelude::*;
use std::path::Path;

/// Share of the views that must agree on a hull cell: lower than for initial points, so that a few wrong views do not empty
/// the hull but show up as outliers.
const AGREEMENT: f64 = 0.8;
/// Mean covered share of silhouettes: above the first poses are good, below the second they are wrong.
const GOOD_SHARE: f64 = 0.8;
const BAD_SHARE: f64 = 0.5;
/// Median share of an image that outlines of an object fill at most.
const MOST_FILLED: f64 = 0.8;
/// Another reading of the poses must cover so much more.
const MIN_READING_GAIN: f64 = 0.25;

/// The visual hull and its fit to each silhouette.
pub(super) struct Silhouettes {
    /// The hull's cells and the silhouettes that carved them.
    pub(super) carved: Carved,
    /// Split and silhouette of the views: those that carved, then held-out ones.
    pub(super) shapes: Vec<(Split, Silhouette)>,
    /// Share of each silhouette that carved which the hull covers.
    fits: Vec<f64>,
    /// The reading of the poses that covers more, if there is one, and the share it covers.
    better: Option<(PoseReading, f64)>,
}

/// As [`check`], without the views whose image or mask cannot be read: they go from `data`, and a finding names and counts them. Where
/// a sample of the images was read, these are others. Of more than [`MAX_PLACES`] there are no silhouettes, and what was not read by then
/// is not counted.
pub(super) fn of_readable(data: &mut Dataset, images: Option<&ImageCache>) -> (Option<Silhouettes>, Option<Finding>) {
    let mut faults: Vec<DataError> = Vec::new();
    let (found, outcome) = loop {
        match check(data, images) {
            Ok(found) => break (found, "their views are left out"),
            Err(errors) => {
                // Views that share a mask go with the first of its errors.
                let (left_out, others): (Vec<_>, Vec<_>) = errors.into_iter().partition(|e| leave_out(data, e));
                let goes_on = !left_out.is_empty();
                faults.extend(if goes_on { left_out } else { others });
                if !goes_on || faults.len() > MAX_PLACES {
                    break (None, "no silhouettes are compared");
                }
            }
        }
    };
    let finding = faults.first().map(|first| {
        let what = format!("images or masks that cannot be used: {}; {outcome}", faults.len());
        let places = faults.iter().map(ToString::to_string);
        Finding::new("images", first.code(), Verdict::Problem, what).at(places).fix(first.fix())
    });
    (found, finding)
}

/// Removes the views that have the image or the mask that an error is of; whether there are any.
fn leave_out(data: &mut Dataset, e: &DataError) -> bool {
    let Some(place) = e.place() else { return false };
    let is_of = |v: &View, source: &ImageSource| match source {
        ImageSource::File(file) => *file == place.file,
        ImageSource::Memory(_) => Path::new(&v.name) == place.file,
    };
    let count = |data: &Dataset| data.train.len() + data.val.len() + data.test.len();
    let before = count(data);
    for views in [&mut data.train, &mut data.val, &mut data.test] {
        views.retain(|v| !is_of(v, &v.image) && !v.mask.as_ref().is_some_and(|mask| is_of(v, mask)));
    }
    count(data) < before
}

/// Carves the training views, and adds those held out; none where there are neither alpha nor masks. `images` may hold reduced images.
///
/// # Errors
/// Those of decoding images and masks: of all training views that cannot be read, or else of all that are held out.
pub(super) fn check(data: &Dataset, images: Option<&ImageCache>) -> Result<Option<Silhouettes>, Vec<DataError>> {
    let Some(carved) = carve(data, AGREEMENT, images)? else { return Ok(None) };
    // Masks of what must not count, or alpha that is 1, are no outlines of an object.
    let filled = |s: &Silhouette| {
        let inside = s.inside();
        inside.iter().filter(|i| **i).count() as f64 / inside.len().max(1) as f64
    };
    if median(&carved.silhouettes.par_iter().map(filled).collect::<Vec<_>>()) > MOST_FILLED {
        return Ok(None);
    }
    let mut shapes: Vec<(Split, Silhouette)> = carved.silhouettes.iter().map(|s| (Split::Train, s.clone())).collect();
    let mut errors = Vec::new();
    for split in [Split::Val, Split::Test] {
        let views = data.views(split);
        if views.iter().any(|v| data.has_alpha || v.mask.is_some()) {
            match carved.silhouettes_of(views, images) {
                Ok(of_split) => shapes.extend(of_split.into_iter().map(|s| (split, s))),
                Err(of_split) => errors.extend(of_split),
            }
        }
    }
    if !errors.is_empty() {
        return Err(errors);
    }
    let fits = covered(&carved);
    let now = mean(&fits);
    let mut better: Option<(PoseReading, f64)> = None;
    if now < GOOD_SHARE {
        for (s, other) in PoseReading::ALL.map(|s| (s, share_under(&carved, data, s))) {
            if other > better.map_or(now.max(BAD_SHARE), |b| b.1) {
                better = Some((s, other));
            }
        }
    }
    let better = better.filter(|b| b.1 > now + MIN_READING_GAIN);
    Ok(Some(Silhouettes { carved, shapes, fits, better }))
}

/// The mean covered share of the silhouettes if the poses were read in another way.
fn share_under(carved: &Carved, data: &Dataset, reading: PoseReading) -> f64 {
    mean(&covered(&carved.under(data, AGREEMENT, |c| reading.camera(c))))
}

/// The share of each silhouette that the projected hull covers; 1 for an empty one.
fn covered(carved: &Carved) -> Vec<f64> {
    let share = |s: &Silhouette| {
        let (inside, cover) = (s.inside(), carved.cover(&s.camera));
        let both = inside.iter().zip(&cover).filter(|(s, c)| **s && **c).count();
        match inside.iter().filter(|s| **s).count() {
            0 => 1.0,
            n => both as f64 / n as f64,
        }
    };
    carved.silhouettes.par_iter().map(share).collect()
}

impl Silhouettes {
    /// Findings on all poses together.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let (share, count) = (mean(&self.fits), self.fits.len());
        let text = format!("what {count} silhouettes carve fills {:.0} % of each, in the mean", 100.0 * share);
        if let Some((s, other)) = self.better {
            let what = format!("{text}; with poses {} it would be {:.0} %", s.what(), 100.0 * other);
            return vec![Finding::new("poses", "poses.convention", Verdict::Problem, what).fix(s.fix())];
        }
        if share >= GOOD_SHARE {
            return vec![Finding::ok("poses", text)];
        }
        let verdict = if share < BAD_SHARE { Verdict::Problem } else { Verdict::Warning };
        let what = format!("{text}: poses, focal length, box or alpha do not belong together");
        let fix = "compare the figures of the hull with the images; check alpha and the units of the poses, or set \
                   the box: gs4d init DATA --bound HALF (half of its side)";
        vec![Finding::new("poses", "poses.silhouettes", verdict, what).fix(fix)]
    }

    /// Whether camera axes of the other convention would be told as such, the poses of `data` being right.
    pub(super) fn tells_axes(&self, data: &Dataset) -> bool {
        let right = mean(&self.fits);
        if right <= BAD_SHARE {
            return false;
        }
        let flipped = share_under(&self.carved, data, PoseReading::Flipped);
        flipped < GOOD_SHARE && right > flipped + MIN_READING_GAIN
    }
}

/// A camera turned about its own centre by a rotation vector in its axes, radians.
pub(super) fn turn(c: &Camera, vector: DVec3) -> Camera {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(vector));
    Camera { rotation: turn * c.rotation, translation: turn * c.translation, ..c.clone() }
}

fn mean(shares: &[f64]) -> f64 {
    shares.iter().sum::<f64>() / shares.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_data::ImageU8;
    use gs_synth::{SynthOptions, generate};
    use std::sync::Arc;

    /// As of a data set of which a sample was read.
    #[test]
    fn views_that_cannot_be_read_are_named_and_the_others_compared() {
        let mut data = generate("static", &SynthOptions::of_views(40, 20, 4)).expect("scene").dataset;
        let (train, test) = (data.train.len(), data.test.len());
        let wrong = Arc::new(ImageU8 { width: 2, height: 1, data: vec![0; 8] });
        let spoil = |v: &mut View, name: &str| {
            (v.name, v.image) = (name.to_owned(), ImageSource::Memory(wrong.clone()));
        };
        // Each is decoded, even of memory.
        let views = data.train.iter_mut().chain(&mut data.test);
        views.for_each(|v| v.stored = Some([v.camera.width, v.camera.height]));
        let (of_train, of_test) = ([3, 7, 11], [1, 2]);
        let name_of = |split: Split, k: usize| format!("bad view {k} of {split:?}");
        of_train.iter().for_each(|&k| spoil(&mut data.train[k], &name_of(Split::Train, k)));
        of_test.iter().for_each(|&k| spoil(&mut data.test[k], &name_of(Split::Test, k)));
        let images = ImageCache::new(0, 1.0);
        let (found, finding) = of_readable(&mut data, Some(&images));
        let (found, finding) = (found.expect("a hull"), finding.expect("a finding"));
        assert_eq!((finding.code, finding.verdict), ("data.image_size", Verdict::Problem));
        let names =
            of_train.map(|k| name_of(Split::Train, k)).into_iter().chain(of_test.map(|k| name_of(Split::Test, k)));
        for name in names {
            assert!(finding.places.iter().any(|place| place.starts_with(&name)), "{name}: {:?}", finding.places);
        }
        assert_eq!(finding.places.len(), of_train.len() + of_test.len());
        assert_eq!((data.train.len(), data.test.len()), (train - 3, test - 2));
        let of = |split: Split| found.shapes.iter().filter(|s| s.0 == split).count();
        assert_eq!((of(Split::Train), of(Split::Test)), (train - 3, test - 2));
        // One pass finds all training views that cannot be read, another all held-out ones, a third reads what is left.
        let left = (data.train.len() + data.test.len()) as u64;
        assert!((2 * left..=3 * left).contains(&images.decoded()), "{} of {left}", images.decoded());
        let (again, none) = of_readable(&mut data, None);
        assert!(again.is_some() && none.is_none());
    }
}
