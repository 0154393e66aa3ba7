//! Time and error of the encoders, the layers and the whole fields.
//!
//! Each row is printed and appended to `target/speed-error/gs-deform.jsonl`. `work` is the count behind the rate:
//! points, or floating-point operations for matrix products. The roof is the same machine's 1024³ product, one serial
//! call per thread.

use criterion::Criterion;
use glam::Vec3;
use gs_core::nn::gemm;
use gs_core::nn::{BLOCK, CHUNKS, Init, Mlp, MlpGrad, MlpTape, blocks_per_chunk};
use gs_core::speed::{BenchRow, Stopwatch};
use gs_core::{Geometry, Rng, Time};
use gs_deform::encode::{HexPlane, HexPlaneConfig, HexTape};
use gs_deform::reference::HexPlaneRef;
use gs_deform::{Aabb, DefGsConfig, DefMlp, Field, FourDgsConfig, HexPlaneField};
use rayon::prelude::*;
use std::time::Duration;

/// A row of the table, without its time.
struct Row {
    case: &'static str,
    variant: &'static str,
    n: usize,
    work: f64,
    error: f64,
    error_kind: &'static str,
}

/// Measures `f`, prints the row, appends it, returns the median in milliseconds.
fn measure(c: &mut Criterion, row: &Row, mut f: impl FnMut()) -> f64 {
    let mut laps = Stopwatch::default();
    c.bench_function(&format!("{}/{}/{}", row.case, row.variant, row.n), |b| {
        b.iter_custom(|calls| laps.run(calls, &mut f))
    });
    let Some(ms) = laps.median_ms() else { return f64::NAN };
    let line = BenchRow {
        krate: "gs-deform",
        case: row.case.to_owned(),
        variant: row.variant.to_owned(),
        n: row.n,
        threads: rayon::current_num_threads(),
        ms,
        work: row.work,
        error: Some(row.error),
        error_kind: row.error_kind,
    };
    line.append(env!("CARGO_MANIFEST_DIR"));
    ms
}

fn random(n: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::new(1, name, 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}

fn points(n: usize) -> Vec<Vec3> {
    let mut rng = Rng::new(1, "points", 0, 0);
    (0..n).map(|_| Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0))).collect()
}

fn t() -> Time {
    Time { normalised: 0.37, seconds: 0.37 }
}

/// Largest difference relative to the largest wanted value.
fn worst(got: impl Iterator<Item = f32>, want: &[f64]) -> f64 {
    let largest = want.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
    got.zip(want).fold(0.0f64, |m, (g, w)| m.max((f64::from(g) - w).abs())) / largest
}

/// The case of the library comparison: six planes of 128² nodes, 32 channels.
fn hexplane(c: &mut Criterion) {
    let n = 100_000;
    let config = HexPlaneConfig { resolution: [128, 128, 128, 255], levels: vec![1], ..HexPlaneConfig::default() };
    let Ok(mut hex) = HexPlane::new("hex", &config, Aabb::cube(1.0), 1) else { return };
    let (means, mut tape, mut d_means) = (points(n), HexTape::default(), vec![Vec3::ZERO; n]);
    hex.forward(&means, t(), &mut tape);
    let d = random(32, "d");
    for block in &mut tape.blocks {
        block.d_features = d.iter().copied().cycle().take(block.features.len()).collect();
    }
    hex.backward(&mut tape, Some(&mut d_means));
    let reference = HexPlaneRef::new(&hex);
    let mut scratch: Vec<Vec<f64>> = reference.planes.iter().map(|p| vec![0.0; p.len()]).collect();
    let d: Vec<f64> = d.into_iter().map(f64::from).collect();
    let (mut features, mut gradients) = (Vec::new(), Vec::new());
    for p in &means[..2000] {
        let p = p.to_array().map(f64::from);
        features.extend(reference.features(p, t()));
        gradients.extend(reference.backward(p, t(), &d, &mut scratch));
    }
    let forward_error = worst(tape.blocks.iter().flat_map(|b| b.features.iter().copied()), &features);
    let backward_error = worst(d_means.iter().flat_map(|d| d.to_array()), &gradients);
    let row = |variant, error| Row {
        case: "hexplane 6x128^2x32",
        variant,
        n,
        work: n as f64,
        error,
        error_kind: "relative to f64",
    };
    measure(c, &row("forward", forward_error), || hex.forward(&means, t(), &mut tape));
    measure(c, &row("backward to planes and points", backward_error), || hex.backward(&mut tape, Some(&mut d_means)));
    measure(c, &row("backward to planes", backward_error), || hex.backward(&mut tape, None));
}

/// Three layers of 64 on many rows, as a field runs them: blocks forward, chunks of blocks back.
fn mlp(c: &mut Criterion, roof: f64) {
    let n = 100_000;
    let mut net = Mlp::new("net", &[64, 64, 64, 64], Init::FanIn, Init::FanIn, 1);
    let (x, dy) = (random(n * 64, "x"), random(n * 64, "dy"));
    let mut blocks: Vec<(MlpTape, Vec<f32>)> = vec![Default::default(); n.div_ceil(BLOCK)];
    let mut chunks = vec![MlpGrad::default(); CHUNKS];
    let forward = |net: &Mlp, blocks: &mut Vec<(MlpTape, Vec<f32>)>| {
        blocks.par_iter_mut().zip(x.par_chunks(BLOCK * 64)).for_each(|((tape, _), x)| net.forward(x, tape));
    };
    forward(&net, &mut blocks);
    let mut want: Vec<f64> = x[..64].iter().map(|&v| f64::from(v)).collect();
    for (i, layer) in net.layers().iter().enumerate() {
        let row =
            |(w, b): (&[f32], &f32)| w.iter().zip(&want).map(|(w, h)| f64::from(*w) * h).sum::<f64>() + f64::from(*b);
        let y: Vec<f64> = layer.weight.value.chunks(64).zip(&layer.bias.value).map(row).collect();
        want = y.into_iter().map(|v| if i < 2 { v.max(0.0) } else { v }).collect();
    }
    let error = worst(blocks[0].0.output().iter().copied(), &want);
    let flops = 2.0 * (n * 3 * 64 * 64) as f64;
    let row = |variant, work| Row { case: "mlp 3x64", variant, n, work, error, error_kind: "output relative to f64" };
    let ms = measure(c, &row("forward", flops), || forward(&net, &mut blocks));
    println!("    {:.0} % of the roof", 100.0 * flops / ms / 1e6 / roof);
    let ms = measure(c, &row("forward and backward", 3.0 * flops), || {
        forward(&net, &mut blocks);
        let per_chunk = blocks_per_chunk(blocks.len());
        let rows = x.par_chunks(per_chunk * BLOCK * 64).zip(dy.par_chunks(per_chunk * BLOCK * 64));
        blocks.par_chunks_mut(per_chunk).zip(&mut chunks).zip(rows).for_each(|((blocks, grad), (x, dy))| {
            grad.reset(&net);
            for ((tape, dx), (x, dy)) in blocks.iter_mut().zip(x.chunks(BLOCK * 64).zip(dy.chunks(BLOCK * 64))) {
                dx.clear();
                dx.resize(x.len(), 0.0);
                net.backward(x, tape, dy, Some(dx), grad);
            }
        });
        net.add_grads(chunks.iter());
    });
    println!("    {:.0} % of the roof", 100.0 * 3.0 * flops / ms / 1e6 / roof);
}

/// A whole field as a training step uses it; the error is how far an untrained field is from the identity.
fn field<F: Field>(c: &mut Criterion, case: &'static str, n: usize, mut field: F) {
    let canonical =
        Geometry { means: points(n), quats: vec![[1.0, 0.2, 0.0, 0.0]; n], scales: vec![Vec3::splat(0.01); n] };
    let (mut tape, mut out) = (F::Tape::default(), Geometry::default());
    field.forward(canonical.view(), t(), &mut tape, &mut out);
    let error = canonical.means.iter().zip(&out.means).fold(0.0f32, |m, (a, b)| m.max((*a - *b).abs().max_element()));
    field.visit_mut(&mut |p| {
        if p.value.iter().all(|v| *v == 0.0) {
            p.value = random(p.len(), &p.name).iter().map(|v| 0.01 * v).collect();
        }
    });
    field.forward(canonical.view(), t(), &mut tape, &mut out);
    let (d_out, mut d) = (Geometry { means: points(n), ..Geometry::zeros(n) }, Geometry::zeros(n));
    let row = |variant| Row {
        case,
        variant,
        n,
        work: n as f64,
        error: f64::from(error),
        error_kind: "untrained against identity",
    };
    measure(c, &row("forward"), || field.forward(canonical.view(), t(), &mut tape, &mut out));
    measure(c, &row("forward and backward"), || {
        field.forward(canonical.view(), t(), &mut tape, &mut out);
        field.backward(canonical.view(), &mut tape, d_out.view(), &mut d);
    });
    if !field.regularise(canonical.view(), t(), 1).is_empty() {
        measure(c, &row("regularisers"), || {
            field.regularise(canonical.view(), t(), 1);
        });
    }
}

fn main() {
    let mut c = Criterion::default()
        .sample_size(15)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(900))
        .without_plots()
        .configure_from_args();
    let roof = gemm::roof();
    roof.append(env!("CARGO_MANIFEST_DIR"));
    hexplane(&mut c);
    mlp(&mut c, roof.rate());
    for (case, config) in [("fourdgs default", FourDgsConfig::default()), ("fourdgs fast", FourDgsConfig::fast())] {
        if let Ok(f) = HexPlaneField::new("field", &config, Aabb::cube(1.0), 1) {
            field(&mut c, case, 20_000, f);
        }
    }
    for (case, config) in [("defgs default", DefGsConfig::default()), ("defgs fast", DefGsConfig::fast())] {
        if let Ok(f) = DefMlp::new(&config, 1) {
            field(&mut c, case, 20_000, f);
        }
    }
}
