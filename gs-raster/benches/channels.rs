//! A frame of more channels and its gradients against the plain path of three: `cargo bench -p gs-raster --bench channels`.
//!
//! Prints milliseconds, the least of 31 rounds, and the medians of the rounds' ratios. A round times both paths, and the next
//! one in the other order, so a machine that is busy for a while slows both alike. The plain path takes the camera's gradient
//! as well. Results are dropped after the clock is read.

use gs_core::{Color, SplatsRef};
use gs_raster::{
    Channels, FrameGrad, RasterOptions, Workspace, measure, render, render_backward_with_camera, render_channels,
    render_channels_backward,
};
use std::hint::black_box;
use std::time::Instant;

const ROUNDS: usize = 31;
const CHANNELS: [usize; 3] = [3, 6, 12];
const VALUES: [f32; 3] = [0.5, 0.2, 0.7];

fn main() {
    for (n, side) in [(10_000, 256), (100_000, 256), (100_000, 800)] {
        for count in CHANNELS {
            let rounds = measured(n, side, count);
            let least = |path: usize, part: usize| {
                1e3 * rounds.iter().map(|round| round[path][part]).fold(f64::INFINITY, f64::min)
            };
            println!("{n} splats, {side}x{side}, {count} channels:");
            for (part, name) in ["forward", "backward"].into_iter().enumerate() {
                let ratio = median(rounds.iter().map(|[plain, channels]| channels[part] / plain[part]));
                println!("  {name}: {:.2} ms, plain {:.2} ms, ratio {ratio:.3}", least(1, part), least(0, part));
            }
            let sum = |times: [f64; 2]| times[0] + times[1];
            let ratio = median(rounds.iter().map(|[plain, channels]| sum(*channels) / sum(*plain)));
            println!("  both: ratio {ratio:.3}");
        }
    }
}

/// Seconds forward and backward in each round, of the plain path and of so many channels.
fn measured(n: usize, side: u32, count: usize) -> Vec<[[f64; 2]; 2]> {
    let (splats, camera, options) = (measure::scene(n, 0), measure::camera(side), RasterOptions::default());
    let color = Color::Rgb(vec![VALUES; n]);
    let splats = SplatsRef { color: &color, ..splats.view() };
    let values: Vec<f32> = (0..n * count).map(|i| VALUES[i % 3]).collect();
    let channels = Channels::new(n, count, &values, None).expect("channels");
    let pixels = (side * side) as usize;
    let cotangents = |count: usize| FrameGrad { rgb: vec![1.0; count * pixels], ..FrameGrad::default() };
    let (plain_d, channels_d) = (cotangents(3), cotangents(count));
    let plain = |w: &mut Workspace| {
        let forward = seconds(|| render(splats, &camera, &options, w));
        let backward = seconds(|| {
            let (mut grad, mut stats) = Default::default();
            let d_camera = render_backward_with_camera(splats, &camera, &options, w, &plain_d, &mut grad, &mut stats);
            (grad, stats, d_camera)
        });
        [forward, backward]
    };
    let grouped = |w: &mut Workspace| {
        let forward = seconds(|| render_channels(splats, &channels, &camera, &options, w));
        let backward = seconds(|| render_channels_backward(splats, &channels, &camera, &options, w, &channels_d));
        [forward, backward]
    };
    let mut w = Workspace::new();
    let mut round = |i: usize| {
        if i.is_multiple_of(2) {
            let first = plain(&mut w);
            [first, grouped(&mut w)]
        } else {
            let first = grouped(&mut w);
            [plain(&mut w), first]
        }
    };
    (0..ROUNDS).map(&mut round).collect()
}

/// Time of a call; its result is dropped afterwards.
fn seconds<R>(call: impl FnOnce() -> R) -> f64 {
    let start = Instant::now();
    let result = call();
    let seconds = start.elapsed().as_secs_f64();
    black_box(result);
    seconds
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
