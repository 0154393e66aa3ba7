//! Nets on planes in three levels: what must hold by construction, the f64 reference against central differences, the
//! fast net against the reference. Then what must hold to the last bit.
//!
//! Tolerances (f32: worst seen times about four):
//! | quantity | against | relative to | bound |
//! |---|---|---|---|
//! | reference's gradients | its central differences | 1 + value | 1e-6 |
//! | outputs, f32 | reference | largest of the head | 1.5e-5 |
//! | gradients of layers, f32 | reference | largest of the block | 2e-5 |
//! | gradients of planes, f32 | reference | largest of the plane | 2e-5 |
//! | gradients of points, f32 | reference | largest | 2e-5 |

use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Params, Rng, Time};
use gs_deform::encode::HexPlaneConfig;
use gs_deform::reference::{PlaneNetRef, PlaneNetRefGrad};
use gs_deform::{Aabb, DefGsConfig, DefMlp, Grid4dConfig, PlaneNet, PlaneNetConfig, PlaneNetTape};

type Heads = &'static [(&'static str, usize)];

const LOCAL: Heads = &[("means", 3), ("scales", 3), ("quats", 4)];
const GLOBAL: Heads = &[("positions", 3), ("features", 32), ("offsets", 30), ("scales", 6)];
const ONE: Heads = &[("only", 1)];

fn time(t: f32) -> Time {
    Time::new(t).unwrap()
}

fn config(width: usize, depth: usize) -> PlaneNetConfig {
    let hexplane =
        HexPlaneConfig { resolution: [5, 4, 3, 7], levels: vec![1, 2], channels: 16, ..HexPlaneConfig::default() };
    PlaneNetConfig { width, depth, zero_init: false, hexplane }
}

/// A net whose every parameter matters: planes of order one and of both signs, some texels zero.
fn net(config: &PlaneNetConfig, heads: Heads) -> PlaneNet {
    let aabb = Aabb::new(Vec3::new(-1.0, -2.0, 0.5), Vec3::new(2.0, 1.0, 1.5)).unwrap();
    let mut net = PlaneNet::new("gad", config, heads, aabb, 3).unwrap();
    net.visit_mut(&mut |p| {
        let mut rng = Rng::new(1, &p.name, 1, 0);
        if p.name.starts_with("gad.planes") {
            p.value.iter_mut().for_each(|v| *v = if rng.uniform() < 0.1 { 0.0 } else { rng.range(-1.6, 1.6) });
        }
    });
    net
}

/// Points inside the box, outside, on faces and corners, and far away.
fn points(n: usize) -> Vec<Vec3> {
    let special = [
        Vec3::new(-1.0, -2.0, 0.5),
        Vec3::new(2.0, 1.0, 1.5),
        Vec3::new(0.3, 1.0, 0.7),
        Vec3::new(9.0, -9.0, 1.0),
        Vec3::new(1e30, 0.2, -1e30),
    ];
    let inside = |row| {
        let mut rng = Rng::new(7, "points", 0, row);
        Vec3::new(rng.range(-1.6, 2.6), rng.range(-2.6, 1.6), rng.range(0.3, 1.7))
    };
    (0..n).map(|i| if i % 4 == 3 { special[(i / 4) % special.len()] } else { inside(i as u64) }).collect()
}

/// Outputs by head, `[points, outputs]` each.
fn outputs(tape: &PlaneNetTape, heads: Heads) -> Vec<Vec<f32>> {
    (0..heads.len()).map(|h| tape.blocks().iter().flat_map(|b| b.head(h)).copied().collect()).collect()
}

/// Fills in random cotangents and returns them by head.
fn random_cotangents(tape: &mut PlaneNetTape, heads: Heads) -> Vec<Vec<f32>> {
    let mut all = vec![Vec::new(); heads.len()];
    for (b, block) in tape.blocks_mut().iter_mut().enumerate() {
        for (h, all) in all.iter_mut().enumerate() {
            let mut rng = Rng::new(5, "cotangents", h as u32, b as u64);
            block.head_grad_mut(h).fill_with(|| rng.normal());
            all.extend_from_slice(block.head_grad_mut(h));
        }
    }
    all
}

fn grads(net: &PlaneNet) -> Vec<(String, Vec<f32>)> {
    let mut all = Vec::new();
    net.visit(&mut |p| all.push((p.name.clone(), p.grad.clone())));
    all
}

fn wide(p: Vec3) -> [f64; 3] {
    p.to_array().map(f64::from)
}

fn assert_close(got: &[f32], want: &[f64], bound: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    assert!(got.iter().all(|v| v.is_finite()), "{what}");
    let largest = want.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
    let worst = got.iter().zip(want).fold(0.0f64, |m, (g, w)| m.max((f64::from(*g) - w).abs())) / largest;
    assert!(worst <= bound, "{what}: {worst:e}");
}

/// Level one to two.
#[test]
fn the_reference_is_differentiable() {
    for (depth, heads, t) in [(0, LOCAL, 0.0), (1, LOCAL, 0.42), (3, GLOBAL, 1.0), (2, ONE, 0.9)] {
        let names: Vec<&str> = heads.iter().map(|h| h.0).collect();
        let mut reference = PlaneNetRef::new("gad", &net(&config(9, depth), heads), &names);
        let at = [[0.37, -0.61, 0.93], [1.2, 7.0, 0.6]];
        let weight = |h: usize, k: usize| ((h * 31 + k * 7) as f64).sin();
        let d: Vec<Vec<f64>> =
            heads.iter().enumerate().map(|(h, n)| (0..n.1).map(|k| weight(h, k)).collect()).collect();
        let loss = |reference: &PlaneNetRef, at: &[[f64; 3]]| -> f64 {
            let one = |p: &[f64; 3]| -> f64 {
                reference.outputs(*p, time(t)).concat().iter().zip(d.concat()).map(|(y, d)| y * d).sum()
            };
            at.iter().map(one).sum()
        };
        let mut grad = reference.zero_grad();
        let d_points = at.map(|p| reference.backward(p, time(t), &d, &mut grad));
        let h = 1e-6;
        let check = |got: f64, hi: f64, lo: f64, what: &str| {
            let want = (hi - lo) / (2.0 * h);
            assert!((got - want).abs() < 1e-6 * (1.0 + want.abs()), "{what}: {got} {want}");
        };
        for (r, k) in (0..2).flat_map(|r| (0..3).map(move |k| (r, k))) {
            let (mut hi, mut lo) = (at, at);
            hi[r][k] += h;
            lo[r][k] -= h;
            check(d_points[r][k], loss(&reference, &hi), loss(&reference, &lo), "point");
        }
        let PlaneNetRefGrad { planes, layers } = grad;
        for (plane, got) in planes.iter().enumerate() {
            for i in (0..got.len()).step_by(11) {
                let v = reference.hexplane.planes[plane][i];
                let mut at_step = |step: f64| {
                    reference.hexplane.planes[plane][i] = v + step;
                    loss(&reference, &at)
                };
                let (hi, lo) = (at_step(h), at_step(-h));
                at_step(0.0);
                check(got[i], hi, lo, "texel");
            }
        }
        for (name, got) in &layers {
            for i in (0..got.len()).step_by(3) {
                let v = reference.layers[name][i];
                let mut at_step = |step: f64| {
                    reference.layers.get_mut(name).unwrap()[i] = v + step;
                    loss(&reference, &at)
                };
                let (hi, lo) = (at_step(h), at_step(-h));
                at_step(0.0);
                check(got[i], hi, lo, name);
            }
        }
    }
}

/// Level two to three: every tail length, depths, widths and heads; the ends of time and beyond.
#[test]
fn the_fast_net_agrees_with_the_reference() {
    for (n, t, width, depth, heads) in [
        (1, 0.0, 128, 1, LOCAL),
        (15, 1.0, 64, 0, LOCAL),
        (17, 0.31, 9, 3, GLOBAL),
        (40, 1.7, 128, 1, GLOBAL),
        (BLOCK + 1, -0.4, 12, 2, ONE),
    ] {
        let mut net = net(&config(width, depth), heads);
        let names: Vec<&str> = heads.iter().map(|h| h.0).collect();
        let (reference, means, mut tape) = (PlaneNetRef::new("gad", &net, &names), points(n), PlaneNetTape::default());
        net.forward(&means, time(t), &mut tape);
        let (got, d) = (outputs(&tape, heads), random_cotangents(&mut tape, heads));
        let mut d_means = vec![Vec3::ZERO; n];
        net.backward(&mut tape, Some(&mut d_means));

        let (mut want, mut want_d, mut grad) = (vec![Vec::new(); heads.len()], Vec::new(), reference.zero_grad());
        for (r, p) in means.iter().enumerate() {
            let row = |(d, head): (&Vec<f32>, &(&str, usize))| {
                d[r * head.1..][..head.1].iter().map(|v| f64::from(*v)).collect::<Vec<f64>>()
            };
            let d: Vec<Vec<f64>> = d.iter().zip(heads).map(row).collect();
            want.iter_mut().zip(reference.outputs(wide(*p), time(t))).for_each(|(all, y)| all.extend(y));
            want_d.extend(reference.backward(wide(*p), time(t), &d, &mut grad));
        }
        for ((got, want), (name, _)) in got.iter().zip(&want).zip(heads) {
            assert_close(got, want, 1.5e-5, &format!("{name}, n = {n}"));
        }
        let d_means: Vec<f32> = d_means.iter().flat_map(|d| d.to_array()).collect();
        assert_close(&d_means, &want_d, 2e-5, &format!("points, n = {n}"));
        let mut planes = grad.planes.iter();
        for (name, got) in grads(&net) {
            let want = match grad.layers.get(&name["gad.".len()..]) {
                Some(layer) => layer,
                None => planes.next().unwrap(),
            };
            assert_close(&got, want, 2e-5, &format!("{name}, n = {n}"));
        }
    }
}

#[test]
fn names_follow_the_net_and_counts_the_layers() {
    let size = |heads: Heads, resolution| {
        let hexplane = HexPlaneConfig { resolution, levels: vec![1, 2], channels: 16, ..HexPlaneConfig::default() };
        let config = PlaneNetConfig { hexplane, ..PlaneNetConfig::default() };
        let net = PlaneNet::new("lgd", &config, heads, Aabb::cube(1.0), 0).unwrap();
        let (mut names, mut dense) = (Vec::new(), 0);
        net.visit(&mut |p| {
            dense += if p.name.starts_with("lgd.planes") { 0 } else { p.len() };
            names.push(p.name.clone());
        });
        (names, dense)
    };
    let (names, dense) = size(LOCAL, [64, 64, 64, 100]);
    assert_eq!(names[0], "lgd.planes.xy.0");
    let want = ["trunk.0", "hidden", "means", "scales", "quats"];
    let want: Vec<String> = want.iter().flat_map(|n| ["weight", "bias"].map(|p| format!("lgd.{n}.{p}"))).collect();
    assert_eq!(names[12..], want);
    // The published sizes of the two networks (MoDec-GS: what is needed of the stored ones).
    assert_eq!((dense, size(GLOBAL, [32, 32, 32, 10]).1), (55_050, 79_431));
}

#[test]
fn an_untrained_net_outputs_zero() {
    let config = PlaneNetConfig { zero_init: true, ..config(16, 1) };
    let (net, mut tape) = (net(&config, GLOBAL), PlaneNetTape::default());
    for t in [-1.0, 0.0, 0.5, 1.0, 3.0] {
        net.forward(&points(50), time(t), &mut tape);
        assert!(outputs(&tape, GLOBAL).concat().iter().all(|v| *v == 0.0));
    }
}

/// Depth 0 and 1 are the same net, as in the reference.
#[test]
fn depth_zero_counts_as_one() {
    let on = |depth| {
        let (net, mut tape) = (net(&config(16, depth), LOCAL), PlaneNetTape::default());
        net.forward(&points(20), time(0.3), &mut tape);
        (outputs(&tape, LOCAL), net.param_count())
    };
    assert_eq!(on(0), on(1));
    assert_eq!(on(3).1 - on(1).1, 2 * (16 * 16 + 16));
}

/// Everything a step produces, as bits.
fn step(
    net: &mut PlaneNet,
    tape: &mut PlaneNetTape,
    forward: impl Fn(&PlaneNet, &mut PlaneNetTape),
    n: usize,
) -> Vec<u32> {
    net.clear_grads();
    forward(net, tape);
    let mut all: Vec<f32> = outputs(tape, LOCAL).concat();
    random_cotangents(tape, LOCAL);
    let mut d_means = vec![Vec3::ZERO; n];
    net.backward(tape, Some(&mut d_means));
    all.extend(d_means.iter().flat_map(|d| d.to_array()));
    all.extend(grads(net).into_iter().flat_map(|g| g.1));
    all.iter().map(|v| v.to_bits()).collect()
}

/// Cells found once are valid at every time and for every later state of the planes, bit for bit, and tapes may
/// alternate.
#[test]
fn placed_points_change_no_bit() {
    let means = points(2 * BLOCK + 9);
    let (mut net, mut plain, mut placed) =
        (net(&config(16, 1), LOCAL), PlaneNetTape::default(), PlaneNetTape::default());
    let places = net.place(&means);
    assert_eq!((places.len(), places.is_empty()), (means.len(), false));
    for t in [0.0, 0.7, 1.0] {
        let want = step(&mut net, &mut plain, |net, tape| net.forward(&means, time(t), tape), means.len());
        let got = step(&mut net, &mut placed, |net, tape| net.forward_located(&places, time(t), tape), means.len());
        assert!(want == got, "t = {t}");
        net.visit_mut(&mut |p| p.value.iter_mut().for_each(|v| *v *= 1.01));
        // A tape that shares cells makes its own for other points without changing the shared ones.
        net.forward(&means[..40], time(t), &mut placed);
    }
}

#[test]
fn threads_and_warm_tapes_change_no_bit() {
    let n = 11 * BLOCK + 17;
    let (all, make) = (points(n), || net(&config(20, 2), LOCAL));
    let run = |net: &mut PlaneNet, tape: &mut PlaneNetTape, n: usize| {
        step(net, tape, |net, tape| net.forward(&all[..n], time(0.4), tape), n)
    };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&mut make(), &mut PlaneNetTape::default(), n))
    };
    let one = on(1);
    assert!(one == on(2) && one == on(4), "results depend on the number of threads");
    let (mut net, mut tape) = (make(), PlaneNetTape::default());
    for n in [n, 0, 1, 15, 16, 17, BLOCK, BLOCK + 1] {
        assert!(run(&mut net, &mut tape, n) == run(&mut make(), &mut PlaneNetTape::default(), n), "n = {n}");
    }
}

#[test]
fn sizes_are_counted_whatever_they_are() {
    let most = usize::MAX;
    for (depth, skip) in [(1, 4), (8, 4), (3, 2), (3, 1), (2, 0)] {
        let config = DefGsConfig { depth, skip, ..DefGsConfig::default() };
        let mut made = 0;
        DefMlp::new(&config, 1).unwrap().visit(&mut |p| made += p.len() as u64);
        assert_eq!(config.param_count(), made, "{depth} layers, inputs again after {skip}");
    }
    let planes = HexPlaneConfig { resolution: [most, most, most, 0], channels: most, ..HexPlaneConfig::default() };
    let absurd = PlaneNetConfig { width: most, depth: most, hexplane: planes, ..PlaneNetConfig::default() };
    assert_eq!(absurd.param_count(LOCAL), u64::MAX);
    let absurd = DefGsConfig { width: most, depth: most, skip: most, bands_position: most, ..DefGsConfig::default() };
    assert_eq!(absurd.param_count(), u64::MAX);
    let mut absurd = Grid4dConfig { width: most, depth: most, ..Grid4dConfig::default() };
    (absurd.canonical.levels, absurd.fourier.bands) = (most, most);
    assert_eq!(absurd.param_count(), u64::MAX);
}
