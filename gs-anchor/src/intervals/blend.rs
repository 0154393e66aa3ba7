//! Key frames: the canonical times whose deformations a frame blends, and how much of each.
//!
//! With `b` the boundaries (`b_N = 1`), `c` the interval of `t`, `h = b_{c+1} − b_c` and `u = (t − b_c) / h`:
//! ```text
//! hold      p_c
//! linear    (1 − u) p_c + u p_{c+1}
//! smooth    (1 + 2u)(1 − u)² p_c + u (1 − u)² h m_c + u² (3 − 2u) p_{c+1} − u² (1 − u) h m_{c+1}
//!           m_c = (p_{c+1} − p_{c−1}) / (b_{c+1} − b_{c−1}), one-sided at both ends
//! ```
//! Before 0 and after 1 a frame is that at the end.

use super::{Blend, Intervals};

impl Intervals {
    /// The canonical times that a frame at normalised time `t` blends, with weights that sum to 1; at most four.
    pub fn keys(&self, t: f32) -> Vec<(f32, f32)> {
        if self.config.blend == Blend::Hold {
            return vec![(self.canonical_time(t), 1.0)];
        }
        let c = self.locate(t);
        let (start, end) = (self.starts.value[c], self.end(c));
        let u = ((t - start) / (end - start)).clamp(0.0, 1.0);
        let weights = match self.config.blend {
            Blend::Smooth => self.cubic(c, u),
            _ => vec![(c, 1.0 - u), (c + 1, u)],
        };
        weights.into_iter().filter(|w| w.1 != 0.0).map(|(key, w)| (self.key(key), w)).collect()
    }

    /// Boundary `key`, 0 to N.
    fn key(&self, key: usize) -> f32 {
        self.starts.value.get(key).copied().unwrap_or(1.0)
    }

    /// Weights of boundaries `c − 1` to `c + 2`, as far as there are such, at share `u` of interval `c`.
    fn cubic(&self, c: usize, u: f32) -> Vec<(usize, f32)> {
        let n = self.len();
        let h = self.key(c + 1) - self.key(c);
        let v = 1.0 - u;
        let mut weights = vec![(c, (1.0 + 2.0 * u) * v * v), (c + 1, u * u * (3.0 - 2.0 * u))];
        for (at, share) in [(c, u * v * v * h), (c + 1, -u * u * v * h)] {
            let (before, after) = (at.saturating_sub(1), (at + 1).min(n));
            let slope = share / (self.key(after) - self.key(before));
            weights.extend([(after, slope), (before, -slope)]);
        }
        let sum = |key: usize| weights.iter().filter(|w| w.0 == key).map(|w| w.1).sum();
        (c.saturating_sub(1)..=(c + 2).min(n)).map(|key| (key, sum(key))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::IntervalConfig;
    use super::*;

    /// Five intervals of different widths.
    fn intervals(blend: Blend) -> Intervals {
        let config = IntervalConfig { segments: 5, blend, ..IntervalConfig::default() };
        let mut intervals = Intervals::new(&config, 100).unwrap();
        intervals.starts.value = vec![0.0, 0.1, 0.35, 0.6, 0.7];
        intervals
    }

    /// A function of time, known at key frames, as a frame at `t` has it.
    fn blended(blend: Blend, t: f32, f: impl Fn(f32) -> f32) -> f32 {
        intervals(blend).keys(t).into_iter().map(|(key, w)| w * f(key)).sum()
    }

    const TIMES: std::ops::RangeInclusive<i32> = -2..=52;

    #[test]
    fn weights_sum_to_one_and_a_key_frame_is_itself() {
        for blend in [Blend::Hold, Blend::Linear, Blend::Smooth] {
            for t in TIMES.map(|k| k as f32 / 50.0) {
                let keys = intervals(blend).keys(t);
                assert!((keys.iter().map(|k| k.1).sum::<f32>() - 1.0).abs() < 1e-6 && keys.len() <= 4, "{blend:?} {t}");
            }
            for (key, t) in [0.0, 0.1, 0.35, 0.6, 0.7].into_iter().enumerate() {
                assert_eq!(intervals(blend).keys(t), [(intervals(blend).key(key), 1.0)], "{blend:?} {t}");
            }
        }
        assert_eq!(intervals(Blend::Linear).keys(1.0), [(1.0, 1.0)]);
        assert_eq!(intervals(Blend::Hold).keys(0.5), [(0.35, 1.0)]);
    }

    #[test]
    fn even_motion_is_exact_and_nothing_jumps() {
        for t in TIMES.map(|k| k as f32 / 50.0) {
            for blend in [Blend::Linear, Blend::Smooth] {
                let (at, off) = (t.clamp(0.0, 1.0), |t: f32| blended(blend, t, |t| 3.0 * t - 1.0));
                assert!((off(t) - (3.0 * at - 1.0)).abs() < 1e-5, "{blend:?} {t}");
                assert!((off(t + 1e-4) - off(t)).abs() < 1e-3, "{blend:?} {t}");
            }
        }
        let step = |t: f32| (blended(Blend::Hold, t, |t| 3.0 * t) - blended(Blend::Hold, t - 1e-4, |t| 3.0 * t)).abs();
        assert!(step(0.35) > 0.7, "held, it jumps");
    }

    #[test]
    fn the_smooth_curve_has_no_corner_and_is_nearer_to_a_swing() {
        let swing = |t: f32| (5.0 * t).sin();
        // Between the second boundary and the last but one, where slopes are two-sided.
        let worst = |blend| {
            let off = |t: f32| (blended(blend, t, swing) - swing(t)).abs();
            (10..=60).map(|k| off(k as f32 / 100.0)).fold(0.0, f32::max)
        };
        let [hold, linear, smooth] = [Blend::Hold, Blend::Linear, Blend::Smooth].map(worst);
        assert!(smooth < 0.5 * linear && linear < 0.3 * hold, "{smooth} {linear} {hold}");
        let slope = |blend, t: f32| (blended(blend, t + 1e-3, swing) - blended(blend, t, swing)) * 1e3;
        let corner = |blend, t: f32| (slope(blend, t) - slope(blend, t - 1e-3)).abs();
        for t in [0.1, 0.35, 0.6, 0.7] {
            assert!(corner(Blend::Smooth, t) < 0.2, "{t}: {}", corner(Blend::Smooth, t));
        }
        assert!(corner(Blend::Linear, 0.35) > 0.5);
    }
}
