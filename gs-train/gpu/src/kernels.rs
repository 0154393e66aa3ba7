//! The kernels of a step, compiled once.

use gs_gpu::Bind::{self, Read, Uniform, Write};
use gs_gpu::{Gpu, INDEX, Kernel};

pub(crate) struct Kernels {
    pub activate: Kernel,
    pub activate_colors: Kernel,
    pub finite: Kernel,
    pub activate_backward: Kernel,
    pub activate_rest_backward: Kernel,
    pub activate_colors_backward: Kernel,
    pub planes_forward: Kernel,
    pub planes_peaks: Kernel,
    pub planes_backward: Kernel,
    pub points_backward: Kernel,
    pub planes_sum: Kernel,
    pub encode: Kernel,
    pub linear: Kernel,
    pub linear_sum: Kernel,
    pub loss_forward: Kernel,
    pub loss_backward: Kernel,
    pub statistics: Kernel,
    pub adam: Kernel,
}

const CLOUD: &str = include_str!("shaders/cloud.wgsl");
const PLANES: &str = include_str!("shaders/planes.wgsl");
const FIXED_POINT: &str = include_str!("shaders/fixed_point.wgsl");
const SSIM: &str = include_str!("shaders/ssim.wgsl");

impl Kernels {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let make = |name, parts: &[&str], entry, binds: &[Bind]| {
            let source = std::iter::once(INDEX).chain(parts.iter().copied()).collect::<String>();
            Kernel::new(gpu.device(), name, &source, entry, binds)
        };
        let backward = [PLANES, FIXED_POINT, include_str!("shaders/planes_backward.wgsl")];
        let back = [Uniform, Read, Read, Read, Write, Write, Write];
        Self {
            activate: make(
                "activate",
                &[CLOUD, include_str!("shaders/activate.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Write, Write, Write],
            ),
            activate_colors: make(
                "activate colors",
                &[CLOUD, include_str!("shaders/activate_colors.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Write, Write],
            ),
            finite: make(
                "finite",
                &[CLOUD, include_str!("shaders/finite.wgsl")],
                "main",
                &[Uniform, Write, Write, Write],
            ),
            activate_backward: make(
                "activate backward",
                &[CLOUD, include_str!("shaders/activate_backward.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Write, Write, Write],
            ),
            activate_rest_backward: make(
                "activate rest backward",
                &[CLOUD, include_str!("shaders/activate_rest_backward.wgsl")],
                "main",
                &[Uniform, Read, Read, Write, Write],
            ),
            activate_colors_backward: make(
                "activate colors backward",
                &[CLOUD, include_str!("shaders/activate_colors_backward.wgsl")],
                "main",
                &[Uniform, Read, Write, Write],
            ),
            planes_forward: make(
                "planes forward",
                &[PLANES, include_str!("shaders/planes_forward.wgsl")],
                "main",
                &[Uniform, Read, Read, Write],
            ),
            planes_peaks: make("planes peaks", &backward, "find_peaks", &back),
            planes_backward: make("planes backward", &backward, "main", &back),
            points_backward: make(
                "points backward",
                &[include_str!("shaders/points_backward.wgsl")],
                "main",
                &[Uniform, Read, Write],
            ),
            planes_sum: make(
                "planes sum",
                &[FIXED_POINT, include_str!("shaders/planes_sum.wgsl")],
                "main",
                &[Uniform, Read, Read, Write, Write, Write],
            ),
            encode: make("encode", &[include_str!("shaders/encode.wgsl")], "main", &[Uniform, Read, Write]),
            linear: make("linear", &[include_str!("shaders/linear.wgsl")], "main", &[Uniform, Read, Read, Read, Write]),
            linear_sum: make(
                "linear sum",
                &[include_str!("shaders/linear_sum.wgsl")],
                "main",
                &[Uniform, Read, Write, Write],
            ),
            loss_forward: make(
                "loss forward",
                &[SSIM, include_str!("shaders/loss_forward.wgsl")],
                "main",
                &[Uniform, Read, Read, Write, Write],
            ),
            loss_backward: make(
                "loss backward",
                &[SSIM, include_str!("shaders/loss_backward.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Write],
            ),
            statistics: make(
                "statistics",
                &[include_str!("shaders/statistics.wgsl")],
                "main",
                &[Uniform, Read, Read, Write, Write, Write],
            ),
            adam: make(
                "adam",
                &[include_str!("shaders/adam.wgsl")],
                "main",
                &[Uniform, Read, Read, Read, Read, Write, Write, Write],
            ),
        }
    }
}
