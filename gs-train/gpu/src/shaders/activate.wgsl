// One thread a splat: where its raw parameters and the offsets of a field put it (gs_deform::apply).

@group(0) @binding(1) var<storage, read> raw_means: array<f32>;
@group(0) @binding(2) var<storage, read> raw_quats: array<f32>;
@group(0) @binding(3) var<storage, read> log_scales: array<f32>;
@group(0) @binding(4) var<storage, read> offsets: array<f32>; // [n, 10]: of the mean, of the scales, of the quaternion
@group(0) @binding(5) var<storage, read_write> means: array<f32>;
@group(0) @binding(6) var<storage, read_write> quats: array<f32>;
@group(0) @binding(7) var<storage, read_write> scales: array<f32>;

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
    for (var k = 0u; k < 3u; k++) {
        var mean = raw_means[3u * i + k];
        if (moves(MEANS)) {
            mean += offsets[10u * i + k];
        }
        means[3u * i + k] = mean;
        var scale = exp(log_scales[3u * i + k]);
        if (moves(SCALES)) {
            let ds = offsets[10u * i + 3u + k];
            if (has_rule(SCALES_ADD)) {
                scale += ds;
            } else {
                scale *= exp(ds);
            }
        }
        scales[3u * i + k] = scale;
    }
    var quat = vec4(raw_quats[4u * i], raw_quats[4u * i + 1u], raw_quats[4u * i + 2u], raw_quats[4u * i + 3u]);
    if (moves(QUATS)) {
        let at = 10u * i + 6u;
        let dr = vec4(offsets[at], offsets[at + 1u], offsets[at + 2u], offsets[at + 3u]);
        if (has_rule(QUATS_UNIT)) {
            quat += length_of(quat) * dr;
        } else {
            quat += dr;
        }
    }
    for (var k = 0u; k < 4u; k++) {
        quats[4u * i + k] = quat[k];
    }
}
