//! The moments of views: the different times at which a scene was seen.

use crate::View;
use gs_core::cast;
use std::collections::BTreeMap;

/// Images of different cameras closer than this share of an even interval between them are of one moment.
const TOGETHER: f32 = 0.25;

/// The moment of each view, normalised time, in the order of the views. Images that several cameras took almost together are of one:
/// those less than a quarter of the interval apart that these cameras would have if they took turns. It is their mean time.
pub fn of_views(views: &[View]) -> Vec<f32> {
    let mut of_cameras: BTreeMap<u32, Vec<f32>> = BTreeMap::new();
    views.iter().for_each(|v| of_cameras.entry(v.camera_id).or_default().push(v.time.normalised));
    let cameras = of_cameras.len();
    let turns: Vec<f32> = of_cameras.into_values().flat_map(|times| steps(&sorted(times))).collect();
    let apart = if cameras > 1 { TOGETHER * median(turns) / cameras as f32 } else { 0.0 };
    let time = |k: &usize| views[*k].time.normalised;
    let mut order: Vec<usize> = (0..views.len()).collect();
    order.sort_by(|a, b| time(a).total_cmp(&time(b)));
    let mut moments = vec![0.0; views.len()];
    for together in order.chunk_by(|a, b| time(b) - time(a) <= apart) {
        let mean = together.iter().map(|k| f64::from(time(k))).sum::<f64>() / together.len() as f64;
        together.iter().for_each(|k| moments[*k] = cast::to_f32(mean));
    }
    moments
}

/// The different moments of views, normalised time, ascending.
pub fn distinct(views: &[View]) -> Vec<f32> {
    let mut moments = sorted(of_views(views));
    moments.dedup();
    moments
}

/// The upper median of the intervals between different times, which are in order; 0 if there is none.
pub fn median_step(times: &[f32]) -> f32 {
    median(steps(times))
}

fn sorted(mut values: Vec<f32>) -> Vec<f32> {
    values.sort_by(f32::total_cmp);
    values
}

/// The intervals between different times, which are in order.
fn steps(times: &[f32]) -> Vec<f32> {
    times.windows(2).map(|t| t[1] - t[0]).filter(|step| *step > 0.0).collect()
}

/// The upper median; 0 of nothing.
fn median(values: Vec<f32>) -> f32 {
    let values = sorted(values);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImageSource;
    use glam::DVec3;
    use gs_core::{Camera, Rng, Time};

    /// Views of cameras, `(number, time)`.
    fn shots(shots: impl IntoIterator<Item = (u32, f32)>) -> Vec<View> {
        let camera = Camera::look_at(8, 8, 0.7, DVec3::Z, DVec3::ZERO, DVec3::Y).unwrap();
        let view = |(camera_id, t): (u32, f32)| {
            let time = Time { normalised: t, seconds: t.into() };
            View::new("v", camera.clone(), time, ImageSource::File("v.png".into()), camera_id)
        };
        shots.into_iter().map(view).collect()
    }

    #[test]
    fn cameras_that_are_not_quite_together_show_one_moment() {
        let mut rng = Rng::new(3, "jitter", 0, 0);
        let frames = 0..31;
        let mut film = |jitter: f32| {
            let all = frames.clone().flat_map(|k| (0..8).map(move |c| (c, k as f32 / 30.0)));
            shots(all.map(|(c, t)| (c, t + jitter * rng.range(-1.0, 1.0))).collect::<Vec<_>>())
        };
        let (exact, off) = (film(0.0), film(1e-3));
        assert!(
            of_views(&exact).iter().eq(exact.iter().map(|v| &v.time.normalised)),
            "the times themselves, to the bit"
        );
        assert!(of_views(&off).chunks(8).all(|moment| moment.iter().all(|t| *t == moment[0])));
        let off = distinct(&off);
        assert_eq!((distinct(&exact).len(), off.len()), (31, 31));
        assert!((median_step(&off) * 30.0 - 1.0).abs() < 0.1, "{}", median_step(&off));
        // One camera may see as quickly as it likes, and cameras that take turns see a moment each.
        let quick = distinct(&shots([0.0, 0.001, 0.5, 0.501, 1.0].map(|t| (0, t))));
        let turns = distinct(&shots((0..24).map(|k| (k % 8, k as f32))));
        assert_eq!((quick.len(), turns.len(), median_step(&turns)), (5, 24, 1.0));
    }
}
