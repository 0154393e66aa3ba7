//! A Kalman filter of places: nearly constant acceleration, whose changes (the jerk) are white noise.
//!
//! ```text
//! s = (x, v, a)    s' = F s + w, w ~ N(0, q Q)    z = x + e, e ~ N(0, σ²)
//! ```
//! Axes share one covariance. The ratio q/σ² is the likeliest of a list, given the places; σ² itself does not enter
//! a forecast. With q = 0 the filter is the least-squares parabola.

use glam::{DMat3, DVec3};

/// The state after the last place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kalman {
    /// Time of the last place, seconds.
    last: f64,
    /// Seconds of the unit of time below: the mean interval of the places.
    unit: f64,
    /// Place, velocity and acceleration, world units and units of time.
    state: [DVec3; 3],
}

/// Ratios q/σ² tried, in units of time to the power −5; steps of 10.
const RATIOS: std::ops::RangeInclusive<i32> = -8..=3;

impl Kalman {
    /// Of `(seconds, position)` in order of time; `None` for fewer than five, or times that do not grow.
    pub(super) fn of(places: &[(f64, DVec3)]) -> Option<Self> {
        let (first, last) = (places.first()?.0, places.last()?.0);
        if places.len() < 5 || places.windows(2).any(|w| w[1].0 <= w[0].0) {
            return None;
        }
        let unit = (last - first) / (places.len() - 1) as f64;
        let scaled: Vec<(f64, DVec3)> = places.iter().map(|p| ((p.0 - first) / unit, p.1)).collect();
        let ratios = std::iter::once(0.0).chain(RATIOS.map(|k| 10f64.powi(k)));
        let run = ratios.map(|ratio| Run::over(&scaled, ratio));
        let best = run.filter(|r| r.cost.is_finite()).min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        Some(Self { last, unit, state: best.state })
    }

    /// The forecast at a time, seconds.
    pub(super) fn at(&self, seconds: f64) -> DVec3 {
        let t = (seconds - self.last) / self.unit;
        self.state[0] + self.state[1] * t + self.state[2] * (0.5 * t * t)
    }
}

/// One pass over all places.
struct Run {
    state: [DVec3; 3],
    /// −2 log likelihood, up to a constant, with σ² at its best.
    cost: f64,
}

impl Run {
    fn over(places: &[(f64, DVec3)], ratio: f64) -> Self {
        // Nothing is known before the first place; the first three settle the state and do not count.
        let (mut state, mut p) = ([places[0].1, DVec3::ZERO, DVec3::ZERO], DMat3::from_diagonal(DVec3::splat(1e8)));
        let (mut squares, mut logs, mut counted) = (0.0, 0.0, 0.0);
        let mut now = places[0].0;
        for (k, &(t, z)) in places.iter().enumerate() {
            let dt = t - now;
            now = t;
            let f = DMat3::from_cols(DVec3::X, DVec3::new(dt, 1.0, 0.0), DVec3::new(0.5 * dt * dt, dt, 1.0));
            state = [state[0] + state[1] * dt + state[2] * (0.5 * dt * dt), state[1] + state[2] * dt, state[2]];
            p = f * p * f.transpose() + white_jerk(dt) * ratio;
            let (spread, off) = (p.x_axis.x + 1.0, z - state[0]);
            let gain = p.x_axis / spread;
            (0..3).for_each(|i| state[i] += off * gain[i]);
            p -= DMat3::from_cols(gain * p.x_axis.x, gain * p.x_axis.y, gain * p.x_axis.z);
            if k >= 3 {
                squares += off.length_squared() / spread;
                logs += spread.ln();
                counted += 3.0;
            }
        }
        Self { state, cost: counted * (squares / counted).max(f64::MIN_POSITIVE).ln() + 3.0 * logs }
    }
}

/// Covariance of the state after white jerk of power 1 over `dt`.
fn white_jerk(dt: f64) -> DMat3 {
    let [one, two, three, four, five] = [1, 2, 3, 4, 5].map(|k| dt.powi(k));
    DMat3::from_cols(
        DVec3::new(five / 20.0, four / 8.0, three / 6.0),
        DVec3::new(four / 8.0, three / 3.0, two / 2.0),
        DVec3::new(three / 6.0, two / 2.0, one),
    )
}

#[cfg(test)]
mod tests {
    use super::super::Parabola;
    use super::*;
    use gs_core::rng::Rng;

    /// Places of a fall at 30 frames a second, pushed sideways until frame `push`, with noise, world units.
    fn places(push: usize, noise: f64, rng: &mut Rng) -> Vec<(f64, DVec3)> {
        let (mut x, mut v) = (DVec3::ZERO, DVec3::new(1.0, -2.0, 0.0));
        let dt = 1.0 / 30.0;
        let place = |k: usize| {
            let a = DVec3::new(if k < push { 20.0 } else { 0.0 }, 9.8, 0.0);
            let off = DVec3::from_array([(); 3].map(|()| f64::from(rng.normal()))) * noise;
            let z = (k as f64 * dt, x + off);
            x += v * dt + a * (0.5 * dt * dt);
            v += a * dt;
            z
        };
        (0..20).map(place).collect()
    }

    /// Errors of filter and parabola five frames after the ten that they see; means over 20 draws of the noise.
    fn errors(push: usize, noise: f64) -> [f64; 2] {
        let mut rng = Rng::new(1, "track", 0, 0);
        let truth = places(push, 0.0, &mut rng)[14];
        let mut sums = [0.0; 2];
        for _ in 0..20 {
            let seen = &places(push, noise, &mut rng)[..10];
            let at = [Kalman::of(seen).unwrap().at(truth.0), Parabola::through(seen).unwrap().at(truth.0)];
            (0..2).for_each(|k| sums[k] += at[k].distance(truth.1) / 20.0);
        }
        sums
    }

    #[test]
    fn a_fall_goes_on_nearly_as_the_parabola_through_it() {
        assert!(errors(0, 0.0)[0] < 1e-8);
        let [kalman, parabola] = errors(0, 1e-3);
        assert!(kalman < 2.5 * parabola, "{kalman} against {parabola}");
    }

    #[test]
    fn a_push_is_forgotten_where_the_parabola_keeps_it() {
        let [kalman, parabola] = errors(3, 1e-4);
        assert!(kalman < 0.2 * parabola, "{kalman} against {parabola}");
    }

    #[test]
    fn too_few_places_and_times_that_stand_give_none() {
        let track = places(0, 0.0, &mut Rng::new(1, "track", 0, 0));
        assert!(Kalman::of(&track[..4]).is_none() && Kalman::of(&[]).is_none());
        assert!(Kalman::of(&[track[0]; 6]).is_none());
    }
}
