//! Several cameras in one call against one call of each.

use crate::common;
use gs_core::{Camera, Splats, SplatsGrad};
use gs_raster::{
    Channels, Frame, FrameGrad, RasterOptions, ViewsError, ViewsGrad, Workspace, measure, render_channels,
    render_channels_backward, render_views, render_views_backward,
};

const SPLATS: usize = 3000;
const CHANNELS: usize = 5;

/// Splats, and three cameras whose images differ in size and place.
fn scene() -> (Splats, Vec<Camera>) {
    let camera = |side: u32, x: f64| {
        let mut camera = measure::camera(side);
        camera.translation.x += x;
        camera
    };
    (measure::scene(SPLATS, 0), vec![camera(64, -0.2), camera(40, 0.0), camera(52, 0.3)])
}

fn colors(count: usize) -> Vec<Channels> {
    let colors = |seed: u64| Channels::new(SPLATS, CHANNELS, &common::weights(seed, SPLATS * CHANNELS), None);
    (0..count as u64).map(|seed| colors(seed).expect("channels")).collect()
}

/// Cotangents of colours, alpha and depth.
fn cotangents(frames: &[Frame]) -> Vec<FrameGrad> {
    let of = |(i, frame): (usize, &Frame)| {
        let pixels = frame.alpha.len();
        let w = common::weights(20 + i as u64, (CHANNELS + 2) * pixels);
        let (rgb, rest) = w.split_at(CHANNELS * pixels);
        FrameGrad { rgb: rgb.to_vec(), alpha: rest[..pixels].to_vec(), depth: rest[pixels..].to_vec() }
    };
    frames.iter().enumerate().map(of).collect()
}

fn together(colors: &[Channels]) -> (Vec<Frame>, ViewsGrad) {
    let ((splats, cameras), options, mut workspaces) = (scene(), RasterOptions::default(), Vec::new());
    let frames = render_views(&splats, colors, &cameras, &options, &mut workspaces).expect("frames");
    let d = cotangents(&frames);
    let grad = render_views_backward(&splats, colors, &cameras, &options, &mut workspaces, &d).expect("gradients");
    (frames, grad)
}

fn add(to: &mut [f32], from: &[f32]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}

/// All numbers of the splats' gradient but those of colours.
fn flat(grad: &SplatsGrad) -> Vec<f32> {
    let vectors = grad.means.iter().chain(&grad.scales).flat_map(|v| v.to_array());
    vectors.chain(grad.quats.as_flattened().iter().copied()).chain(grad.opacities.iter().copied()).collect()
}

/// Frames, statistics and gradients of cameras are those of single calls bit for bit; the gradients of splats and shared
/// colours are their sums in the order of the cameras.
#[test]
fn views_have_the_bits_of_single_calls() {
    let ((splats, cameras), options) = (scene(), RasterOptions::default());
    for parts in [1, cameras.len()] {
        let colors = colors(parts);
        let (frames, grad) = together(&colors);
        let (mut sum, mut d_colors) = (vec![0.0; flat(&grad.splats).len()], vec![vec![0.0; SPLATS * CHANNELS]; parts]);
        for (i, (camera, d)) in cameras.iter().zip(cotangents(&frames)).enumerate() {
            let (channels, mut workspace) = (&colors[i % parts], Workspace::new());
            assert_eq!(frames[i], render_channels(&splats, channels, camera, &options, &mut workspace));
            let (alone, stats, d_camera) =
                render_channels_backward(&splats, channels, camera, &options, &mut workspace, &d);
            assert_eq!((&grad.stats[i], grad.cameras[i]), (&stats, d_camera));
            assert!(flat(&alone).iter().any(|v| *v != 0.0) && d_camera.fx != 0.0);
            add(&mut sum, &flat(&alone));
            add(&mut d_colors[i % parts], &alone.color);
        }
        assert_eq!((flat(&grad.splats), grad.colors), (sum, d_colors));
        assert!(grad.splats.color.is_empty());
    }
}

#[test]
fn the_bits_of_views_do_not_depend_on_threads() {
    let colors = colors(1);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| together(&colors))
    };
    let one = on(1);
    assert!(on(2) == one && on(5) == one);
}

#[test]
fn arguments_that_do_not_fit_the_cameras_are_refused() {
    let ((splats, cameras), options, colors) = (scene(), RasterOptions::default(), colors(2));
    let error = |argument, got| Some(ViewsError { argument, got, cameras: 3 });
    let mut workspaces = Vec::new();
    assert_eq!(render_views(&splats, &colors, &cameras, &options, &mut workspaces).err(), error("colors", 2));
    let (frames, shared) = (vec![Frame::default(); 2], &colors[..1]);
    let backward = |workspaces: &mut Vec<Workspace>, colors: &[Channels]| {
        render_views_backward(&splats, colors, &cameras, &options, workspaces, &cotangents(&frames)).err()
    };
    assert_eq!(backward(&mut workspaces, &colors), error("colors", 2));
    assert_eq!(backward(&mut workspaces, shared), error("workspaces", 0));
    workspaces.resize_with(3, Workspace::new);
    assert_eq!(backward(&mut workspaces, shared), error("d", 2));
    assert_eq!(error("d", 2).map(|e| e.to_string()).as_deref(), Some("`d` has 2 entries for 3 cameras"));
}
