//! The HexPlane encoder of 4D Gaussian Splatting, with its error against the f64 twin.

use super::{Case, relative_l2};
use glam::Vec3;
use gs_core::speed::BenchRow;
use gs_core::{Rng, Time};
use gs_deform::Aabb;
use gs_deform::encode::{HexPlane, HexPlaneConfig, HexTape};
use gs_deform::reference::HexPlaneRef;

const POINTS: usize = 20_000;
/// The error is measured on this many points.
const ERROR_POINTS: usize = 500;
const RUNS: usize = 7;

pub(super) fn rows() -> Vec<BenchRow> {
    let config = HexPlaneConfig { resolution: [64, 64, 64, 75], levels: vec![1, 2], ..HexPlaneConfig::default() };
    // The configuration is constant and valid; without an encoder there is nothing to measure.
    let Ok(mut hex) = HexPlane::new("hex", &config, Aabb::cube(1.0), 1) else { return Vec::new() };
    let t = Time { normalised: 0.37, seconds: 0.37 };
    let mut rng = Rng::new(1, "bench points", 0, 0);
    let points: Vec<Vec3> =
        (0..POINTS).map(|_| Vec3::from_array(std::array::from_fn(|_| rng.range(-1.0, 1.0)))).collect();
    let (mut tape, mut d_points) = (HexTape::default(), vec![Vec3::ZERO; POINTS]);
    hex.forward(&points, t, &mut tape);
    let d: Vec<f32> = (0..hex.width()).map(|_| rng.normal()).collect();
    for block in &mut tape.blocks {
        block.d_features = d.iter().copied().cycle().take(block.features.len()).collect();
    }
    hex.backward(&mut tape, Some(&mut d_points));
    let [forward_error, backward_error] = errors(&hex, &points, t, &tape, &d, &d_points);
    let case = |variant, error_kind| Case {
        krate: "gs-deform",
        case: "hexplane 64^3x75, 2 levels".into(),
        variant,
        error_kind,
    };
    let work = POINTS as f64;
    vec![
        case("forward", "relative L2 of features, f64")
            .row(POINTS, work, forward_error, RUNS, || hex.forward(&points, t, &mut tape)),
        case("backward", "relative L2 of dL/d points, f64")
            .row(POINTS, work, backward_error, RUNS, || hex.backward(&mut tape, Some(&mut d_points))),
    ]
}

fn errors(hex: &HexPlane, points: &[Vec3], t: Time, tape: &HexTape, d: &[f32], d_points: &[Vec3]) -> [f64; 2] {
    let twin = HexPlaneRef::new(hex);
    let mut scratch: Vec<Vec<f64>> = twin.planes.iter().map(|p| vec![0.0; p.len()]).collect();
    let d: Vec<f64> = d.iter().map(|&v| f64::from(v)).collect();
    let (mut features, mut gradients) = (Vec::new(), Vec::new());
    for p in &points[..ERROR_POINTS] {
        let p = p.to_array().map(f64::from);
        features.extend(twin.features(p, t));
        gradients.extend(twin.backward(p, t, &d, &mut scratch));
    }
    let got = tape.blocks.iter().flat_map(|b| &b.features).map(|&v| f64::from(v));
    let got_back = d_points.iter().flat_map(|d| d.to_array()).map(f64::from);
    [relative_l2(got, features.into_iter()), relative_l2(got_back, gradients.into_iter())]
}
