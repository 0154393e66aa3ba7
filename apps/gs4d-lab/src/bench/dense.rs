//! Networks and a convolution at the sizes PyTorch was timed at, with errors against loops in `f64`.

use super::{Case, Measured, OUTPUT_ERROR, relative_l2, train};
use gs_core::Rng;
use gs_core::nn::gemm::Write;
use gs_core::nn::map_reference::{RefMap, conv as conv_reference};
use gs_core::nn::{BLOCK, Conv, ConvSpec, Dense, Init, Map, Mlp, MlpGrad, MlpTape, Sites, blocks_per_chunk};
use gs_train::adam::Adam;
use rayon::prelude::*;

const RUNS: usize = 7;
/// Rows of a network, and side of a map, on which the error is measured.
const ERROR_SIDE: usize = 16;

/// A network to measure.
struct Net {
    case: &'static str,
    /// Inputs, hidden layers, outputs.
    widths: &'static [usize],
    rows: usize,
    /// Milliseconds of PyTorch: forward, and a step.
    pytorch: [f64; 2],
}

const NETS: [Net; 2] = [
    Net {
        case: "mlp 84-8x256-10",
        widths: &[84, 256, 256, 256, 256, 256, 256, 256, 256, 10],
        rows: 10_000,
        pytorch: [67.0, 159.0],
    },
    Net { case: "mlp 3x64", widths: &[64; 4], rows: 100_000, pytorch: [21.0, 90.0] },
];

const CONV: ConvSpec = ConvSpec { kernel: 3, stride: 1, inputs: 64, outputs: 64, bias: true };
const CONV_SIDE: usize = 128;
/// Milliseconds of PyTorch: forward, and both ways.
const CONV_PYTORCH: [f64; 2] = [7.3, 17.0];

pub(super) fn rows() -> Vec<Measured> {
    NETS.iter().flat_map(net).chain(conv(CONV_SIDE)).collect()
}

fn random(n: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::new(1, name, 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}

/// What a network works on: rows in blocks, chunks of blocks on the way back, as fields do.
struct Batch {
    x: Vec<f32>,
    d: Vec<f32>,
    blocks: Vec<MlpTape>,
    chunks: Vec<MlpGrad>,
    per_chunk: usize,
}

impl Batch {
    fn new(net: &Mlp, rows: usize) -> Self {
        let blocks = rows.div_ceil(BLOCK);
        let per_chunk = blocks_per_chunk(blocks);
        Self {
            x: random(rows * net.inputs(), "bench inputs"),
            d: random(rows * net.outputs(), "bench cotangents"),
            blocks: vec![MlpTape::default(); blocks],
            chunks: vec![MlpGrad::default(); blocks.div_ceil(per_chunk)],
            per_chunk,
        }
    }

    fn forward(&mut self, net: &Mlp) {
        let rows = self.x.par_chunks(BLOCK * net.inputs());
        self.blocks.par_iter_mut().zip(rows).for_each(|(tape, x)| net.forward(x, tape));
    }

    /// Adds the gradients of the parameters; inputs get none.
    fn backward(&mut self, net: &mut Mlp) {
        let Self { x, d, blocks, chunks, per_chunk } = self;
        let (of, widths) = (&*net, [net.inputs(), net.outputs()].map(|w| w * BLOCK));
        let rows = x.par_chunks(*per_chunk * widths[0]).zip(d.par_chunks(*per_chunk * widths[1]));
        blocks.par_chunks_mut(*per_chunk).zip(&mut *chunks).zip(rows).for_each(|((blocks, grad), (x, d))| {
            grad.reset(of);
            for (tape, (x, d)) in blocks.iter_mut().zip(x.chunks(widths[0]).zip(d.chunks(widths[1]))) {
                of.backward(x, tape, d, None, grad);
            }
        });
        net.add_grads(chunks.iter());
    }
}

/// Forward, and a step: forward, backward without the gradient of the inputs, Adam.
fn net(of: &Net) -> [Measured; 2] {
    let mut net = Mlp::new("net", of.widths, Init::FanIn, Init::FanIn, 1);
    let mut batch = Batch::new(&net, of.rows);
    batch.forward(&net);
    let got = batch.blocks.iter().flat_map(MlpTape::output).map(|v| f64::from(*v));
    let inputs = batch.x.chunks(net.inputs()).take(ERROR_SIDE);
    let error = relative_l2(got, inputs.flat_map(|x| reference(&net, x)));
    let products = |layer: &Dense| 2.0 * (of.rows * layer.inputs() * layer.outputs()) as f64;
    let forward: f64 = net.layers().iter().map(products).sum();
    let step = 3.0 * forward - net.layers().first().map_or(0.0, products);
    let case = |variant| Case { krate: "gs-core", case: of.case.into(), variant, error_kind: OUTPUT_ERROR };
    let row = case("forward").row(of.rows, forward, error, RUNS, || batch.forward(&net));
    let mut adam = Adam::default();
    let trained = case("forward+backward+Adam").row(of.rows, step, error, RUNS, || {
        batch.forward(&net);
        batch.backward(&mut net);
        train(&mut net, &mut adam);
    });
    [Measured::flops(row, Some(of.pytorch[0])), Measured::flops(trained, Some(of.pytorch[1]))]
}

/// The output of a network for one row.
fn reference(net: &Mlp, x: &[f32]) -> Vec<f64> {
    let last = net.layers().len() - 1;
    let wide = x.iter().map(|v| f64::from(*v)).collect();
    net.layers().iter().enumerate().fold(wide, |x: Vec<f64>, (i, layer)| {
        let rows = layer.weight.value.chunks(x.len()).zip(&layer.bias.value);
        let sum =
            |(w, b): (&[f32], &f32)| f64::from(*b) + w.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum::<f64>();
        rows.map(sum).map(|y| if i < last { y.max(0.0) } else { y }).collect()
    })
}

/// A 3×3 convolution of 64 channels: forward, and with the gradients of input and parameters.
fn conv(side: usize) -> [Measured; 2] {
    let mut layer = Conv::new("conv", CONV, Init::FanIn, 1);
    let (x, d) = (random_map(side, "bench map"), random_map(side, "bench cotangents"));
    let (mut y, mut dx, sites) =
        (Map::zeros(side, side, 64, 0), Map::zeros(side, side, 64, 0), Sites::full(side, side));
    let error = conv_error(&layer);
    let flops = 2.0 * (side * side) as f64 * ConvSpec { bias: false, ..CONV }.count() as f64;
    let case = |variant| Case { krate: "gs-core", case: "conv 3x3 64->64".into(), variant, error_kind: OUTPUT_ERROR };
    let row = case("forward").row(side * side, flops, error, RUNS, || layer.forward(&x, &mut y, &sites));
    let both = case("forward+backward").row(side * side, 3.0 * flops, error, RUNS, || {
        layer.forward(&x, &mut y, &sites);
        layer.backward_input(&d, &mut dx, &sites, Write::Set);
        layer.backward_params(&x, &d, &sites);
    });
    [Measured::flops(row, Some(CONV_PYTORCH[0])), Measured::flops(both, Some(CONV_PYTORCH[1]))]
}

fn random_map(side: usize, name: &str) -> Map {
    let mut map = Map::zeros(side, side, 64, 1);
    map.load(&random(side * side * 64, name));
    map
}

/// Relative L2 of the output on a small map.
fn conv_error(layer: &Conv) -> f64 {
    let side = ERROR_SIDE;
    let (x, mut y) = (random_map(side, "bench map"), Map::zeros(side, side, 64, 0));
    layer.forward(&x, &mut y, &Sites::full(side, side));
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let data = (0..side).flat_map(|row| wide(x.row(row))).collect();
    let input = RefMap { height: side, width: side, channels: 64, data };
    let bias = layer.bias.as_ref().map_or(Vec::new(), |b| wide(&b.value));
    let want = conv_reference(&input, &wide(&layer.weight.value), &bias, CONV.kernel, CONV.stride);
    relative_l2((0..side).flat_map(|row| wide(y.row(row))), want.data.into_iter())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A network of 2 · 3 and 3 · 2 multiply-adds a row, and a small map.
    #[test]
    fn rows_count_their_products_and_are_accurate() {
        let small = Net { case: "small", widths: &[2, 3, 2], rows: 600, pytorch: [1.0, 2.0] };
        let all: Vec<Measured> = net(&small).into_iter().chain(conv(8)).collect();
        assert!(all.iter().all(|m| m.flops && m.row.ms > 0.0 && m.row.error.is_some_and(|e| e > 0.0 && e < 1e-5)));
        let work: Vec<f64> = all.iter().map(|m| m.row.work).collect();
        let taps = 2.0 * 64.0 * 9.0 * 64.0 * 64.0;
        assert_eq!(work, [2.0 * 600.0 * 12.0, 2.0 * 600.0 * 30.0, taps, 3.0 * taps]);
        let figures: Vec<_> = all.iter().map(|m| m.pytorch).collect();
        assert_eq!(figures, [1.0, 2.0, 7.3, 17.0].map(Some));
    }

    #[test]
    fn a_step_of_a_network_brings_it_nearer() {
        let mut net = Mlp::new("net", &[4, 16, 1], Init::FanIn, Init::FanIn, 1);
        let (mut batch, mut adam) = (Batch::new(&net, 1000), Adam::default());
        let mut loss = Vec::new();
        for _ in 0..30 {
            batch.forward(&net);
            let out: Vec<f32> = batch.blocks.iter().flat_map(MlpTape::output).copied().collect();
            // Half the squares of the outputs.
            batch.d.clone_from(&out);
            batch.backward(&mut net);
            train(&mut net, &mut adam);
            loss.push(out.iter().map(|v| f64::from(v * v)).sum::<f64>());
        }
        assert!(loss[29] < 0.95 * loss[0], "{loss:?}");
    }
}
