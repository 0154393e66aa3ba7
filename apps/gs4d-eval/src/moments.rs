//! The moments of a data set, over all of its splits.

use gs_core::Time;
use gs_data::{Dataset, Split, View, moments};

/// A time at which the scene was seen: images that cameras took almost together ([`gs_data::moments`]) are of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// The mean time of its images.
    pub time: Time,
    /// Normalised time of its latest image.
    pub last: f32,
}

impl Moment {
    /// The moments of the views of all splits, in order.
    pub fn all(dataset: &Dataset) -> Vec<Self> {
        let views: Vec<View> = Split::ALL.iter().flat_map(|split| dataset.views(*split)).cloned().collect();
        let times = views.iter().map(|v| v.time);
        let mut shots: Vec<(f32, Time)> = moments::of_views(&views).into_iter().zip(times).collect();
        shots.sort_by(|a, b| a.0.total_cmp(&b.0));
        shots.chunk_by(|a, b| a.0 == b.0).map(Self::of).collect()
    }

    /// The moment of images, each with its moment's normalised time and its own time.
    fn of(shots: &[(f32, Time)]) -> Self {
        let (normalised, first) = (shots[0].0, shots[0].1.seconds);
        let since: f64 = shots.iter().map(|(_, own)| own.seconds - first).sum();
        let last = shots.iter().map(|(_, own)| own.normalised).fold(f32::NEG_INFINITY, f32::max);
        Self { time: Time { normalised, seconds: first + since / shots.len() as f64 }, last }
    }

    /// The moment nearest to a normalised time; none of none.
    pub fn nearest(moments: &[Self], t: f32) -> Option<Self> {
        let off = |m: &Self| (m.time.normalised - t).abs();
        moments.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{SynthOptions, generate};

    /// Four cameras and a held-out one, each late by its own thousandth.
    #[test]
    fn cameras_that_are_not_quite_together_show_one_moment() {
        let options =
            SynthOptions { size: 8, cameras: 4, held_out: 1, moments: 6, supersample: 1, ..SynthOptions::default() };
        let mut data = generate("balls", &options).unwrap().dataset;
        let exact = Moment::all(&data);
        assert_eq!(exact.len(), 6);
        assert!(exact.iter().all(|m| m.last == m.time.normalised), "{exact:?}");
        for view in [&mut data.train, &mut data.test, &mut data.extrapolate].into_iter().flatten() {
            view.time.normalised += 1e-3 * view.camera_id as f32;
            view.time.seconds = 10.0 * f64::from(view.time.normalised);
        }
        let late = Moment::all(&data);
        assert_eq!(late.len(), 6);
        for (exact, late) in exact.iter().zip(&late) {
            let [mean, last] = [2e-3, 4e-3].map(|off: f32| exact.last + off);
            assert!((late.time.normalised - mean).abs() < 1e-6 && (late.last - last).abs() < 1e-6, "{late:?}");
            assert!((late.time.seconds - 10.0 * f64::from(mean)).abs() < 1e-5, "{late:?}");
        }
        assert_eq!(Moment::nearest(&late, late[2].last), Some(late[2]));
        assert_eq!(Moment::nearest(&[], 0.5), None);
    }
}
