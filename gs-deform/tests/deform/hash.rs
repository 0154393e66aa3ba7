//! The hash grid in three levels: what the numbers must be by construction, the f64 reference against central
//! differences, the fast encoder against the reference.
//!
//! Tolerances (f32 against f64, worst seen times about four). A coordinate in cells has the rounding of `f32` at the
//! resolution, hence the second row.
//! | quantity | relative to | bound |
//! |---|---|---|
//! | features and table gradients, resolution to 32 | largest | 1e-5 |
//! | the same, resolution to 2048 | largest | 5e-4 |
//! | slice against space, both f32 | largest | 1e-6 |
//! | other instruction set | largest | 1e-6 |

use fearless_simd::Level;
use gs_core::{Params, Rng};
use gs_deform::encode::{Columns, HashGrid, HashGridConfig, Slice};
use gs_deform::reference::HashGridRef;

/// Dense coarse levels and hashed fine ones, another growth along every axis.
fn mixed() -> HashGridConfig {
    HashGridConfig { base: [3.0, 4.0, 2.0], end: [17.0, 23.0, 9.5], levels: 5, log2_table: 9 }
}

/// The temporal grids of D-NeRF scenes: dense throughout.
fn temporal() -> HashGridConfig {
    HashGridConfig { base: [8.0; 3], end: [32.0, 32.0, 16.0], levels: 32, log2_table: 19 }
}

/// A grid with values of order one, so that nothing is hidden.
fn grid(config: &HashGridConfig, seed: u64) -> HashGrid {
    let mut grid = HashGrid::new("grid", config, seed).unwrap();
    let mut rng = Rng::new(seed, "values", 0, 0);
    grid.visit_mut(&mut |p| p.value.iter_mut().for_each(|v| *v = rng.range(-1.0, 1.0)));
    grid
}

/// Points inside; every eighth on a corner, a face, a cell border, outside, or not a number.
fn points(n: usize, seed: u64) -> Vec<[f32; 3]> {
    let odd = [
        [0.0; 3],
        [1.0; 3],
        [0.0, 1.0, 0.3],
        [0.5, 0.25, 0.75],
        [1.0, 0.4, 0.0],
        [1.0 + f32::EPSILON, 0.5, 0.5],
        [0.5, -1e-9, 0.5],
        [0.5, 0.5, f32::NAN],
        [f32::INFINITY, 0.5, 0.5],
        [-0.0, 0.5, 1.0],
    ];
    let random = |row| {
        let mut rng = Rng::new(seed, "points", 0, row);
        [rng.uniform(), rng.uniform(), rng.uniform()]
    };
    (0..n).map(|i| if i % 8 == 7 { odd[(i / 8) % odd.len()] } else { random(i as u64) }).collect()
}

fn wide(p: &[f32; 3]) -> [f64; 3] {
    p.map(f64::from)
}

fn cotangents(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = Rng::new(seed, "cotangents", 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}

fn tight(grid: &HashGrid) -> Columns {
    Columns { stride: grid.width(), offset: 0 }
}

fn run(grid: &mut HashGrid, points: &[[f32; 3]], d: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let columns = tight(grid);
    let mut out = vec![f32::NAN; points.len() * grid.width()];
    grid.clear_grads();
    grid.forward(points, &mut out, columns);
    grid.backward(points, d, columns);
    (out, grid.table().grad.clone())
}

fn run_slice(
    grid: &mut HashGrid,
    points: &[[f32; 2]],
    t: f32,
    budget: usize,
    d: &[f32],
) -> (Vec<f32>, Vec<f32>, usize) {
    let columns = tight(grid);
    let (mut out, mut slice) = (vec![f32::NAN; points.len() * grid.width()], Slice::default());
    grid.clear_grads();
    grid.slice(t, budget, &mut slice);
    grid.forward_slice(&slice, points, &mut out, columns);
    grid.backward_slice(&mut slice, points, d, columns);
    (out, grid.table().grad.clone(), slice.blended())
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

fn worst_f32(got: &[f32], want: &[f32]) -> f64 {
    worst(got, &want.iter().map(|&v| f64::from(v)).collect::<Vec<_>>())
}

fn truth(reference: &HashGridRef, points: &[[f32; 3]], d: &[f32]) -> (Vec<f64>, Vec<f64>) {
    let (mut features, mut d_table) = (Vec::new(), vec![0.0; reference.table.len()]);
    let d: Vec<f64> = d.iter().map(|&v| f64::from(v)).collect();
    let width = d.len() / points.len().max(1);
    for (p, d) in points.iter().zip(d.chunks(width.max(1))) {
        features.extend(reference.features(wide(p)));
        reference.backward(wide(p), d, &mut d_table);
    }
    (features, d_table)
}

#[test]
fn starts_small_and_reproducible() {
    let new = |seed| HashGrid::new("grid", &mixed(), seed).unwrap();
    let (grid, other) = (new(3), new(4));
    assert_eq!((grid.width(), grid.table().name.as_str()), (10, "grid"));
    assert_eq!(grid.table().value, new(3).table().value);
    assert_ne!(grid.table().value, other.table().value);
    let values = &grid.table().value;
    assert!(values.iter().all(|v| v.abs() <= 1e-4) && largest(values.iter().map(|&v| f64::from(v))) > 9e-5);
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    assert!(mean.abs() < 5e-6, "{mean:e}");
}

/// Weights of a cell sum to one, so a constant table is a constant feature, and nothing outside the cube.
#[test]
fn a_constant_table_is_a_constant_feature_inside_and_zero_outside() {
    for config in [mixed(), temporal()] {
        let mut grid = grid(&config, 1);
        grid.visit_mut(&mut |p| p.value.fill(0.75));
        let points = points(333, 2);
        let d = vec![1.0; 333 * grid.width()];
        let (out, grad) = run(&mut grid, &points, &d);
        let width = grid.width();
        let mut inside = 0;
        for (p, row) in points.iter().zip(out.chunks(width)) {
            let here = p.iter().all(|c| (0.0..=1.0).contains(c));
            inside += usize::from(here);
            assert!(row.iter().all(|&f| if here { (f - 0.75).abs() < 1e-6 } else { f == 0.0 }), "{p:?}: {row:?}");
        }
        let got: f64 = grad.iter().map(|&g| f64::from(g)).sum();
        let want = (inside * width) as f64;
        assert!((got / want - 1.0).abs() < 1e-6, "every point inside distributes its whole cotangent: {got} {want}");
        assert!(inside > 280 && inside < 320);
    }
}

/// Every node of a dense level gives back its own value; on cell borders the two cells agree.
#[test]
fn nodes_are_interpolated() {
    let config = HashGridConfig { base: [5.0, 3.0, 2.0], end: [5.0, 3.0, 2.0], levels: 2, log2_table: 9 };
    let mut grid = grid(&config, 5);
    let mut nodes = Vec::new();
    for (z, y, x) in (0..2).flat_map(|z| (0..3).flat_map(move |y| (0..5).map(move |x| (z, y, x)))) {
        nodes.push([x as f32 / 4.0, y as f32 / 2.0, z as f32]);
    }
    let d = vec![1.0; nodes.len() * 4];
    let (out, grad) = run(&mut grid, &nodes, &d);
    for (i, row) in out.chunks(4).enumerate() {
        let value = &grid.table().value;
        assert_eq!(row, [value[2 * i], value[2 * i + 1], value[60 + 2 * i], value[60 + 2 * i + 1]], "node {i}");
    }
    assert!(grad.iter().all(|&g| g == 1.0));
    // Half way between two nodes smoothstep weights them alike.
    grid.visit_mut(&mut |p| p.value.iter_mut().enumerate().for_each(|(i, v)| *v = (i / 2 % 5) as f32));
    let mut out = [0.0; 4];
    grid.forward(&[[0.375, 0.2, 0.9]], &mut out, Columns { stride: 4, offset: 0 });
    assert!(out.iter().all(|f| (f - 1.5).abs() < 1e-6), "{out:?}");
    // A quarter into the cell: w = 3/16 − 2/64 = 5/32.
    grid.forward(&[[0.3125, 0.2, 0.9]], &mut out, Columns { stride: 4, offset: 0 });
    assert!(out.iter().all(|f| (f - (1.0 + 5.0 / 32.0)).abs() < 1e-6), "{out:?}");
}

/// Level one to two: the reference's gradient is the derivative of its features.
#[test]
fn the_reference_is_differentiable() {
    let mut reference = HashGridRef::new(&grid(&mixed(), 1));
    let weights: Vec<f64> = cotangents(10, 1).into_iter().map(f64::from).collect();
    for p in [[0.37, 0.61, 0.93], [1.0, 0.0, 0.5], [0.5, 1.2, 0.5]] {
        let loss =
            |reference: &HashGridRef| reference.features(p).iter().zip(&weights).map(|(f, w)| f * w).sum::<f64>();
        let mut got = vec![0.0; reference.table.len()];
        reference.backward(p, &weights, &mut got);
        let touched: Vec<usize> =
            (0..5).flat_map(|l| reference.corners(l, p)).flat_map(|(at, _)| [at, at + 1]).collect();
        let h = 1e-3;
        for i in (0..got.len()).step_by(17).chain(touched) {
            let at = reference.table[i];
            reference.table[i] = at + h;
            let hi = loss(&reference);
            reference.table[i] = at - h;
            let want = (hi - loss(&reference)) / (2.0 * h);
            reference.table[i] = at;
            assert!((got[i] - want).abs() < 1e-11, "value {i}: {} {want}", got[i]);
        }
    }
}

/// Level two to three, for every tail length.
#[test]
fn the_fast_encoder_agrees_with_the_reference() {
    let canonical = HashGridConfig { base: [16.0; 3], end: [2048.0; 3], levels: 8, log2_table: 12 };
    let temporal = HashGridConfig { levels: 6, ..temporal() };
    for (config, bound) in [(mixed(), 1e-5), (temporal, 1e-5), (canonical, 5e-4)] {
        for n in [1, 8, 15, 16, 17, 255, 256, 257, 600] {
            let mut grid = grid(&config, n as u64);
            let (points, d) = (points(n, 5), cotangents(n * grid.width(), 9));
            let (want, want_grad) = truth(&HashGridRef::new(&grid), &points, &d);
            let (out, grad) = run(&mut grid, &points, &d);
            assert!(worst(&out, &want) < bound, "features, n = {n}: {:e}", worst(&out, &want));
            assert!(worst(&grad, &want_grad) < bound, "gradient, n = {n}: {:e}", worst(&grad, &want_grad));
        }
    }
}

/// A slice is the grid at its third coordinate, whether all levels are blended, some, or none.
#[test]
fn a_slice_is_the_grid_at_that_time() {
    for (config, partly) in [(mixed(), 20), (temporal(), 100)] {
        for t in [0.0, 0.31, 0.5, 1.0, -0.1, 1.01, f32::NAN] {
            let mut grid = grid(&config, 7);
            let space: Vec<[f32; 3]> = points(300, 5).into_iter().map(|[x, y, _]| [x, y, t]).collect();
            let plane: Vec<[f32; 2]> = space.iter().map(|&[x, y, _]| [x, y]).collect();
            let d = cotangents(300 * grid.width(), 9);
            let (want, want_grad) = run(&mut grid, &space, &d);
            for (budget, blended) in [(0, 0), (usize::MAX, config.levels), (partly, 0)] {
                let (out, grad, got) = run_slice(&mut grid, &plane, t, budget, &d);
                if budget == partly {
                    assert!(got > 0 && got < config.levels, "{got}");
                } else {
                    assert_eq!(got, blended);
                }
                assert!(worst_f32(&out, &want) <= 1e-6, "t = {t}: {:e}", worst_f32(&out, &want));
                assert!(worst_f32(&grad, &want_grad) <= 1e-6, "t = {t}: {:e}", worst_f32(&grad, &want_grad));
            }
            if !(0.0..=1.0).contains(&t) {
                assert!(want.iter().chain(&want_grad).all(|&v| v == 0.0));
            }
        }
    }
}

/// Features go to their columns and nowhere else, gradients are added to what is there.
#[test]
fn columns_and_sums() {
    let mut grid = grid(&mixed(), 2);
    let (points, width) = (points(300, 3), grid.width());
    let columns = Columns { stride: width + 7, offset: 3 };
    let narrow = cotangents(300 * width, 1);
    let mut d = vec![f32::NAN; 300 * columns.stride];
    for (row, narrow) in d.chunks_mut(columns.stride).zip(narrow.chunks(width)) {
        row[3..3 + width].copy_from_slice(narrow);
    }
    let (want, want_grad) = run(&mut grid, &points, &narrow);
    grid.visit_mut(&mut |p| p.grad.fill(1.0));
    let mut out = vec![7.0; 300 * columns.stride];
    grid.forward(&points, &mut out, columns);
    grid.backward(&points, &d, columns);
    for (row, want) in out.chunks(columns.stride).zip(want.chunks(width)) {
        assert_eq!((&row[..3], &row[3..3 + width], &row[3 + width..]), (&[7.0; 3][..], want, &[7.0; 4][..]));
    }
    let sum: Vec<f32> = want_grad.iter().map(|g| g + 1.0).collect();
    assert!(worst_f32(&grid.table().grad, &sum) < 1e-6);
}

#[test]
fn no_points_are_fine() {
    let mut grid = grid(&mixed(), 1);
    let (out, grad) = run(&mut grid, &[], &[]);
    assert!(out.is_empty() && grad.iter().all(|&g| g == 0.0));
    let (out, grad, _) = run_slice(&mut grid, &[], 0.5, 0, &[]);
    assert!(out.is_empty() && grad.iter().all(|&g| g == 0.0));
}

/// Bits do not depend on the number of threads; other instruction sets agree within rounding.
#[test]
fn threads_change_no_bit_and_instruction_sets_only_rounding() {
    for config in [mixed(), temporal()] {
        let points = points(5000, 8);
        let plane: Vec<[f32; 2]> = points.iter().map(|&[x, y, _]| [x, y]).collect();
        let all = |mut grid: HashGrid| {
            let d = cotangents(5000 * grid.width(), 2);
            let (a, b) = run(&mut grid, &points, &d);
            let (c, e, _) = run_slice(&mut grid, &plane, 0.4, plane.len(), &d);
            [a, b, c, e]
        };
        let result = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| all(grid(&config, 6)).map(|v| v.iter().map(|v| v.to_bits()).collect::<Vec<u32>>()))
        };
        let one = result(1);
        assert!(one == result(2) && one == result(8));
        let best = all(grid(&config, 6).with_simd(Level::new()));
        let plain = all(grid(&config, 6).with_simd(Level::baseline()));
        for (a, b) in plain.iter().zip(&best) {
            assert!(worst_f32(a, b) < 1e-6, "{:e}", worst_f32(a, b));
        }
    }
}
