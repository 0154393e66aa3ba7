//! The tolerance table of a rasteriser against the `f64` reference on hard scenes.
//!
//! | quantity | tolerance | why |
//! |---|---|---|
//! | frame, off the cutoff band | 2e-5 | exp2 polynomial 1e-7, whitened offsets 5e-6 of a standard deviation, sums of 300 samples |
//! | frame, on the band | 1.1/255 per flip | one sample may be in or out |
//! | pixels on the band | 0.5 % of all | decisions within 1e-5 of a threshold are rare |
//! | gradients per kind | cosine ≥ 0.9999, relative L2 ≤ 1e-3 | sums of f32 records in f64 |
//! | gradient of the camera | the same, for rotation, translation, focal lengths, principal point | sums of f64 over splats |

use super::{Case, KERNELS, case, kernel, weights};
use gs_raster::reference::{self, Cutoff, Scene};
use gs_raster::{ClampGrad, Frame, FrameGrad, RasterOptions, Rasterizer, SimdLevel};

/// Pixels whose decisions lie closer than this (relative) to a threshold may flip.
pub const BAND: f64 = 1e-5;

/// Entries of [`gs_raster::CameraGrad::to_array`] of one unit.
const CAMERA_KINDS: [(&str, &[usize]); 4] = [
    ("camera rotation", &[0, 1, 2, 4, 5, 6, 8, 9, 10]),
    ("camera translation", &[3, 7, 11]),
    ("focal lengths", &[12, 13]),
    ("principal point", &[14, 15]),
];

/// What the scenes of a sweep came to.
#[derive(Default)]
pub struct Tally {
    pixels: usize,
    flips: usize,
    worst_frame: f64,
    worst_cosine: f64,
    worst_l2: f64,
}

impl Tally {
    /// Prints the worst errors under a name. Pixels on the band must be rare.
    pub fn report(&self, name: &str) {
        println!(
            "{name}: frame {:.1e}, 1 - cosine {:.1e}, relative L2 {:.1e}, {} of {} pixels on the band",
            self.worst_frame, self.worst_cosine, self.worst_l2, self.flips, self.pixels
        );
        assert!(self.flips * 200 < self.pixels, "the cutoff band must be rare: {} of {}", self.flips, self.pixels);
    }
}

/// A scene that was checked, with its frame and the reference's.
pub struct Checked {
    pub name: String,
    pub case: Case,
    pub options: RasterOptions,
    pub frame: Frame,
    pub want: reference::Frame<f64>,
}

fn frame_error(frame: &Frame, want: &reference::Frame<f64>, tally: &mut Tally, name: &str) {
    for i in 0..want.alpha.len() {
        let mut worst = (f64::from(frame.alpha[i]) - want.alpha[i]).abs();
        for c in 0..3 {
            let scale = want.rgb[i][c].abs().max(1.0);
            worst = worst.max((f64::from(frame.rgb.data[3 * i + c]) - want.rgb[i][c]).abs() / scale);
        }
        let scale = want.depth[i].abs().max(1.0);
        worst = worst.max((f64::from(frame.depth[i]) - want.depth[i]).abs() / scale);
        tally.pixels += 1;
        if want.margin[i] < BAND {
            tally.flips += 1;
            continue;
        }
        tally.worst_frame = tally.worst_frame.max(worst);
        assert!(worst <= 2e-5, "{name}: pixel {i} is off by {worst:.2e} (margin {:.1e})", want.margin[i]);
    }
}

/// Cosine and relative L2 distance.
fn compare(got: &[f64], want: &[f64]) -> (f64, f64) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let diff: Vec<f64> = got.iter().zip(want).map(|(a, b)| a - b).collect();
    let (g, w) = (dot(got, got).sqrt(), dot(want, want).sqrt());
    if w < 1e-12 {
        return (1.0, g);
    }
    (dot(got, want) / (g * w).max(1e-300), dot(&diff, &diff).sqrt() / w)
}

/// Scene number `seed` by a rasteriser, its frame and its gradients against the reference.
pub fn check(
    rasterizer: &mut dyn Rasterizer,
    seed: u64,
    with_kernel: bool,
    simd: SimdLevel,
    tally: &mut Tally,
) -> Checked {
    let mut case = case(seed, 60);
    let mut name = format!("scene {seed} ({})", case.kind);
    if with_kernel {
        case.splats.kernel = kernel(seed / 8, case.splats.len());
        name += KERNELS[seed as usize / 8 % KERNELS.len()];
    }
    let options = RasterOptions {
        background: case.background,
        antialias: seed / 32 % 2 == 1,
        clamp_grad: if seed / 64 % 2 == 1 { ClampGrad::PassThrough } else { ClampGrad::Exact },
        simd,
        ..Default::default()
    };
    let mut frame = Frame::default();
    rasterizer.render_into(case.splats.view(), &case.camera, &options, &mut frame).expect("a frame");
    let scene = Scene::<f64>::new(&case.splats);
    let want = reference::render(&scene, &case.camera, &options, Cutoff::Hard);
    frame_error(&frame, &want, tally, &name);
    gradient_error(rasterizer, &case, &options, &want.margin, seed, tally, &name);
    Checked { name, case, options, frame, want }
}

/// Cotangents of a frame. They vanish where a sample may be in or out: there two gradients differ by a whole sample.
fn cotangents(seed: u64, margin: &[f64]) -> FrameGrad {
    let n = margin.len();
    let w = weights(seed, 5 * n);
    let keep = |i: usize| if margin[i] < BAND { 0.0 } else { 1.0 };
    FrameGrad {
        rgb: (0..3 * n).map(|k| w[k] * keep(k / 3)).collect(),
        alpha: (0..n).map(|i| w[3 * n + i] * keep(i)).collect(),
        depth: (0..n).map(|i| 0.1 * w[4 * n + i] * keep(i)).collect(),
    }
}

fn gradient_error(
    rasterizer: &mut dyn Rasterizer,
    case: &Case,
    options: &RasterOptions,
    margin: &[f64],
    seed: u64,
    tally: &mut Tally,
    name: &str,
) {
    let d = cotangents(seed, margin);
    let (splats, camera) = (case.splats.view(), &case.camera);
    let [(mut got, mut stats), (mut plain, mut plain_stats)] = [0; 2].map(|_| Default::default());
    let got_camera =
        rasterizer.render_backward_with_camera(splats, camera, options, &d, &mut got, &mut stats).expect("a gradient");
    rasterizer.render_backward_into(splats, camera, options, &d, &mut plain, &mut plain_stats).expect("a gradient");
    assert!((&got, &stats) == (&plain, &plain_stats), "{name}: the camera changes the gradient of the splats");
    let wide = |v: f32| f64::from(v);
    let d64: Vec<_> = (0..margin.len())
        .map(|i| ([0, 1, 2].map(|c| wide(d.rgb[3 * i + c])), wide(d.alpha[i]), wide(d.depth[i])))
        .collect();
    let scene = Scene::<f64>::new(&case.splats);
    let (want, want2d, want_camera) = reference::render_backward(&scene, camera, options, Cutoff::Hard, &d64);
    let flat = |v: &[f32]| v.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
    let vec3 = |v: &[glam::Vec3]| v.iter().flat_map(|m| m.to_array()).map(f64::from).collect::<Vec<_>>();
    let kinds = [
        ("means", vec3(&got.means), want.means.as_flattened().to_vec()),
        ("quats", flat(got.quats.as_flattened()), want.quats.as_flattened().to_vec()),
        ("scales", vec3(&got.scales), want.scales.as_flattened().to_vec()),
        ("opacities", flat(&got.opacities), want.opacities.clone()),
        ("color", flat(&got.color), want.color.clone()),
        ("kernel", flat(&got.kernel), want.kernel.clone()),
        ("means2d", flat(stats.grad_means2d.as_flattened()), want2d.as_flattened().to_vec()),
    ];
    let (got_camera, want_camera) = (got_camera.to_array(), want_camera.to_array());
    let camera_kinds = CAMERA_KINDS.map(|(kind, entries)| {
        let pick = |all: &[f64; 16]| entries.iter().map(|&k| all[k]).collect::<Vec<_>>();
        (kind, pick(&got_camera), pick(&want_camera))
    });
    for (kind, got, want) in kinds.into_iter().chain(camera_kinds) {
        let (cosine, l2) = compare(&got, &want);
        tally.worst_cosine = tally.worst_cosine.max(1.0 - cosine);
        tally.worst_l2 = tally.worst_l2.max(l2);
        assert!(cosine >= 0.9999 && l2 <= 1e-3, "{name}: {kind}: cosine {cosine:.6}, relative L2 {l2:.2e}");
    }
}
