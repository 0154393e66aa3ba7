//! Time and error of the hash grid: dense, hashed and sliced; then table size, levels and the storage of values.
//!
//! Each row is printed and appended to `target/speed-error/gs-deform.jsonl`; `work` is points times levels. Run with
//! `RAYON_NUM_THREADS=1` for the cost on one core.
//!
//! The second part fits `f(x) = sin 9x sin 7y sin 11z + ½ sin(60 (x + y + z))` on a sphere with the sum of all features
//! (Adam on the table) and reports what is left at other points of the sphere. Both storages are read by one scalar
//! loop written here, so that their times compare; the fit itself is made in `f32`, as training would, and rounded.

use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Params, Rng};
use gs_deform::encode::{Columns, HashGrid, HashGridConfig, Slice};
use gs_deform::reference::HashGridRef;
use std::hint::black_box;

const POINTS: usize = 50_000;

/// Points on a sphere inside the cube, as splats lie on surfaces.
fn points(n: usize, purpose: &str) -> Vec<[f32; 3]> {
    let draw = |i| {
        let mut rng = Rng::new(1, purpose, 0, i as u64);
        let v = [rng.normal(), rng.normal(), rng.normal()];
        let length = v.iter().map(|c| c * c).sum::<f32>().sqrt().max(1e-6);
        v.map(|c| 0.5 + 0.4 * c / length)
    };
    (0..n).map(draw).collect()
}

struct Row<'a> {
    case: &'a str,
    variant: &'a str,
    levels: usize,
    error: f64,
    error_kind: &'static str,
}

/// Measures, prints and records the nanoseconds per point and level.
fn row(row: &Row, work: impl FnMut()) {
    let seconds = median_seconds(9, work);
    let line = BenchRow {
        krate: "gs-deform",
        case: row.case.to_owned(),
        variant: row.variant.to_owned(),
        n: POINTS,
        threads: rayon::current_num_threads(),
        ms: 1e3 * seconds,
        work: (POINTS * row.levels) as f64,
        error: Some(row.error),
        error_kind: row.error_kind,
    };
    line.append(env!("CARGO_MANIFEST_DIR"));
    println!("    {:.2} ns per point and level", 1e9 * seconds / (POINTS * row.levels) as f64);
}

/// Largest difference relative to the largest wanted value, over the first points.
fn feature_error(grid: &HashGrid, points: &[[f32; 3]], out: &[f32], stride: usize) -> f64 {
    let reference = HashGridRef::new(grid);
    let (mut worst, mut largest) = (0.0f64, 1e-30f64);
    for (p, out) in points.iter().zip(out.chunks(stride)).take(1000) {
        for (want, got) in reference.features(p.map(f64::from)).into_iter().zip(out) {
            worst = worst.max((want - f64::from(*got)).abs());
            largest = largest.max(want.abs());
        }
    }
    worst / largest
}

/// The production paths. Rows of the temporal grid are as wide as three grids side by side.
fn paths(case: &str, config: &HashGridConfig, stride: usize) {
    let Ok(mut grid) = HashGrid::new("grid", config, 1) else { return };
    let (points, t, columns) = (points(POINTS, "points"), 0.37, Columns { stride, offset: 0 });
    let plane: Vec<[f32; 2]> = points.iter().map(|p| [p[0], p[1]]).collect();
    let at_time: Vec<[f32; 3]> = plane.iter().map(|p| [p[0], p[1], t]).collect();
    let mut out = vec![0.0; POINTS * stride];
    grid.forward(&points, &mut out, columns);
    let error = feature_error(&grid, &points, &out, stride);
    let line = |variant, error| Row { case, variant, levels: config.levels, error, error_kind: "feature against f64" };
    row(&line("space forward", error), || grid.forward(&points, &mut out, columns));
    row(&line("space backward", error), || grid.backward(&points, &out, columns));
    let mut slice = Slice::default();
    grid.slice(t, POINTS, &mut slice);
    grid.forward_slice(&slice, &plane, &mut out, columns);
    let error = feature_error(&grid, &at_time, &out, stride);
    println!("    {} of {} levels are blended", slice.blended(), config.levels);
    row(&line("slice forward", error), || {
        grid.slice(t, POINTS, &mut slice);
        grid.forward_slice(&slice, &plane, &mut out, columns);
    });
    row(&line("slice backward", error), || grid.backward_slice(&mut slice, &plane, &out, columns));
    grid.clear_grads();
    grid.backward(&points, &vec![1.0; out.len()], columns);
    let grad = &grid.table().grad;
    let share = |width: usize| {
        let touched = grad.chunks(width).filter(|row| row.iter().any(|&g| g != 0.0)).count();
        100.0 * touched as f64 / grad.len().div_ceil(width) as f64
    };
    println!("    one step touches {:.0} % of entries, {:.0} % of blocks of 64 values", share(2), share(64));
}

/// How an entry is kept.
trait Stored: Copy {
    fn store(v: f32) -> Self;
    fn load(self) -> f32;
}

impl Stored for f32 {
    fn store(v: f32) -> Self {
        v
    }
    fn load(self) -> f32 {
        self
    }
}

/// Bits of an IEEE half; finite values below 65504 only.
#[derive(Clone, Copy)]
struct Half(u16);

impl Stored for Half {
    fn store(v: f32) -> Self {
        let (sign, size) = ((v.to_bits() >> 16) & 0x8000, v.abs());
        let bits = if size < 6.103_515_6e-5 {
            (size * 16_777_216.0).round_ties_even() as u32
        } else {
            let bits = size.to_bits();
            ((bits + 0xfff + ((bits >> 13) & 1)) >> 13) - (112 << 10)
        };
        Self((sign | bits) as u16)
    }
    fn load(self) -> f32 {
        let size = f32::from_bits(u32::from(self.0 & 0x7fff) << 13) * f32::from_bits((112 + 127) << 23);
        f32::from_bits(size.to_bits() | (u32::from(self.0 & 0x8000) << 16))
    }
}

/// All features of all points by one plain loop, whatever the storage.
fn read<T: Stored>(grid: &HashGrid, table: &[T], points: &[[f32; 3]], out: &mut [f32]) {
    let width = grid.width();
    for (l, level) in grid.levels().iter().enumerate() {
        let entries: &[[T; 2]] = &table.as_chunks().0[level.start..][..level.entries];
        for (p, out) in points.iter().zip(out.chunks_mut(width)) {
            let (mut cell, mut w) = ([0; 3], [0.0; 3]);
            for d in 0..3 {
                let at = p[d] * level.scale[d];
                cell[d] = (at as u32).min(level.res[d] - 2);
                let f = at - cell[d] as f32;
                w[d] = f * f * (3.0 - 2.0 * f);
            }
            let mut sum = [0.0; 2];
            for corner in 0..8u32 {
                let bit = [corner & 1, corner >> 1 & 1, corner >> 2];
                let along = |d: usize| if bit[d] == 1 { w[d] } else { 1.0 - w[d] };
                let weight = along(0) * along(1) * along(2);
                let entry = entries[level.index([cell[0] + bit[0], cell[1] + bit[1], cell[2] + bit[2]])];
                sum = [sum[0] + weight * entry[0].load(), sum[1] + weight * entry[1].load()];
            }
            out[2 * l..2 * l + 2].copy_from_slice(&sum);
        }
    }
}

fn target(p: &[f32; 3]) -> f32 {
    let [x, y, z] = *p;
    (9.0 * x).sin() * (7.0 * y).sin() * (11.0 * z).sin() + 0.5 * (60.0 * (x + y + z)).sin()
}

/// Fits the sum of features to [`target`] with Adam.
fn fit(grid: &mut HashGrid) {
    let (points, width) = (points(20_000, "fit"), grid.width());
    let columns = Columns { stride: width, offset: 0 };
    let mut out = vec![0.0; points.len() * width];
    for step in 1..=60 {
        grid.forward(&points, &mut out, columns);
        for (p, row) in points.iter().zip(out.chunks_mut(width)) {
            let residual = row.iter().sum::<f32>() - target(p);
            row.fill(residual);
        }
        grid.backward(&points, &out, columns);
        let rate = 0.02 / (1.0 - 0.9f32.powi(step)) * (1.0 - 0.99f32.powi(step)).sqrt();
        grid.visit_mut(&mut |p| {
            for (((v, g), m), s) in p.value.iter_mut().zip(&mut p.grad).zip(&mut p.moment1).zip(&mut p.moment2) {
                *m = 0.9 * *m + 0.1 * *g;
                *s = 0.99 * *s + 0.01 * *g * *g;
                *v -= rate * *m / (s.sqrt() + 1e-12);
                *g = 0.0;
            }
        });
    }
}

/// Root mean square of what the fit leaves.
fn left(points: &[[f32; 3]], features: &[f32], width: usize) -> f64 {
    let square = |(p, row): (&[f32; 3], &[f32])| f64::from(row.iter().sum::<f32>() - target(p)).powi(2);
    (points.iter().zip(features.chunks(width)).map(square).sum::<f64>() / points.len() as f64).sqrt()
}

/// Time and errors of one storage of a fitted grid.
fn storage<T: Stored>(case: &str, name: &str, grid: &HashGrid, points: &[[f32; 3]]) {
    let width = grid.width();
    let table: Vec<T> = grid.table().value.iter().map(|&v| T::store(v)).collect();
    let mut out = vec![0.0; points.len() * width];
    read(grid, &table, points, &mut out);
    let kinds = [
        ("feature", feature_error(grid, points, &out, width), "feature against f64"),
        ("fit", left(points, &out, width), "rms left by the fit"),
    ];
    for (what, error, error_kind) in kinds {
        let variant = format!("{name} {what}");
        let line = Row { case, variant: &variant, levels: width / 2, error, error_kind };
        row(&line, || read(grid, black_box(&table), points, &mut out));
    }
}

fn main() {
    let dnerf = HashGridConfig { base: [8.0; 3], end: [32.0, 32.0, 16.0], levels: 32, log2_table: 19 };
    let canonical = HashGridConfig { base: [16.0; 3], end: [2048.0; 3], levels: 16, log2_table: 19 };
    paths("hash temporal (dense)", &dnerf, 192);
    paths("hash video 256^2x128", &HashGridConfig { base: [16.0; 3], end: [256.0, 256.0, 128.0], ..dnerf }, 192);
    paths("hash canonical", &canonical, 32);
    paths("hash finest (all hashed)", &HashGridConfig { base: [2048.0; 3], ..canonical }, 32);
    let points = points(POINTS, "points");
    println!("    the target of the fits has an rms of {:.3}", left(&points, &vec![0.0; POINTS], 1));
    for levels in [8, 16, 32] {
        for log2_table in 14..=19 {
            let config = HashGridConfig { end: [512.0; 3], levels, log2_table, ..canonical };
            let Ok(mut grid) = HashGrid::new("grid", &config, 1) else { return };
            fit(&mut grid);
            let case = format!("hash fit L={levels} T=2^{log2_table}");
            storage::<f32>(&case, "f32", &grid, &points);
            storage::<Half>(&case, "f16", &grid, &points);
        }
    }
}
