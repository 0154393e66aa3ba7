//! Particles that are hardly seen may learn absurd twists; this slows them down before they are rolled.
//!
//! The limit is four times the 99.9 % quantile of the speeds `‖v̄ + w × (x − o)‖` of the visible particles (so a scene of
//! fewer than a thousand is clipped at four times its fastest but one). A clipped particle runs through its own path at a
//! slower clock: with `s = limit / speed` its twist becomes `s u`, its rate `s² u'`, its jerk `s³ u''`.

use crate::twist::Motion;
use glam::Vec3;

const QUANTILE: f64 = 0.999;
const SLACK: f32 = 4.0;

/// Slows particles beyond the limit; gives how many. `seen` marks the visible ones, about `origin`; with none visible
/// nothing is clipped. All slices have one row per particle.
pub fn clip_fast(motions: &mut [Motion<f32>], means: &[Vec3], origin: Vec3, seen: &[bool]) -> usize {
    let speed = |m: &Motion<f32>, x: &Vec3| Vec3::from_array(m.twist.velocity((*x - origin).to_array())).length();
    let speeds: Vec<f32> = motions.iter().zip(means).map(|(m, x)| speed(m, x)).collect();
    let mut visible: Vec<f32> = speeds.iter().zip(seen).filter_map(|(s, seen)| seen.then_some(*s)).collect();
    if visible.is_empty() {
        return 0;
    }
    let rank = (QUANTILE * (visible.len() - 1) as f64) as usize;
    let limit = SLACK * *visible.select_nth_unstable_by(rank, f32::total_cmp).1;
    let mut clipped = 0;
    for (m, speed) in motions.iter_mut().zip(&speeds).filter(|(_, speed)| **speed > limit) {
        let s = limit / speed;
        *m = Motion { twist: m.twist.scaled(s), rate: m.rate.scaled(s * s), jerk: m.jerk.scaled(s * s * s) };
        clipped += 1;
    }
    clipped
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth;
    use crate::twist::Twist;

    #[test]
    fn outliers_are_slowed_onto_their_own_path_and_counted() {
        let n = 3000;
        let flies = |v: f32| Motion { twist: Twist { v: [v, 0.0, 0.0], w: [0.0; 3] }, ..Motion::default() };
        let mut motions: Vec<_> = (0..n).map(|i| flies(1.0 + i as f32 / n as f32)).collect();
        let wild = Motion {
            twist: Twist { v: [30.0, 0.0, 5.0], w: [40.0, -10.0, 3.0] },
            rate: Twist { v: [9.0; 3], w: [4.0; 3] },
            jerk: Twist { v: [20.0; 3], w: [1.0; 3] },
        };
        (motions[3], motions[8]) = (wild, flies(7.9));
        let (means, mut seen) = (vec![Vec3::new(0.5, 0.0, 0.0); n], vec![true; n]);
        seen[3] = false;
        assert_eq!(clip_fast(&mut motions, &means, Vec3::new(0.5, 0.0, 0.0), &seen), 1);
        assert_eq!(motions[8], flies(7.9), "within four times the quantile");
        let speed = Vec3::from_array(motions[3].twist.v).length();
        assert!((speed / 8.0 - 1.0).abs() < 1e-3, "{speed}");
        let (slow, _) = truth::follow(&motions[3].widened(), 0.5, [0.1, 0.2, 0.3]);
        let s = f64::from(speed) / 925.0f64.sqrt();
        let (fast, _) = truth::follow(&wild.widened(), 0.5 * s, [0.1, 0.2, 0.3]);
        assert!((0..3).all(|c| (slow[c] - fast[c]).abs() < 1e-5), "{slow:?} {fast:?}");
        assert_eq!(clip_fast(&mut motions, &means, Vec3::ZERO, &vec![false; n]), 0);
    }
}
