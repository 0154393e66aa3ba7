//! Motion complexity of a video: scene motion velocity and acceleration (TRACE, supplement 5.15).
//!
//! ```text
//! u_k = ((x_{k+1} − x_k) / W, (y_{k+1} − y_k) / H) / (t_{k+1} − t_k)      image sizes per unit of time
//! velocity = mean |u_k|        acceleration = mean |u_{k+1} − u_k|        over moving points, times and views
//! ```
//! The paper does not divide the difference of velocities by the time between them a second time;
//! [`Complexity::acceleration_per_time`] does. A track moves if its whole path is at least [`STATIC_PATH`] long (the
//! paper's threshold is not published).

use glam::DVec2;

/// Length of the path below which a track counts as static, pixels.
pub const STATIC_PATH: f64 = 1.0;

/// Image positions of points over time, as seen from one view.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageTracks {
    /// Width and height of the image, pixels.
    pub size: [f64; 2],
    /// Times of the frames, ascending, in any unit.
    pub times: Vec<f64>,
    /// `[points][times]` pixel positions; none where a point is not visible.
    pub tracks: Vec<Vec<Option<DVec2>>>,
}

/// Mean image motion of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Complexity {
    /// Mean speed of moving points, image sizes per unit of time.
    pub velocity: f64,
    /// Mean change of velocity from one interval to the next (the paper's acceleration), same unit.
    pub acceleration: f64,
    /// Mean change of velocity over the time between the midpoints of the intervals, image sizes per unit of time squared.
    pub acceleration_per_time: f64,
    /// Number of tracks of all views.
    pub tracks: usize,
    /// Number of tracks at least as long as the static path.
    pub moving: usize,
}

/// Sum and count of the values of a mean.
#[derive(Clone, Copy, Debug, Default)]
struct Sum(f64, usize);

impl Sum {
    fn add(&mut self, value: f64) {
        *self = Self(self.0 + value, self.1 + 1);
    }

    fn mean(self) -> f64 {
        if self.1 > 0 { self.0 / self.1 as f64 } else { 0.0 }
    }
}

/// Motion complexity of all views together; `static_path` in pixels ([`STATIC_PATH`]). All means are zero if no point
/// moves.
///
/// ```
/// use glam::DVec2;
/// use gs_physics::complexity::{ImageTracks, STATIC_PATH, complexity};
/// // 20 of 200 pixels in each quarter of the unit of time, at constant velocity.
/// let times = vec![0.0, 0.25, 0.5];
/// let track = times.iter().map(|t| Some(DVec2::new(80.0 * t, 50.0))).collect();
/// let view = ImageTracks { size: [200.0, 100.0], times, tracks: vec![track] };
/// let found = complexity(&[view], STATIC_PATH);
/// assert_eq!((found.velocity, found.acceleration, found.moving), (0.4, 0.0, 1));
/// ```
pub fn complexity(views: &[ImageTracks], static_path: f64) -> Complexity {
    let (mut speed, mut change, mut rate) = (Sum::default(), Sum::default(), Sum::default());
    let mut out = Complexity::default();
    for view in views {
        for track in &view.tracks {
            out.tracks += 1;
            let seen = |k: usize| track.get(k).copied().flatten();
            let step = |k: usize| Some((seen(k + 1)? - seen(k)?, view.times[k + 1] - view.times[k]));
            let steps: Vec<_> = (0..view.times.len().saturating_sub(1)).map(step).collect();
            if steps.iter().flatten().map(|(d, _)| d.length()).sum::<f64>() < static_path {
                continue;
            }
            out.moving += 1;
            let velocity = |(d, dt): (DVec2, f64)| d / DVec2::from_array(view.size) / dt;
            steps.iter().flatten().for_each(|s| speed.add(velocity(*s).length()));
            for pair in steps.windows(2) {
                let (Some(a), Some(b)) = (pair[0], pair[1]) else { continue };
                let difference = (velocity(b) - velocity(a)).length();
                change.add(difference);
                rate.add(difference / (0.5 * (a.1 + b.1)));
            }
        }
    }
    Complexity { velocity: speed.mean(), acceleration: change.mean(), acceleration_per_time: rate.mean(), ..out }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(times: &[f64], paths: &[&dyn Fn(f64) -> Option<DVec2>]) -> ImageTracks {
        let tracks = paths.iter().map(|p| times.iter().map(|t| p(*t)).collect()).collect();
        ImageTracks { size: [200.0, 100.0], times: times.to_vec(), tracks }
    }

    const TIMES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

    /// `x = 40 t + 50 t²` px in 200 px: mean speed (0.2 + 0.25 (t₀ + t₁)), velocity changes by 0.125 each step.
    #[test]
    fn a_parabola_and_a_point_at_rest() {
        let fall = |t: f64| Some(DVec2::new(40.0 * t + 50.0 * t * t, 7.0));
        let still = |t: f64| Some(DVec2::new(3.0 + 0.2 * t, 4.0));
        let c = complexity(&[view(&TIMES, &[&fall, &still])], STATIC_PATH);
        assert_eq!((c.tracks, c.moving), (2, 1));
        assert!((c.velocity - 0.45).abs() < 1e-12 && (c.acceleration - 0.125).abs() < 1e-12, "{c:?}");
        assert!((c.acceleration_per_time - 0.5).abs() < 1e-12, "2 · 50 / 200");
    }

    #[test]
    fn heights_count_by_the_height_and_hidden_points_are_left_out() {
        let rise = |t: f64| (t != 0.5).then_some(DVec2::new(0.0, 20.0 * t));
        let c = complexity(&[view(&TIMES, &[&rise])], STATIC_PATH);
        assert!((c.velocity - 0.2).abs() < 1e-12 && c.moving == 1 && c.acceleration == 0.0, "{c:?}");
        assert_eq!(complexity(&[], STATIC_PATH), Complexity::default());
        let two = [view(&TIMES, &[&rise]), view(&[0.0, 0.5, 2.0], &[&|t| Some(DVec2::new(100.0 * t, 0.0))])];
        let c = complexity(&two, STATIC_PATH);
        assert!((c.velocity - (2.0 * 0.2 + 2.0 * 0.5) / 4.0).abs() < 1e-12 && c.tracks == 2);
    }
}
