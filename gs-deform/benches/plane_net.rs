//! Time and error of nets on planes at the sizes of the two stages of MoDec-GS and of 4DGS: the dense part against the
//! roof of the machine, the planes, and points that stay.
//!
//! Each row is printed and appended to `target/speed-error/gs-deform.jsonl`. `work` counts floating-point operations of
//! matrix products (two per multiply-add), or points. The roof is the machine's 1024³ product, one serial call per
//! thread. The dense part is the whole net less its planes, which are measured alone on the same points.

use glam::Vec3;
use gs_core::nn::gemm;
use gs_core::{Params, Rng, Time};
use gs_deform::encode::{HexPlane, HexPlaneConfig, HexTape};
use gs_deform::reference::PlaneNetRef;
use gs_deform::{Aabb, DeformError, PlaneNet, PlaneNetConfig, PlaneNetTape};
use rows::Rows;

mod rows;

const POINTS: usize = 50_000;
const ROWS: Rows = Rows { n: POINTS, runs: 15 };

/// A net to measure.
struct Case {
    name: &'static str,
    width: usize,
    resolution: [usize; 4],
    heads: &'static [(&'static str, usize)],
    /// Whether points get gradients.
    moving: bool,
}

const LGD: [(&str, usize); 3] = [("means", 3), ("scales", 3), ("quats", 4)];
const CASES: [Case; 3] = [
    Case { name: "local, width 128", width: 128, resolution: [64, 64, 64, 100], heads: &LGD, moving: true },
    Case { name: "local, width 64", width: 64, resolution: [64, 64, 64, 100], heads: &LGD, moving: true },
    Case {
        name: "global, width 128",
        width: 128,
        resolution: [32, 32, 32, 10],
        heads: &[("positions", 3), ("features", 32), ("offsets", 30), ("scales", 6)],
        moving: false,
    },
];

fn random(n: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::new(1, name, 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}

/// Points on a sphere inside the cube, as splats lie on surfaces.
fn points() -> Vec<Vec3> {
    let point = |row| {
        let mut rng = Rng::new(1, "points", 0, row);
        0.8 * Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize_or(Vec3::X)
    };
    (0..POINTS as u64).map(point).collect()
}

fn t() -> Time {
    Time { normalised: 0.37, seconds: 0.37 }
}

/// A net as after some training: features and outputs of order one.
fn net(case: &Case) -> Result<PlaneNet, DeformError> {
    let hexplane = HexPlaneConfig { resolution: case.resolution, channels: 16, ..HexPlaneConfig::default() };
    let config = PlaneNetConfig { width: case.width, depth: 1, zero_init: false, hexplane };
    let mut net = PlaneNet::new("net", &config, case.heads, Aabb::cube(1.0), 1)?;
    net.visit_mut(&mut |p| {
        let mut rng = Rng::new(2, &p.name, 0, 0);
        if p.name.starts_with("net.planes") {
            p.value.iter_mut().for_each(|v| *v = rng.range(0.6, 1.4));
        }
    });
    Ok(net)
}

/// Largest difference relative to the largest wanted value.
fn worst(pairs: &[(f64, f64)]) -> f64 {
    let (difference, size) =
        pairs.iter().fold((0.0f64, 1e-30f64), |(d, s), (a, b)| (d.max((a - b).abs()), s.max(b.abs())));
    difference / size
}

/// Errors of outputs and of gradients of points against the f64 reference, on the first points.
fn against_reference(net: &mut PlaneNet, case: &Case, tape: &mut PlaneNetTape, points: &[Vec3]) -> [f64; 2] {
    let names: Vec<&str> = case.heads.iter().map(|h| h.0).collect();
    let reference = PlaneNetRef::new("net", net, &names);
    let (mut grad, mut d_points) = (reference.zero_grad(), vec![Vec3::ZERO; points.len()]);
    net.forward(points, t(), tape);
    cotangents(case, tape);
    net.backward(tape, Some(&mut d_points));
    let (mut values, mut gradients) = (Vec::new(), Vec::new());
    for (r, p) in points[..100].iter().enumerate() {
        let p = p.to_array().map(f64::from);
        let block = &mut tape.blocks_mut()[0];
        let mut d = Vec::new();
        for (h, want) in reference.outputs(p, t()).iter().enumerate() {
            values.extend(block.head(h)[r * want.len()..].iter().map(|v| f64::from(*v)).zip(want.iter().copied()));
            d.push(block.head_grad_mut(h)[r * want.len()..][..want.len()].iter().map(|v| f64::from(*v)).collect());
        }
        let want = reference.backward(p, t(), &d, &mut grad);
        gradients.extend(d_points[r].to_array().map(f64::from).into_iter().zip(want));
    }
    [worst(&values), worst(&gradients)]
}

/// Fills in random cotangents.
fn cotangents(case: &Case, tape: &mut PlaneNetTape) {
    for block in tape.blocks_mut() {
        for (h, (name, _)) in case.heads.iter().enumerate() {
            let d = block.head_grad_mut(h);
            d.copy_from_slice(&random(d.len(), name));
        }
    }
}

/// Milliseconds of the planes alone, forward and both ways, as the net runs them.
fn planes(case: &Case, hex: &HexPlane, points: &[Vec3]) -> [f64; 2] {
    let (mut hex, mut tape, mut d_points) = (hex.clone(), HexTape::default(), vec![Vec3::ZERO; POINTS]);
    let places = hex.place(points);
    let mut run = |back: bool| {
        if case.moving {
            hex.forward(points, t(), &mut tape);
        } else {
            hex.forward_located(&places, t(), &mut tape);
        }
        if back {
            tape.blocks.iter_mut().for_each(|b| b.d_features.resize(b.features.len(), 0.5));
            hex.backward(&mut tape, case.moving.then_some(d_points.as_mut_slice()));
        }
    };
    let name = format!("planes of {}", case.name);
    [
        ROWS.measured(&name, "forward", POINTS as f64, None, || run(false)),
        ROWS.measured(&name, "forward and backward", POINTS as f64, None, || run(true)),
    ]
}

/// The net as a training step uses it, and the share of the roof its dense part reaches.
fn training(case: &Case, roof: f64) -> Result<(), DeformError> {
    let (mut net, points, mut tape) = (net(case)?, points(), PlaneNetTape::default());
    let [value, gradient] = against_reference(&mut net, case, &mut tape, &points);
    let [plane_forward, plane_both] = planes(case, &net.hexplane().clone(), &points);
    let outputs: usize = case.heads.iter().map(|h| h.1).sum();
    let per_row = net.hexplane().width() * case.width + case.heads.len() * case.width.pow(2) + outputs * case.width;
    let flops = 2.0 * (POINTS * per_row) as f64;
    let (places, mut d_points) = (net.place(&points), vec![Vec3::ZERO; POINTS]);
    let error = [Some((value, "outputs relative to f64")), Some((gradient, "d points relative to f64"))];
    let mut run = |back: bool| {
        if case.moving {
            net.forward(&points, t(), &mut tape);
        } else {
            net.forward_located(&places, t(), &mut tape);
        }
        if back {
            net.backward(&mut tape, case.moving.then_some(d_points.as_mut_slice()));
        }
    };
    let forward = ROWS.measured(case.name, "forward", flops, error[0], || run(false));
    let both = ROWS.measured(case.name, "forward and backward", 3.0 * flops, error[1], || run(true));
    for (variant, ms, work, error) in [
        ("forward", forward - plane_forward, flops, error[0]),
        ("forward and backward", both - plane_both, 3.0 * flops, error[1]),
    ] {
        ROWS.keep(&format!("dense of {}", case.name), variant, work, error, ms);
        println!("    {:.0} % of the roof of {roof:.0} GFLOP/s", 100.0 * work / ms / 1e6 / roof);
    }
    Ok(())
}

/// Static points: cells found at every call, or once.
fn places() -> Result<(), DeformError> {
    let (net, points) = (net(&CASES[2])?, points());
    let (hex, mut tape, mut want) = (net.hexplane(), HexTape::default(), HexTape::default());
    let found = hex.place(&points);
    hex.forward(&points, t(), &mut want);
    hex.forward_located(&found, t(), &mut tape);
    let differs = tape.blocks.iter().zip(&want.blocks).any(|(a, b)| a.features != b.features);
    let error = Some((f64::from(u8::from(differs)), "1 if a bit differs"));
    let anew = ROWS.measured("planes, points that stay", "placed anew", POINTS as f64, error, || {
        hex.forward(&points, t(), &mut tape);
    });
    let once = ROWS.measured("planes, points that stay", "placed once", POINTS as f64, error, || {
        hex.forward_located(&found, t(), &mut want);
    });
    println!("    forward pass of the planes in {:.0} % of the time", 100.0 * once / anew);
    Ok(())
}

fn main() -> Result<(), DeformError> {
    let roof = gemm::roof();
    roof.append(env!("CARGO_MANIFEST_DIR"));
    for case in &CASES {
        training(case, roof.rate())?;
    }
    places()
}
