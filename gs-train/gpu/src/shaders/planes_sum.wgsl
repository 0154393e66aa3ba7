// One thread a value of a plane: its gradient from the sums in integers, and that of the regularisers, as gs_deform states them. The sums
// are set to zero for the next step.

struct Plane {
    at: u32,            // its first value among those of all planes
    len: u32,
    nodes_a: u32,
    nodes_b: u32,
    number: u32,        // level times six, plus the plane
    spread: u32,
    partial_at: u32,    // its first workgroup among those of all planes
    unused: u32,
    smoothness: f32,        // 2 w / count of the second difference along the slow axis
    to_one: f32,        // w / count of the distance to one
    unused_0: f32,
    unused_1: f32,
}

@group(0) @binding(0) var<uniform> plane: Plane;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read> peaks: array<u32>;
@group(0) @binding(3) var<storage, read_write> sums: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> grads: array<f32>;
@group(0) @binding(5) var<storage, read_write> partials: array<vec2<f32>>; // per workgroup: squared second differences, distances to one

var<workgroup> tree: array<vec2<f32>, 256>;

// The second difference that begins at a value, `rows` from the slow axis' first.
fn second_difference(at: u32, row: u32, stride: u32) -> f32 {
    if (row + 2u >= plane.nodes_b) {
        return 0.0;
    }
    return values[at] + values[at + 2u * stride] - 2.0 * values[at + stride];
}

// A whole number of 64 bits, low word first, over 2^32.
fn number(sum: vec2<u32>) -> f32 {
    let negative = (sum.y >> 31u) != 0u;
    let low = select(sum.x, 0u - sum.x, negative);
    let high = select(sum.y, ~sum.y + select(0u, 1u, sum.x == 0u), negative);
    let size = f32(high) + f32(low) * 2.3283064365386963e-10;
    return select(size, -size, negative);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = workgroup_index(group, groups);
    let own = 256u * index + lane;
    var value = vec2(0.0, 0.0);
    if (own < plane.len) {
        let at = plane.at + own;
        let unit = power_of_two(-unit_exponent(peaks[plane.number], plane.spread));
        var g = number(sums[at]) * unit;
        if ((peaks[plane.number] & 0x7f800000u) == 0x7f800000u) {
            g = bitcast<f32>(peaks[plane.number]); // a contribution was not finite
        }
        sums[at] = vec2(0u, 0u);
        let stride = 16u * plane.nodes_a;
        let row = (own / stride) % plane.nodes_b;
        if (plane.smoothness > 0.0) {
            let e = second_difference(at, row, stride);
            value.x = e * e;
            var d = e;
            if (row >= 1u) {
                d -= 2.0 * second_difference(at - stride, row - 1u, stride);
            }
            if (row >= 2u) {
                d += second_difference(at - 2u * stride, row - 2u, stride);
            }
            g += plane.smoothness * d;
        }
        if (plane.to_one > 0.0) {
            let e = values[at] - 1.0;
            value.y = abs(e);
            g += plane.to_one * sign(e);
        }
        grads[at] = g;
    }
    tree[lane] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (lane < half) {
            tree[lane] += tree[lane + half];
        }
        workgroupBarrier();
    }
    if (lane == 0u && own < plane.len) {
        partials[plane.partial_at + index] = tree[0];
    }
}
