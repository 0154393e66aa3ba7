//! The HexPlane encoder of 4D Gaussian Splatting, with its error against the f64 twin.

use super::{Case, Measured, relative_l2};
use glam::Vec3;
use gs_core::{Rng, Time};
use gs_deform::Aabb;
use gs_deform::encode::{HexPlane, HexPlaneConfig, HexTape};
use gs_deform::reference::HexPlaneRef;

/// Planes to measure.
struct Planes {
    case: &'static str,
    /// Nodes along x, y, z, t.
    resolution: [usize; 4],
    levels: &'static [usize],
    points: usize,
    /// Milliseconds of PyTorch (`grid_sample`), both ways.
    pytorch: Option<f64>,
}

const TWO_LEVELS: Planes = Planes {
    case: "hexplane 64^3x75, 2 levels",
    resolution: [64, 64, 64, 75],
    levels: &[1, 2],
    points: 20_000,
    pytorch: None,
};
/// Half the nodes in time are for times that are not used, so the last has six planes of 128².
const PLANES: [Planes; 3] = [
    TWO_LEVELS,
    Planes { points: 100_000, ..TWO_LEVELS },
    Planes {
        case: "hexplane 6x128^2x32",
        resolution: [128, 128, 128, 255],
        levels: &[1],
        points: 100_000,
        pytorch: Some(409.0),
    },
];

/// The error is measured on this many points.
const ERROR_POINTS: usize = 500;
const RUNS: usize = 7;

pub(super) fn rows() -> Vec<Measured> {
    PLANES.iter().flat_map(rows_of).collect()
}

fn rows_of(of: &Planes) -> Vec<Measured> {
    let config = HexPlaneConfig { resolution: of.resolution, levels: of.levels.to_vec(), ..HexPlaneConfig::default() };
    // The configuration is constant and valid; without an encoder there is nothing to measure.
    let Ok(mut hex) = HexPlane::new("hex", &config, Aabb::cube(1.0), 1) else { return Vec::new() };
    let t = Time { normalised: 0.37, seconds: 0.37 };
    let mut rng = Rng::new(1, "bench points", 0, 0);
    let points: Vec<Vec3> =
        (0..of.points).map(|_| Vec3::from_array(std::array::from_fn(|_| rng.range(-1.0, 1.0)))).collect();
    let (mut tape, mut d_points) = (HexTape::default(), vec![Vec3::ZERO; of.points]);
    hex.forward(&points, t, &mut tape);
    let d: Vec<f32> = (0..hex.width()).map(|_| rng.normal()).collect();
    for block in &mut tape.blocks {
        block.d_features = d.iter().copied().cycle().take(block.features.len()).collect();
    }
    hex.backward(&mut tape, Some(&mut d_points));
    let [forward_error, backward_error] = errors(&hex, &points, t, &tape, &d, &d_points);
    let case = |variant, error_kind| Case { krate: "gs-deform", case: of.case.into(), variant, error_kind };
    let (n, work, back) = (of.points, of.points as f64, "relative L2 of dL/d points, f64");
    let forward = case("forward", "relative L2 of features, f64")
        .row(n, work, forward_error, RUNS, || hex.forward(&points, t, &mut tape));
    let backward =
        case("backward", back).row(n, work, backward_error, RUNS, || hex.backward(&mut tape, Some(&mut d_points)));
    let both = case("forward+backward", back).row(n, work, backward_error, RUNS, || {
        hex.forward(&points, t, &mut tape);
        hex.backward(&mut tape, Some(&mut d_points));
    });
    vec![forward.into(), backward.into(), Measured { pytorch: of.pytorch, ..both.into() }]
}

fn errors(hex: &HexPlane, points: &[Vec3], t: Time, tape: &HexTape, d: &[f32], d_points: &[Vec3]) -> [f64; 2] {
    let twin = HexPlaneRef::new(hex);
    let mut scratch: Vec<Vec<f64>> = twin.planes.iter().map(|p| vec![0.0; p.len()]).collect();
    let d: Vec<f64> = d.iter().map(|&v| f64::from(v)).collect();
    let (mut features, mut gradients) = (Vec::new(), Vec::new());
    for p in points.iter().take(ERROR_POINTS) {
        let p = p.to_array().map(f64::from);
        features.extend(twin.features(p, t));
        gradients.extend(twin.backward(p, t, &d, &mut scratch));
    }
    let got = tape.blocks.iter().flat_map(|b| &b.features).map(|&v| f64::from(v));
    let got_back = d_points.iter().flat_map(|d| d.to_array()).map(f64::from);
    [relative_l2(got, features.into_iter()), relative_l2(got_back, gradients.into_iter())]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_stand_beside_pytorch() {
        let small = Planes { resolution: [8, 8, 8, 10], points: 600, pytorch: Some(3.0), ..TWO_LEVELS };
        let rows = rows_of(&small);
        assert!(rows.iter().all(|m| m.row.n == 600 && m.row.ms > 0.0 && m.row.error.is_some_and(|e| e < 1e-4)));
        let said: Vec<_> = rows.iter().map(|m| (m.row.variant.as_str(), m.pytorch)).collect();
        assert_eq!(said, [("forward", None), ("backward", None), ("forward+backward", Some(3.0))]);
    }
}
