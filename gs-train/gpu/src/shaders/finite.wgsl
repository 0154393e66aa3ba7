// One thread a splat: where a gradient is not finite, all of the splat's are set to zero, and it is counted.

@group(0) @binding(1) var<storage, read_write> grads: array<f32>;
@group(0) @binding(2) var<storage, read_write> d_colors: array<f32>;
@group(0) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;

// From the bits: compilers may assume that every number is finite.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

// Whether a row of a column is finite.
fn column(at: u32, width: u32, i: u32) -> bool {
    for (var k = 0u; k < width; k++) {
        if (!is_finite(grads[at * cloud.splats + width * i + k])) {
            return false;
        }
    }
    return true;
}

fn clear(at: u32, width: u32, i: u32) {
    for (var k = 0u; k < width; k++) {
        grads[at * cloud.splats + width * i + k] = 0.0;
    }
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = 256u * workgroup_index(group, groups) + lane;
    if (i >= cloud.splats) {
        return;
    }
    var ok = column(0u, 3u, i) && column(3u, 4u, i) && column(7u, 3u, i) && column(10u, 1u, i);
    for (var k = 0u; k < cloud.rendered; k++) {
        ok = ok && is_finite(d_colors[cloud.rendered * i + k]);
    }
    if (!ok) {
        clear(0u, 3u, i);
        clear(3u, 4u, i);
        clear(7u, 3u, i);
        clear(10u, 1u, i);
        for (var k = 0u; k < cloud.rendered; k++) {
            d_colors[cloud.rendered * i + k] = 0.0;
        }
        atomicAdd(&counters[0], 1u);
    }
}
