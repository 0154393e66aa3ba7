//! Clocks of cameras that are early or late: the gradient of a loss with respect to the time that a view is asked at.
//!
//! ```text
//! dL/dt ≈ Σ_i dL/dx_i · (x_i(t + h) − x_i(t − h)) / 2h        x: means, quats, scales and opacities of the splats
//! ```
//! The image loss gives `dL/dx`, and the method is asked for its splats twice more. So any method has this gradient whose
//! splats are the same ones at every time. What colours do over time is left out.

use crate::method::MethodError;
use crate::timestamp::Timestamp;
use gs_core::{Splats, SplatsGrad, Time};
use gs_data::View;

/// `h`, normalised time.
const HALF_STEP: f32 = 2e-3;

/// Seconds per unit of normalised time in the views; 0 if all are of one time.
pub(crate) fn seconds_per_unit(views: &[View]) -> f64 {
    let times = || views.iter().map(|view| view.time);
    let earlier = |a: Time, b: Time| if b.normalised < a.normalised { b } else { a };
    let later = |a: Time, b: Time| if b.normalised > a.normalised { b } else { a };
    match times().reduce(earlier).zip(times().reduce(later)) {
        Some((a, b)) if b.normalised > a.normalised => (b.seconds - a.seconds) / f64::from(b.normalised - a.normalised),
        _ => 0.0,
    }
}

/// A time moved by `offset` (normalised), with `seconds` per unit of normalised time.
pub(crate) fn moved(t: Time, offset: f32, seconds: f64) -> Time {
    Time { normalised: t.normalised + offset, seconds: t.seconds + f64::from(offset) * seconds }
}

/// What [`slope`] needs of the gradient of a frame's splats.
pub(crate) fn motion_columns(grad: &SplatsGrad) -> SplatsGrad {
    let SplatsGrad { means, quats, scales, opacities, .. } = grad.clone();
    SplatsGrad { means, quats, scales, opacities, ..SplatsGrad::default() }
}

/// Which of a method's splats are shown at a time may change with it, and then rows of two times are not the same splats.
///
/// # Errors
/// If not all are shown.
pub(crate) fn check_all_shown(shown: usize, all: usize, t: Time) -> Result<(), MethodError> {
    if shown == all {
        return Ok(());
    }
    Err(MethodError::Scene(format!(
        "cameras.time needs a method with the same splats at every time, and this one shows {shown} of {all} at t = {:.4}; set \
         cameras.time to false",
        t.normalised
    )))
}

/// `dL/dt`, per unit of normalised time, where the splats at `t` have the gradient `d`.
///
/// # Errors
/// Those of `splats`, and if there are other splats at other times.
pub(crate) fn slope(
    splats: &dyn Fn(&Timestamp) -> Result<Splats, MethodError>,
    t: Time,
    seconds: f64,
    d: &SplatsGrad,
) -> Result<f64, MethodError> {
    let (before, after) = (moved(t, -HALF_STEP, seconds), moved(t, HALF_STEP, seconds));
    let [a, b] = [splats(&Timestamp::new(before))?, splats(&Timestamp::new(after))?];
    if [a.len(), b.len()] != [d.means.len(); 2] {
        let why = format!(
            "cameras.time needs a method with the same splats at every time, and here are {}, {} and {} of them around t = \
             {:.4}; set cameras.time to false",
            a.len(),
            d.means.len(),
            b.len(),
            t.normalised
        );
        return Err(MethodError::Scene(why));
    }
    let mut sum = 0.0;
    for i in 0..a.len() {
        let quat: f64 = (0..4).map(|k| product(d.quats[i][k], b.quats[i][k] - a.quats[i][k])).sum();
        let vectors: f64 = (0..3)
            .map(|k| {
                product(d.means[i][k], b.means[i][k] - a.means[i][k])
                    + product(d.scales[i][k], b.scales[i][k] - a.scales[i][k])
            })
            .sum();
        sum += vectors + quat + product(d.opacities[i], b.opacities[i] - a.opacities[i]);
    }
    Ok(sum / f64::from(after.normalised - before.normalised))
}

fn product(a: f32, b: f32) -> f64 {
    f64::from(a) * f64::from(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use gs_core::{Color, Kernel};

    /// Two splats whose every column but the colour moves.
    fn at(t: f32) -> Splats {
        Splats {
            means: vec![Vec3::new(t * t, 1.0, -2.0 * t), Vec3::ZERO],
            quats: vec![[1.0, t, 0.0, 0.0], [1.0, 0.0, 0.0, 3.0 * t]],
            scales: vec![Vec3::splat(1.0 + t), Vec3::ONE],
            opacities: vec![0.5, 0.2 + 0.1 * t],
            color: Color::Rgb(vec![[0.5; 3]; 2]),
            kernel: Kernel::Gaussian,
        }
    }

    fn gradient() -> SplatsGrad {
        SplatsGrad {
            means: vec![Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0)],
            quats: vec![[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.8]],
            scales: vec![Vec3::new(0.1, 0.2, 0.3), Vec3::ONE],
            opacities: vec![9.0, 10.0],
            ..SplatsGrad::default()
        }
    }

    #[test]
    fn the_slope_is_that_of_every_column_that_moves() {
        let t = Time { normalised: 0.4, seconds: 2.0 };
        let asked = |stamp: &Timestamp| {
            let along = (stamp.t.seconds - t.seconds) / f64::from(stamp.t.normalised - t.normalised);
            assert!((along - 5.0).abs() < 1e-3, "seconds go along: {along}");
            Ok(at(stamp.t.normalised))
        };
        let got = slope(&asked, t, 5.0, &gradient()).unwrap();
        let want = (2.0 * 0.4 * 1.0 - 2.0 * 3.0) + (0.2 + 3.0 * 0.8) + 0.6 + 0.1 * 10.0;
        assert!((got - want).abs() < 2e-3, "{got} {want}");
    }

    #[test]
    fn a_choice_of_splats_is_refused() {
        let t = Time { normalised: 0.4, seconds: 0.4 };
        check_all_shown(2, 2, t).unwrap();
        let error = check_all_shown(2, 3, t).unwrap_err().to_string();
        assert!(error.contains("2 of 3") && error.contains("cameras.time"), "{error}");
    }

    #[test]
    fn other_splats_at_other_times_are_refused() {
        let more = |stamp: &Timestamp| {
            let mut splats = at(stamp.t.normalised);
            if stamp.t.normalised > 0.4 {
                splats.means.pop();
            }
            Ok(splats)
        };
        let error = slope(&more, Time { normalised: 0.4, seconds: 0.4 }, 1.0, &gradient()).unwrap_err().to_string();
        assert!(error.contains("cameras.time") && error.contains("2, 2 and 1"), "{error}");
    }
}
