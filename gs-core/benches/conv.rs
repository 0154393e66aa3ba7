//! Time and error of convolutions, against the matrix product of the same shape and the peak rate of the machine.
//!
//! Each row is printed and appended to `target/speed-error/gs-core.jsonl`. `work` counts floating-point operations (two
//! per multiply-add). The peak is a 1024³ product, one serial call per thread; the product of the same shape is
//! im2col without the cost of im2col. Errors are against `f64`, relative to
//! the largest value. The last rows leave out pixels of a map that is 50, 60 and 70 % full.

use gs_core::nn::gemm::{Mat, MatMut, Write, gemm, roof};
use gs_core::nn::map_reference::{RefMap, conv};
use gs_core::nn::{Conv, ConvSpec, Init, Map, Sites};
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Params, Rng};
use rayon::prelude::*;

const RUNS: usize = 15;
/// Height of the map on which the error against `f64` is measured.
const REFERENCE_SIDE: usize = 16;

/// A convolution of GeoNet or GauNet, and the side of its map there.
struct Case {
    name: &'static str,
    side: usize,
    spec: ConvSpec,
}

const fn case(name: &'static str, side: usize, kernel: usize, stride: usize, inputs: usize, outputs: usize) -> Case {
    Case { name, side, spec: ConvSpec { kernel, stride, inputs, outputs, bias: true } }
}

const CASES: [Case; 9] = [
    case("3x3 16->16", 128, 3, 1, 16, 16),
    case("3x3 32->32", 256, 3, 1, 32, 32),
    case("3x3 64->64", 128, 3, 1, 64, 64),
    case("3x3 96->96", 64, 3, 1, 96, 96),
    case("3x3 54->32", 256, 3, 1, 54, 32),
    case("3x3 48->96 stride 2", 128, 3, 2, 48, 96),
    case("5x5 6->32 stride 2", 256, 5, 2, 6, 32),
    case("3x3 512->512", 32, 3, 1, 512, 512),
    case("3x3 1024->1024", 16, 3, 1, 1024, 1024),
];

fn random(n: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::new(1, name, 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}

fn random_map(side: usize, channels: usize, name: &str) -> Map {
    let mut map = Map::zeros(side, side, channels, 2);
    map.load(&random(side * side * channels, name));
    map
}

/// Measures `f`, appends its row, returns operations per nanosecond.
fn measured(
    case: &str,
    variant: &str,
    n: usize,
    work: f64,
    error: Option<(f64, &'static str)>,
    f: impl FnMut(),
) -> f64 {
    let ms = 1e3 * median_seconds(RUNS, f);
    let row = BenchRow {
        krate: "gs-core",
        case: case.to_owned(),
        variant: variant.to_owned(),
        n,
        threads: rayon::current_num_threads(),
        ms,
        work,
        error: error.map(|e| e.0),
        error_kind: error.map_or("none", |e| e.1),
    };
    row.append(env!("CARGO_MANIFEST_DIR"));
    work / ms / 1e6
}

/// The matrix product of the convolution's shape after im2col.
fn same_shape(case: &Case, pixels: usize, work: f64) -> f64 {
    let ConvSpec { kernel, inputs, outputs, .. } = case.spec;
    let depth = kernel * kernel * inputs;
    let (a, b, mut out) = (random(pixels * depth, "a"), random(depth * outputs, "b"), vec![0.0; pixels * outputs]);
    measured(case.name, "product of the same shape", pixels, work, None, || {
        out.par_chunks_mut(256 * outputs).zip(a.par_chunks(256 * depth)).for_each(|(out, a)| {
            let rows = out.len() / outputs;
            gemm(MatMut::new(out, rows, outputs), Mat::new(a, rows, depth), Mat::new(&b, depth, outputs), Write::Set);
        });
    })
}

/// Largest difference from `f64`, relative to the largest value, on a small map.
fn error(layer: &Conv, spec: ConvSpec) -> f64 {
    let side = if spec.inputs > 256 { 4 } else { REFERENCE_SIDE };
    let (x, out) = (random_map(side, spec.inputs, "x"), side / spec.stride);
    let mut y = Map::zeros(out, out, spec.outputs, 1);
    layer.forward(&x, &mut y, &Sites::full(out, out));
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let input = RefMap::from_fn([side, side, spec.inputs], |y, at, c| f64::from(x.pixel(y, at)[c]));
    let bias = layer.bias.as_ref().map_or(Vec::new(), |b| wide(&b.value));
    let want = conv(&input, &wide(&layer.weight.value), &bias, spec.kernel, spec.stride);
    let mut got = vec![0.0; want.data.len()];
    y.store(&mut got);
    let size = want.data.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    got.iter().zip(&want.data).fold(0.0f64, |m, (g, w)| m.max((f64::from(*g) - w).abs())) / size
}

fn run(case: &Case, peak: f64) {
    let (ConvSpec { kernel, stride, inputs, outputs, .. }, side) = (case.spec, case.side);
    let mut layer = Conv::new("c", case.spec, Init::FanIn, 1);
    let out = side / stride;
    let (x, mut y, mut dx) =
        (random_map(side, inputs, "x"), Map::zeros(out, out, outputs, 1), Map::zeros(side, side, inputs, 1));
    let (sites, all) = (Sites::full(out, out), Sites::full(side, side));
    let work = 2.0 * (out * out * kernel * kernel * inputs * outputs) as f64;
    let measured_error = Some((error(&layer, case.spec), "relative to f64"));
    let forward = measured(case.name, "forward", out * out, work, measured_error, || {
        layer.forward(&x, &mut y, &sites);
    });
    let input = measured(case.name, "gradient of the input", out * out, work, None, || {
        layer.backward_input(&y, &mut dx, &all, Write::Set);
    });
    let weight = measured(case.name, "gradient of the weight", out * out, work, None, || {
        layer.backward_params(&x, &y, &sites);
    });
    layer.clear_grads();
    let product = same_shape(case, out * out, work);
    let share = |rate: f64| 100.0 * rate / peak;
    println!(
        "    {:.0} % of the peak forward, {:.0} % and {:.0} % backward; {:.0} % of the product of the same shape",
        share(forward),
        share(input),
        share(weight),
        100.0 * forward / product
    );
}

/// The sites of a disc that fills part of the map, against all sites.
fn sparse() {
    let (side, spec) = (256, ConvSpec { kernel: 3, stride: 1, inputs: 32, outputs: 32, bias: true });
    let layer = Conv::new("c", spec, Init::FanIn, 1);
    let (x, mut dense, mut part) =
        (random_map(side, 32, "x"), Map::zeros(side, side, 32, 1), Map::zeros(side, side, 32, 1));
    let work = 2.0 * (side * side * 9 * 32 * 32) as f64;
    layer.forward(&x, &mut dense, &Sites::full(side, side));
    for fill in [50usize, 60, 70, 100] {
        let radius2 = (side * side * fill) as f64 / 100.0 / std::f64::consts::PI;
        let centre = side as f64 / 2.0;
        let inside = |y: usize, x: usize| (y as f64 - centre).powi(2) + (x as f64 - centre).powi(2) < radius2;
        let sites = Sites::from_fn(side, side, |y, x| fill == 100 || inside(y, x));
        layer.forward(&x, &mut part, &sites);
        let differs =
            (0..side).any(|y| sites.row(y).iter().any(|&x| part.pixel(y, x as usize) != dense.pixel(y, x as usize)));
        let bits = Some((f64::from(u8::from(differs)), "1 if a bit differs"));
        let work = work * sites.len() as f64 / (side * side) as f64;
        measured("3x3 32->32, sites", &format!("{fill} % full"), sites.len(), work, bits, || {
            layer.forward(&x, &mut part, &sites);
        });
    }
}

fn main() {
    let peak = roof();
    peak.append(env!("CARGO_MANIFEST_DIR"));
    CASES.iter().for_each(|case| run(case, peak.rate()));
    sparse();
}
