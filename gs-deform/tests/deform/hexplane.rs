//! HexPlane in three levels: what the numbers must be by construction, the f64 reference against central differences,
//! the fast encoder against the reference.
//!
//! Tolerances (f32 against f64, worst seen times about four):
//! | quantity | relative to | bound |
//! |---|---|---|
//! | features | largest feature | 1e-5 |
//! | plane gradients | largest of the plane | 2e-5 |
//! | coordinate gradients | largest | 5e-5 |
//! | other instruction set | largest | 2e-6 |
//! | features, R time rows | largest feature | 1e-5 + 4e-7 R: a time's position among R rows is rounded to R · 6e-8 |

use fearless_simd::Level;
use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Params, Rng, Time};
use gs_deform::Aabb;
use gs_deform::encode::{HexPlane, HexPlaneConfig, HexTape};
use gs_deform::reference::HexPlaneRef;

fn config() -> HexPlaneConfig {
    HexPlaneConfig { resolution: [5, 4, 3, 7], levels: vec![1, 2], channels: 32, ..Default::default() }
}

fn time(t: f32) -> Time {
    Time::new(t).unwrap()
}

/// An encoder whose time planes are not 1, so that nothing is hidden.
fn encoder(config: &HexPlaneConfig, seed: u64) -> HexPlane {
    let aabb = Aabb::new(Vec3::new(-1.0, -2.0, 0.5), Vec3::new(2.0, 1.0, 1.5)).unwrap();
    let mut hex = HexPlane::new("hex", config, aabb, seed).unwrap();
    let mut rng = Rng::new(seed, "texels", 0, 0);
    hex.visit_mut(&mut |p| p.value.iter_mut().for_each(|v| *v = rng.range(-1.2, 1.2)));
    hex
}

/// Points inside, outside and on the faces and corners of the box.
fn points(n: usize, seed: u64) -> Vec<Vec3> {
    let faces =
        [Vec3::new(-1.0, -2.0, 0.5), Vec3::new(2.0, 1.0, 1.5), Vec3::new(0.3, 1.0, 0.7), Vec3::new(9.0, -9.0, 1.0)];
    let inside = |row| {
        let mut rng = Rng::new(seed, "points", 0, row);
        Vec3::new(rng.range(-1.6, 2.6), rng.range(-2.6, 1.6), rng.range(0.3, 1.7))
    };
    (0..n).map(|i| if i % 16 == 15 { faces[(i / 16) % 4] } else { inside(i as u64) }).collect()
}

fn wide(p: Vec3) -> [f64; 3] {
    p.to_array().map(f64::from)
}

/// Features, plane gradients and coordinate gradients of the fast encoder for random cotangents.
fn run(hex: &mut HexPlane, means: &[Vec3], t: Time, seed: u64) -> (Vec<f32>, Vec<f32>, Vec<Vec<f32>>, Vec<Vec3>) {
    let (mut tape, mut d_means) = (HexTape::default(), vec![Vec3::ZERO; means.len()]);
    hex.clear_grads();
    hex.forward(means, t, &mut tape);
    let (mut features, mut d) = (Vec::new(), Vec::new());
    let mut rng = Rng::new(seed, "cotangents", 0, 0);
    for block in &mut tape.blocks {
        features.extend_from_slice(&block.features);
        block.d_features = block.features.iter().map(|_| rng.normal()).collect();
        d.extend_from_slice(&block.d_features);
    }
    hex.backward(&mut tape, Some(&mut d_means));
    let mut grads = Vec::new();
    hex.visit(&mut |p| grads.push(p.grad.clone()));
    (features, d, grads, d_means)
}

fn largest(v: impl IntoIterator<Item = f64>) -> f64 {
    v.into_iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// Largest difference relative to the largest wanted value.
fn worst(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    assert!(got.iter().all(|v| v.is_finite()));
    largest(got.iter().zip(want).map(|(g, w)| f64::from(*g) - w)) / largest(want.iter().copied()).max(1e-30)
}

#[test]
fn known_values() {
    // Spatial planes ½ everywhere, time planes 1: each feature is ⅛ at any point and time.
    let mut hex = HexPlane::new("hex", &config(), Aabb::cube(1.0), 0).unwrap();
    hex.visit_mut(&mut |p| {
        if p.value[0] != 1.0 {
            p.value.fill(0.5);
        }
    });
    let mut tape = HexTape::default();
    for t in [-1.0, 0.0, 0.4, 1.0, 7.0] {
        hex.forward(&points(17, 1), time(t), &mut tape);
        assert!(tape.blocks[0].features.iter().all(|&f| f == 0.125));
    }
    // A ramp along x in plane xy at level 1 is reproduced by interpolation: φ_x of the 5 nodes, times ¼.
    hex.visit_mut(&mut |p| {
        if p.name == "hex.xy.0" {
            p.value.chunks_mut(16).enumerate().for_each(|(i, texel)| texel.fill((i % 5) as f32));
        }
    });
    hex.forward(&[Vec3::new(-0.3, 0.2, 0.9)], time(0.5), &mut tape);
    assert!((tape.blocks[0].features[20] - 0.25 * (0.7 / 2.0 * 4.0)).abs() < 1e-6);
}

#[test]
fn starts_as_published() {
    let hex = HexPlane::new("hex", &config(), Aabb::cube(1.0), 3).unwrap();
    let mut names = Vec::new();
    hex.visit(&mut |p| {
        names.push(p.name.clone());
        let range = if p.name.contains('t') { 1.0..=1.0 } else { 0.1..=0.5 };
        assert!(p.value.iter().all(|v| range.contains(v)), "{}", p.name);
    });
    assert_eq!(names[..3], ["hex.xy.0", "hex.xz.0", "hex.xt.0"]);
    assert_eq!((names.len(), hex.width()), (12, 64));
    // Rows 3 to 6 of 7 serve times 0 to 1.
    assert_eq!(hex.plane(1, 2).len(), 10 * 4 * 32);
}

/// Level one to two: the reference's gradients are derivatives of its features.
#[test]
fn the_reference_is_differentiable() {
    let mut reference = HexPlaneRef::new(&encoder(&config(), 1));
    let (p, t) = ([0.37, -0.61, 0.93], time(0.42));
    let mut rng = Rng::new(1, "twin", 0, 0);
    let weights: Vec<f64> = (0..64).map(|_| f64::from(rng.normal())).collect();
    let loss =
        |reference: &HexPlaneRef, p| reference.features(p, t).iter().zip(&weights).map(|(f, w)| f * w).sum::<f64>();
    let mut d_planes: Vec<Vec<f64>> = reference.planes.iter().map(|p| vec![0.0; p.len()]).collect();
    let d_p = reference.backward(p, t, &weights, &mut d_planes);
    let h = 1e-6;
    for k in 0..3 {
        let (mut hi, mut lo) = (p, p);
        hi[k] += h;
        lo[k] -= h;
        let want = (loss(&reference, hi) - loss(&reference, lo)) / (2.0 * h);
        assert!((d_p[k] - want).abs() < 1e-7 * (1.0 + want.abs()), "axis {k}: {} {want}", d_p[k]);
    }
    for (plane, got) in d_planes.iter().enumerate() {
        for i in (0..got.len()).step_by(7) {
            let at = reference.planes[plane][i];
            reference.planes[plane][i] = at + h;
            let hi = loss(&reference, p);
            reference.planes[plane][i] = at - h;
            let want = (hi - loss(&reference, p)) / (2.0 * h);
            reference.planes[plane][i] = at;
            assert!((got[i] - want).abs() < 1e-8 * (1.0 + want.abs()), "plane {plane}, value {i}");
        }
    }
}

/// Level two to three, for every tail length, at the ends of time and beyond.
#[test]
fn the_fast_encoder_agrees_with_the_reference() {
    for (n, t) in [(1, 0.0), (15, 1.0), (16, 0.31), (17, -0.4), (300, 1.7), (BLOCK, 0.5)] {
        let mut hex = encoder(&config(), n as u64);
        let reference = HexPlaneRef::new(&hex);
        let means = points(n, 5);
        let (features, d, grads, d_means) = run(&mut hex, &means, time(t), 9);
        let mut want_planes: Vec<Vec<f64>> = reference.planes.iter().map(|p| vec![0.0; p.len()]).collect();
        let (mut want_features, mut want_means) = (Vec::new(), Vec::new());
        for (p, d) in means.iter().zip(d.chunks(64)) {
            let d: Vec<f64> = d.iter().map(|&v| f64::from(v)).collect();
            want_features.extend(reference.features(wide(*p), time(t)));
            want_means.extend(reference.backward(wide(*p), time(t), &d, &mut want_planes));
        }
        assert!(worst(&features, &want_features) < 1e-5, "features, n = {n}: {:e}", worst(&features, &want_features));
        let d_means: Vec<f32> = d_means.iter().flat_map(|d| d.to_array()).collect();
        assert!(worst(&d_means, &want_means) < 5e-5, "means, n = {n}: {:e}", worst(&d_means, &want_means));
        for (plane, (got, want)) in grads.iter().zip(&want_planes).enumerate() {
            assert!(worst(got, want) < 2e-5, "plane {plane}, n = {n}: {:e}", worst(got, want));
        }
    }
}

#[test]
fn no_points_and_flat_boxes_are_fine() {
    let mut hex = encoder(&config(), 1);
    let (features, _, grads, _) = run(&mut hex, &[], time(0.5), 1);
    assert!(features.is_empty() && grads.iter().flatten().all(|&g| g == 0.0));
    let flat = Aabb::new(Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, 0.0, 1.0)).unwrap();
    let mut hex = HexPlane::new("hex", &config(), flat, 1).unwrap();
    let (features, _, _, d_means) = run(&mut hex, &points(16, 2), time(0.5), 1);
    assert!(features.iter().all(|f| f.is_finite()) && d_means.iter().all(|d| d.is_finite() && d.y == 0.0));
}

#[test]
fn a_point_outside_is_clamped_to_the_face_without_gradient_across_it() {
    let mut hex = encoder(&config(), 4);
    let pair = [Vec3::new(2.0, 0.0, 1.0), Vec3::new(1e6, 0.0, 1.0)];
    let (features, _, _, d_means) = run(&mut hex, &pair, time(0.5), 1);
    assert_eq!(features[..64], features[64..]);
    assert!(d_means.iter().all(|d| d.x == 0.0 && d.y != 0.0 && d.z != 0.0));
}

/// Bits do not depend on the number of threads; other instruction sets agree within rounding.
#[test]
fn threads_change_no_bit_and_instruction_sets_only_rounding() {
    let means = points(3 * BLOCK + 17, 8);
    let result = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut hex = encoder(&config(), 6);
            let (features, _, _, d_means) = run(&mut hex, &means, time(0.7), 2);
            let values = hex.regularise();
            let mut grads = Vec::new();
            hex.visit(&mut |p| grads.extend(p.grad.iter().map(|g| g.to_bits())));
            (features, grads, d_means, values)
        })
    };
    let one = result(1);
    assert!(one == result(2) && one == result(4));

    let run_on = |level| run(&mut encoder(&config(), 6).with_simd(level), &means, time(0.7), 2);
    let best = run_on(Level::new());
    let plain = run_on(Level::baseline());
    let to_wide = |v: &[f32]| v.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    assert!(worst(&plain.0, &to_wide(&best.0)) < 2e-6);
    for (a, b) in plain.2.iter().zip(&best.2) {
        assert!(worst(a, &to_wide(b)) < 2e-6);
    }
}

#[test]
fn regularisers_match_finite_differences() {
    let config = HexPlaneConfig { plane_tv: 0.3, time_smoothness: 0.7, time_l1: 0.2, ..config() };
    let mut hex = encoder(&config, 2);
    let reference = HexPlaneRef::new(&hex);
    // In f64, from the definition: [plane][nodes_b][nodes_a][channel]; unread time rows add nothing but count.
    let nodes = |level: usize| [5 * (level + 1), 4 * (level + 1), 3 * (level + 1), 7];
    let value = |planes: &[Vec<f64>]| -> f64 {
        let mut total = 0.0;
        for (i, plane) in planes.iter().enumerate() {
            let (a, b) = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)][i % 6];
            let (width, height) = (nodes(i / 6)[a], nodes(i / 6)[b]);
            let stored = plane.len() / 32 / width;
            let at = |c: usize, y: usize, x: usize| plane[((c / 16 * stored + y) * width + x) * 16 + c % 16];
            let mut bend = 0.0;
            for c in 0..32 {
                for x in 0..width {
                    bend += (2..stored)
                        .map(|y| (at(c, y, x) - 2.0 * at(c, y - 1, x) + at(c, y - 2, x)).powi(2))
                        .sum::<f64>();
                }
            }
            bend /= (32 * (height - 2) * width) as f64;
            let far = plane.iter().map(|v| (1.0 - v).abs()).sum::<f64>() / (32 * height * width) as f64;
            total += if b == 3 { 0.7 * bend + 0.2 * far } else { 0.3 * bend };
        }
        total
    };
    let got = hex.regularise();
    assert_eq!(got.map(|v| v.0), ["plane_tv", "time_smoothness", "time_l1"]);
    let sum: f64 = got.iter().map(|v| f64::from(v.1)).sum();
    assert!((sum - value(&reference.planes)).abs() < 1e-5, "{sum} {}", value(&reference.planes));
    let mut grads = Vec::new();
    hex.visit(&mut |p| grads.push(p.grad.clone()));
    let mut planes = reference.planes.clone();
    for (plane, grad) in grads.iter().enumerate() {
        for i in (0..grad.len()).step_by(61) {
            let (at, h) = (planes[plane][i], 1e-5);
            planes[plane][i] = at + h;
            let hi = value(&planes);
            planes[plane][i] = at - h;
            let want = (hi - value(&planes)) / (2.0 * h);
            planes[plane][i] = at;
            let got = f64::from(grad[i]);
            assert!((got - want).abs() < 1e-7, "plane {plane}, value {i}: {got} {want}");
        }
    }
}

/// A feature from the definition: 24 taps, the whole time axis, time fed raw into an axis made for −1 … 1.
fn whole_axis(planes: &[Vec<f64>; 6], nodes: [usize; 4], u: [f64; 4], channel: usize) -> f64 {
    let place = |k: usize| {
        let position = ((u[k] + 1.0) / 2.0 * (nodes[k] - 1) as f64).clamp(0.0, (nodes[k] - 1) as f64);
        let index = (position as usize).min(nodes[k] - 2);
        (index, position - index as f64)
    };
    let mut product = 1.0;
    for (plane, (a, b)) in planes.iter().zip([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]) {
        let ((i, w), (j, z)) = (place(a), place(b));
        let at = |i: usize, j: usize| plane[(j * nodes[a] + i) * 16 + channel];
        product *= (1.0 - w) * (1.0 - z) * at(i, j)
            + w * (1.0 - z) * at(i + 1, j)
            + (1.0 - w) * z * at(i, j + 1)
            + w * z * at(i + 1, j + 1);
    }
    product
}

/// Two exact optimisations: rows of the time axis that times 0 … 1 never reach are not stored, and the rows around a
/// timestamp are blended once for all points.
#[test]
fn lines_of_the_stored_half_equal_the_whole_axis() {
    for rows in [2, 3, 10, 75, 100] {
        let resolution = [5, 4, 3, rows];
        let config = HexPlaneConfig { resolution, levels: vec![1], channels: 16, ..Default::default() };
        let (mut rng, mut whole) = (Rng::new(2, "whole", 0, 0), Vec::new());
        for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            whole.push((0..resolution[a] * resolution[b] * 16).map(|_| rng.range(-1.2, 1.2)).collect::<Vec<f32>>());
        }
        let mut hex = HexPlane::new("hex", &config, Aabb::cube(1.0), 1).unwrap();
        let mut left = whole.iter();
        hex.visit_mut(&mut |p| {
            let full = left.next().unwrap();
            let unread = full.len() - p.len();
            p.value.copy_from_slice(&full[unread..]);
        });
        let planes: [Vec<f64>; 6] = std::array::from_fn(|p| whole[p].iter().map(|&v| f64::from(v)).collect());
        let (means, mut tape) = (points(33, 4), HexTape::default());
        for t in [0.0, 1e-3, 0.26, 0.5, 0.999, 1.0] {
            hex.forward(&means, time(t), &mut tape);
            let want: Vec<f64> = means
                .iter()
                .flat_map(|p| {
                    let [x, y, z] = wide(*p);
                    let planes = &planes;
                    (0..16).map(move |c| whole_axis(planes, resolution, [x, y, z, f64::from(t)], c))
                })
                .collect();
            let error = worst(&tape.blocks[0].features, &want);
            assert!(error < 1e-5 + 4e-7 * rows as f64, "{rows} rows, t = {t}: {error:e}");
        }
    }
}

/// The second difference runs along the second axis of each pair, and the means count the whole time axis.
#[test]
fn regularisers_of_parabolas_by_hand() {
    let weights = HexPlaneConfig { plane_tv: 1.0, time_smoothness: 1.0, time_l1: 1.0, ..Default::default() };
    let config = HexPlaneConfig { resolution: [3, 4, 5, 9], levels: vec![1], channels: 16, ..weights };
    // Of nine time rows, five are stored: three second differences of seven.
    for (name, nodes_a, along_a, along_b) in [
        ("hex.xy.0", 3, [0.0, 0.0], [4.0, 0.0]),
        ("hex.xz.0", 3, [0.0, 0.0], [4.0, 0.0]),
        ("hex.yz.0", 4, [0.0, 0.0], [4.0, 0.0]),
        ("hex.xt.0", 3, [0.0, 0.0], [0.0, 4.0 * 3.0 / 7.0]),
        ("hex.zt.0", 5, [0.0, 0.0], [0.0, 4.0 * 3.0 / 7.0]),
    ] {
        for (along_second, want) in [(false, along_a), (true, along_b)] {
            let mut hex = HexPlane::new("hex", &config, Aabb::cube(1.0), 0).unwrap();
            hex.visit_mut(&mut |p| {
                p.value.fill(1.0);
                if p.name == name {
                    for (i, texel) in p.value.chunks_mut(16).enumerate() {
                        texel.fill((if along_second { i / nodes_a } else { i % nodes_a }).pow(2) as f32);
                    }
                }
            });
            let [tv, smooth, _] = hex.regularise().map(|v| f64::from(v.1));
            assert!((tv - want[0]).abs() < 1e-6 && (smooth - want[1]).abs() < 1e-6, "{name}: {tv} {smooth}");
        }
    }
    // |1 − P| of one row of y = 0 … 3 at distances 0, 1, 2, 3 from 1: 6 · 16 of 16 · 9 · 4 values, and ∓1 / 576 each.
    let mut hex = HexPlane::new("hex", &config, Aabb::cube(1.0), 0).unwrap();
    hex.visit_mut(&mut |p| {
        p.value.fill(1.0);
        if p.name == "hex.yt.0" {
            p.value.chunks_mut(16).take(4).enumerate().for_each(|(i, texel)| texel.fill(1.0 - i as f32));
        }
    });
    let [_, smooth, l1] = hex.regularise().map(|v| v.1);
    assert!((l1 - 6.0 / 36.0).abs() < 1e-6, "{l1}");
    // Only the first second difference sees the row: 0, 1, 4, 9 over 7 · 4.
    assert!((smooth - 14.0 / 28.0).abs() < 1e-6, "{smooth}");
    let grad = &hex.plane(0, 4).grad;
    assert!(grad[0] == 0.0, "no gradient at 1: {}", grad[0]);
    // Value −2 at y = 3: −1/576 of the distance, and 2 e / (16 · 7 · 4) with e = −3 of the bend.
    assert!((grad[48] + 1.0 / 576.0 + 6.0 / 448.0).abs() < 1e-7, "{}", grad[48]);
}
