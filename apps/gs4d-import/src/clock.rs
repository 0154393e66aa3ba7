//! Clocks of cameras that were switched on one after the other.
//!
//! What happens before the cameras of a rig makes their pictures change by much or by little, at the same moments in all of them. The
//! changes of two cameras, as functions of time, are correlated at every offset (Pearson); the offset of the largest correlation is
//! that of their clocks, where no other comes near it and both halves of the film say the same. Between frames the peak of a parabola
//! through three correlations is taken. Pairs with the clearest peaks are followed first (a tree of largest sum), so that two
//! cameras which see nothing in common may still meet in a third.

use serde::{Deserialize, Serialize};

/// Least correlation at the offset, and its least lead over all offsets that are farther than this many seconds from it.
const MIN_PEAK: f64 = 0.6;
const MIN_LEAD: f64 = 0.12;
const PEAK_WIDTH: f64 = 0.4;
/// Offsets at which the halves of a film may peak, frames from that of the whole.
const HALVES: usize = 2;
/// Fewest steps that two films share at an offset.
const FEWEST: usize = 24;

/// The clocks of cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Clocks {
    /// What the first camera shows at time `t` a camera shows at `t + offset`, seconds; 0 where that is not known.
    pub offsets: Vec<f64>,
    /// Whether the offset of a camera is known.
    pub known: Vec<bool>,
    /// Least correlation of a pair that was used.
    pub weakest: Option<f64>,
    /// Most seconds by which a pair that was not needed disagrees.
    pub disagreement: Option<f64>,
}

/// The offset of the second curve of a pair.
#[derive(Clone, Copy, Debug)]
struct Pair {
    cameras: [usize; 2],
    seconds: f64,
    peak: f64,
}

/// The offsets of curves of changes, `rate` values per second, of at most `limit` seconds.
///
/// ```
/// let bump = |at: f64, t: f64| (-((t - at) / 0.2).powi(2)).exp();
/// let curve = |late: f64| -> Vec<f64> {
///     let at = |k: i32| f64::from(k) / 30.0 - late;
///     (0..240).map(|k| bump(1.5, at(k)) + 2.0 * bump(4.0, at(k)) + bump(5.1, at(k))).collect()
/// };
/// let clocks = gs4d_import::clock::offsets(&[curve(0.0), curve(0.75)], 30.0, 3.0);
/// assert!(clocks.known[1] && (clocks.offsets[1] - 0.75).abs() < 0.01);
/// ```
pub fn offsets(curves: &[Vec<f64>], rate: f64, limit: f64) -> Clocks {
    let n = curves.len();
    let mut pairs: Vec<Pair> = Vec::new();
    for a in 0..n {
        for b in a + 1..n {
            let found = offset(&curves[a], &curves[b], rate, limit);
            pairs.extend(found.map(|(seconds, peak)| Pair { cameras: [a, b], seconds, peak }));
        }
    }
    pairs.sort_by(|a, b| b.peak.total_cmp(&a.peak).then(a.cameras.cmp(&b.cameras)));
    // The camera of which each one hangs, and its offset against it.
    let mut group: Vec<(usize, f64)> = (0..n).map(|k| (k, 0.0)).collect();
    let (mut weakest, mut unused) = (None, Vec::new());
    for pair in pairs {
        let [(root, at), (other, there)] = pair.cameras.map(|c| group[c]);
        if root == other {
            unused.push(pair);
            continue;
        }
        weakest = Some(pair.peak);
        let moved = at + pair.seconds - there;
        group.iter_mut().filter(|g| g.0 == other).for_each(|g| *g = (root, g.1 + moved));
    }
    let size = |root: usize| group.iter().filter(|g| g.0 == root).count();
    // The largest group, of equal ones that of the first camera.
    let main = (0..n).map(|k| group[k].0).max_by_key(|&root| (size(root), std::cmp::Reverse(root))).unwrap_or(0);
    let known: Vec<bool> = group.iter().map(|g| g.0 == main && size(main) > 1).collect();
    let zero = known.iter().position(|t| *t).map_or(0.0, |k| group[k].1);
    let offsets: Vec<f64> = group.iter().zip(&known).map(|(g, known)| if *known { g.1 - zero } else { 0.0 }).collect();
    let apart = |p: &Pair| (offsets[p.cameras[1]] - offsets[p.cameras[0]] - p.seconds).abs();
    let of_main = unused.iter().filter(|p| p.cameras.iter().all(|&c| known[c]));
    Clocks { disagreement: of_main.map(apart).reduce(f64::max), offsets, known, weakest }
}

/// The offset of `b` against `a`, seconds, and the correlation there; none where it is not known.
fn offset(a: &[f64], b: &[f64], rate: f64, limit: f64) -> Option<(f64, f64)> {
    let most = gs_core::cast::to_usize(limit * rate).min(a.len().max(b.len()));
    // `lags[k]` is the correlation where `b` runs `k - most` steps late.
    let lags: Vec<f64> = (0..=2 * most).map(|k| correlation(a, b, k, most, [0.0, 1.0])).collect();
    let best = (0..lags.len()).max_by(|&i, &j| lags[i].total_cmp(&lags[j]))?;
    let (peak, width) = (lags[best], gs_core::cast::to_usize(PEAK_WIDTH * rate).max(2));
    let rival = (0..lags.len()).filter(|k| k.abs_diff(best) > width).map(|k| lags[k]).fold(-1.0, f64::max);
    let half = |part: [f64; 2]| {
        let range = best.saturating_sub(width)..=(best + width).min(2 * most);
        let at = range.max_by(|&i, &j| correlation(a, b, i, most, part).total_cmp(&correlation(a, b, j, most, part)));
        at.is_some_and(|at| at.abs_diff(best) <= HALVES)
    };
    let sure = peak >= MIN_PEAK && peak - rival >= MIN_LEAD && half([0.0, 0.5]) && half([0.5, 1.0]);
    if !sure || best == 0 || best == 2 * most {
        return None;
    }
    let [before, after] = [lags[best - 1], lags[best + 1]];
    let bend = 2.0 * peak - before - after;
    let part = if bend > 1e-9 { (0.5 * (after - before) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    Some(((best as f64 - most as f64 + part) / rate, peak))
}

/// Pearson's correlation of `a[i]` and `b[i + k − most]` over a part of what both have; −1 where that is too short.
fn correlation(a: &[f64], b: &[f64], k: usize, most: usize, part: [f64; 2]) -> f64 {
    let from = most.saturating_sub(k);
    let until = a.len().min((b.len() + most).saturating_sub(k));
    let length = until.saturating_sub(from);
    let [low, high] = part.map(|p| from + gs_core::cast::to_usize(p * length as f64));
    if length < FEWEST || high <= low {
        return -1.0;
    }
    let (x, y) = (&a[low..high], &b[low + k - most..high + k - most]);
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mx, my) = (mean(x), mean(y));
    let sum = |f: &dyn Fn(f64, f64) -> f64| x.iter().zip(y).map(|(x, y)| f(x - mx, y - my)).sum::<f64>();
    let norm = (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt();
    if norm > 1e-12 { sum(&|x, y| x * y) / norm } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: f64 = 30.0;

    /// Bursts of motion at irregular times, seen with another gain, some noise and a clock that is `late` seconds late.
    fn film(late: f64, camera: u64, length: usize) -> Vec<f64> {
        let bursts =
            [(0.9, 0.15, 1.0), (2.3, 0.3, 0.6), (3.1, 0.12, 1.6), (5.0, 0.25, 0.8), (6.2, 0.2, 1.3), (7.7, 0.18, 0.7)];
        let gain = |k: usize| 1.0 + 0.4 * (((k as u64 * 31 + camera * 17) % 7) as f64 / 7.0 - 0.5);
        let at = |i: usize| {
            let t = i as f64 / RATE - late;
            let one = |(k, (at, width, height)): (usize, &(f64, f64, f64))| {
                gain(k) * height * (-((t - at) / width).powi(2)).exp()
            };
            let noise = ((i as u64 * 7919 + camera * 104_729) % 101) as f64 / 101.0 - 0.5;
            bursts.iter().enumerate().map(one).sum::<f64>() + 0.1 * noise
        };
        (0..length).map(at).collect()
    }

    #[test]
    fn offsets_are_found_between_frames() {
        let late = [0.0, 0.517, -1.243, 2.0];
        let films: Vec<Vec<f64>> = late.iter().zip(0..).map(|(l, k)| film(*l, k, 300 - 10 * k as usize)).collect();
        let clocks = offsets(&films, RATE, 4.0);
        assert!(clocks.known.iter().all(|t| *t), "{clocks:?}");
        for (found, true_one) in clocks.offsets.iter().zip(late) {
            assert!((found - true_one).abs() < 0.3 / RATE, "{clocks:?}");
        }
        assert!(clocks.weakest.unwrap() > 0.8 && clocks.disagreement.unwrap() < 0.5 / RATE, "{clocks:?}");
    }

    #[test]
    fn what_is_not_clear_is_not_known() {
        let noise = |camera: u64| {
            film(0.0, camera, 240)
                .iter()
                .enumerate()
                .map(|(i, _)| ((i as u64 * 48_271 * (camera + 3)) % 1009) as f64)
                .collect::<Vec<_>>()
        };
        let clocks = offsets(&[film(0.0, 0, 240), noise(5)], RATE, 3.0);
        assert_eq!((clocks.known, clocks.offsets, clocks.weakest), (vec![false, false], vec![0.0, 0.0], None));
        // A pendulum tells the time up to its period.
        let swing = |late: f64| (0..300).map(|i| ((i as f64 / RATE - late) * 9.0).sin().abs()).collect::<Vec<_>>();
        assert!(!offsets(&[swing(0.0), swing(0.2)], RATE, 3.0).known[1]);
        assert!(!offsets(&[vec![0.0; 300], vec![0.0; 300]], RATE, 3.0).known[0]);
        assert!(!offsets(&[film(0.0, 0, 10), film(0.0, 1, 10)], RATE, 3.0).known[0], "too short");
        // Two that agree and one that sees nothing of it: of the first nothing is known.
        let clocks = offsets(&[noise(7), film(0.5, 1, 300), film(0.0, 2, 300)], RATE, 3.0);
        assert_eq!(clocks.known, [false, true, true]);
        assert!((clocks.offsets[2] + 0.5).abs() < 0.02 && clocks.offsets[..2] == [0.0, 0.0], "{clocks:?}");
    }
}
