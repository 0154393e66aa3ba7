// One thread a splat: statistics of densification, as gs_train::densify has them. A frame that did not fit leaves them alone.

struct Statistics {
    splats: u32,
    entries: u32, // that the frame had room for
    half_width: f32,
    half_height: f32,
}

@group(0) @binding(0) var<uniform> frame: Statistics;
@group(0) @binding(1) var<storage, read> totals: array<u32>;
@group(0) @binding(2) var<storage, read> grads: array<f32>;
@group(0) @binding(3) var<storage, read_write> grad_sum: array<f32>;
@group(0) @binding(4) var<storage, read_write> seen: array<f32>;
@group(0) @binding(5) var<storage, read_write> max_radius: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = 256u * workgroup_index(group, groups) + lane;
    let n = frame.splats;
    if (i >= n || totals[arrayLength(&totals) - 1u] > frame.entries) {
        return;
    }
    let radius = grads[13u * n + i];
    if (radius > 0.0) {
        let x = grads[11u * n + 2u * i] * frame.half_width;
        let y = grads[11u * n + 2u * i + 1u] * frame.half_height;
        // Scaled, so that squares neither overflow nor vanish.
        let big = max(abs(x), abs(y));
        var norm = 0.0;
        if (big > 0.0 && (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u && (bitcast<u32>(y) & 0x7f800000u) != 0x7f800000u) {
            norm = big * sqrt((x / big) * (x / big) + (y / big) * (y / big));
        }
        grad_sum[i] += norm;
        seen[i] += 1.0;
        max_radius[i] = max(max_radius[i], ceil(radius));
    }
}
