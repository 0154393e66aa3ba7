//! The camera of one view that explains its matches, all other cameras being right.
//!
//! Gauss-Newton on Sampson errors over the six degrees of freedom of a pose, with weights of Geman and McClure whose scale
//! shrinks from a tenth of the image to the tolerance, so that wrong matches lose their say (Zhou, Park and Koltun 2016).

use super::epipolar::Pair;
use glam::{DVec2, DVec3};
use gs_core::Camera;

/// Scales of the weights, and steps at each.
const SCALES: usize = 6;
const STEPS: usize = 4;
/// Largest turn of one step, radians.
const MAX_TURN: f64 = 0.15;
/// Step of numerical derivatives, radians and shares of `reach`.
const EPSILON: f64 = 1e-5;

/// Matches of a view with another one: the other's camera, pixels of the view first.
pub(super) struct Seen<'a> {
    pub(super) camera: &'a Camera,
    pub(super) points: &'a [[DVec2; 2]],
}

/// A camera and the share of the matches that agree with it.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) camera: Camera,
    pub(super) share: f64,
}

/// The share of matches whose error under a camera is below the tolerance.
pub(super) fn share(camera: &Camera, seen: &[Seen<'_>], tolerance: f64) -> f64 {
    let errors = |s: &Seen<'_>| {
        let pair = Pair::new(camera, s.camera);
        s.points.iter().filter(|p| pair.error(**p) < tolerance).count()
    };
    let all: usize = seen.iter().map(|s| s.points.len()).sum();
    seen.iter().map(errors).sum::<usize>() as f64 / all.max(1) as f64
}

/// The best fit from several starts; `reach` is the unit of translations, the distance to what is looked at.
pub(super) fn refit(starts: &[Camera], seen: &[Seen<'_>], tolerance: f64, reach: f64) -> Option<Fit> {
    let fits = starts.iter().map(|start| {
        let camera = descend(start, seen, tolerance, reach);
        let share = share(&camera, seen, tolerance);
        Fit { camera, share }
    });
    fits.reduce(|a, b| if b.share > a.share { b } else { a })
}

fn descend(start: &Camera, seen: &[Seen<'_>], tolerance: f64, reach: f64) -> Camera {
    let mut camera = start.clone();
    let largest = 0.1 * f64::from(start.width.max(start.height));
    for k in 0..SCALES {
        let scale = largest * (tolerance / largest).powf(k as f64 / (SCALES - 1) as f64);
        for _ in 0..STEPS {
            let Some(step) = step(&camera, seen, scale, reach) else { return camera };
            camera = moved(&camera, step, reach);
        }
    }
    camera
}

/// A camera turned and shifted in its own axes: radians, and shares of `reach`.
fn moved(c: &Camera, step: [f64; 6], reach: f64) -> Camera {
    c.moved(DVec3::new(step[0], step[1], step[2]), DVec3::new(step[3], step[4], step[5]) * reach)
}

/// The step of Gauss-Newton, damped; none where matches do not determine it.
fn step(camera: &Camera, seen: &[Seen<'_>], scale: f64, reach: f64) -> Option<[f64; 6]> {
    let nudged: [Camera; 6] = std::array::from_fn(|k| {
        let mut step = [0.0; 6];
        step[k] = EPSILON;
        moved(camera, step, reach)
    });
    let (mut normal, mut right) = ([[0.0; 6]; 6], [0.0; 6]);
    for s in seen {
        let here = Pair::new(camera, s.camera);
        let there: [Pair; 6] = std::array::from_fn(|k| Pair::new(&nudged[k], s.camera));
        for p in s.points {
            let (r, nearby) = (here.signed(*p), there.each_ref().map(|pair| pair.signed(*p)));
            // From one place nothing tells how far off a match is.
            if !r.is_finite() || nearby.iter().any(|n| !n.is_finite()) {
                continue;
            }
            let weight = (scale * scale / (scale * scale + r * r)).powi(2);
            let slope: [f64; 6] = std::array::from_fn(|k| (nearby[k] - r) / EPSILON);
            for i in 0..6 {
                right[i] -= weight * slope[i] * r;
                (0..6).for_each(|j| normal[i][j] += weight * slope[i] * slope[j]);
            }
        }
    }
    let mean = (0..6).map(|k| normal[k][k]).sum::<f64>() / 6.0;
    (0..6).for_each(|k| normal[k][k] += 1e-4 * mean + 1e-12);
    let step = solve(normal, right)?;
    let turn = DVec3::new(step[0], step[1], step[2]).length();
    let part = (MAX_TURN / turn.max(1e-12)).min(1.0);
    Some(step.map(|v| v * part))
}

/// Solves a symmetric positive definite system by elimination; none where it is singular.
fn solve(mut a: [[f64; 6]; 6], mut b: [f64; 6]) -> Option<[f64; 6]> {
    for k in 0..6 {
        if !(a[k][k].is_finite() && a[k][k] > 1e-300) {
            return None;
        }
        for i in k + 1..6 {
            let f = a[i][k] / a[k][k];
            (k..6).for_each(|j| a[i][j] -= f * a[k][j]);
            b[i] -= f * b[k];
        }
    }
    for k in (0..6).rev() {
        let rest: f64 = (k + 1..6).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - rest) / a[k][k];
    }
    b.iter().all(|v| v.is_finite()).then_some(b)
}
