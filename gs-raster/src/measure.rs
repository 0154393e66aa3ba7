//! The scenes of the benchmarks, their time and error, and the machine's roofline.
//!
//! Scenes follow the statistics that published CPU peers were timed on: centres uniform in the unit box, log-normal
//! sizes (σ 0.5) times per-axis log-normal (σ 0.6), opacity logits N(0, 1.8²), unnormalised quaternions, SH degree 3.

use crate::options::{RasterOptions, SimdLevel};
use crate::reference::{self, Cutoff, Scene};
use crate::{DeviceError, Frame, FrameGrad, Rasterizer, ScreenStats, Workspace, render, render_backward, simd};
use fearless_simd::{dispatch, f32x16, prelude::*};
use glam::{DMat3, DVec3, Vec3};
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Camera, Color, Kernel, Rng, Splats, SplatsGrad, SplatsRef, sh};
use rayon::prelude::*;
use std::hint::black_box;
use std::time::Instant;

/// A random scene of `n` splats of SH degree `degree` (0 to 3), the same on every call; median scale 0.020 for 10 000,
/// 0.010 for 100 000 splats.
///
/// ```
/// let splats = gs_raster::measure::scene(10, 3);
/// assert!(splats.check().is_ok() && splats == gs_raster::measure::scene(10, 3));
/// ```
pub fn scene(n: usize, degree: u8) -> Splats {
    let median = 0.02 * (1e4 / n.max(1) as f64).powf(std::f64::consts::LOG10_2);
    let mut rng = Rng::new(20_240_817, "bench scene", 0, n as u64);
    let mut s = Splats { kernel: Kernel::Gaussian, ..Splats::default() };
    let width = 3 * sh::coeffs(degree);
    let mut coeffs = Vec::with_capacity(n * width);
    for _ in 0..n {
        s.means.push(Vec3::from_array(std::array::from_fn(|_| rng.range(-0.5, 0.5))));
        s.quats.push(std::array::from_fn(|_| rng.normal()));
        let size = median as f32 * (0.5 * rng.normal()).exp();
        s.scales.push(Vec3::from_array(std::array::from_fn(|_| size * (0.6 * rng.normal()).exp())));
        s.opacities.push(1.0 / (1.0 + (-1.8 * rng.normal()).exp()));
        coeffs.extend((0..width).map(|k| if k < 3 { rng.normal() } else { 0.2 * rng.normal() }));
    }
    s.color = Color::Sh { degree, coeffs };
    s
}

/// The kernels of the benchmarks for `n` splats, by name: the Gaussian, the frequency kernel at its neutral parameters
/// (λ = β = ½), and the frequency and acutance kernels with parameters over most of their domain.
pub fn kernels(n: usize) -> [(&'static str, Kernel); 4] {
    let mut rng = Rng::new(20_240_817, "bench kernels", 0, n as u64);
    let lambdas: Vec<f32> = (0..n).map(|_| rng.uniform()).collect();
    let betas = lambdas.iter().map(|&l| rng.range(0.0, 0.98 * (0.5 + l).min(1.0))).collect();
    let acutances = (0..n).map(|_| rng.range(-0.8, 0.8)).collect();
    [
        ("gaussian", Kernel::Gaussian),
        ("frequency neutral", Kernel::Frequency { lambdas: vec![0.5; n], betas: vec![0.5; n] }),
        ("frequency", Kernel::Frequency { lambdas, betas }),
        ("acutance", Kernel::Acutance { acutances }),
    ]
}

/// The camera of the scenes: `side × side` pixels, 1.5 units from the centre, `fx = fy = 1.2 · side`.
pub fn camera(side: u32) -> Camera {
    let rotation = DMat3::from_rotation_x(0.12) * DMat3::from_rotation_y(0.21);
    let f = 1.2 * f64::from(side);
    Camera {
        width: side,
        height: side,
        fx: f,
        fy: f,
        cx: 0.5 * f64::from(side),
        cy: 0.5 * f64::from(side),
        rotation,
        translation: DVec3::new(0.0, 0.0, 1.5),
    }
}

/// Bytes that a splat takes while a frame is drawn, and while its gradients are: splats, gradients, and what the rasteriser keeps for
/// them and for the tiles of the frame. The frame itself is left out. Zeros without splats.
///
/// ```
/// use gs_raster::{RasterOptions, measure};
///
/// let splats = measure::scene(1000, 0);
/// let [forward, both] = measure::bytes_per_splat(splats.view(), &measure::camera(64), &RasterOptions::default());
/// assert!(forward > 56.0 && both > forward + 56.0, "14 numbers each");
/// ```
pub fn bytes_per_splat(splats: SplatsRef<'_>, camera: &Camera, options: &RasterOptions) -> [f64; 2] {
    let (mut workspace, n) = (Workspace::new(), splats.len());
    if n == 0 {
        return [0.0; 2];
    }
    let frame = render(splats, camera, options, &mut workspace);
    let forward = workspace.bytes();
    let d = FrameGrad { rgb: vec![1.0; 3 * frame.alpha.len()], ..FrameGrad::default() };
    let (grad, _) = render_backward(splats, camera, options, &mut workspace, &d);
    // Gradients have the columns of the splats: mean, rotation, scales and opacity, colours, kernel.
    let values = size_of::<f32>() * (11 * n + grad.color.len() + grad.kernel.len());
    [values + forward, 2 * values + workspace.bytes()].map(|bytes| bytes as f64 / n as f64)
}

/// Peak throughput of this machine with the threads of the current rayon pool: the roofline beside a measured time.
#[derive(Clone, Copy, Debug)]
pub struct Roofline {
    /// Number of threads that measured together.
    pub threads: usize,
    /// Fused multiply-adds, GFLOP/s; each counts as two operations.
    pub fma: f64,
    /// Evaluations of the blend's `2^x`, 10⁹/s.
    pub exp2: f64,
}

impl Roofline {
    /// Measures both with an instruction set; takes about a tenth of a second.
    pub fn measure(choice: SimdLevel) -> Self {
        let threads = rayon::current_num_threads();
        let level = simd::level(choice);
        let rounds = 200_000usize;
        let best_seconds = |work: &(dyn Fn() -> f32 + Sync)| {
            let mut least = f64::INFINITY;
            for _ in 0..5 {
                let start = Instant::now();
                (0..threads).into_par_iter().with_max_len(1).for_each(|_| {
                    black_box(work());
                });
                least = least.min(start.elapsed().as_secs_f64());
            }
            least
        };
        let fma = best_seconds(&|| dispatch!(level, simd => fma_rounds(simd, rounds)));
        let exp2 = best_seconds(&|| dispatch!(level, simd => exp2_rounds(simd, rounds)));
        let work = (threads * rounds) as f64 * 16.0 * 1e-9;
        Self { threads, fma: work * 2.0 * 12.0 / fma, exp2: work * 4.0 / exp2 }
    }
}

#[inline(always)]
fn fma_rounds<S: Simd>(simd: S, rounds: usize) -> f32 {
    let (a, b) = (f32x16::splat(simd, black_box(0.999)), f32x16::splat(simd, black_box(0.001)));
    let mut acc = [f32x16::splat(simd, black_box(1.0)); 12];
    for _ in 0..rounds {
        for v in &mut acc {
            *v = v.mul_add(a, b);
        }
    }
    let mut sum = f32x16::splat(simd, 0.0);
    for v in acc {
        sum += v;
    }
    sum.reduce_sum()
}

#[inline(always)]
fn exp2_rounds<S: Simd>(simd: S, rounds: usize) -> f32 {
    let step = f32x16::splat(simd, black_box(-1e-5));
    let mut x = [0.0f32, -1.0, -2.0, -3.0].map(|v| f32x16::splat(simd, black_box(v)));
    let mut sum = [f32x16::splat(simd, 0.0); 4];
    for _ in 0..rounds {
        for (s, x) in sum.iter_mut().zip(&mut x) {
            *s += simd::exp2(simd, *x);
            *x += step;
        }
    }
    (sum[0] + sum[1] + sum[2] + sum[3]).reduce_sum()
}

/// Median time of `runs` frames with the current pool: forward, forward + backward, the same with the camera's gradient.
/// Each with its error against the `f64` reference on a smaller image of the same scene (`error_side` pixels wide).
pub fn rows(
    case: &str,
    splats: &Splats,
    camera: &Camera,
    options: &RasterOptions,
    runs: usize,
    error_side: u32,
) -> [BenchRow; 3] {
    let on = Device { krate: "gs-raster", name: simd::level_name(simd::level(options.simd)) };
    let rows = device_rows(&mut Workspace::new(), &on, case, splats, camera, options, runs, error_side);
    rows.unwrap_or_else(|e| unreachable!("the CPU does not fail: {e}"))
}

/// What a row is measured on.
#[derive(Clone, Debug)]
pub struct Device {
    /// Crate of the rasteriser.
    pub krate: &'static str,
    /// Name in the row's variant.
    pub name: String,
}

/// [`rows`] of any rasteriser. Times include what is copied to and from its device.
///
/// # Errors
/// If the device fails.
#[expect(clippy::too_many_arguments, reason = "those of `rows`, and the rasteriser")]
pub fn device_rows(
    rasterizer: &mut dyn Rasterizer,
    on: &Device,
    case: &str,
    splats: &Splats,
    camera: &Camera,
    options: &RasterOptions,
    runs: usize,
    error_side: u32,
) -> Result<[BenchRow; 3], DeviceError> {
    let small = camera.scaled(f64::from(error_side) / f64::from(camera.width));
    let Errors { frame: frame_error, means, camera: camera_error, blended_samples } =
        errors(rasterizer, splats, &small, options)?;
    let (mut frame, n) = (Frame::default(), (camera.width * camera.height) as usize);
    let d = FrameGrad { rgb: cotangents(3 * n), ..FrameGrad::default() };
    let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
    let view = splats.view();
    let mut result = Ok(());
    let mut time = |backward: Backward| {
        median_seconds(runs, || {
            let mut run = || {
                rasterizer.render_into(view, camera, options, &mut frame)?;
                match backward {
                    Backward::None => Ok(()),
                    Backward::Splats => {
                        rasterizer.render_backward_into(view, camera, options, &d, &mut grad, &mut stats)
                    }
                    Backward::Camera => rasterizer
                        .render_backward_with_camera(view, camera, options, &d, &mut grad, &mut stats)
                        .map(drop),
                }
            };
            if let Err(e) = run() {
                result = Err(e);
            }
        })
    };
    let [forward, both, with_camera] = [Backward::None, Backward::Splats, Backward::Camera].map(&mut time);
    result?;
    let scale = n as f64 / f64::from(small.width * small.height);
    let row = |variant: &str, seconds: f64, error, error_kind| BenchRow {
        krate: on.krate,
        case: format!("{case}@{}", camera.width),
        variant: format!("{variant} {}", on.name),
        n: splats.len(),
        threads: rayon::current_num_threads(),
        ms: 1e3 * seconds,
        work: blended_samples * scale,
        error: Some(error),
        error_kind,
    };
    Ok([
        row("forward", forward, frame_error, "frame max abs off the cutoff band"),
        row("forward+backward", both, means, "means gradient relative L2"),
        row("forward+backward+camera", with_camera, camera_error, "camera twist relative L2"),
    ])
}

/// How far a timed frame is pulled back.
#[derive(Clone, Copy)]
enum Backward {
    None,
    Splats,
    Camera,
}

fn cotangents(n: usize) -> Vec<f32> {
    let mut rng = Rng::new(1, "bench cotangents", 0, 0);
    (0..n).map(|_| rng.range(-1.0, 1.0)).collect()
}

/// Errors of a frame and of its gradients.
struct Errors {
    /// Largest error of the frame off the cutoff band.
    frame: f64,
    /// Relative L2 of the gradient of the means.
    means: f64,
    /// Relative L2 of the gradient of the camera's motion.
    camera: f64,
    /// Number of blended samples.
    blended_samples: f64,
}

fn errors(
    rasterizer: &mut dyn Rasterizer,
    splats: &Splats,
    camera: &Camera,
    options: &RasterOptions,
) -> Result<Errors, DeviceError> {
    let exact = Scene::<f64>::new(splats);
    let want = reference::render(&exact, camera, options, Cutoff::Hard);
    let mut frame = Frame::default();
    rasterizer.render_into(splats.view(), camera, options, &mut frame)?;
    let n = want.alpha.len();
    let mut rgb = cotangents(3 * n);
    let mut worst = 0.0f64;
    for i in 0..n {
        for c in 0..3 {
            if want.margin[i] < 1e-5 {
                rgb[3 * i + c] = 0.0;
            } else {
                worst = worst.max((f64::from(frame.rgb.data[3 * i + c]) - want.rgb[i][c]).abs());
            }
        }
    }
    let d: Vec<_> = rgb.as_chunks::<3>().0.iter().map(|d| (d.map(f64::from), 0.0, 0.0)).collect();
    let (want_grad, _, want_camera) = reference::render_backward(&exact, camera, options, Cutoff::Hard, &d);
    let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
    let d = FrameGrad { rgb, ..FrameGrad::default() };
    let got_camera =
        rasterizer.render_backward_with_camera(splats.view(), camera, options, &d, &mut grad, &mut stats)?;
    let got_means: Vec<f64> = grad.means.iter().flat_map(|m| m.to_array().map(f64::from)).collect();
    Ok(Errors {
        frame: worst,
        means: relative_l2(&got_means, want_grad.means.as_flattened()),
        camera: relative_l2(&got_camera.twist(camera), &want_camera.twist(camera)),
        blended_samples: want.blended_samples as f64,
    })
}

fn relative_l2(got: &[f64], want: &[f64]) -> f64 {
    let distance: f64 = got.iter().zip(want).map(|(g, w)| (g - w).powi(2)).sum();
    let norm: f64 = want.iter().map(|w| w * w).sum();
    (distance / norm.max(f64::MIN_POSITIVE)).sqrt()
}
