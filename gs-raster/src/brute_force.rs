//! Tile lists against brute force: evaluating every splat at every pixel must give the same bits as the exact supports,
//! and a box of three standard deviations must not.

use crate::forward::{Lists, render_with};
use crate::frame::Frame;
use crate::kernel::{KernelProfile, PiecewiseLinear, ProfileConsts, Sample, SampleGrad};
use crate::measure::{camera, scene};
use crate::options::{Limits, RasterOptions};
use crate::rows::Row;
use crate::tiles::LOG2_SCALE;
use crate::workspace::{Chunk, MaxEntries, Workspace};
use fearless_simd::{f32x16, mask32x16, prelude::*};
use gs_core::{Kernel, Rng, Splats};

/// A kernel profile, evaluated at every pixel.
#[derive(Clone, Copy)]
struct UnboundedSupport<K>(K);

/// Radius of its support in the blend's units: beyond any image.
const SUPPORT_RADIUS: f64 = 1e6;

impl<K: KernelProfile> KernelProfile for UnboundedSupport<K> {
    const HAS_PARAMS: bool = K::HAS_PARAMS;

    fn consts(self, index: u32) -> ProfileConsts {
        self.0.consts(index)
    }

    #[inline(always)]
    fn sample<S: Simd>(simd: S, row: &Row, p: f32x16<S>, limits: Limits) -> Sample<S> {
        K::sample(simd, row, p, limits)
    }

    #[inline(always)]
    fn backward<S: Simd>(
        simd: S,
        row: &Row,
        s: Sample<S>,
        has_grad: mask32x16<S>,
        d_alpha: f32x16<S>,
    ) -> SampleGrad<S> {
        K::backward(simd, row, s, has_grad, d_alpha)
    }

    fn support(self, _: u32, _: f64, _: f64) -> f64 {
        SUPPORT_RADIUS * SUPPORT_RADIUS
    }

    fn max_distance(self, _: u32, _: f64, _: f64) -> f64 {
        SUPPORT_RADIUS / LOG2_SCALE
    }
}

/// The kernels of scene `i`.
fn kernel(i: u64, n: usize) -> Kernel {
    let mut rng = Rng::new(i, "kernels", 0, 0);
    let mut column = |low: f32, high: f32| (0..n).map(|_| rng.range(low, high)).collect::<Vec<_>>();
    match i % 5 {
        0 => Kernel::Frequency { lambdas: vec![0.01; n], betas: vec![0.49; n] },
        1 => Kernel::Frequency { lambdas: vec![1.0; n], betas: vec![0.98; n] },
        2 => Kernel::Acutance { acutances: column(-0.95, 0.95) },
        // The whole domain, including splats that never decay.
        3 => Kernel::Frequency { lambdas: column(0.0, 1.0), betas: column(0.0, 1.0) },
        _ => Kernel::Frequency { lambdas: column(0.0, 0.3), betas: column(0.0, 0.49) },
    }
}

fn scenes() -> impl Iterator<Item = (Splats, RasterOptions)> {
    (0..200).map(|i| {
        let mut splats = scene(20 + i as usize % 60, 0);
        splats.kernel = kernel(i, splats.len());
        splats.check().expect("legal splats");
        (splats, RasterOptions { antialias: i % 2 == 1, ..RasterOptions::default() })
    })
}

fn bits<K: KernelProfile>(kernel: K, splats: &Splats, options: &RasterOptions) -> Vec<u32> {
    let mut frame = Frame::default();
    render_with(kernel, splats.view(), Lists::New(&camera(50)), options, &mut Workspace::new(), &mut frame);
    [frame.rgb.data, frame.alpha, frame.depth].concat().iter().map(|v| v.to_bits()).collect()
}

#[test]
fn exact_supports_lose_no_pixel_and_a_three_sigma_box_does() {
    let (mut boxed, mut soft) = (0, 0);
    for (i, (splats, options)) in scenes().enumerate() {
        let mut consts = Vec::new();
        let kernel = PiecewiseLinear::new(&splats.kernel, splats.len(), options.kernel_cut, &mut consts);
        let want = bits(UnboundedSupport(kernel), &splats, &options);
        assert!(bits(kernel, &splats, &options) == want, "scene {i}: a list lost a pixel");
        soft += usize::from(i % 5 == 0);
        let box_of_three = RasterOptions { box_sigmas: 3.0, ..options.clone() };
        boxed += usize::from(i % 5 == 0 && bits(kernel, &splats, &box_of_three) != want);
    }
    assert!(boxed == soft && soft > 0, "a 3σ box must cut soft kernels: {boxed} of {soft} scenes");
}

/// A splat that never decays ends at the cut, whatever the position of the tiles.
#[test]
fn the_cut_does_not_depend_on_tiles() {
    let n = 12;
    let mut splats = scene(n, 0);
    splats.kernel = Kernel::Frequency { lambdas: vec![0.05; n], betas: vec![0.9; n] };
    let options = RasterOptions::default();
    let mut consts = Vec::new();
    let kernel = PiecewiseLinear::new(&splats.kernel, splats.len(), options.kernel_cut, &mut consts);
    assert!(bits(kernel, &splats, &options) == bits(UnboundedSupport(kernel), &splats, &options));
    let render = |shift: u32| {
        let mut camera = camera(64);
        (camera.cx, camera.cy) = (camera.cx + f64::from(shift), camera.cy + f64::from(shift));
        (camera.width, camera.height) = (64 + shift, 64 + shift);
        let mut frame = Frame::default();
        render_with(kernel, splats.view(), Lists::New(&camera), &options, &mut Workspace::new(), &mut frame);
        frame
    };
    let base = render(0);
    for shift in [1usize, 5, 8, 11, 16] {
        let moved = render(shift as u32);
        let mut flips = 0;
        for (i, &want) in base.alpha.iter().enumerate() {
            let at = (i / 64 + shift) * (64 + shift) + i % 64 + shift;
            flips += usize::from((moved.alpha[at] - want).abs() > 1e-5);
        }
        assert!(flips <= 2, "{flips} pixels changed with tiles moved by {shift}");
    }
}

/// A scene of neutral kernels gives the frame of a scene of Gaussians, bit for bit.
#[test]
fn neutral_kernels_are_the_gaussian_to_the_bit() {
    let plain = scene(400, 0);
    let options = RasterOptions::default();
    let want = bits(crate::kernel::Gaussian, &plain, &options);
    for beta in [0.0, 1e-7, 0.5, 1.0 - 1e-7, 1.0] {
        let kernel = Kernel::Frequency { lambdas: vec![0.5; plain.len()], betas: vec![beta; plain.len()] };
        assert!(
            bits(PiecewiseLinear::new(&kernel, plain.len(), 9.0, &mut Vec::new()), &plain, &options) == want,
            "β {beta}"
        );
    }
    let kernel = Kernel::Acutance { acutances: vec![0.0; plain.len()] };
    assert!(bits(PiecewiseLinear::new(&kernel, plain.len(), 9.0, &mut Vec::new()), &plain, &options) == want);
}

/// Above half its height a sharp kernel reaches further than the Gaussian.
#[test]
fn a_high_threshold_loses_no_pixel_of_a_sharp_kernel() {
    let (camera, options) = (camera(50), RasterOptions { min_alpha: 0.9, ..RasterOptions::default() });
    let mut splats = scene(1, 0);
    splats.kernel = Kernel::Acutance { acutances: vec![0.9] };
    (splats.quats[0], splats.opacities[0]) = ([1.0, 0.0, 0.0, 0.0], 0.99);
    let (depth, sigma) = (4.0, 100.0);
    splats.scales[0] = glam::Vec3::splat((sigma * depth / camera.fx) as f32);
    let mut seen = 0;
    for off in (0..160).step_by(10) {
        let at = glam::DVec3::new((-f64::from(off) - camera.cx) / camera.fx * depth, 0.0, depth);
        splats.means[0] = (camera.rotation.transpose() * (at - camera.translation)).as_vec3();
        let mut consts = Vec::new();
        let kernel = PiecewiseLinear::new(&splats.kernel, 1, options.kernel_cut, &mut consts);
        let want = bits(UnboundedSupport(kernel), &splats, &options);
        assert!(bits(kernel, &splats, &options) == want, "{off} pixels beyond the border: a pixel is lost");
        seen += usize::from(want.iter().any(|v| *v != 0) && off > 50);
    }
    assert!(seen > 2, "{seen} are seen further off than the Gaussian's reach");
}

/// Splats that fill the screen are listed in as many chunks as their memory asks for, and the picture is the same.
#[test]
fn a_chunk_of_too_many_entries_is_cut() {
    let mut splats = scene(3000, 0);
    splats.opacities.fill(0.02);
    splats.scales.iter_mut().for_each(|s| *s *= 30.0);
    let (camera, options) = (camera(96), RasterOptions::default());
    let render = |most: Option<usize>| {
        let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
        if let Some(most) = most {
            workspace.max_entries = MaxEntries(most);
        }
        crate::render_into(&splats, &camera, &options, &mut workspace, &mut frame);
        let of_chunk = |c: &Chunk| (c.entries.len(), c.projected.len());
        (frame, workspace.chunks[..workspace.chunk_count].iter().map(of_chunk).collect::<Vec<_>>())
    };
    let (whole, few) = render(None);
    for most in [20_000, 3000, 1] {
        let (cut, many) = render(Some(most));
        assert!(cut == whole && many.len() > few.len(), "{most}: {} chunks", many.len());
        assert!(many.iter().all(|(entries, splats)| *entries <= most || *splats == 1), "{most}: {many:?}");
    }
}
