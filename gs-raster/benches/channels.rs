//! Milliseconds of a frame of more channels, the least of 31: `cargo bench -p gs-raster --bench channels`.
//!
//! `plain` is the path of three channels, with the camera's gradient as the others have it. All variants take turns, so a machine that is busy for a while slows all alike.

use gs_core::{Color, SplatsRef};
use gs_raster::{
    Channels, FrameGrad, RasterOptions, Workspace, measure, render, render_backward_with_camera, render_channels,
    render_channels_backward,
};
use std::time::Instant;

const ROUNDS: usize = 31;
const CHANNELS: [usize; 3] = [3, 6, 12];

fn main() {
    for (n, side) in [(10_000, 256), (100_000, 256), (100_000, 800)] {
        let (splats, camera, options) = (measure::scene(n, 0), measure::camera(side), RasterOptions::default());
        let color = Color::Rgb(vec![[0.5, 0.2, 0.7]; n]);
        let splats = SplatsRef { color: &color, ..splats.view() };
        let pixels = (side * side) as usize;
        let cotangents = |count: usize| FrameGrad { rgb: vec![1.0; count * pixels], ..FrameGrad::default() };
        let cases = CHANNELS.map(|count| {
            let values: Vec<f32> = (0..n * count).map(|i| [0.5, 0.2, 0.7][i % 3]).collect();
            (Channels::new(n, count, &values, None).expect("channels"), cotangents(count))
        });
        let (mut workspace, d) = (Workspace::new(), cotangents(3));
        let mut times = vec![[Vec::new(), Vec::new()]; 1 + CHANNELS.len()];
        for _ in 0..ROUNDS {
            let start = Instant::now();
            render(splats, &camera, &options, &mut workspace);
            times[0][0].push(start.elapsed().as_secs_f64());
            let start = Instant::now();
            let (mut grad, mut stats) = Default::default();
            render_backward_with_camera(splats, &camera, &options, &mut workspace, &d, &mut grad, &mut stats);
            times[0][1].push(start.elapsed().as_secs_f64());
            for ((channels, d), times) in cases.iter().zip(&mut times[1..]) {
                let start = Instant::now();
                render_channels(splats, channels, &camera, &options, &mut workspace);
                times[0].push(start.elapsed().as_secs_f64());
                let start = Instant::now();
                render_channels_backward(splats, channels, &camera, &options, &mut workspace, d);
                times[1].push(start.elapsed().as_secs_f64());
            }
        }
        let names = ["plain".to_owned()].into_iter().chain(CHANNELS.map(|c| format!("{c} channels")));
        for (name, times) in names.zip(&times) {
            let [forward, backward] = times.each_ref().map(|t| 1e3 * t.iter().copied().fold(f64::INFINITY, f64::min));
            println!("{n} splats, {side}x{side}, {name}: forward {forward:.2} ms, backward {backward:.2} ms");
        }
    }
}
