//! Closed forms, invariances, and the same bits from any number of threads.

use crate::common;
use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Color, Kernel, Splats};
use gs_raster::reference::{Cutoff, Scene, render as reference};
use gs_raster::{
    ClampGrad, Frame, FrameGrad, RasterOptions, SimdLevel, Workspace, render, render_backward, render_into,
};

fn camera(width: u32, height: u32) -> Camera {
    Camera {
        width,
        height,
        fx: 100.0,
        fy: 100.0,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
    }
}

/// Round splats of one colour at given depths on the optical axis.
fn stack(depths: &[f32], scale: f32, opacities: &[f32], rgb: &[[f32; 3]]) -> Splats {
    Splats {
        means: depths.iter().map(|&z| Vec3::new(0.0, 0.0, z)).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; depths.len()],
        scales: vec![Vec3::splat(scale); depths.len()],
        opacities: opacities.to_vec(),
        color: Color::Rgb(rgb.to_vec()),
        kernel: Kernel::Gaussian,
    }
}

fn render_new(s: &Splats, c: &Camera, o: &RasterOptions) -> Frame {
    render(s, c, o, &mut Workspace::new())
}

/// The integral of one splat's alpha over the plane is `2π o √|Σ'|` minus the tail below 1/255: `o·2π√|Σ'|·(1 − τ)`
/// with `τ = 1/(255 o)`, because the tail of a Gaussian below `g = τ` holds the share τ of its mass.
#[test]
fn one_splat_integrates_to_its_closed_form() {
    let (o, z, s) = (0.8f32, 2.0f32, 0.12f32);
    let frame = render_new(&stack(&[z], s, &[o], &[[1.0; 3]]), &camera(96, 96), &RasterOptions::default());
    let variance = (100.0 * f64::from(s) / f64::from(z)).powi(2) + 0.3;
    let o = f64::from(o);
    let want = std::f64::consts::TAU * variance * (o - 1.0 / 255.0);
    let got: f64 = frame.alpha.iter().map(|&a| f64::from(a)).sum();
    // The cut at 1/255 is a step, so the pixel sum meets the integral up to boundary pixels of weight 1/255.
    assert!((got / want - 1.0).abs() < 1e-3, "{got} {want}");
}

#[test]
fn two_layers_compose_by_the_over_operator() {
    let s = stack(&[3.0, 2.0], 0.5, &[0.6, 0.5], &[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
    let c = camera(33, 33);
    let frame = render_new(&s, &c, &RasterOptions { background: [0.0, 0.0, 1.0], ..Default::default() });
    let centre = 16 * 33 + 16;
    let near = |k: usize, want: f32| assert!((frame.rgb.data[3 * centre + k] - want).abs() < 1e-5, "channel {k}");
    near(0, 0.5);
    near(1, 0.5 * 0.6);
    near(2, 0.5 * 0.4);
    assert!((frame.alpha[centre] - 0.8).abs() < 1e-5);
    assert!((frame.depth[centre] - (0.5 * 2.0 + 0.3 * 3.0)).abs() < 1e-5);
}

/// 10⁵ faint layers: accumulated alpha is `1 − (1 − α)^n`.
#[test]
fn many_faint_layers_follow_the_power_law() {
    let n = 100_000;
    let alpha = 1.0 / 250.0f32;
    let depths: Vec<f32> = (0..n).map(|i| 10.0 + i as f32 * 1e-3).collect();
    let s = stack(&depths, 1e4, &vec![alpha; n], &vec![[1.0; 3]; n]);
    let options = RasterOptions { stop: 0.0, ..Default::default() };
    for count in [10usize, 1000] {
        let part = Splats {
            means: s.means[..count].to_vec(),
            quats: s.quats[..count].to_vec(),
            scales: s.scales[..count].to_vec(),
            opacities: s.opacities[..count].to_vec(),
            color: Color::Rgb(vec![[1.0; 3]; count]),
            kernel: Kernel::Gaussian,
        };
        let frame = render_new(&part, &camera(1, 1), &options);
        let want = 1.0 - (1.0 - f64::from(alpha)).powi(count as i32);
        assert!((f64::from(frame.alpha[0]) / want - 1.0).abs() < 1e-5, "{count}: {} {want}", frame.alpha[0]);
    }
    let frame = render_new(&s, &camera(1, 1), &options);
    assert!(frame.alpha[0] == 1.0 && frame.rgb.data[0].is_finite() && (frame.rgb.data[0] - 1.0).abs() < 1e-4);
}

#[test]
fn a_wall_of_one_colour_is_constant() {
    let rgb = [0.25, 0.5, 0.75];
    let n = 40;
    let depths: Vec<f32> = (0..n).map(|i| 5.0 + i as f32).collect();
    let s = stack(&depths, 1e4, &vec![0.9; n], &vec![rgb; n]);
    let frame = render_new(&s, &camera(37, 21), &RasterOptions { background: rgb, ..Default::default() });
    for p in frame.rgb.data.chunks_exact(3) {
        assert!(p.iter().zip(rgb).all(|(a, b)| (a - b).abs() < 1e-6), "{p:?}");
    }
}

#[test]
fn an_empty_scene_is_the_background() {
    let o = RasterOptions { background: [0.1, 0.2, 0.3], ..Default::default() };
    let mut w = Workspace::new();
    for s in [Splats::default(), stack(&[-1.0], 1.0, &[1.0], &[[1.0; 3]]), stack(&[1.0], 1.0, &[0.0], &[[1.0; 3]])] {
        let frame = render(&s, &camera(20, 10), &o, &mut w);
        assert!(frame.rgb.data.chunks_exact(3).all(|p| p == o.background) && frame.alpha.iter().all(|&a| a == 0.0));
        let d = FrameGrad { rgb: vec![1.0; 600], ..Default::default() };
        let (g, stats) = render_backward(&s, &camera(20, 10), &o, &mut w, &d);
        assert!(g.opacities.iter().all(|&v| v == 0.0) && stats.radii.iter().all(|&r| r == 0.0));
    }
}

fn bits(frame: &Frame) -> Vec<u32> {
    frame.rgb.data.iter().chain(&frame.alpha).chain(&frame.depth).map(|v| v.to_bits()).collect()
}

#[test]
fn order_of_rows_does_not_matter_when_depths_differ() {
    let case = common::case(0, 60);
    let options = RasterOptions { background: case.background, ..Default::default() };
    let want = bits(&render_new(&case.splats, &case.camera, &options));
    let order = gs_core::Rng::new(3, "permute", 0, 0).permutation(case.splats.len());
    let pick = |i: &u32| *i as usize;
    let s = &case.splats;
    let Color::Sh { degree, coeffs } = &s.color else { unreachable!("cases carry SH") };
    let width = s.color.width();
    let permuted = Splats {
        means: order.iter().map(|i| s.means[pick(i)]).collect(),
        quats: order.iter().map(|i| s.quats[pick(i)]).collect(),
        scales: order.iter().map(|i| s.scales[pick(i)]).collect(),
        opacities: order.iter().map(|i| s.opacities[pick(i)]).collect(),
        color: Color::Sh {
            degree: *degree,
            coeffs: order.iter().flat_map(|i| coeffs[pick(i) * width..][..width].to_vec()).collect(),
        },
        kernel: Kernel::Gaussian,
    };
    assert_eq!(bits(&render_new(&permuted, &case.camera, &options)), want);
}

#[test]
fn hidden_splats_change_nothing() {
    // Opaque walls, then anything behind them: T falls below the stop after two walls of 0.99.
    let mut depths = vec![1.0, 1.1, 1.2];
    let mut opacities = vec![1.0; 3];
    let mut colors = vec![[1.0, 0.5, 0.0]; 3];
    let wall = stack(&depths, 1e4, &opacities, &colors);
    let c = camera(40, 40);
    let want = bits(&render_new(&wall, &c, &RasterOptions::default()));
    for i in 0..5000 {
        depths.push(2.0 + i as f32 * 1e-3);
        opacities.push(0.7);
        colors.push([0.0, 0.3, 1.0]);
    }
    assert_eq!(bits(&render_new(&stack(&depths, 1e4, &opacities, &colors), &c, &RasterOptions::default())), want);
}

#[test]
fn quaternion_sign_and_length_do_not_matter() {
    let case = common::case(0, 40);
    let want = render_new(&case.splats, &case.camera, &RasterOptions::default());
    let mut s = case.splats.clone();
    s.quats.iter_mut().for_each(|q| *q = q.map(|v| -4.0 * v));
    let got = render_new(&s, &case.camera, &RasterOptions::default());
    assert!(got.rgb.data.iter().zip(&want.rgb.data).all(|(a, b)| (a - b).abs() < 2e-5));
}

#[test]
fn moving_the_world_and_the_camera_together_changes_nothing() {
    let case = common::case(0, 40);
    let want = render_new(&case.splats, &case.camera, &RasterOptions::default());
    // SH beyond degree 0 depend on the view direction, so this holds for the constant term only.
    let flat = |s: &Splats| {
        let width = s.color.width();
        let rgb = s.color.as_flat().chunks_exact(width).map(|c| [c[0], c[1], c[2]]).collect();
        Splats { color: Color::Rgb(rgb), ..s.clone() }
    };
    let base = render_new(&flat(&case.splats), &case.camera, &RasterOptions::default());
    assert_eq!(base.alpha, want.alpha);
    let turn = DMat3::from_rotation_y(0.5);
    let shift = DVec3::new(0.5, -2.0, 1.0);
    let q = gs_core::rot::from_glam(glam::Quat::from_mat3(&turn.as_mat3()));
    let mut s = flat(&case.splats);
    for m in &mut s.means {
        *m = (turn * m.as_dvec3() + shift).as_vec3();
    }
    for r in &mut s.quats {
        *r = gs_core::rot::hamilton(q, *r);
    }
    let mut c = case.camera.clone();
    c.rotation = case.camera.rotation * turn.transpose();
    c.translation = case.camera.translation - c.rotation * shift;
    let got = render_new(&s, &c, &RasterOptions::default());
    let worst = got.rgb.data.iter().zip(&base.rgb.data).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(worst < 2e-5, "{worst:.1e}: f32 means moved by rounding");
}

fn in_pool<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool").install(work)
}

/// Frame, gradients and statistics, as bits.
fn everything(threads: usize, simd: SimdLevel) -> Vec<u32> {
    let splats = gs_raster::measure::scene(6000, 2);
    let camera = gs_raster::measure::camera(150);
    in_pool(threads, || {
        let options = RasterOptions { simd, ..Default::default() };
        let mut w = Workspace::new();
        let frame = render(&splats, &camera, &options, &mut w);
        let d = FrameGrad { rgb: common::weights(1, 3 * 150 * 150), ..Default::default() };
        let (g, stats) = render_backward(&splats, &camera, &options, &mut w, &d);
        let mut all = bits(&frame);
        let mut push = |v: &[f32]| all.extend(v.iter().map(|x| x.to_bits()));
        g.means.iter().for_each(|m| push(m.as_ref()));
        g.scales.iter().for_each(|m| push(m.as_ref()));
        push(g.quats.as_flattened());
        push(&g.opacities);
        push(&g.color);
        push(&stats.radii);
        push(stats.grad_means2d.as_flattened());
        all
    })
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for simd in [SimdLevel::Auto, SimdLevel::Portable] {
        let one = everything(1, simd);
        for threads in [2, 3, 4, 8] {
            assert!(everything(threads, simd) == one, "{threads} threads, {simd:?}");
        }
    }
}

/// Chunks and closed tiles change nothing: the image is that of every splat against every pixel.
#[test]
fn lists_lose_nothing_on_a_crowded_scene() {
    let splats = gs_raster::measure::scene(6000, 0);
    let camera = gs_raster::measure::camera(100);
    let frame = render_new(&splats, &camera, &RasterOptions::default());
    let want = reference(&Scene::<f64>::new(&splats), &camera, &RasterOptions::default(), Cutoff::Hard);
    let mut flips = 0;
    for i in 0..want.alpha.len() {
        let error = (0..3).fold(0.0f64, |m, c| m.max((f64::from(frame.rgb.data[3 * i + c]) - want.rgb[i][c]).abs()));
        if want.margin[i] < 1e-5 {
            flips += 1;
        } else {
            assert!(error < 2e-5, "pixel {i}: {error:.1e}");
        }
    }
    assert!(flips * 20 < want.alpha.len(), "{flips}");
}

/// Above the cap the exact rule has no gradient; pass-through keeps one.
#[test]
fn clamp_rules_differ_only_above_the_cap() {
    let c = camera(1, 1);
    let grad = |opacity: f32, clamp_grad| {
        let s = stack(&[2.0], 10.0, &[opacity], &[[1.0; 3]]);
        let options = RasterOptions { clamp_grad, ..Default::default() };
        let mut w = Workspace::new();
        render(&s, &c, &options, &mut w);
        let d = FrameGrad { rgb: vec![1.0; 3], ..Default::default() };
        render_backward(&s, &c, &options, &mut w, &d).0.opacities[0]
    };
    assert_eq!(grad(1.0, ClampGrad::Exact), 0.0);
    assert!((grad(1.0, ClampGrad::PassThrough) - 3.0).abs() < 1e-4);
    assert_eq!(grad(0.5, ClampGrad::Exact), grad(0.5, ClampGrad::PassThrough));
}

#[test]
fn a_warm_workspace_gives_the_same_frame_for_any_history() {
    let mut w = Workspace::new();
    let mut frame = Frame::default();
    for seed in [1u64, 6, 3, 0, 7, 2] {
        let case = common::case(seed, 60);
        let options = RasterOptions { background: case.background, ..Default::default() };
        render_into(&case.splats, &case.camera, &options, &mut w, &mut frame);
        assert_eq!(bits(&frame), bits(&render_new(&case.splats, &case.camera, &options)), "scene {seed}");
    }
}

/// The gradient of a colour is the share that its splat has in the pixel, behind however many others the transmittance went to nothing.
#[test]
fn without_an_early_stop_the_backward_pass_still_knows_the_front() {
    let options = RasterOptions { stop: 0.0, ..Default::default() };
    for (n, opacity) in [(60, 0.9f32), (90, 0.8), (300, 0.4), (400, 0.3)] {
        let depths: Vec<f32> = (0..n).map(|k| 1.0 + 0.01 * k as f32).collect();
        let splats = stack(&depths, 1e4, &vec![opacity; n], &vec![[1.0; 3]; n]);
        let camera = camera(1, 1);
        let mut workspace = Workspace::new();
        let frame = render(&splats, &camera, &options, &mut workspace);
        assert!(frame.alpha[0] > 0.999_99);
        let d = FrameGrad { rgb: vec![1.0; 3], ..FrameGrad::default() };
        let (grad, _) = render_backward(&splats, &camera, &options, &mut workspace, &d);
        let first = grad.color[0];
        assert!((first - opacity).abs() < 2e-3 * opacity, "{n} of {opacity}: {first}");
    }
}

#[test]
fn options_with_which_opaque_splats_vanish_are_refused() {
    let refused = |options: RasterOptions| options.check().expect_err("out of its domain").field;
    assert_eq!(refused(RasterOptions { max_alpha: 0.999_99, ..Default::default() }), "max_alpha");
    assert_eq!(refused(RasterOptions { max_alpha: 1.0 - 1e-12, stop: 0.0, ..Default::default() }), "max_alpha");
    assert_eq!(refused(RasterOptions { kernel_cut: f64::INFINITY, ..Default::default() }), "kernel_cut");
    assert!(RasterOptions { max_alpha: 0.999, ..Default::default() }.check().is_ok());
}

/// Without dilation a point has no area on the screen: neither path shows it.
#[test]
fn a_splat_without_area_is_not_shown() {
    let options = RasterOptions { dilation: 0.0, ..Default::default() };
    let mut splats = stack(&[2.0, 3.0], 0.1, &[0.8, 0.8], &[[1.0; 3], [0.5; 3]]);
    splats.scales[0] = Vec3::ZERO;
    let camera = camera(24, 24);
    let production = render_new(&splats, &camera, &options);
    let exact = reference(&Scene::<f64>::new(&splats), &camera, &options, Cutoff::Hard);
    assert!(production.rgb.data.iter().any(|v| *v > 0.3));
    for (a, b) in production.rgb.data.iter().zip(exact.rgb.as_flattened()) {
        assert!((f64::from(*a) - b).abs() < 2e-5, "{a} {b}");
    }
}
