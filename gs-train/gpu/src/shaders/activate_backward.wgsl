// One thread a splat: gradients of raw quaternions and scales and of the offsets of a field, from those of the splat.

@group(0) @binding(1) var<storage, read> grads: array<f32>; // column after column: see gs-gpu
@group(0) @binding(2) var<storage, read> raw_quats: array<f32>;
@group(0) @binding(3) var<storage, read> log_scales: array<f32>;
@group(0) @binding(4) var<storage, read> offsets: array<f32>;
@group(0) @binding(5) var<storage, read_write> d_quats: array<f32>;
@group(0) @binding(6) var<storage, read_write> d_log_scales: array<f32>;
@group(0) @binding(7) var<storage, read_write> d_offsets: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = 256u * workgroup_index(group, groups) + lane;
    let n = cloud.splats;
    if (i >= n) {
        return;
    }
    for (var k = 0u; k < 3u; k++) {
        let at = 3u * i + k;
        let d_scale = select(grads[7u * n + at], 0.0, has_rule(KEEPS_SIZES));
        var scale = exp(log_scales[at]);
        var d_ds = d_scale;
        if (moves(SCALES) && !has_rule(SCALES_ADD)) {
            scale *= exp(offsets[10u * i + 3u + k]);
            d_ds = d_scale * scale;
        }
        d_log_scales[at] = d_scale * scale;
        if (cloud.moves != 0u) {
            d_offsets[10u * i + k] = grads[at];
            d_offsets[10u * i + 3u + k] = d_ds;
        }
    }
    let at = 3u * n + 4u * i;
    var d_quat = vec4(grads[at], grads[at + 1u], grads[at + 2u], grads[at + 3u]);
    var d_dr = d_quat;
    if (moves(QUATS) && has_rule(QUATS_UNIT)) {
        let quat = vec4(raw_quats[4u * i], raw_quats[4u * i + 1u], raw_quats[4u * i + 2u], raw_quats[4u * i + 3u]);
        let o = 10u * i + 6u;
        let dr = vec4(offsets[o], offsets[o + 1u], offsets[o + 2u], offsets[o + 3u]);
        let norm = length_of(quat);
        d_dr = norm * d_quat;
        if (norm > 0.0) {
            d_quat += quat / norm * dot(d_quat, dr);
        }
    }
    for (var k = 0u; k < 4u; k++) {
        d_quats[4u * i + k] = d_quat[k];
        if (cloud.moves != 0u) {
            d_offsets[10u * i + 6u + k] = d_dr[k];
        }
    }
}
