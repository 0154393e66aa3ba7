//! Speed beside the machine's roofs: the scenes of the benchmarks, and what the machine can do at most.
//!
//! Scenes follow the statistics that published CPU peers were timed on: centres uniform in the unit box, log-normal sizes
//! (σ 0.5) times per-axis log-normal (σ 0.6), opacity logits N(0, 1.8²), unnormalised quaternions, SH degree 3.

use crate::options::SimdLevel;
use crate::simd;
use fearless_simd::{dispatch, f32x16, prelude::*};
use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Color, Kernel, Rng, Splats, sh};
use rayon::prelude::*;
use std::hint::black_box;
use std::time::Instant;

/// A random scene of `n` splats of SH degree `degree`; median scale 0.020 for 10 000, 0.010 for 100 000 splats.
pub fn scene(n: usize, degree: u8) -> Splats {
    let median = 0.02 * (1e4 / n.max(1) as f64).powf(0.30103);
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

/// The camera of the scenes: 1.5 units off the centre, `fx = 1.2 · side`.
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

/// What this machine does at most, for the threads of the current pool.
#[derive(Clone, Copy, Debug)]
pub struct Roofs {
    /// Threads measured.
    pub threads: usize,
    /// Fused multiply-adds, GFLOP/s.
    pub fma: f64,
    /// Evaluations of the blend's `2^x`, 10⁹/s.
    pub exp2: f64,
}

impl Roofs {
    /// Measures both at an instruction set, in about a tenth of a second.
    pub fn measure(choice: SimdLevel) -> Self {
        let threads = rayon::current_num_threads();
        let level = simd::level(choice);
        let rounds = 200_000usize;
        let best = |work: &(dyn Fn() -> f32 + Sync)| {
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
        let fma = best(&|| dispatch!(level, simd => fma_rounds(simd, rounds)));
        let exp2 = best(&|| dispatch!(level, simd => exp2_rounds(simd, rounds)));
        let work = (threads * rounds) as f64 * 16.0 * 1e-9;
        Self { threads, fma: work * 2.0 * 12.0 / fma, exp2: work * 4.0 / exp2 }
    }
}

#[inline(always)]
fn fma_rounds<S: Simd>(simd: S, rounds: usize) -> f32 {
    let (a, b) = (f32x16::splat(simd, black_box(0.999)), f32x16::splat(simd, black_box(0.001)));
    let mut acc = [f32x16::splat(simd, black_box(1.0)); 12];
    for _ in 0..rounds {
        acc = acc.map(|v| v.mul_add(a, b));
    }
    acc.into_iter().fold(f32x16::splat(simd, 0.0), |s, v| s + v).reduce_sum()
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

/// Median seconds of `runs` calls after one warm-up.
pub fn median_seconds(runs: usize, mut work: impl FnMut()) -> f64 {
    work();
    let mut times: Vec<f64> = (0..runs.max(1))
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
