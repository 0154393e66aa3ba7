//! Time and error of the two networks at their presets, and what leaving out empty texels saves.
//!
//! Each row is printed and appended to `target/speed-error/gs-texel.jsonl`. `work` counts floating-point operations of
//! the convolutions (two per multiply-add; forward and backward three times as many). The error is that of the output on
//! a small map, against the `f64` network, relative to the largest value; for sparse rows, whether a bit differs from
//! computing every texel. `tiny` and `small` run by default, `-- paper` adds the published sizes.

use gs_core::nn::map_reference::RefMap;
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Params, Rng};
use gs_texel::gaunet::{GauNet, GauNetConfig};
use gs_texel::geonet::{GeoNet, GeoNetConfig};
use gs_texel::net::{NetError, NormOver, reference};

/// Multiply-adds per texel of a GeoNet of width 32.
const GEONET: f64 = 5.88e9 / 65536.0;

fn random(n: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::new(1, name, 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}

fn keep(case: &str, variant: &str, size: usize, work: f64, error: (f64, &'static str), seconds: f64) {
    let row = BenchRow {
        krate: "gs-texel",
        case: case.to_owned(),
        variant: variant.to_owned(),
        n: size * size,
        threads: rayon::current_num_threads(),
        ms: 1e3 * seconds,
        work,
        error: Some(error.0),
        error_kind: error.1,
    };
    row.append(env!("CARGO_MANIFEST_DIR"));
}

/// Largest difference of outputs, relative to the largest wanted.
fn apart(got: &[f32], want: &[f64]) -> f64 {
    let size = want.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
    got.iter().zip(want).fold(0.0f64, |m, (g, w)| m.max((f64::from(*g) - w).abs())) / size
}

/// Values of every block in `f64`, and an input with all texels valid.
fn wide(net: &impl Params, size: usize, halvings: u32) -> (Vec<Vec<f64>>, RefMap<f64>, Vec<Vec<bool>>) {
    let mut params = Vec::new();
    net.visit(&mut |p| params.push(p.value.iter().map(|v| f64::from(*v)).collect()));
    let data = random(size * size * 6, "input").into_iter().map(f64::from).collect();
    let input = RefMap { height: size, width: size, channels: 6, data };
    (params, input, reference::masks(&vec![true; size * size], size, halvings))
}

/// A disc that fills `percent` of the map.
fn disc(size: usize, percent: usize) -> Vec<bool> {
    let (reach, centre) = ((size * size * percent) as f64 / 100.0 / std::f64::consts::PI, size as f64 / 2.0);
    let away = |i: usize| ((i % size) as f64 - centre).powi(2) + ((i / size) as f64 - centre).powi(2);
    (0..size * size).map(|i| away(i) < reach).collect()
}

/// Random values in the last layer, as after some training.
fn stirred<N: Params>(mut net: N) -> N {
    net.visit_mut(&mut |p| p.value.iter_mut().zip(random(p.grad.len(), &p.name)).for_each(|(v, n)| *v += 0.03 * n));
    net
}

fn runs(work: f64) -> usize {
    if work > 2e10 { 3 } else { 9 }
}

fn geonet(size: usize) -> Result<(), NetError> {
    let mut net = stirred(GeoNet::new("geonet", GeoNetConfig::default(), 1)?);
    let (params, input, masks) = wide(&net, 16, 3);
    let mut small = net.tape(16, None)?;
    let want = reference::geonet(&params, &input, &masks);
    let error = (apart(net.forward(&random(16 * 16 * 6, "input"), &mut small)?, &want.data), "relative to f64, 16^2");
    let (map, d, mut tape) = (random(size * size * 6, "map"), random(size * size * 3, "d"), net.tape(size, None)?);
    let work = 2.0 * GEONET * (size * size) as f64;
    let name = format!("GeoNet {size}^2");
    let mut failed = Ok(());
    let forward = median_seconds(runs(work), || failed = net.forward(&map, &mut tape).map(|_| ()));
    keep(&name, "forward", size, work, error, forward);
    let both = median_seconds(runs(work), || {
        failed = net.forward(&map, &mut tape).map(|_| ()).and_then(|()| net.backward(&mut tape, &d));
    });
    keep(&name, "forward and backward", size, 3.0 * work, error, both);
    println!("    {:.0} MB of maps", tape.bytes() as f64 / 1e6);
    failed
}

fn gaunet(name: &str, config: GauNetConfig, size: usize) -> Result<(), NetError> {
    let mut net = stirred(GauNet::new("gaunet", config, 1)?);
    let (params, input, masks) = wide(&net, 16, config.levels);
    let mut small = net.tape(16, None)?;
    let want = reference::gaunet(&params, &input, &masks);
    let error = (apart(net.forward(&random(16 * 16 * 6, "input"), &mut small)?, &want.data), "relative to f64, 16^2");
    let outputs = config.outputs();
    let (map, d, mut tape) =
        (random(size * size * 6, "map"), random(size * size * outputs, "d"), net.tape(size, None)?);
    let work = 2.0 * config.multiply_adds() * (size * size) as f64;
    let name = format!("GauNet {name} {size}^2");
    let mut failed = Ok(());
    let forward = median_seconds(runs(work), || failed = net.forward(&map, &mut tape).map(|_| ()));
    keep(&name, "forward", size, work, error, forward);
    let both = median_seconds(runs(work), || {
        failed = net.forward(&map, &mut tape).map(|_| ()).and_then(|()| net.backward(&mut tape, &d));
    });
    keep(&name, "forward and backward", size, 3.0 * work, error, both);
    println!("    {:.0} MB of maps", tape.bytes() as f64 / 1e6);
    failed
}

/// The tiny GauNet over a mask, every texel computed or only valid ones.
fn sparse(size: usize) -> Result<(), NetError> {
    let config = GauNetConfig { norm_over: NormOver::Mask, ..GauNetConfig::tiny() };
    let work = 2.0 * config.multiply_adds() * (size * size) as f64;
    for percent in [50, 60, 70] {
        let (mask, map, d) = (disc(size, percent), random(size * size * 6, "map"), random(size * size * 14, "d"));
        let (mut want, mut first) = (Vec::new(), None);
        for sparse in [false, true] {
            let mut net = stirred(GauNet::new("gaunet", GauNetConfig { sparse, ..config }, 1)?);
            let mut tape = net.tape(size, Some(&mask))?;
            let got = net.forward(&map, &mut tape)?.to_vec();
            let differs = sparse && got != want;
            want = got;
            let mut failed = Ok(());
            let seconds = median_seconds(9, || {
                failed = net.forward(&map, &mut tape).map(|_| ()).and_then(|()| net.backward(&mut tape, &d));
            });
            failed?;
            let variant = if sparse { "valid texels" } else { "every texel" };
            let case = format!("GauNet tiny {size}^2, {percent} %");
            keep(&case, variant, size, 3.0 * work, (f64::from(u8::from(differs)), "1 if a bit differs"), seconds);
            match first {
                None => first = Some(seconds),
                Some(first) => println!("    in {:.0} % of the time", 100.0 * seconds / first),
            }
        }
    }
    Ok(())
}

fn main() -> Result<(), NetError> {
    let paper = std::env::args().any(|a| a == "paper");
    geonet(64)?;
    geonet(128)?;
    gaunet("tiny", GauNetConfig::tiny(), 128)?;
    gaunet("small", GauNetConfig::small(), 256)?;
    sparse(128)?;
    if paper {
        geonet(256)?;
        gaunet("paper", GauNetConfig::default(), 256)?;
    }
    Ok(())
}
