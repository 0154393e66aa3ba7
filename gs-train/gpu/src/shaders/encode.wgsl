// One thread a coordinate of a splat: p, then sin and cos of 2^k p (gs_core::nn::encoding), to about 1e-7.

struct Encode {
    points: u32,
    bands: u32,
    scale: f32, // of coordinates, before they are encoded
    unused: u32,
}

@group(0) @binding(0) var<uniform> encode: Encode;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read_write> encoded: array<f32>; // [points, 3 (1 + 2 bands)]

// 1 / 2 pi in binary, its first 256 bits behind the point.
const TURN: array<u32, 8> = array(
    0x28be60dbu, 0x9391054au, 0x7f09d5f4u, 0x7d4d3770u,
    0x36d8a566u, 0x4f10e410u, 0x7f9458eau, 0xf7aef158u,
);

// 32 of these bits from one on; zeros stand before the first.
fn bits_from(first: i32) -> u32 {
    let word = first >> 5u;
    let shift = u32(first & 31);
    var turn = TURN;
    var left = 0u;
    var right = 0u;
    if (word >= 0 && word < 8) {
        left = turn[word];
    }
    if (word >= -1 && word < 7) {
        right = turn[word + 1];
    }
    if (shift == 0u) {
        return left;
    }
    return (left << shift) | (right >> (32u - shift));
}

// The high word of a product.
fn high_word(a: u32, b: u32) -> u32 {
    let low = (a & 0xffffu) * (b & 0xffffu);
    let first = (a >> 16u) * (b & 0xffffu);
    let second = (a & 0xffffu) * (b >> 16u);
    let middle = (low >> 16u) + (first & 0xffffu) + (second & 0xffffu);
    return (a >> 16u) * (b >> 16u) + (first >> 16u) + (second >> 16u) + (middle >> 16u);
}

// Sine and cosine of 2^k x. The part of a turn is taken in integers, exact to 2^-32 of a turn for every x (Payne and Hanek 1983): x is a
// whole number m of 24 bits times a power of two, and whole turns of m times the bits of 1 / 2 pi fall away. The polynomials are
// Taylor's to the ninth and eighth order, to 1e-7 within an eighth of a turn.
fn sin_cos(x: f32, k: u32) -> vec2<f32> {
    let bits = bitcast<u32>(x);
    let exponent = (bits >> 23u) & 0xffu;
    let m = (bits & 0x7fffffu) | select(0x800000u, 0u, exponent == 0u);
    let power = i32(max(exponent, 1u)) - 150 + i32(k);
    var turns = m * bits_from(power) + high_word(m, bits_from(power + 32));
    turns = select(turns, 0u - turns, (bits >> 31u) != 0u);
    let quarter = (turns + 0x20000000u) >> 30u;
    let r = f32(bitcast<i32>(turns - (quarter << 30u))) * 1.4629180792671596e-9;
    let s = r * r;
    let sine = r + r * s * (-1.6666667e-1 + s * (8.3333338e-3 + s * (-1.9841270e-4 + s * 2.7557319e-6)));
    let cosine = 1.0 + s * (-0.5 + s * (4.1666668e-2 + s * (-1.3888889e-3 + s * 2.4801587e-5)));
    if (quarter == 0u) {
        return vec2(sine, cosine);
    }
    if (quarter == 1u) {
        return vec2(cosine, -sine);
    }
    if (quarter == 2u) {
        return vec2(-sine, -cosine);
    }
    return vec2(-cosine, sine);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = 256u * workgroup_index(group, groups) + lane;
    if (at >= 3u * encode.points) {
        return;
    }
    let d = at % 3u;
    let row = (at / 3u) * 3u * (1u + 2u * encode.bands);
    let p = points[at] * encode.scale;
    encoded[row + d] = p;
    for (var k = 0u; k < encode.bands; k++) {
        let v = sin_cos(p, k);
        encoded[row + 3u + 6u * k + d] = v.x;
        encoded[row + 6u + 6u * k + d] = v.y;
    }
}
