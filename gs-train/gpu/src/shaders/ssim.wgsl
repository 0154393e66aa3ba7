// What the kernels of the image loss know: L = l1 mean|x - y| + dssim (1 - SSIM(x, y)), x the frame, y the ground truth.

struct Loss {
    width: u32,
    height: u32,
    columns: u32, // of tiles
    rows: u32,
    background: vec4<f32>,
    l1: f32,      // over the number of values
    dssim: f32,   // likewise
    unused_0: f32,
    unused_1: f32,
}

@group(0) @binding(0) var<uniform> loss: Loss;
@group(0) @binding(1) var<storage, read> frame: array<f32>;  // [H, W, 3]
@group(0) @binding(2) var<storage, read> truth: array<u32>;  // [H, W]: RGBA, red in the lowest byte, straight alpha

const RADIUS: u32 = 5u;
const SIDE: u32 = 16u;
const WIDE: u32 = 26u; // SIDE + 2 RADIUS
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

// Weights of the window by the distance from its centre: Gaussian of standard deviation 1.5, eleven taps, sum 1.
fn weight(tap: u32) -> f32 {
    let window = array(0.2660117249, 0.2130055377, 0.1093606895, 0.0360007721, 0.0075987581, 0.0010283801);
    return window[max(tap, RADIUS) - min(tap, RADIUS)];
}

// A channel of the ground truth over the background.
fn truth_at(pixel: u32, channel: u32) -> f32 {
    let rgba = truth[pixel];
    let alpha = f32(rgba >> 24u) / 255.0;
    return f32((rgba >> (8u * channel)) & 0xffu) / 255.0 * alpha + loss.background[channel] * (1.0 - alpha);
}
