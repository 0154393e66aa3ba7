//! The same call gives the same bits; what does not fit is refused by name; nothing depends on what was rendered before.

use crate::adapter::{gpu, scene_with};
use gs_core::{Color, Kernel, Splats, SplatsGrad};
use gs_gpu::{GpuError, Renderer, Shape};
use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, measure};

/// A frame and its gradient by a renderer.
fn both(
    renderer: &mut Renderer,
    splats: &Splats,
    side: u32,
    options: &RasterOptions,
) -> (Frame, SplatsGrad, ScreenStats) {
    let camera = measure::camera(side);
    let (mut frame, mut grad, mut stats) = Default::default();
    renderer.render_into(splats, &camera, options, &mut frame).expect("a frame");
    let d = cotangents(&frame);
    renderer.render_backward_into(splats, &camera, options, &d, &mut grad, &mut stats).expect("a gradient");
    (frame, grad, stats)
}

fn cotangents(frame: &Frame) -> FrameGrad {
    let n = frame.alpha.len();
    let wave = |k: usize| (0.37 * k as f32).sin();
    FrameGrad { rgb: (0..3 * n).map(wave).collect(), alpha: (0..n).map(wave).collect(), depth: vec![0.1; n] }
}

#[test]
fn two_renderers_give_the_same_bits_whatever_they_rendered_before() {
    let Some(gpu) = gpu() else { return };
    for (kernel, antialias) in [(false, false), (true, true)] {
        let options = RasterOptions { antialias, background: [0.2, 0.4, 0.6], ..RasterOptions::default() };
        let splats = scene_with(6_000, kernel);
        let first = both(&mut Renderer::new(&gpu), &splats, 160, &options);
        let mut used = Renderer::new(&gpu);
        // A smaller scene, a larger image, few splats and none: buffers grow, and keep what lies behind what is in use.
        both(&mut used, &scene_with(300, !kernel), 401, &options);
        both(&mut used, &scene_with(3, kernel), 33, &options);
        both(&mut used, &Splats::default(), 16, &options);
        for _ in 0..2 {
            assert!(both(&mut used, &splats, 160, &options) == first, "profile {kernel}");
        }
    }
}

#[test]
fn colours_of_every_degree_and_plain_ones_agree_with_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = Renderer::new(&gpu);
    let options = RasterOptions::default();
    let plain = Splats { color: Color::Rgb(vec![[0.2, -0.5, 7.0]; 500]), ..measure::scene(500, 0) };
    let scenes = (0..=3).map(|degree| measure::scene(500, degree)).chain([plain]);
    for splats in scenes {
        let (frame, grad, _) = both(&mut renderer, &splats, 64, &options);
        let (want, want_grad) = on_the_cpu(&splats, 64, &options);
        let far = frame.rgb.data.iter().zip(&want.rgb.data).filter(|(a, b)| (*a - *b).abs() > 1e-4).count();
        assert!(far < 12, "{far} values differ"); // samples on a threshold
        assert_eq!(grad.color.len(), 500 * splats.color.width());
        let off = apart(&grad.color, &want_grad.color);
        assert!(off < 1e-3, "{off}");
    }
}

/// A frame and its gradient by the CPU, for the cotangents of [`both`].
fn on_the_cpu(splats: &Splats, side: u32, options: &RasterOptions) -> (Frame, SplatsGrad) {
    let (camera, mut workspace) = (measure::camera(side), Workspace::default());
    let frame = gs_raster::render(splats, &camera, options, &mut workspace);
    let grad = gs_raster::render_backward(splats, &camera, options, &mut workspace, &cotangents(&frame));
    (frame, grad.0)
}

/// How far values are from others, relative to the length of these.
fn apart(got: &[f32], want: &[f32]) -> f64 {
    let square = |v: f32| f64::from(v).powi(2);
    let off: f64 = got.iter().zip(want).map(|(a, b)| square(a - b)).sum();
    (off / want.iter().map(|v| square(*v)).sum::<f64>()).sqrt()
}

/// A transmittance that goes to nothing leaves no gradient of what is in front: both devices stop before.
#[test]
fn without_an_early_stop_the_front_keeps_its_gradient() {
    let Some(gpu) = gpu() else { return };
    let options = RasterOptions { stop: 0.0, ..RasterOptions::default() };
    let mut splats = measure::scene(90, 0);
    splats.scales.fill(glam::Vec3::splat(10.0));
    splats.opacities.fill(0.8);
    splats.kernel = Kernel::Gaussian;
    let (_, grad, _) = both(&mut Renderer::new(&gpu), &splats, 16, &options);
    let (_, want) = on_the_cpu(&splats, 16, &options);
    let off = apart(&grad.color, &want.color);
    assert!(off < 1e-3, "{off}");
}

/// More block sums than one round of the scan adds.
#[test]
fn many_splats_agree_with_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let (splats, options) = (measure::scene(270_000, 0), RasterOptions::default());
    let (frame, grad, _) = both(&mut Renderer::new(&gpu), &splats, 64, &options);
    let (want, want_grad) = on_the_cpu(&splats, 64, &options);
    let far = frame.rgb.data.iter().zip(&want.rgb.data).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
    assert!(far < 60, "{far} values differ"); // samples on a threshold
    let off = apart(&grad.opacities, &want_grad.opacities);
    assert!(off < 1e-2, "{off}");
}

#[test]
fn nothing_to_draw_is_the_background() {
    let Some(gpu) = gpu() else { return };
    let options = RasterOptions { background: [0.1, 0.2, 0.3], ..RasterOptions::default() };
    let mut hidden = measure::scene(5, 1);
    hidden.means.iter_mut().for_each(|m| m.z = -50.0);
    for splats in [Splats::default(), hidden] {
        let (frame, grad, _) = both(&mut Renderer::new(&gpu), &splats, 20, &options);
        assert!(frame.rgb.data.chunks(3).all(|c| c == [0.1, 0.2, 0.3]) && frame.alpha.iter().all(|&a| a == 0.0));
        assert!(grad.means.iter().all(|m| *m == glam::Vec3::ZERO) && grad.means.len() == splats.len());
    }
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = Renderer::new(&gpu);
    let (splats, options) = (measure::scene(100, 0), RasterOptions::default());
    let (mut frame, mut grad, mut stats) = (Frame::default(), SplatsGrad::default(), ScreenStats::default());
    let d = FrameGrad { alpha: vec![1.0; 64 * 64], ..FrameGrad::default() };
    let mut backward = |r: &mut Renderer, side| {
        r.render_backward_into(&splats, &measure::camera(side), &options, &d, &mut grad, &mut stats)
    };
    assert_eq!(backward(&mut renderer, 64), Err(GpuError::NoFrame));
    renderer.render_into(&splats, &measure::camera(64), &options, &mut frame).expect("a frame");
    assert_eq!(backward(&mut renderer, 32), Err(GpuError::NoFrame), "a frame of another size");
    assert_eq!(backward(&mut renderer, 64), Ok(()));

    // Big faint splats over a big image: 41 million pairs, and 156 MiB for each number of them where 128 MiB are allowed.
    let mut wide = measure::scene(10_000, 0);
    wide.scales.fill(glam::Vec3::splat(10.0));
    wide.opacities.fill(0.01);
    wide.kernel = Kernel::Gaussian;
    let camera = measure::camera(1024);
    match renderer.render_into(&wide, &camera, &options, &mut frame) {
        Err(e @ GpuError::TooLarge { .. }) => {
            let text = e.to_string();
            assert!(text.contains("MiB in one buffer") && text.contains("use fewer splats"), "{text}");
        }
        other => panic!("{other:?}"),
    }
    // The renderer goes on.
    renderer.render_into(&splats, &measure::camera(64), &options, &mut frame).expect("a frame");
}

/// Room for the pairs of one frame is not what the gradients of the next need.
#[test]
fn a_frame_of_many_pairs_costs_the_next_gradient_nothing() {
    let Some(gpu) = gpu() else { return };
    let (mut renderer, options, mut frame) = (Renderer::new(&gpu), RasterOptions::default(), Frame::default());
    // 3.3 million pairs: the frame fits, its gradient would take 150 MiB of 128. Pixels are opaque after a few.
    let mut wide = measure::scene(800, 0);
    wide.scales.fill(glam::Vec3::splat(10.0));
    wide.opacities.fill(0.99);
    renderer.render_into(&wide, &measure::camera(1024), &options, &mut frame).expect("a frame");
    let (_, grad, _) = both(&mut renderer, &measure::scene(100, 0), 64, &options);
    assert!(grad.opacities.iter().any(|g| *g != 0.0));
    // Of room for eight pairs of each splat the gradient would not fit.
    let shape = Shape { splats: 400_000, sh_degree: None };
    let (mut resident, desc) = (Renderer::new(&gpu), Default::default());
    resident.make_room(shape).expect("room");
    let mut encoder = gpu.device().create_command_encoder(&desc);
    resident.encode_frame(&mut encoder, shape, &measure::camera(16), &options).expect("a frame and its gradient fit");
}
