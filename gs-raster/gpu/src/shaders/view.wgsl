// What every kernel knows of a frame. Numbers that f32 would round come as a high and a low part.
struct View {
    rotation_h: array<vec4<f32>, 3>, // row of R, entry of T
    rotation_l: array<vec4<f32>, 3>,
    focal: vec4<f32>,                // fx, fy, low parts
    center: vec4<f32>,               // cx, cy, low parts
    limits_h: vec4<f32>,             // bounds of x/z and y/z in the Jacobian: x low, x high, y low, y high
    limits_l: vec4<f32>,
    position_h: vec4<f32>,           // camera centre
    position_l: vec4<f32>,
    background: vec4<f32>,
    thresholds: vec4<f32>,           // min_alpha, log2(min_alpha), max_alpha, stop
    range: vec4<f32>,                // near, far, dilation, largest visible a² + b²
    limits: vec4<f32>,               // smallest opacity drawn, -, -, -
    sizes: vec4<u32>,                // width, height, tile columns, tile rows
    counts: vec4<u32>,               // splats, entries that fit, SH degree, -
    flags: vec4<u32>,                // antialias, gradient above the cap, SH colours, listing writes
    zero: vec4<u32>,                 // zeros that no compiler can see
}

const TILE: u32 = 16u;
const LOG2_SCALE: f32 = 0.84932178258895874;
const LOG2_SCALE_LOW: f32 = 1.7699060344e-08;
const MIN_COMPENSATION: f32 = 0.005;

@group(0) @binding(0) var<uniform> view: View;
