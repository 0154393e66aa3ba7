//! What the device's own functions are worth.

use crate::device::Gpu;
use crate::memory::{Array, Readback};

/// Largest relative error of `exp2` that the blend accepts: that of the CPU's.
const MAX_ERROR: f64 = 2.5e-7;
/// Number of arguments tried.
const SAMPLES: u32 = 16_384;
/// Lowest argument: alpha 1/255 lies at −8, the threshold may be lower.
const LOWEST: f32 = -20.0;

const SOURCE: &str = "
@group(0) @binding(0) var<storage, read> x: array<f32>;
@group(0) @binding(1) var<storage, read_write> y: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < arrayLength(&x)) {
        y[id.x] = exp2(x[id.x]);
    }
}
";

/// Whether the device's `exp2` is as accurate as the blend needs, measured.
pub(crate) fn exp2_is_accurate(gpu: &Gpu) -> bool {
    exp2_error(gpu).is_some_and(|e| e <= MAX_ERROR)
}

/// Largest relative error of the device's `exp2`; `None` if it cannot be measured.
pub(crate) fn exp2_error(gpu: &Gpu) -> Option<f64> {
    let x: Vec<f32> = (0..SAMPLES).map(|i| LOWEST * (i as f32 + 0.37) / SAMPLES as f32).collect();
    let (mut input, mut output) = (Array::new(gpu, "arguments of exp2"), Array::new(gpu, "values of exp2"));
    input.upload(gpu, &x).ok()?;
    output.resize(gpu, input.bytes()).ok()?;
    let kernel = crate::kernels::probe(gpu.device(), SOURCE);
    let group = kernel.bind(gpu.device(), &[&input, &output]);
    let mut encoder = gpu.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    kernel.run(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()), &group, [SAMPLES / 64, 1]);
    let mut worst = 0.0f64;
    let measure = |_, bytes: &[u8]| {
        let y: Vec<f32> = bytemuck::pod_collect_to_vec(bytes);
        let errors = x.iter().zip(y).map(|(&x, y)| (f64::from(y) / f64::from(x).exp2() - 1.0).abs());
        // What is no number is the largest error.
        worst = errors.fold(0.0, |worst, e| if e <= worst || worst.is_nan() { worst } else { e });
    };
    Readback::default().submit(gpu, encoder, &[&output], measure).ok()?;
    Some(worst)
}
