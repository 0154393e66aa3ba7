//! Both fields against a plain f64 reference: values, and every kind of gradient against the reference's central
//! differences. Then what must hold to the last bit: the untrained field is the identity, threads change nothing, a
//! warm tape neither.
//!
//! Tolerances (f32 against f64, relative to the largest entry of the column or block, worst seen times about four):
//! | quantity | bound |
//! |---|---|
//! | moved splats | 2e-6 |
//! | gradients of splats | 2e-5 |
//! | gradients of parameters | 5e-5 |

use crate::support::{cotangents, row, time};
use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Geometry, Params, Rng, Time};
use gs_deform::apply::{QuatRule, ScaleRule};
use gs_deform::encode::HexPlaneConfig;
use gs_deform::reference::HexPlaneRef;
use gs_deform::{Aabb, DefGsConfig, DefMlp, DeformError, Field, FourDgsConfig, HexPlaneField};
use std::collections::BTreeMap;

type Blocks = BTreeMap<String, Vec<f64>>;

/// A field's f64 reference: one splat (mean, quat, scale flat) at a time; `query` is the point the field is sampled at.
type Reference<'a> = dyn Fn(&Blocks, [f64; 3], [f64; 10]) -> [f64; 10] + 'a;

fn splats(n: usize) -> Geometry {
    let mut s = Geometry::default();
    for row in 0..n {
        let mut rng = Rng::new(4, "splats", 0, row as u64);
        let mut vec3 = |lo, hi| Vec3::new(rng.range(lo, hi), rng.range(lo, hi), rng.range(lo, hi));
        s.means.push(if row % 8 == 7 { Vec3::new(2.0, 5.0, -9.0) } else { vec3(-1.2, 1.2) });
        s.scales.push(vec3(0.01, 0.3));
        s.quats.push([rng.normal(), rng.normal(), rng.normal(), rng.normal()]);
    }
    s
}

fn blocks(params: &impl Params) -> Blocks {
    let mut all = Blocks::new();
    params.visit(&mut |p| {
        all.insert(p.name.clone(), p.value.iter().map(|&v| f64::from(v)).collect());
    });
    all
}

fn dense(blocks: &Blocks, name: &str, x: &[f64]) -> Vec<f64> {
    let rows = blocks[&format!("{name}.weight")].chunks(x.len());
    let dot = |(w, b): (&[f64], &f64)| w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b;
    rows.zip(&blocks[&format!("{name}.bias")]).map(dot).collect()
}

fn relu(mut x: Vec<f64>) -> Vec<f64> {
    x.iter_mut().for_each(|v| *v = v.max(0.0));
    x
}

fn fourdgs_reference<'a>(
    hex: &'a HexPlaneRef,
    t: Time,
    depth: usize,
    scale_rule: ScaleRule,
) -> impl Fn(&Blocks, [f64; 3], [f64; 10]) -> [f64; 10] + 'a {
    move |blocks, query, s| {
        let mut hex = hex.clone();
        let names = blocks.keys().filter(|k| k.starts_with("field.planes")).count();
        for level in 0..names / 6 {
            for (pair, name) in ["xy", "xz", "xt", "yz", "yt", "zt"].into_iter().enumerate() {
                hex.planes[level * 6 + pair] = blocks[&format!("field.planes.{name}.{level}")].clone();
            }
        }
        let mut h = hex.features(query, t);
        for i in 0..depth {
            h = relu(dense(blocks, &format!("field.trunk.{i}"), &h));
        }
        // The first layers of the heads that exist lie one below the other.
        let hidden = relu(dense(blocks, "field.hidden", &h));
        let exists = |name: &&str| blocks.contains_key(&format!("field.{name}.weight"));
        let head = |name: &str, n: usize| {
            let index = ["means", "scales", "quats"].into_iter().filter(exists).position(|other| other == name);
            index.map_or(vec![0.0; n], |k| dense(blocks, &format!("field.{name}"), &hidden[k * h.len()..][..h.len()]))
        };
        let (x, r, z) = (head("means", 3), head("quats", 4), head("scales", 3));
        std::array::from_fn(|k| match k {
            0..3 => s[k] + x[k],
            3..7 => s[k] + r[k - 3],
            _ if scale_rule == ScaleRule::Log => s[k] * z[k - 7].exp(),
            _ => (s[k] + z[k - 7]).abs(),
        })
    }
}

fn encode(p: f64, bands: usize) -> Vec<f64> {
    let wave = |k: usize| p * f64::from(1 << k);
    std::iter::once(p).chain((0..bands).flat_map(|k| [wave(k).sin(), wave(k).cos()])).collect()
}

fn hamilton(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    gs_core::rot::hamilton(a, b)
}

fn defgs_reference(config: DefGsConfig, t: Time) -> impl Fn(&Blocks, [f64; 3], [f64; 10]) -> [f64; 10] {
    move |blocks, query, s| {
        let coded = query.map(|v| encode(v * f64::from(config.coordinate_scale), config.bands_position));
        let mut input: Vec<f64> = (0..coded[0].len()).flat_map(|k| [coded[0][k], coded[1][k], coded[2][k]]).collect();
        let mut tau = encode(f64::from(t.normalised), config.bands_time);
        if config.time_hidden > 0 {
            tau = dense(blocks, "field.time.1", &relu(dense(blocks, "field.time.0", &tau)));
        }
        input.extend(tau);
        let mut h = Vec::new();
        for i in 0..config.depth {
            let joined = if i == 0 || i == config.skip + 1 { [input.clone(), h].concat() } else { h };
            let slope = f64::from(config.leak);
            h = dense(blocks, &format!("field.layer.{i}"), &joined).iter().map(|v| v.max(slope * v)).collect();
        }
        let (x, r, z) =
            (dense(blocks, "field.means", &h), dense(blocks, "field.quats", &h), dense(blocks, "field.scales", &h));
        let q = [s[3], s[4], s[5], s[6]];
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let q = match config.quat_rule {
            QuatRule::Raw => std::array::from_fn(|k| q[k] + r[k]),
            QuatRule::Unit => std::array::from_fn(|k| length * (q[k] / length + r[k])),
            QuatRule::Compose => {
                let turn = [1.0 + r[0], r[1], r[2], r[3]];
                let norm = turn.iter().map(|v| v * v).sum::<f64>().sqrt();
                hamilton(turn.map(|v| v / norm), q)
            }
        };
        std::array::from_fn(|k| match k {
            0..3 => s[k] + x[k],
            3..7 => q[k - 3],
            _ if config.scale_rule == ScaleRule::Log => s[k] * z[k - 7].exp(),
            _ => s[k] + z[k - 7],
        })
    }
}

fn assert_close(got: &[f64], want: &[f64], bound: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(1e-12f64, |m, v| m.max(v.abs()));
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        assert!((g - w).abs() <= bound * largest, "{what}[{i}]: {g} against {w}, error {:e}", (g - w).abs() / largest);
    }
}

/// Runs a field forward and backward on `n` splats and compares everything with the reference. `detached`: the point
/// the field is sampled at is a constant. `stride`: every how many parameter values are checked.
fn compare<F: Field>(mut field: F, n: usize, t: Time, detached: bool, reference: &Reference<'_>, stride: usize) {
    let (s, mut tape, mut out) = (splats(n), F::Tape::default(), Geometry::default());
    field.forward(s.view(), t, &mut tape, &mut out);
    let d_out = cotangents(s.len(), 1);
    let mut d = Geometry::zeros(s.len());
    field.backward(s.view(), &mut tape, d_out.view(), &mut d);
    let params = blocks(&field);
    let weights = |r| row(&d_out.means, &d_out.quats, &d_out.scales, r);
    let at = |query: Option<[f64; 3]>, params: &Blocks, v: [f64; 10], r| -> f64 {
        let moved = reference(params, query.unwrap_or([v[0], v[1], v[2]]), v);
        moved.iter().zip(weights(r)).map(|(m, w)| m * w).sum()
    };
    let (mut got, mut want, mut got_d, mut want_d) = (vec![], vec![], vec![], vec![]);
    let h = 1e-6;
    for r in 0..n {
        let v = row(&s.means, &s.quats, &s.scales, r);
        let fixed = detached.then_some([v[0], v[1], v[2]]);
        got.extend(row(&out.means, &out.quats, &out.scales, r));
        want.extend(reference(&params, [v[0], v[1], v[2]], v));
        got_d.extend(row(&d.means, &d.quats, &d.scales, r));
        want_d.extend((0..10).map(|k| {
            let (mut hi, mut lo) = (v, v);
            hi[k] += h;
            lo[k] -= h;
            (at(fixed, &params, hi, r) - at(fixed, &params, lo, r)) / (2.0 * h)
        }));
    }
    assert_close(&got, &want, 2e-6, "moved splats");
    assert_close(&got_d, &want_d, 2e-5, "gradients of splats");

    field.visit(&mut |p| {
        let (mut params, mut got, mut want) = (params.clone(), vec![], vec![]);
        let largest = p.grad.iter().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).map_or(0, |m| m.0);
        for i in (0..p.len()).step_by(stride).chain([largest]) {
            let mut loss = |step: f64| -> f64 {
                params.get_mut(&p.name).unwrap()[i] = f64::from(p.value[i]) + step;
                (0..n)
                    .map(|r| row(&s.means, &s.quats, &s.scales, r))
                    .enumerate()
                    .map(|(r, v)| at(None, &params, v, r))
                    .sum()
            };
            want.push((loss(h) - loss(-h)) / (2.0 * h));
            loss(0.0);
            got.push(f64::from(p.grad[i]));
        }
        assert_close(&got, &want, 5e-5, &p.name);
    });
}

fn small_hexplane() -> HexPlaneConfig {
    HexPlaneConfig { resolution: [4, 5, 3, 6], levels: vec![1, 2], channels: 16, ..HexPlaneConfig::default() }
}

fn small_fourdgs() -> FourDgsConfig {
    FourDgsConfig { width: 12, zero_init: false, hexplane: small_hexplane(), ..FourDgsConfig::default() }
}

/// A field whose every parameter matters: time planes off 1, features of order one.
fn fourdgs(config: &FourDgsConfig) -> HexPlaneField {
    let mut field = HexPlaneField::new("field", config, Aabb::cube(1.0), 3).unwrap();
    field.visit_mut(&mut |p| {
        if p.name.starts_with("field.planes") {
            let mut rng = Rng::new(1, &p.name, 1, 0);
            p.value.iter_mut().for_each(|v| *v = rng.range(0.6, 1.4));
        }
    });
    field
}

fn small_defgs() -> DefGsConfig {
    DefGsConfig {
        width: 14,
        depth: 4,
        skip: 1,
        bands_position: 5,
        bands_time: 3,
        time_hidden: 9,
        time_features: 4,
        zero_init: false,
        ..DefGsConfig::default()
    }
}

#[test]
fn fourdgs_agrees_with_its_reference() {
    let t = time(0.37);
    for (n, config) in [
        (17, small_fourdgs()),
        (19, FourDgsConfig { scale_rule: ScaleRule::Add, ..small_fourdgs() }),
        (3, FourDgsConfig { depth: 3, detach_coordinates: true, ..small_fourdgs() }),
        (2, FourDgsConfig { depth: 0, move_scales: false, move_quats: false, ..small_fourdgs() }),
    ] {
        let field = fourdgs(&config);
        let hex = HexPlaneRef::new(field.hexplane());
        let reference = fourdgs_reference(&hex, t, config.depth.max(1), config.scale_rule);
        compare(field, n, t, config.detach_coordinates, &reference, 37);
    }
}

#[test]
fn planes_can_be_sampled_elsewhere_than_at_the_means() {
    let config = small_fourdgs();
    let (mut field, t, n) = (fourdgs(&config), time(0.37), 2 * BLOCK + 5);
    let (s, d_out) = (splats(n), cotangents(n, 2));
    let (mut tape, mut out, mut same) = (Default::default(), Geometry::default(), Geometry::default());
    field.forward(s.view(), t, &mut tape, &mut out);
    let mut d = Geometry::zeros(n);
    field.clear_grads();
    field.backward(s.view(), &mut tape, d_out.view(), &mut d);
    let mut grads = Vec::new();
    field.visit(&mut |p| grads.push(p.grad.clone()));
    // At the means: the same, and both parts of the cotangent add up to that of the means.
    field.forward_at(&s.means, s.view(), t, &mut tape, &mut same);
    assert_eq!(out, same);
    let (mut d_at, mut d_places) = (Geometry::zeros(n), vec![Vec3::ZERO; n]);
    field.clear_grads();
    field.backward_at(s.view(), &mut tape, d_out.view(), &mut d_at, &mut d_places);
    let mut again = Vec::new();
    field.visit(&mut |p| again.push(p.grad.clone()));
    assert_eq!(grads, again);
    for (whole, (a, b)) in d.means.iter().zip(d_at.means.iter().zip(&d_places)) {
        assert!((*whole - *a - *b).length() <= 1e-5 * (1.0 + whole.length()), "{whole} {a} {b}");
    }
    assert!(d_places.iter().any(|p| p.length() > 1e-3));
    // Elsewhere: the offsets of those places.
    let places: Vec<Vec3> = s.means.iter().map(|m| *m * 0.5 + 0.1).collect();
    field.forward_at(&places, s.view(), t, &mut tape, &mut same);
    let mut offsets = Default::default();
    field.offsets_at(&places, t, &mut tape, &mut offsets);
    for (i, moved) in same.means.iter().enumerate() {
        assert_eq!(*moved, s.means[i] + Vec3::from_slice(&offsets.means[3 * i..]));
    }
}

#[test]
fn defgs_agrees_with_its_reference() {
    for (n, t, config) in [
        (17, 0.6, small_defgs()),
        (
            3,
            1.0,
            DefGsConfig { time_hidden: 0, quat_rule: QuatRule::Compose, scale_rule: ScaleRule::Log, ..small_defgs() },
        ),
        (7, 0.4, DefGsConfig { leak: 0.1, ..small_defgs() }),
        (2, 0.0, DefGsConfig { depth: 1, quat_rule: QuatRule::Raw, coordinate_scale: 0.3, ..small_defgs() }),
    ] {
        let reference = defgs_reference(config.clone(), time(t));
        compare(DefMlp::new(&config, 5).unwrap(), n, time(t), true, &reference, 11);
    }
}

fn identity<F: Field>(field: F) {
    let (s, mut tape, mut out) = (splats(2 * BLOCK + 5), F::Tape::default(), Geometry::default());
    for t in [-0.5, 0.0, 0.3, 1.0, 2.0] {
        field.forward(s.view(), time(t), &mut tape, &mut out);
        assert_eq!(out, s, "t = {t}");
    }
}

#[test]
fn an_untrained_field_is_the_identity_to_the_last_bit() {
    identity(
        HexPlaneField::new(
            "field",
            &FourDgsConfig { hexplane: small_hexplane(), ..Default::default() },
            Aabb::cube(1.0),
            0,
        )
        .unwrap(),
    );
    for quat_rule in [QuatRule::Raw, QuatRule::Unit, QuatRule::Compose] {
        for scale_rule in [ScaleRule::Add, ScaleRule::Log] {
            identity(DefMlp::new(&DefGsConfig { quat_rule, scale_rule, ..DefGsConfig::fast() }, 0).unwrap());
        }
    }
}

/// Everything a step produces, as bits.
fn step<F: Field>(field: &mut F, tape: &mut F::Tape, n: usize, t: f32) -> Vec<u32> {
    let (s, mut out) = (splats(n), Geometry::default());
    field.clear_grads();
    field.forward(s.view(), time(t), tape, &mut out);
    let mut d = Geometry::zeros(s.len());
    field.backward(s.view(), tape, cotangents(s.len(), 2).view(), &mut d);
    let terms = field.regularise(s.view(), time(t), 1);
    let mut bits: Vec<u32> = terms.iter().map(|v| v.1.to_bits()).collect();
    for v in [&out.means, &out.scales, &d.means, &d.scales] {
        bits.extend(v.iter().flat_map(|v| v.to_array()).map(f32::to_bits));
    }
    bits.extend(out.quats.iter().chain(&d.quats).flatten().map(|v| v.to_bits()));
    field.visit(&mut |p| bits.extend(p.grad.iter().map(|v| v.to_bits())));
    bits
}

fn reproducible<F: Field>(make: impl Fn() -> F + Sync) {
    // More blocks than chunks, and a ragged end.
    let n = 11 * BLOCK + 17;
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| step(&mut make(), &mut F::Tape::default(), n, 0.4))
    };
    let one = on(1);
    assert!(one == on(2) && one == on(4), "results depend on the number of threads");
    let (mut field, mut tape) = (make(), F::Tape::default());
    for n in [n + 300, 0, 1, 15, 16, 17, BLOCK, BLOCK + 1] {
        assert_eq!(step(&mut field, &mut tape, n, 0.9), step(&mut make(), &mut F::Tape::default(), n, 0.9), "n = {n}");
    }
    assert!(step(&mut field, &mut tape, n, 0.4) == one, "a warm tape changes the result");
}

#[test]
fn threads_and_warm_tapes_change_no_bit() {
    reproducible(|| fourdgs(&small_fourdgs()));
    reproducible(|| DefMlp::new(&small_defgs(), 5).unwrap());
}

#[test]
fn gradients_are_added_not_overwritten() {
    let mut field = fourdgs(&small_fourdgs());
    let (s, mut tape, mut out) = (splats(20), Default::default(), Geometry::default());
    let d_out = cotangents(s.len(), 1);
    let (mut once, mut twice) = (Geometry::zeros(s.len()), Geometry::zeros(s.len()));
    field.forward(s.view(), time(0.5), &mut tape, &mut out);
    field.backward(s.view(), &mut tape, d_out.view(), &mut once);
    let first = blocks_of_grads(&field);
    for _ in 0..2 {
        field.backward(s.view(), &mut tape, d_out.view(), &mut twice);
    }
    let third = blocks_of_grads(&field);
    for (a, b) in once.means.iter().zip(&twice.means) {
        assert!((2.0 * *a - *b).abs().max_element() <= 1e-6 * (1.0 + b.abs().max_element()), "{a} {b}");
    }
    for (a, b) in first.iter().zip(&third) {
        assert!((3.0 * a - b).abs() <= 1e-5 * (1.0 + b.abs()), "{a} {b}");
    }
}

fn blocks_of_grads(params: &impl Params) -> Vec<f32> {
    let mut all = Vec::new();
    params.visit(&mut |p| all.extend_from_slice(&p.grad));
    all
}

#[test]
fn bad_settings_are_named() {
    let error = |e: Result<HexPlaneField, DeformError>| e.unwrap_err().to_string();
    let config = FourDgsConfig { width: 0, ..Default::default() };
    assert!(error(HexPlaneField::new("field", &config, Aabb::cube(1.0), 0)).contains("`width` = 0"));
    let mut config = FourDgsConfig::default();
    config.hexplane.channels = 5;
    assert!(error(HexPlaneField::new("field", &config, Aabb::cube(1.0), 0)).contains("`channels` = 5"));
    let error = |config| DefMlp::new(&config, 0).unwrap_err().to_string();
    assert!(error(DefGsConfig { leak: 1.5, ..Default::default() }).contains("`leak` = 1.5"));
    assert!(error(DefGsConfig { depth: 0, ..Default::default() }).contains("`depth` = 0"));
    assert!(
        error(DefGsConfig { coordinate_scale: f32::NAN, ..Default::default() }).contains("`coordinate_scale` = NaN")
    );
}
