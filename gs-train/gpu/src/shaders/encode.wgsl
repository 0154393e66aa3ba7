// One thread a coordinate of a splat: p, then sin and cos of 2^k p (gs_core::nn::encoding), to about 1e-7 where |2^k p| is below 8192.

struct Encode {
    points: u32,
    bands: u32,
    scale: f32, // of coordinates, before they are encoded
    unused: u32,
}

@group(0) @binding(0) var<uniform> encode: Encode;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read_write> encoded: array<f32>; // [points, 3 (1 + 2 bands)]

// Sine and cosine. The quarter turns are taken off in three parts, of which products with small whole numbers are exact (Cody and
// Waite 1980); the polynomials are Taylor's to the ninth and eighth order, to 1e-7 within an eighth of a turn.
fn sin_cos(x: f32) -> vec2<f32> {
    let turns = round(x * 0.63661977);
    let r = ((x - turns * 1.5703125) - turns * 4.837512969970703e-4) - turns * 7.54978995489e-8;
    let s = r * r;
    let sine = r + r * s * (-1.6666667e-1 + s * (8.3333338e-3 + s * (-1.9841270e-4 + s * 2.7557319e-6)));
    let cosine = 1.0 + s * (-0.5 + s * (4.1666668e-2 + s * (-1.3888889e-3 + s * 2.4801587e-5)));
    let quarter = u32(i32(turns)) & 3u;
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
    var band = p;
    for (var k = 0u; k < encode.bands; k++) {
        let v = sin_cos(band);
        encoded[row + 3u + 6u * k + d] = v.x;
        encoded[row + 6u + 6u * k + d] = v.y;
        band *= 2.0;
    }
}
