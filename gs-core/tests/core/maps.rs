//! Layers of maps: analytic truths, `f64` derivatives against differences, `f32` against `f64`, and the same bits for
//! any number of threads and any choice of sites.
use gs_core::nn::gemm::Write;
use gs_core::nn::map_reference::{self as reference, Dual, RefMap};
use gs_core::nn::{Conv, ConvSpec, ConvTranspose, GroupNorm, Init, Map, NormTape, Sites, resample};
use gs_core::{Params, Rng};

/// `f64` derivative against a central difference of step 1e-5, relative to 1 + |derivative|.
const DIFFERENCE: f64 = 2e-7;
/// `f32` value or gradient against `f64`, relative to the largest of its kind.
const CONV: f64 = 2e-6;
/// As [`CONV`], with statistics over some hundred values in between.
const NORM: f64 = 5e-6;
/// As [`CONV`]: a few products.
const RESAMPLE: f64 = 3e-7;

fn random(n: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::new(11, name, 0, n as u64);
    (0..n).map(|_| rng.normal()).collect()
}

fn map(shape: [usize; 3], border: usize, name: &str) -> Map {
    let mut map = Map::zeros(shape[0], shape[1], shape[2], border);
    map.load(&random(shape.iter().product(), name));
    map
}

fn inside(map: &Map) -> Vec<f32> {
    let mut values = vec![0.0; map.height() * map.width() * map.channels()];
    map.store(&mut values);
    values
}

/// About two thirds of the pixels.
fn some(height: usize, width: usize) -> Sites {
    Sites::from_fn(height, width, |y, x| (y * 7 + x * 3 + y * x) % 3 != 0)
}

fn flags(sites: &Sites) -> Vec<bool> {
    let mut flags = vec![false; sites.height() * sites.width()];
    for y in 0..sites.height() {
        sites.row(y).iter().for_each(|&x| flags[y * sites.width() + x as usize] = true);
    }
    flags
}

fn ref_map(shape: [usize; 3], values: &[Dual]) -> RefMap<Dual> {
    let [height, width, channels] = shape;
    RefMap { height, width, channels, data: values.to_vec() }
}

/// `Σ weight · y` over the pixels that are inside.
fn loss(y: RefMap<Dual>, weight: &[f32], inside: &[bool]) -> Dual {
    let y = y.masked(inside);
    y.data.iter().zip(weight).fold(Dual::default(), |s, (y, w)| s + *y * Dual { v: f64::from(*w), d: 0.0 })
}

/// Values of `f32` against `f64`, relative to the largest.
fn close(got: &[f32], want: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), want.len());
    let size = want.iter().fold(1e-30f64, |s, v| s.max(v.abs()));
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        assert!((f64::from(*g) - w).abs() <= tolerance * size, "{what}[{i}]: {g} against {w} of {size}");
    }
}

/// For every argument: the exact `f64` derivative of `loss` at a sample of entries, against differences and `got`.
fn gradients(what: &str, args: &[&[f32]], got: &[Vec<f32>], tolerance: f64, loss: &dyn Fn(&[Vec<Dual>]) -> Dual) {
    let mut at: Vec<Vec<Dual>> =
        args.iter().map(|a| a.iter().map(|v| Dual { v: f64::from(*v), d: 0.0 }).collect()).collect();
    for a in 0..args.len() {
        let step = at[a].len().div_ceil(40).max(1);
        let (mut exact, mut found) = (Vec::new(), Vec::new());
        for i in (0..at[a].len()).step_by(step) {
            let (v, h) = (at[a][i].v, 1e-5);
            at[a][i].d = 1.0;
            let d = loss(&at).d;
            at[a][i] = Dual { v: v + h, d: 0.0 };
            let high = loss(&at).v;
            at[a][i].v = v - h;
            let difference = (high - loss(&at).v) / (2.0 * h);
            at[a][i].v = v;
            assert!((d - difference).abs() <= DIFFERENCE * (1.0 + d.abs()), "{what} {a}[{i}]: {d}, {difference}");
            exact.push(d);
            found.push(got[a][i]);
        }
        close(&found, &exact, tolerance, &format!("{what}, gradient {a}"));
    }
}

#[test]
fn a_convolution_shifts_scales_and_pads() {
    let mut layer = Conv::new("c", ConvSpec { kernel: 3, stride: 1, inputs: 1, outputs: 1, bias: true }, Init::Zero, 1);
    // Twice the right neighbour.
    layer.weight.value[5] = 2.0;
    layer.bias.as_mut().unwrap().value[0] = 0.5;
    let (x, mut y) = (map([2, 3, 1], 1, "x"), Map::zeros(2, 3, 1, 1));
    layer.forward(&x, &mut y, &Sites::full(2, 3));
    let v = inside(&x);
    assert_eq!(inside(&y), [2.0 * v[1] + 0.5, 2.0 * v[2] + 0.5, 0.5, 2.0 * v[4] + 0.5, 2.0 * v[5] + 0.5, 0.5]);
}

#[test]
fn convolutions_have_three_level_gradients() {
    for (case, (kernel, stride, inputs, outputs, size)) in [
        (1, 1, 5, 3, [4, 5]),
        (3, 1, 1, 1, [3, 4]),
        (3, 1, 6, 17, [8, 6]),
        (3, 2, 7, 33, [6, 10]),
        (5, 2, 6, 32, [8, 8]),
        (5, 1, 2, 70, [5, 6]),
        (1, 2, 16, 48, [4, 6]),
        (3, 1, 300, 20, [4, 3]),
    ]
    .into_iter()
    .enumerate()
    {
        for full in [true, false] {
            let spec = ConvSpec { kernel, stride, inputs, outputs, bias: case % 2 == 0 };
            let mut layer = Conv::new("c", spec, Init::FanIn, case as u64);
            let [h, w] = size;
            let out = [h / stride, w / stride, outputs];
            let (sites, all) =
                (if full { Sites::full(out[0], out[1]) } else { some(out[0], out[1]) }, Sites::full(h, w));
            let (x, mut y) = (map([h, w, inputs], 2, "x"), Map::zeros(out[0], out[1], outputs, 2));
            layer.forward(&x, &mut y, &sites);
            let weight = random(out.iter().product(), "dy");
            let mut dy = Map::like(&y);
            dy.load(&weight);
            dy.clear_outside(&sites);
            let mut dx = Map::zeros(h, w, inputs, 1);
            layer.backward_input(&dy, &mut dx, &all, Write::Set);
            let once = inside(&dx);
            layer.backward_input(&dy, &mut dx, &all, Write::Add);
            assert!(once.iter().zip(inside(&dx)).all(|(a, b)| (2.0 * a - b).abs() <= 4e-6 * (1.0 + a.abs())));
            layer.backward_params(&x, &dy, &sites);
            let (values, none) = (inside(&x), Vec::new());
            let bias = layer.bias.as_ref().map_or(&none, |b| &b.value);
            let run = |a: &[Vec<Dual>]| reference::conv(&ref_map([h, w, inputs], &a[0]), &a[1], &a[2], kernel, stride);
            let wide = |v: &[f32]| v.iter().map(|v| Dual { v: f64::from(*v), d: 0.0 }).collect::<Vec<_>>();
            let want = run(&[wide(&values), wide(&layer.weight.value), wide(bias)]).masked(&flags(&sites));
            close(&inside(&y), &want.data.iter().map(|v| v.v).collect::<Vec<_>>(), CONV, &format!("case {case}"));
            let bias_grad = layer.bias.as_ref().map_or(none.clone(), |b| b.grad.clone());
            let got = [once, layer.weight.grad.clone(), bias_grad];
            let args = [values.as_slice(), &layer.weight.value, bias];
            gradients(&format!("case {case}"), &args, &got, CONV, &|a| loss(run(a), &weight, &flags(&sites)));
        }
    }
}

#[test]
fn transposed_convolutions_have_three_level_gradients() {
    for (inputs, outputs, full) in [(5, 3, true), (32, 16, false), (20, 70, true)] {
        let mut layer = ConvTranspose::new("t", inputs, outputs, Init::FanIn, 3);
        let shape = [3, 4, inputs];
        let (sites, out_sites) = (Sites::full(3, 4), if full { Sites::full(6, 8) } else { some(6, 8) });
        let (x, mut y) = (map(shape, 1, "x"), Map::zeros(6, 8, outputs, 1));
        layer.forward(&x, &mut y, &out_sites);
        let weight = random(48 * outputs, "dy");
        let (mut dy, mut dx) = (Map::like(&y), Map::like(&x));
        dy.load(&weight);
        dy.clear_outside(&out_sites);
        layer.backward_input(&dy, &mut dx, &sites, Write::Set);
        layer.backward_params(&x, &dy, &sites, &out_sites);
        let values = inside(&x);
        let run = |a: &[Vec<Dual>]| reference::conv_transpose(&ref_map(shape, &a[0]), &a[1], &a[2]);
        let args = [values.as_slice(), &layer.weight.value, &layer.bias.value];
        let want = {
            let wide = |v: &[f32]| v.iter().map(|v| Dual { v: f64::from(*v), d: 0.0 }).collect::<Vec<_>>();
            run(&args.map(wide)).masked(&flags(&out_sites))
        };
        close(&inside(&y), &want.data.iter().map(|v| v.v).collect::<Vec<_>>(), CONV, "transposed");
        let got = [inside(&dx), layer.weight.grad.clone(), layer.bias.grad.clone()];
        gradients("transposed", &args, &got, CONV, &|a| loss(run(a), &weight, &flags(&out_sites)));
    }
}

#[test]
fn norms_have_three_level_gradients() {
    for (channels, groups, relu, full) in
        [(8, 8, false, true), (48, 6, true, false), (128, 1, true, true), (6, 3, true, false)]
    {
        let shape = [5, 7, channels];
        let sites = if full { Sites::full(5, 7) } else { some(5, 7) };
        let mut layer = GroupNorm::new("n", channels, groups, relu);
        layer.scale.value = random(channels, "scale");
        layer.shift.value = random(channels, "shift");
        let (x, mut y, mut tape) = (map(shape, 1, "x"), Map::zeros(5, 7, channels, 1), NormTape::default());
        layer.forward(&x, &mut y, &sites, &mut tape);
        let weight = random(35 * channels, "dy");
        let mut d = Map::like(&y);
        d.load(&weight);
        d.clear_outside(&sites);
        layer.backward(&x, &mut d, &sites, &mut tape);
        let values = inside(&x);
        let run = |a: &[Vec<Dual>]| {
            let y = reference::group_norm(&ref_map(shape, &a[0]), &a[1], &a[2], groups, &flags(&sites));
            if relu { reference::relu(y) } else { y }
        };
        let args = [values.as_slice(), &layer.scale.value, &layer.shift.value];
        let wide = |v: &[f32]| v.iter().map(|v| Dual { v: f64::from(*v), d: 0.0 }).collect::<Vec<_>>();
        let want: Vec<f64> = run(&args.map(wide)).data.iter().map(|v| v.v).collect();
        close(&inside(&y), &want, NORM, "norm");
        let got = [inside(&d), layer.scale.grad.clone(), layer.shift.grad.clone()];
        gradients("norm", &args, &got, NORM, &|a| loss(run(a), &weight, &flags(&sites)));
    }
}

/// A standard deviation of 1 about a mean of 10 000, where `Σ x² − (Σ x)²/n` in `f32` has no correct digit.
#[test]
fn a_norm_is_accurate_about_a_large_mean() {
    let (mut x, layer, sites) = (Map::zeros(32, 32, 8, 0), GroupNorm::new("n", 8, 1, false), Sites::full(32, 32));
    let values: Vec<f32> = random(32 * 32 * 8, "x").iter().map(|v| v + 1e4).collect();
    x.load(&values);
    let (mut y, mut tape) = (Map::like(&x), NormTape::default());
    layer.forward(&x, &mut y, &sites, &mut tape);
    let n = values.len() as f64;
    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
    let variance = values.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / n;
    for (y, x) in inside(&y).iter().zip(&values) {
        let want = (f64::from(*x) - mean) / (variance + 1e-5).sqrt();
        // The mean itself is an f32: half a unit in the last place of 10 000 is 5e-4.
        assert!((f64::from(*y) - want).abs() < 6e-4, "{y} {want}");
    }
    let variance = inside(&y).iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / n;
    assert!((variance - 1.0).abs() < 1e-4, "{variance}");
}

/// One of the layers without parameters: forward, backward, reference.
struct Plain {
    name: &'static str,
    from: [usize; 3],
    to: [usize; 3],
    forward: fn(&Map, &mut Map, &Sites),
    backward: fn(&Map, &Map, &Map, &mut Map, &Sites),
    reference: fn(&RefMap<Dual>) -> RefMap<Dual>,
}

#[test]
fn plain_layers_have_three_level_gradients() {
    let layers = [
        Plain {
            name: "max pool",
            from: [6, 8, 3],
            to: [3, 4, 3],
            forward: resample::max_pool,
            backward: |x, y, dy, dx, sites| resample::max_pool_backward(x, y, dy, dx, sites, Write::Set),
            reference: reference::max_pool,
        },
        Plain {
            name: "upsample",
            from: [3, 4, 5],
            to: [6, 8, 5],
            forward: resample::upsample,
            backward: |_, _, dy, dx, sites| resample::upsample_backward(dy, dx, sites, Write::Set),
            reference: reference::upsample,
        },
        Plain {
            name: "upsample one pixel",
            from: [1, 1, 2],
            to: [2, 2, 2],
            forward: resample::upsample,
            backward: |_, _, dy, dx, sites| resample::upsample_backward(dy, dx, sites, Write::Set),
            reference: reference::upsample,
        },
        Plain {
            name: "concatenate with itself",
            from: [3, 4, 2],
            to: [3, 4, 4],
            forward: |x, y, sites| resample::concat(x, x, y, sites),
            backward: |_, _, dy, dx, sites| {
                resample::concat_backward(dy, 0, dx, sites, Write::Set);
                resample::concat_backward(dy, 2, dx, sites, Write::Add);
            },
            reference: |x| reference::concat(x, x),
        },
        Plain {
            name: "add and ReLU",
            from: [3, 4, 2],
            to: [3, 4, 2],
            forward: |x, y, sites| resample::add_relu(x, x, y, sites),
            backward: |_, y, dy, dx, sites| {
                resample::copy(dy, dx, sites, Write::Set);
                resample::copy(dy, dx, sites, Write::Add);
                resample::relu_map_backward(y, dx, sites);
            },
            reference: |x| reference::relu(reference::add(x, x)),
        },
        Plain {
            name: "ReLU",
            from: [3, 4, 2],
            to: [3, 4, 2],
            forward: |x, y, sites| {
                resample::copy(x, y, sites, Write::Set);
                resample::relu_map(y, sites);
            },
            backward: |_, y, dy, dx, sites| {
                resample::copy(dy, dx, sites, Write::Set);
                resample::relu_map_backward(y, dx, sites);
            },
            reference: |x| reference::relu(x.clone()),
        },
    ];
    for layer in layers {
        let full = |shape: [usize; 3]| Sites::full(shape[0], shape[1]);
        let (x, mut y) = (map(layer.from, 1, "x"), Map::zeros(layer.to[0], layer.to[1], layer.to[2], 1));
        (layer.forward)(&x, &mut y, &full(layer.to));
        let (dy, mut dx) = (map(layer.to, 1, "dy"), Map::like(&x));
        (layer.backward)(&x, &y, &dy, &mut dx, &full(layer.from));
        let (values, weight) = (inside(&x), inside(&dy));
        let run = |a: &[Vec<Dual>]| (layer.reference)(&ref_map(layer.from, &a[0]));
        let wide: Vec<Dual> = values.iter().map(|v| Dual { v: f64::from(*v), d: 0.0 }).collect();
        let want: Vec<f64> = run(&[wide]).data.iter().map(|v| v.v).collect();
        close(&inside(&y), &want, RESAMPLE, layer.name);
        let all = vec![true; layer.to[0] * layer.to[1]];
        gradients(layer.name, &[&values], &[inside(&dx)], RESAMPLE, &|a| loss(run(a), &weight, &all));
    }
}

#[test]
fn one_of_equal_maxima_gets_the_gradient_of_a_pool() {
    let (mut x, mut y) = (Map::zeros(4, 4, 1, 0), Map::zeros(2, 2, 1, 0));
    x.load(&[1.0; 16]);
    resample::max_pool(&x, &mut y, &Sites::full(2, 2));
    let (dy, mut dx) = (map([2, 2, 1], 0, "dy"), Map::like(&x));
    resample::max_pool_backward(&x, &y, &dy, &mut dx, &Sites::full(4, 4), Write::Set);
    let d = inside(&dy);
    let want = [d[0], 0.0, d[1], 0.0, 0.0, 0.0, 0.0, 0.0, d[2], 0.0, d[3], 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(inside(&dx), want);
}

#[test]
fn a_ramp_stays_a_ramp_when_upsampled() {
    let (mut x, mut y) = (Map::zeros(4, 8, 1, 0), Map::zeros(8, 16, 1, 0));
    x.load(&(0..32).map(|i| (i % 8) as f32 + 10.0 * (i / 8) as f32).collect::<Vec<_>>());
    resample::upsample(&x, &mut y, &Sites::full(8, 16));
    for row in 1..7 {
        for at in 1..15 {
            let want = (at as f32 - 0.5) / 2.0 + 10.0 * (row as f32 - 0.5) / 2.0;
            assert!((y.pixel(row, at)[0] - want).abs() < 1e-5);
        }
    }
}

/// All results of one pass through the layers.
fn everything(sites: &Sites, all: &Sites) -> Vec<Vec<f32>> {
    let (h, w) = (all.height(), all.width());
    let mut conv =
        Conv::new("c", ConvSpec { kernel: 3, stride: 1, inputs: 24, outputs: 40, bias: true }, Init::FanIn, 1);
    let mut wide =
        Conv::new("w", ConvSpec { kernel: 3, stride: 1, inputs: 200, outputs: 150, bias: true }, Init::FanIn, 1);
    let mut norm = GroupNorm::new("n", 40, 5, true);
    let (x, mut z, mut tape) = (map([h, w, 24], 1, "x"), Map::zeros(h, w, 40, 1), NormTape::default());
    conv.forward(&x, &mut z, sites);
    let mut y = Map::like(&z);
    norm.forward(&z, &mut y, sites, &mut tape);
    let mut d = map([h, w, 40], 1, "d");
    d.clear_outside(sites);
    norm.backward(&z, &mut d, sites, &mut tape);
    let mut dx = Map::like(&x);
    conv.backward_input(&d, &mut dx, sites, Write::Set);
    conv.backward_params(&x, &d, sites);
    let mut d_wide = map([h, w, 150], 1, "dw");
    d_wide.clear_outside(sites);
    wide.backward_params(&map([h, w, 200], 1, "xw"), &d_wide, sites);
    let mut out = vec![inside(&y), inside(&d), inside(&dx)];
    for layer in [&conv as &dyn Params, &wide, &norm] {
        layer.visit(&mut |p| out.push(p.grad.clone()));
    }
    out
}

#[test]
fn threads_do_not_change_a_bit() {
    let (sites, all) = (some(37, 50), Sites::full(37, 50));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| everything(&sites, &all))
    };
    let one = run(1);
    assert!(one == run(2) && one == run(4));
}

#[test]
fn a_site_has_the_same_bits_in_any_set_of_sites() {
    let (sites, all) = (some(19, 33), Sites::full(19, 33));
    for (inputs, outputs) in [(6, 3), (24, 40), (70, 130)] {
        let spec = ConvSpec { kernel: 3, stride: 1, inputs, outputs, bias: true };
        let layer = Conv::new("c", spec, Init::FanIn, 1);
        let x = map([19, 33, inputs], 1, "x");
        let (mut dense, mut sparse) = (Map::zeros(19, 33, outputs, 1), Map::zeros(19, 33, outputs, 1));
        layer.forward(&x, &mut dense, &all);
        layer.forward(&x, &mut sparse, &sites);
        assert_ne!(dense, sparse);
        dense.clear_outside(&sites);
        assert_eq!(dense, sparse);
    }
}

#[test]
#[should_panic(expected = "border of 0 is too narrow")]
fn a_missing_border_is_refused() {
    let layer = Conv::new("c", ConvSpec { kernel: 3, stride: 1, inputs: 1, outputs: 1, bias: false }, Init::Zero, 1);
    layer.forward(&Map::zeros(4, 4, 1, 0), &mut Map::zeros(4, 4, 1, 0), &Sites::full(4, 4));
}
