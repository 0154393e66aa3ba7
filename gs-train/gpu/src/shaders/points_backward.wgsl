// One thread a point: adds what its channels give to the gradient of its place, in order.

struct Sizes {
    points: u32,
    quads: u32,
    unused_0: u32,
    unused_1: u32,
}

@group(0) @binding(0) var<uniform> sizes: Sizes;
@group(0) @binding(1) var<storage, read> parts: array<vec4<f32>>; // [points, quads]
@group(0) @binding(2) var<storage, read_write> d_points: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = 256u * workgroup_index(group, groups) + lane;
    if (i >= sizes.points) {
        return;
    }
    var sum = vec4(0.0, 0.0, 0.0, 0.0);
    for (var q = 0u; q < sizes.quads; q++) {
        sum += parts[sizes.quads * i + q];
    }
    d_points[3u * i] += sum.x;
    d_points[3u * i + 1u] += sum.y;
    d_points[3u * i + 2u] += sum.z;
}
