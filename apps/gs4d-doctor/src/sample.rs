//! Which images are read: all of a few; of many a sample, spread evenly over splits, cameras and times.
//!
//! The views are sorted by split, camera and time, and [`gs_data::spread`] chooses of them.

use super::{Finding, Verdict};
use gs_data::{Dataset, Split};

/// Most images that are read, unless all are asked for.
const MAX_IMAGES: usize = 300;

/// Split and index of views.
pub(super) struct Sample {
    /// Those that are read.
    pub(super) views: Vec<(Split, usize)>,
    /// Number of views of the data set.
    pub(super) total: usize,
}

impl Sample {
    /// Every view, or a sample of at most [`MAX_IMAGES`]; the same for the same data.
    pub(super) fn of(data: &Dataset, all: bool) -> Self {
        let total = Split::ALL.iter().map(|&s| data.views(s).len()).sum();
        let whole = all || total <= MAX_IMAGES;
        let of_split = |&split: &Split| {
            let views = data.views(split);
            let mut order: Vec<usize> = (0..views.len()).collect();
            if !whole {
                order.sort_by(|&a, &b| {
                    let (a, b) = (&views[a], &views[b]);
                    a.camera_id.cmp(&b.camera_id).then(a.time.normalised.total_cmp(&b.time.normalised))
                });
            }
            order.into_iter().map(move |i| (split, i))
        };
        let views: Vec<(Split, usize)> = Split::ALL.iter().flat_map(of_split).collect();
        let most = if whole { total } else { MAX_IMAGES };
        Self { views: gs_data::spread(total, most).into_iter().map(|k| views[k]).collect(), total }
    }

    /// What was left out, if anything.
    pub(super) fn finding(&self) -> Option<Finding> {
        (self.views.len() < self.total).then(|| {
            let what =
                format!("{} of {} images are read, spread evenly over cameras and times", self.views.len(), self.total);
            Finding::new("images", "images.sample", Verdict::Note, what).fix("--all reads every one")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::cast;
    use gs_synth::{SynthOptions, generate};
    use std::collections::BTreeMap;

    #[test]
    fn every_camera_and_all_times_are_in_the_sample() {
        let rig = SynthOptions { size: 16, cameras: 8, moments: 60, ..Default::default() };
        let data = generate("falling", &rig).unwrap().dataset;
        let sample = Sample::of(&data, false);
        assert!(sample.total > MAX_IMAGES && sample.views.len() == MAX_IMAGES && sample.finding().is_some());
        assert_eq!(sample.views, Sample::of(&data, false).views);
        let share = MAX_IMAGES as f64 / sample.total as f64;
        let even = |key: &dyn Fn(Split, usize) -> u32| {
            let mut counts: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
            for split in Split::ALL {
                (0..data.views(split).len()).for_each(|i| counts.entry(key(split, i)).or_default()[0] += 1.0);
            }
            sample.views.iter().for_each(|&(s, i)| counts.entry(key(s, i)).or_default()[1] += 1.0);
            assert!(
                counts.values().all(|[all, some]| (some - share * all).abs() < 0.35 * share * all + 1.0),
                "{counts:?}"
            );
        };
        even(&|split, i| data.views(split)[i].camera_id);
        even(&|split, i| cast::to_u32((data.views(split)[i].time.normalised * 5.99) as usize));
        let all = Sample::of(&data, true);
        assert!(all.views.len() == sample.total && all.finding().is_none());
    }
}
