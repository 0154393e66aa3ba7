//! Time and error of gs-core: splat files, SH basis and rotation, covariance from quaternion and scales.
//!
//! Criterion measures the time; each case is also timed here (median) and appended with its error, against the encoded
//! values or against `f64`, as a JSON line to `target/speed-error/gs-core.jsonl`.

use criterion::{Criterion, Throughput};
use glam::Vec3;
use gs_core::io::{Limits, RawSplats, parse_splats, ply, splat, spz};
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Rng, covariance, rot, sh};
use std::hint::black_box;

const ROWS: usize = 100_000;
const REPEATS: usize = 15;

fn cloud(n: usize) -> RawSplats {
    let mut out = RawSplats { degree: 3, ..RawSplats::default() };
    for row in 0..n {
        let mut r = Rng::new(1, "bench cloud", 0, row as u64);
        out.means.push(Vec3::new(r.normal(), r.normal(), r.normal()));
        out.quats.push([r.normal(), r.normal(), r.normal(), r.normal()]);
        out.log_scales.push(Vec3::new(r.range(-6.0, 0.0), r.range(-6.0, 0.0), r.range(-6.0, 0.0)));
        out.logit_opacities.push(1.8 * r.normal());
        out.sh.extend((0..48).map(|_| 0.2 * r.normal()));
    }
    out
}

/// One case: its closure, amount of work and error.
struct Case<'a> {
    case: &'static str,
    variant: &'static str,
    /// Bytes of the file, or evaluations.
    work: u64,
    unit: &'static str,
    error: f64,
    error_kind: &'static str,
    run: Box<dyn FnMut() + 'a>,
}

/// Measures the case and appends its row.
fn record(case: &mut Case<'_>) {
    let ms = 1e3 * median_seconds(REPEATS, &mut case.run);
    let row = BenchRow {
        krate: "gs-core",
        case: case.case.into(),
        variant: case.variant.into(),
        n: ROWS,
        threads: 1,
        ms,
        work: case.work as f64,
        error: Some(case.error),
        error_kind: case.error_kind,
    };
    row.append(env!("CARGO_MANIFEST_DIR"));
}

fn file_cases(splats: &RawSplats) -> Vec<Case<'_>> {
    type Encode = fn(&RawSplats) -> Vec<u8>;
    let formats: [(&'static str, Encode); 3] = [
        ("ply", |s| encode(|out| ply::write(s, out))),
        ("splat", |s| encode(|out| splat::write(s, out))),
        ("spz", |s| encode(|out| spz::write(s, &spz::SpzOptions::default(), out))),
    ];
    let mut cases = Vec::new();
    for (name, write) in formats {
        let bytes = write(splats);
        let again = read(name, &bytes);
        let exact = name == "ply";
        let error = difference(splats, &again, exact);
        let kind = if exact { "max abs, all columns" } else { "max abs, means and log-scales" };
        let (work, unit) = (bytes.len() as u64, "B");
        let write_case = move || drop(black_box(write(splats)));
        let read_case = move || drop(black_box(read(name, &bytes)));
        let case = |variant, run| Case { case: name, variant, work, unit, error, error_kind: kind, run };
        cases.push(case("write", Box::new(write_case) as Box<dyn FnMut()>));
        cases.push(case("read", Box::new(read_case)));
    }
    cases
}

/// Largest difference of means and log-scales, or of every column.
fn difference(a: &RawSplats, b: &RawSplats, all: bool) -> f64 {
    let flat = |s: &RawSplats| {
        let mut v: Vec<f32> = s.means.iter().chain(&s.log_scales).flat_map(|v| v.to_array()).collect();
        if all {
            v.extend(s.quats.as_flattened().iter().chain(&s.logit_opacities).chain(&s.sh));
        }
        v
    };
    let (a, b) = (flat(a), flat(b));
    assert_eq!(a.len(), b.len(), "a row was lost");
    a.iter().zip(b).map(|(x, y)| f64::from((x - y).abs())).fold(0.0, f64::max)
}

fn encode(write: impl FnOnce(&mut Vec<u8>) -> std::io::Result<()>) -> Vec<u8> {
    let mut out = Vec::new();
    write(&mut out).expect("writing to memory");
    out
}

fn read(format: &str, bytes: &[u8]) -> RawSplats {
    parse_splats(bytes, &format!("bench.{format}"), &Limits::default()).expect("what was written is read")
}

/// Sum of a row's 16 basis values, so that nothing is optimised away.
fn basis_sums(splats: &RawSplats) -> f32 {
    splats.means.iter().map(|m| sh::basis(sh::direction(m.to_array(), [0.0; 3]).0, 3).iter().sum::<f32>()).sum()
}

fn covariances(splats: &RawSplats) -> f32 {
    let rows = splats.quats.iter().zip(&splats.log_scales);
    rows.map(|(q, s)| {
        let m = covariance::factor(&rot::matrix(rot::normalise(*q).wxyz), s.to_array().map(f32::exp));
        covariance::covariance(&m).iter().sum::<f32>()
    })
    .sum()
}

/// Coefficients that turn with the splats.
fn rotated(splats: &RawSplats) -> Vec<f32> {
    let mut coeffs = splats.sh.clone();
    for (row, q) in coeffs.chunks_exact_mut(48).zip(&splats.quats) {
        sh::ShRotation::new(&rot::matrix(rot::normalise(*q).wxyz), 3).apply(row);
    }
    coeffs
}

/// Worst difference of [`rotated`] from the same in `f64`.
fn rotated_error(splats: &RawSplats) -> f64 {
    let rows = rotated(splats);
    let rows = rows.chunks_exact(48).zip(splats.sh.chunks_exact(48)).zip(&splats.quats);
    let worst = rows.map(|((got, sh), q)| {
        let mut wide: Vec<f64> = sh.iter().map(|v| f64::from(*v)).collect();
        sh::ShRotation::new(&rot::matrix(rot::normalise(q.map(f64::from)).wxyz), 3).apply(&mut wide);
        got.iter().zip(&wide).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
    });
    worst.fold(0.0, f64::max)
}

fn math_cases(splats: &RawSplats) -> Vec<Case<'_>> {
    let basis_error = |m: &Vec3| {
        let wide = sh::basis(sh::direction(m.to_array().map(f64::from), [0.0; 3]).0, 3);
        let narrow = sh::basis(sh::direction(m.to_array(), [0.0; 3]).0, 3);
        wide.iter().zip(narrow).map(|(a, b)| (a - f64::from(b)).abs()).fold(0.0, f64::max)
    };
    let covariance_error = |(q, s): (&[f32; 4], &Vec3)| {
        let scales = s.to_array().map(f32::exp);
        let narrow = covariance::covariance(&covariance::factor(&rot::matrix(rot::normalise(*q).wxyz), scales));
        let unit = rot::normalise(q.map(f64::from)).wxyz;
        let wide = covariance::covariance(&covariance::factor(&rot::matrix(unit), scales.map(f64::from)));
        let size = wide.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        wide.iter().zip(narrow).map(|(a, b)| (a - f64::from(b)).abs() / size).fold(0.0, f64::max)
    };
    let case = |case, error, error_kind, run| Case {
        case,
        variant: "f32 scalar",
        work: ROWS as u64,
        unit: "rows",
        error,
        error_kind,
        run,
    };
    vec![
        case(
            "sh basis",
            splats.means.iter().map(basis_error).fold(0.0, f64::max),
            "max abs against f64",
            Box::new(|| _ = black_box(basis_sums(splats))) as Box<dyn FnMut()>,
        ),
        case(
            "sh rotation, degree 3",
            rotated_error(splats),
            "max abs against f64, coefficients of 0.2",
            Box::new(|| _ = black_box(rotated(splats))),
        ),
        case(
            "covariance",
            splats.quats.iter().zip(&splats.log_scales).map(covariance_error).fold(0.0, f64::max),
            "max against f64, relative to the largest entry",
            Box::new(|| _ = black_box(covariances(splats))),
        ),
    ]
}

fn main() {
    let mut criterion = Criterion::default().sample_size(10).configure_from_args();
    let splats = cloud(ROWS);
    for mut case in file_cases(&splats).into_iter().chain(math_cases(&splats)) {
        record(&mut case);
        let mut group = criterion.benchmark_group(case.case);
        group.throughput(if case.unit == "B" { Throughput::Bytes(case.work) } else { Throughput::Elements(case.work) });
        group.bench_function(case.variant, |b| b.iter(&mut case.run));
        group.finish();
    }
    criterion.final_summary();
}
