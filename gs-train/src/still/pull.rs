//! A pull to rest: what the images do not ask for, the field is not to move.
//!
//! ```text
//! L = pull / n · Σ ln(1 + u)
//! u = reach ‖Δm‖ / pixels + (‖Δs‖ / max |s| + 2 ‖Δq‖ / ‖q‖) / shape        Δ: what the field adds to a splat
//! ```
//! over the splats that take part in the field and that a view has shown: the measures by which a splat counts as still, in units of
//! their tolerances. Its slope falls with distance, so that a small motion goes to nothing and a large one that the
//! images ask for stays. `reach`, `|s|` and `‖q‖` count as constants.

use glam::Vec4;
use gs_core::{Geometry, GeometryRef};

/// Tolerances and weight of the pull.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pull {
    /// Of the sum over splats.
    pub(super) weight: f32,
    /// Pixels.
    pub(super) pixels: f32,
    /// A share.
    pub(super) shape: f32,
}

impl Pull {
    /// Writes the gradient of the pull of a row with respect to what the field makes of it (`moved`); returns its value. `reach`: pixels
    /// per world unit.
    pub(super) fn row(
        self,
        row: usize,
        reach: f32,
        canonical: GeometryRef<'_>,
        moved: &Geometry,
        to: &mut Geometry,
    ) -> f32 {
        let mean = moved.means[row] - canonical.means[row];
        let scales = moved.scales[row] - canonical.scales[row];
        let [from, now] = [canonical.quats[row], moved.quats[row]].map(Vec4::from);
        let quat = now - from;
        let size = canonical.scales[row].abs().max_element().max(f32::MIN_POSITIVE);
        let units =
            [reach / self.pixels, 1.0 / (self.shape * size), 2.0 / (self.shape * from.length().max(f32::MIN_POSITIVE))];
        let u = units[0] * mean.length() + units[1] * scales.length() + units[2] * quat.length();
        let slopes = units.map(|unit| self.weight / (1.0 + u) * unit);
        to.means[row] = slopes[0] * mean.normalize_or_zero();
        to.scales[row] = slopes[1] * scales.normalize_or_zero();
        to.quats[row] = (slopes[2] * quat.normalize_or_zero()).to_array();
        self.weight * u.ln_1p()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use gs_core::Rng;

    /// The value in f64, from the formula.
    fn reference(pull: Pull, reach: f64, canonical: &[f64; 10], moved: &[f64; 10]) -> f64 {
        let [weight, pixels, shape] = [pull.weight, pull.pixels, pull.shape].map(f64::from);
        let norm = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        let way = |range: std::ops::Range<usize>| norm(&range.map(|k| moved[k] - canonical[k]).collect::<Vec<_>>());
        let size = canonical[3..6].iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let u = reach * way(0..3) / pixels + (way(3..6) / size + 2.0 * way(6..10) / norm(&canonical[6..])) / shape;
        weight * u.ln_1p()
    }

    fn geometry(v: &[f64; 10]) -> Geometry {
        let v = v.map(|v| v as f32);
        Geometry {
            means: vec![Vec3::from_slice(&v)],
            scales: vec![Vec3::from_slice(&v[3..])],
            quats: vec![[v[6], v[7], v[8], v[9]]],
        }
    }

    /// Value and gradient in f32 against differences of the reference; both within 2e-5 of the largest slope.
    #[test]
    fn the_gradient_is_the_slope_of_the_value() {
        for case in 0..200 {
            let mut rng = Rng::new(5, "pull", 0, case);
            // Motions from 1e-3 to 10 of the splat's own numbers.
            let far = 10f64.powf(f64::from(rng.range(-3.0, 1.0)));
            let canonical: [f64; 10] = std::array::from_fn(|_| f64::from(rng.range(0.2, 1.0)));
            let mut moved = canonical.map(|v| f64::from((v + far * f64::from(rng.normal())) as f32));
            let canonical = canonical.map(|v| f64::from(v as f32));
            let (pull, reach) = (Pull { weight: 0.3, pixels: 0.5, shape: 0.05 }, f64::from(rng.range(1.0, 900.0)));
            let mut grad = Geometry::zeros(1);
            let value = pull.row(0, reach as f32, geometry(&canonical).view(), &geometry(&moved), &mut grad);
            let want = reference(pull, f64::from(reach as f32), &canonical, &moved);
            assert!((f64::from(value) - want).abs() < 2e-5 * want, "case {case}: {value} {want}");
            let flat = [grad.means[0].to_array().to_vec(), grad.scales[0].to_array().to_vec(), grad.quats[0].to_vec()];
            let largest = flat.concat().iter().fold(0.0f32, |m, v| m.max(v.abs()));
            for (k, got) in flat.concat().into_iter().enumerate() {
                let (h, at) = (1e-5 * far, moved[k]);
                let mut at_step = |step: f64| {
                    moved[k] = at + step;
                    reference(pull, f64::from(reach as f32), &canonical, &moved)
                };
                let slope = (at_step(h) - at_step(-h)) / (2.0 * h);
                moved[k] = at;
                let error = (f64::from(got) - slope).abs();
                assert!(error < 2e-4 * f64::from(largest), "case {case}, value {k}: {got} {slope}");
            }
        }
    }

    #[test]
    fn at_rest_there_is_no_slope() {
        let rest = geometry(&[0.5; 10]);
        let mut grad = Geometry::zeros(1);
        let pull = Pull { weight: 1.0, pixels: 0.5, shape: 0.05 };
        assert_eq!(pull.row(0, 100.0, rest.view(), &rest, &mut grad), 0.0);
        assert_eq!(grad, Geometry::zeros(1));
    }
}
