//! A step of the U-Net of 16, 32, 64 and 128 channels that PyTorch was timed with: GauNet of preset `tiny`, on 256² texels.

use super::{Case, Measured, OUTPUT_ERROR, relative_l2, train};
use gs_core::nn::map_reference::RefMap;
use gs_core::{Params, Rng};
use gs_texel::gaunet::{GauNet, GauNetConfig};
use gs_texel::net::{NetError, reference};
use gs_train::adam::Adam;
use std::hint::black_box;

const SIDE: usize = 256;
/// Side of the map on which the error is measured.
const ERROR_SIDE: usize = 16;
const RUNS: usize = 5;
/// Milliseconds of PyTorch for a step, the least of several runs.
const PYTORCH: f64 = 94.0;

pub(super) fn rows() -> Vec<Measured> {
    // The configuration and the sides are constant and valid; without a network there is nothing to measure.
    rows_at(SIDE).map_or(Vec::new(), Vec::from)
}

/// Forward, and a step: forward, backward, Adam.
fn rows_at(side: usize) -> Result<[Measured; 2], NetError> {
    let config = GauNetConfig::tiny();
    let mut net = GauNet::new("gau", config, 1)?;
    let error = error(&net)?;
    let (map, d) = (random(side * side * config.inputs), random(side * side * config.outputs()));
    let (mut tape, mut adam) = (net.tape(side, None)?, Adam::default());
    let flops = 2.0 * config.multiply_adds() * (side * side) as f64;
    let case =
        |variant| Case { krate: "gs-texel", case: format!("U-Net tiny {side}^2"), variant, error_kind: OUTPUT_ERROR };
    let row = case("forward").row(side * side, flops, error, RUNS, || {
        let _ = black_box(net.forward(&map, &mut tape));
    });
    // The input has no gradient.
    let of_input = 2.0 * (9 * config.inputs * config.width * side * side) as f64;
    let step = case("forward+backward+Adam").row(side * side, 3.0 * flops - of_input, error, RUNS, || {
        let _ = black_box(net.forward(&map, &mut tape).map(drop).and_then(|()| net.backward(&mut tape, &d)));
        train(&mut net, &mut adam);
    });
    Ok([Measured::flops(row, None), Measured::flops(step, Some(PYTORCH))])
}

fn random(n: usize) -> Vec<f32> {
    let mut rng = Rng::new(1, "bench map", 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}

/// Relative L2 of the output on a small map.
fn error(net: &GauNet) -> Result<f64, NetError> {
    let (side, GauNetConfig { inputs, levels, .. }) = (ERROR_SIDE, *net.config());
    let (map, mut tape) = (random(side * side * inputs), net.tape(side, None)?);
    let got = net.forward(&map, &mut tape)?;
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let mut params = Vec::new();
    net.visit(&mut |p| params.push(wide(&p.value)));
    let input = RefMap { height: side, width: side, channels: inputs, data: wide(&map) };
    let want = reference::gaunet(&params, &input, &reference::masks(&vec![true; side * side], side, levels));
    Ok(relative_l2(got.iter().map(|v| f64::from(*v)), want.data.into_iter()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_map_is_measured_and_accurate() {
        let all = rows_at(16).unwrap();
        assert!(all.iter().all(|m| m.flops && m.row.ms > 0.0 && m.row.error.is_some_and(|e| e > 0.0 && e < 1e-4)));
        // 0.59 thousand million multiply-adds on 128² texels.
        let per_texel = all[0].row.work / 256.0;
        assert!((per_texel / 2.0 * 16_384.0 / 0.59e9 - 1.0).abs() < 0.01, "{per_texel}");
        assert_eq!(all.map(|m| m.pytorch), [None, Some(PYTORCH)]);
        assert!(rows_at(12).is_err(), "12 texels are not halved three times");
    }
}
