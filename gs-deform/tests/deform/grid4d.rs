//! The Grid4D field, with and without its Fourier branch and gate, against a plain f64 reference: values, and every
//! kind of gradient against the reference's central differences. Then the exact savings on and off, and what must hold
//! to the last bit.
//!
//! Tolerances (f32 against f64, relative to the largest entry of the column or block, worst seen times about four):
//! | quantity | bound |
//! |---|---|
//! | moved splats | 2e-6 |
//! | gradients of splats | 2e-5 |
//! | gradients of parameters | 5e-5 |
//! | exact savings, on against off, values and gradients | 1e-5 |

use crate::support::{cotangents, row, time};
use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Geometry, Params, Rng};
use gs_deform::encode::HashGridConfig;
use gs_deform::field::grid4d::{ExactConfig, FourierConfig, Fusion, GateConfig, GateMode, WaveTime};
use gs_deform::reference::Grid4dRef;
use gs_deform::{DeformError, Field, Grid4dConfig, Grid4dField};

const MODES: [GateMode; 4] =
    [GateMode::ScaleParam, GateMode::LerpPosition, GateMode::TranslationOnly, GateMode::Literal];

/// Every eighth splat lies outside the cube; the first two sit on its faces.
fn splats(n: usize) -> Geometry {
    let mut s = Geometry::default();
    for row in 0..n {
        let mut rng = Rng::new(4, "splats", 0, row as u64);
        let mut vec3 = |lo, hi| Vec3::new(rng.range(lo, hi), rng.range(lo, hi), rng.range(lo, hi));
        s.means.push(match row {
            0 => Vec3::new(1.5, -1.5, 0.3),
            1 => Vec3::new(0.0, 0.0, -1.5),
            _ if row % 8 == 7 => Vec3::new(0.2, 1.6, -0.4),
            _ => vec3(-1.4, 1.4),
        });
        // Scales of either sign: only their squares matter.
        s.scales.push(vec3(-0.1, 0.3));
        s.quats.push([rng.normal(), rng.normal(), rng.normal(), rng.normal()]);
    }
    s
}

fn assert_close(got: &[f64], want: &[f64], bound: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(1e-12f64, |m, v| m.max(v.abs()));
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        assert!((g - w).abs() <= bound * largest, "{what}[{i}]: {g} against {w}, error {:e}", (g - w).abs() / largest);
    }
}

/// A small field with levels of every kind: dense, hashed, and of a size of its own along each axis.
fn small() -> Grid4dConfig {
    let plain = Grid4dConfig::default();
    Grid4dConfig {
        bound: 1.5,
        canonical: HashGridConfig { base: [3.0; 3], end: [5.0, 6.0, 9.0], levels: 3, log2_table: 7 },
        temporal: HashGridConfig { base: [2.0, 3.0, 4.0], end: [4.0, 5.0, 6.0], levels: 2, log2_table: 6 },
        width: 16,
        zero_init: false,
        fourier: FourierConfig { bands: 8, ..plain.fourier },
        ..plain
    }
}

fn grid4d(config: Grid4dConfig) -> Grid4dConfig {
    Grid4dConfig {
        fourier: FourierConfig { on: false, ..config.fourier.clone() },
        gate: GateConfig { on: false, ..config.gate },
        ..config
    }
}

/// A field whose every parameter matters: features and amplitudes of order one.
fn field(config: &Grid4dConfig) -> Grid4dField {
    let mut field = Grid4dField::new(config, 3).unwrap();
    field.visit_mut(&mut |p| {
        let mut rng = Rng::new(1, &p.name, 1, 0);
        if p.name.starts_with("field.grids") {
            p.value.iter_mut().for_each(|v| *v = rng.normal());
        } else if p.name.starts_with("field.net.amplitude") {
            p.value.iter_mut().for_each(|v| *v = 0.3 * rng.normal());
        }
    });
    field
}

/// Runs a field forward and backward on `n` splats and compares everything with the reference; `stride`: every how many
/// parameter values are checked.
fn compare(config: &Grid4dConfig, n: usize, t: f32, stride: usize) {
    let (mut field, s, t) = (field(config), splats(n), time(t));
    let (mut tape, mut out) = (Default::default(), Geometry::default());
    field.forward(s.view(), t, &mut tape, &mut out);
    let (d_out, mut d) = (cotangents(s.len(), 1), Geometry::zeros(s.len()));
    field.backward(s.view(), &mut tape, d_out.view(), &mut d);
    let reference = Grid4dRef::new(&field);
    let place = |r: usize| s.means[r].to_array().map(f64::from);
    let loss = |reference: &Grid4dRef, v: [f64; 10], r: usize| -> f64 {
        let weights = row(&d_out.means, &d_out.quats, &d_out.scales, r);
        reference.moved(place(r), v, t).iter().zip(weights).map(|(m, w)| m * w).sum()
    };
    let (mut got, mut want, mut got_d, mut want_d) = (vec![], vec![], vec![], vec![]);
    let h = 1e-6;
    for r in 0..n {
        let v = row(&s.means, &s.quats, &s.scales, r);
        got.extend(row(&out.means, &out.quats, &out.scales, r));
        want.extend(reference.moved(place(r), v, t));
        got_d.extend(row(&d.means, &d.quats, &d.scales, r));
        want_d.extend((0..10).map(|k| {
            let (mut hi, mut lo) = (v, v);
            hi[k] += h;
            lo[k] -= h;
            (loss(&reference, hi, r) - loss(&reference, lo, r)) / (2.0 * h)
        }));
    }
    assert_close(&got, &want, 2e-6, "moved splats");
    assert_close(&got_d, &want_d, 2e-5, "gradients of splats");

    field.visit(&mut |p| {
        let (mut reference, mut got, mut want) = (reference.clone(), vec![], vec![]);
        let largest = p.grad.iter().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).map_or(0, |m| m.0);
        for i in (0..p.len()).step_by(stride).chain([largest]) {
            let mut total = |step: f64| -> f64 {
                reference.block(&p.name).unwrap()[i] = f64::from(p.value[i]) + step;
                (0..n).map(|r| loss(&reference, row(&s.means, &s.quats, &s.scales, r), r)).sum()
            };
            want.push((total(h) - total(-h)) / (2.0 * h));
            total(0.0);
            got.push(f64::from(p.grad[i]));
        }
        assert!(p.grad[largest] != 0.0, "{} has no gradient", p.name);
        assert_close(&got, &want, 5e-5, &p.name);
    });
}

#[test]
fn fags_agrees_with_its_reference_in_every_mode_of_the_gate() {
    for mode in MODES {
        compare(&Grid4dConfig { gate: GateConfig { on: true, mode, start: 0.5 }, ..small() }, 17, 0.37, 11);
    }
}

#[test]
fn every_fusion_and_depth_agrees_with_its_reference() {
    let fourier = |fusion, bands, hidden: &[usize]| FourierConfig {
        fusion,
        bands,
        hidden: hidden.to_vec(),
        gamma_max: 5.0,
        gain: 0.7,
        time: WaveTime::Scaled,
        on: true,
    };
    let full = ExactConfig { time_slicing: false, fourier_collapse: false, cached_attention: false };
    for (depth, fourier, exact) in [
        (0, fourier(Fusion::Add, 8, &[]), full),
        (0, fourier(Fusion::Add, 8, &[]), small().exact),
        (2, fourier(Fusion::Add, 8, &[]), small().exact),
        (0, fourier(Fusion::Add, 8, &[5]), small().exact),
        (1, fourier(Fusion::Mul, 8, &[]), full),
        (0, fourier(Fusion::Concat, 3, &[7, 4]), small().exact),
    ] {
        compare(&Grid4dConfig { depth, fourier, exact, ..small() }, 9, 0.8, 17);
    }
}

#[test]
fn grid4d_agrees_with_its_reference() {
    compare(&grid4d(small()), 17, 0.0, 7);
    compare(&Grid4dConfig { directional: false, depth: 1, ..grid4d(small()) }, 3, 1.0, 7);
    compare(&Grid4dConfig { compat_grid4d: true, ..grid4d(small()) }, 17, 0.5, 13);
    // Beyond the cube's time the grids hold their end values.
    compare(&small(), 5, 1.4, 23);
}

#[test]
fn an_untrained_field_is_the_identity_to_the_last_bit() {
    let s = splats(2 * BLOCK + 5);
    for gate in MODES[..3].iter().map(|&mode| GateConfig { on: true, mode, start: 0.5 }) {
        let plain = Grid4dConfig { zero_init: true, gate, ..small() };
        for config in [plain.clone(), grid4d(plain)] {
            let (field, mut tape, mut out) = (field(&config), Default::default(), Geometry::default());
            for t in [-0.5, 0.0, 0.3, 1.0, 2.0] {
                field.forward(s.view(), time(t), &mut tape, &mut out);
                assert!(out == s, "t = {t}");
            }
        }
    }
}

#[test]
fn the_gate_starts_at_its_setting() {
    let s = splats(16);
    let config = |start| Grid4dConfig { zero_init: true, gate: GateConfig { start, ..small().gate }, ..small() };
    for start in [0.05, 0.5, 0.9] {
        let quantities = Grid4dField::new(&config(start), 1).unwrap().quantities(s.view(), time(0.3));
        let (name, gate) = &quantities[0];
        assert_eq!((*name, gate.len()), ("gate", 16));
        for (row, &eta) in gate.iter().enumerate() {
            let want = if row % 8 == 7 { 0.0 } else { start };
            assert!((eta - want).abs() < 1e-6, "splat {row}: {eta}, {want} expected");
        }
    }
    for start in [0.0, 1.0, f32::NAN] {
        let refused = Grid4dField::new(&config(start), 1);
        assert!(matches!(refused, Err(DeformError::Config { field: "start", .. })));
    }
}

#[test]
fn outside_the_cube_nothing_moves_and_nothing_has_a_gradient() {
    let far = Geometry { means: vec![Vec3::new(0.0, 1.51, 0.0); 3], ..splats(3) };
    let (mut field, mut tape, mut out) = (field(&small()), Default::default(), Geometry::default());
    field.forward(far.view(), time(0.6), &mut tape, &mut out);
    assert_eq!(out, far);
    let (d_out, mut d) = (cotangents(far.len(), 1), Geometry::zeros(far.len()));
    field.backward(far.view(), &mut tape, d_out.view(), &mut d);
    assert_eq!((d.means, d.scales, d.quats), (d_out.means, d_out.scales, d_out.quats));
    field.visit(&mut |p| assert!(p.grad.iter().all(|g| *g == 0.0), "{}", p.name));
    assert_eq!(field.quantities(far.view(), time(0.6)), [("gate", vec![0.0; 3])]);
}

/// Everything a step produces, as numbers.
fn step(field: &mut Grid4dField, tape: &mut <Grid4dField as Field>::Tape, n: usize, t: f32) -> Vec<Vec<f32>> {
    let (s, mut out) = (splats(n), Geometry::default());
    field.clear_grads();
    field.forward(s.view(), time(t), tape, &mut out);
    let mut d = Geometry::zeros(s.len());
    field.backward(s.view(), tape, cotangents(s.len(), 2).view(), &mut d);
    let flat = |v: &[Vec3]| v.iter().flat_map(|v| v.to_array()).collect::<Vec<f32>>();
    let mut all = vec![flat(&out.means), flat(&out.scales), flat(&d.means), flat(&d.scales)];
    all.extend([out.quats.as_flattened().to_vec(), d.quats.as_flattened().to_vec()]);
    field.visit(&mut |p| all.push(p.grad.clone()));
    all
}

fn step_and_regularise(field: &mut Grid4dField, tape: &mut <Grid4dField as Field>::Tape, n: usize, t: f32) -> Vec<u32> {
    let mut all = step(field, tape, n, t);
    all.push(field.regularise(splats(n).view(), time(t), 5).iter().map(|v| v.1).collect());
    field.visit(&mut |p| all.push(p.grad.clone()));
    all.iter().flatten().map(|v| v.to_bits()).collect()
}

#[test]
fn exact_savings_change_rounding_only() {
    let off = ExactConfig { time_slicing: false, fourier_collapse: false, cached_attention: false };
    let plain = small();
    for config in [plain.clone(), Grid4dConfig { depth: 1, ..plain.clone() }, grid4d(plain)] {
        let slow = Grid4dConfig { exact: off, ..config.clone() };
        for t in [0.0, 0.41, 1.0] {
            let fast = step(&mut field(&config), &mut Default::default(), BLOCK + 9, t);
            let slow = step(&mut field(&slow), &mut Default::default(), BLOCK + 9, t);
            for (i, (a, b)) in fast.iter().zip(&slow).enumerate() {
                let wide = |v: &[f32]| v.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
                assert_close(&wide(a), &wide(b), 1e-5, &format!("column {i} at {t}"));
            }
        }
    }
}

#[test]
fn threads_and_warm_tapes_change_no_bit() {
    for config in [small(), Grid4dConfig { fourier: FourierConfig { hidden: vec![5], ..small().fourier }, ..small() }] {
        // More blocks than chunks, and a ragged end.
        let n = 11 * BLOCK + 17;
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| step_and_regularise(&mut field(&config), &mut Default::default(), n, 0.4))
        };
        let one = on(1);
        assert!(one == on(2) && one == on(8), "results depend on the number of threads");
        let (mut warm, mut tape) = (field(&config), Default::default());
        for n in [n + 300, 0, 1, 15, 16, 17, BLOCK, BLOCK + 1] {
            let fresh = step_and_regularise(&mut field(&config), &mut Default::default(), n, 0.9);
            assert!(step_and_regularise(&mut warm, &mut tape, n, 0.9) == fresh, "n = {n}");
        }
        assert!(step_and_regularise(&mut warm, &mut tape, n, 0.4) == one, "a warm tape changes the result");
    }
}

#[test]
fn gradients_are_added_not_overwritten() {
    let (mut field, s, mut tape) = (field(&small()), splats(20), Default::default());
    let d_out = cotangents(s.len(), 1);
    field.forward(s.view(), time(0.5), &mut tape, &mut Geometry::default());
    let mut d = Geometry::zeros(s.len());
    let grads = |field: &Grid4dField| {
        let mut all = Vec::new();
        field.visit(&mut |p| all.extend(p.grad.iter().map(|&g| f64::from(g))));
        all
    };
    field.backward(s.view(), &mut tape, d_out.view(), &mut d);
    let (once, first) = (grads(&field), d.means[3]);
    field.backward(s.view(), &mut tape, d_out.view(), &mut d);
    assert_close(&grads(&field), &once.iter().map(|g| 2.0 * g).collect::<Vec<_>>(), 1e-6, "parameters");
    assert!((d.means[3] - 2.0 * first).abs().max_element() < 1e-5 * first.length());
}

#[test]
fn another_time_with_a_warm_tape_gives_the_same_bits() {
    for cached_attention in [true, false] {
        for collapse in [true, false] {
            let exact = ExactConfig { cached_attention, fourier_collapse: collapse, ..small().exact };
            let (field, s) = (field(&Grid4dConfig { exact, ..small() }), splats(BLOCK + 40));
            let (mut again, mut anew) = (Default::default(), Default::default());
            let (mut out, mut want) = (Geometry::default(), Geometry::default());
            field.forward(s.view(), time(0.3), &mut again, &mut out);
            for t in [0.1, 0.9, 0.5] {
                field.forward_again(s.view(), time(t), &mut again, &mut out);
                field.forward(s.view(), time(t), &mut anew, &mut want);
                assert!(out == want, "collapse {collapse}, cache {cached_attention}");
            }
        }
    }
}

#[test]
fn the_gate_is_reported_only_where_there_is_one() {
    let s = splats(9);
    let gates = field(&small()).quantities(s.view(), time(0.3));
    let reference = Grid4dRef::new(&field(&small()));
    for (r, gate) in gates[0].1.iter().enumerate().filter(|(r, _)| r % 8 != 7) {
        let raw = reference.head(s.means[r].to_array().map(f64::from), time(0.3))[0];
        assert!((f64::from(*gate) - 1.0 / (1.0 + (-raw).exp())).abs() < 1e-6);
    }
    assert!(field(&grid4d(small())).quantities(s.view(), time(0.3)).is_empty());
}

#[test]
fn names_are_those_of_the_parts() {
    let mut names = Vec::new();
    field(&Grid4dConfig { depth: 1, ..small() }).visit(&mut |p| names.push(p.name.clone()));
    let layers = ["space", "time", "amplitude.0", "hidden.0", "head"];
    let want: Vec<String> = ["xyz", "xyt", "yzt", "xzt"]
        .iter()
        .map(|g| format!("field.grids.{g}"))
        .chain(layers.iter().flat_map(|l| ["weight", "bias"].map(|p| format!("field.net.{l}.{p}"))))
        .collect();
    assert_eq!(names, want);
}

#[test]
fn bad_settings_are_named() {
    let error = |config: Grid4dConfig| match Grid4dField::new(&config, 0) {
        Err(DeformError::Config { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    assert_eq!(error(Grid4dConfig { bound: f32::NAN, ..small() }), "bound");
    assert_eq!(error(Grid4dConfig { width: 10, ..small() }), "bands");
    assert_eq!(
        error(Grid4dConfig { canonical: HashGridConfig { levels: 0, ..small().canonical }, ..small() }),
        "levels"
    );
}
