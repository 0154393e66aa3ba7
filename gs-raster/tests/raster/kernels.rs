//! Splats with kernel parameters: closed forms, neutral parameters, near-singular parameters, clamp rules.

use glam::{DMat3, DVec3, Vec3};
use gs_core::kernel::Profile;
use gs_core::{Camera, Color, Kernel, Splats, SplatsGrad};
use gs_raster::measure::{camera as bench_camera, scene};
use gs_raster::{ClampGrad, Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, render, render_backward};

const SIDE: u32 = 240;
/// Standard deviation of [`one`] on the screen, pixels, before dilation.
const SIGMA: f64 = 24.0;

/// One round splat in the middle of the image.
fn one(opacity: f32, kernel: Kernel) -> Splats {
    Splats {
        means: vec![Vec3::new(0.0, 0.0, 2.0)],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        scales: vec![Vec3::splat(2.0 * SIGMA as f32 / 100.0)],
        opacities: vec![opacity],
        color: Color::Rgb(vec![[1.0; 3]]),
        kernel,
    }
}

fn camera() -> Camera {
    let half = 0.5 * f64::from(SIDE);
    Camera {
        width: SIDE,
        height: SIDE,
        fx: 100.0,
        fy: 100.0,
        cx: half,
        cy: half,
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
    }
}

/// Frame, gradients of the sum of all alphas, statistics.
fn both(splats: &Splats, camera: &Camera, options: &RasterOptions) -> (Frame, SplatsGrad, ScreenStats) {
    let mut workspace = Workspace::new();
    let frame = render(splats, camera, options, &mut workspace);
    let n = frame.alpha.len();
    let d = FrameGrad { rgb: vec![0.0; 3 * n], alpha: vec![1.0; n], depth: Vec::new() };
    let (grad, stats) = render_backward(splats, camera, options, &mut workspace, &d);
    (frame, grad, stats)
}

fn frequency(l: f32, b: f32) -> Kernel {
    Kernel::Frequency { lambdas: vec![l], betas: vec![b] }
}

/// The alphas of one splat add up to `2π o √|Σ'| (m − k g*)`: the mass of the kernel less the tail below 1/255, which
/// lies on the foot. Its derivatives with respect to λ and acutance follow from those of mass and foot.
#[test]
fn one_splat_integrates_to_its_mass() {
    let h = 1e-4;
    let o = 0.8f32;
    let per_mass = std::f64::consts::TAU * (SIGMA * SIGMA + 0.3) * f64::from(o);
    type Shape = fn(f64) -> Profile<f64>;
    let cases: [(Shape, f32, Kernel); 4] = [
        (|l| Profile::frequency(l, 0.5), 0.9, frequency(0.9, 0.5)),
        (|l| Profile::frequency(l, 0.4), 0.1, frequency(0.1, 0.4)),
        (Profile::acutance, 0.5, Kernel::Acutance { acutances: vec![0.5] }),
        (Profile::acutance, -0.4, Kernel::Acutance { acutances: vec![-0.4] }),
    ];
    for (shape, at, kernel) in cases {
        let at = f64::from(at);
        let tail = shape(at).support(1.0 / (255.0 * f64::from(o))).expect("visible");
        let visible = |x: f64| shape(x).mass() - shape(x).foot * tail;
        let (frame, grad, _) = both(&one(o, kernel), &camera(), &RasterOptions::default());
        let got: f64 = frame.alpha.iter().map(|&a| f64::from(a)).sum();
        assert!((got / (per_mass * visible(at)) - 1.0).abs() < 2e-3, "{got} {}", per_mass * visible(at));
        let slope = per_mass * (visible(at + h) - visible(at - h)) / (2.0 * h);
        let got = f64::from(grad.kernel[0]);
        // ∂ψ jumps at the knots, so the pixel sum meets the integral up to the pixels they cross.
        assert!((got - slope).abs() < 0.01 * per_mass, "derivative {got}, closed form {slope}");
    }
}

/// λ = ½ everywhere: the Gaussian's frame and gradients bit for bit, a gradient for λ and none for β.
#[test]
fn neutral_kernels_render_as_gaussians_and_get_gradients() {
    let plain = scene(500, 1);
    let (camera, options) = (bench_camera(80), RasterOptions::default());
    let (frame, grad, stats) = both(&plain, &camera, &options);
    let n = plain.len();
    let neutral = Splats { kernel: Kernel::Frequency { lambdas: vec![0.5; n], betas: vec![0.5; n] }, ..plain.clone() };
    let (neutral_frame, neutral_grad, neutral_stats) = both(&neutral, &camera, &options);
    assert!(neutral_frame == frame && neutral_stats == stats);
    assert!(SplatsGrad { kernel: Vec::new(), ..neutral_grad.clone() } == grad);
    let pairs = neutral_grad.kernel.as_chunks::<2>().0;
    assert!(pairs.iter().all(|[_, beta]| *beta == 0.0));
    assert!(pairs.iter().filter(|[lambda, _]| *lambda != 0.0).count() > n / 2);
    let acutance = Splats { kernel: Kernel::Acutance { acutances: vec![0.0; n] }, ..plain };
    let (neutral_frame, neutral_grad, _) = both(&acutance, &camera, &options);
    assert!(neutral_frame == frame && neutral_grad.kernel.iter().any(|d| *d != 0.0));
}

/// Neutral splats keep their bits when the scene also holds a splat that is not neutral.
#[test]
fn one_sharp_splat_does_not_change_the_others() {
    let plain = scene(300, 0);
    let options = RasterOptions::default();
    let frame_of = |s: &Splats| render(s, &bench_camera(64), &options, &mut Workspace::new());
    let mut mixed = plain.clone();
    mixed.means.push(Vec3::new(0.0, 0.0, -100.0));
    mixed.quats.push([1.0, 0.0, 0.0, 0.0]);
    mixed.scales.push(Vec3::ONE);
    mixed.opacities.push(1.0);
    let Color::Sh { coeffs, .. } = &mut mixed.color else { panic!("the scene has SH") };
    coeffs.extend([0.0; 3]);
    let mut lambdas = vec![0.5; 300];
    lambdas.push(1.0);
    mixed.kernel = Kernel::Frequency { lambdas, betas: vec![0.3; 301] };
    assert!(frame_of(&mixed) == frame_of(&plain));
}

/// Kernels at and beyond the ends of their regular domain: everything stays finite, alphas within bounds.
#[test]
fn near_singular_kernels_stay_finite() {
    let base = scene(200, 0);
    let n = base.len();
    let ends = [0.0f32, 1e-7, 1e-3, 0.2, 0.4999, 0.5, 0.5001, 0.9, 1.0 - 6e-8, 1.0];
    let gaps = [1e-1f32, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 0.0, -1e-7, -0.1, -0.5];
    let mut kernels: Vec<Kernel> =
        [-0.999f32, -0.5, 0.5, 0.999].map(|a| Kernel::Acutance { acutances: vec![a; n] }).into_iter().collect();
    for l in ends {
        let betas = gaps.iter().map(|g| 0.5 + l - g).chain([0.0, 1e-7, 1.0 - 6e-8, 1.0]);
        kernels.extend(betas.map(|b| Kernel::Frequency { lambdas: vec![l; n], betas: vec![b.clamp(0.0, 1.0); n] }));
    }
    for kernel in kernels {
        let name = format!("{:?} …", kernel.bend(0));
        let mut splats = Splats { kernel, ..base.clone() };
        // One centre exactly on a pixel's: g = 1.
        splats.means[0] = (bench_camera(41).position() + bench_camera(41).forward() * 1.5).as_vec3();
        splats.opacities[0] = 1.0;
        splats.check().expect("legal splats");
        for clamp_grad in [ClampGrad::Exact, ClampGrad::PassThrough] {
            let options = RasterOptions { clamp_grad, ..Default::default() };
            let (frame, grad, _) = both(&splats, &bench_camera(41), &options);
            assert!(frame.rgb.data.iter().chain(&frame.depth).all(|v| v.is_finite()), "{name}");
            assert!(frame.alpha.iter().all(|a| (0.0..=1.0).contains(a)), "{name}");
            assert_eq!(grad.first_non_finite(), None, "{name}");
        }
    }
}

/// Above the cap the exact rule has no gradient for opacity and kernel; pass-through keeps both.
#[test]
fn clamp_rules_hold_for_kernels() {
    let grad = |opacity: f32, clamp_grad| {
        let mut camera = camera();
        // One pixel, a little off the centre: on the plateau of a sharp kernel.
        (camera.width, camera.height, camera.cx, camera.cy) = (1, 1, 1.5, 0.5);
        let options = RasterOptions { clamp_grad, ..Default::default() };
        let g = both(&one(opacity, frequency(0.9, 0.9)), &camera, &options).1;
        (g.opacities[0], g.kernel[0], g.kernel[1])
    };
    assert_eq!(grad(1.0, ClampGrad::Exact), (0.0, 0.0, 0.0));
    let (o, l, b) = grad(1.0, ClampGrad::PassThrough);
    assert!(o > 0.9 && l > 0.0 && b > 0.0);
    assert_eq!(grad(0.5, ClampGrad::Exact), grad(0.5, ClampGrad::PassThrough));
}

/// The radius for densification is three standard deviations whatever the kernel.
#[test]
fn the_radius_of_the_statistics_ignores_the_kernel() {
    let radius = |kernel| both(&one(0.9, kernel), &camera(), &RasterOptions::default()).2.radii[0];
    let want = radius(Kernel::Gaussian);
    assert!((f64::from(want) - 3.0 * (SIGMA * SIGMA + 0.3).sqrt()).abs() < 1e-4);
    assert_eq!(radius(frequency(0.05, 0.5)), want);
    assert_eq!(radius(frequency(1.0, 0.98)), want);
}
