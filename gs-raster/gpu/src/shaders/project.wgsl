// One thread a splat: its ellipse on the screen, and the keys of the depth order. A row that is not drawn has support −1.

@group(0) @binding(1) var<storage, read> means: array<f32>;
@group(0) @binding(2) var<storage, read> quats: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> scales: array<f32>;
@group(0) @binding(4) var<storage, read> opacities: array<f32>;
@group(0) @binding(5) var<storage, read> profiles: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> projected: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> keys: array<u32>;
@group(0) @binding(8) var<storage, read_write> low_keys: array<u32>;

const FAR_KEY: u32 = 0xffffffffu;

// Depths that agree in f32 are told apart by 24 bits of the low part.
fn low_key(depth: vec2<f32>) -> u32 {
    let exponent = bitcast<u32>(depth.x) >> 23u;
    let per_ulp = bitcast<f32>((277u - max(exponent, 24u)) << 23u);
    return u32(clamp((depth.y * per_ulp + 0.5) * 16777215.0, 0.0, 16777215.0));
}

fn hide(i: u32) {
    keys[i] = FAR_KEY;
    low_keys[i] = 0u;
    projected[STRIDE * i + 3u] = vec4(0.0, 0.0, 0.0, -1.0);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = 256u * workgroup_index(group, groups) + lane;
    if (i >= view.counts.x) {
        return;
    }
    let mean = vec3(means[3u * i], means[3u * i + 1u], means[3u * i + 2u]);
    let depth = in_camera(mean, 2u);
    let in_range = d_less(d_from(view.range.x), depth) && d_less(depth, d_from(view.range.y));
    // What is no number is at least nothing.
    if (!in_range || !(opacities[i] >= view.limits.x)) {
        hide(i);
        return;
    }
    let g = project_splat(mean, quats[i], vec3(scales[3u * i], scales[3u * i + 1u], scales[3u * i + 2u]));
    let log2_opacity = log2(opacities[i] * g.compensation);
    var profile = vec4(0.0, 0.0, 0.0, 0.0);
    if (HAS_PROFILE) {
        profile = profiles[i];
    }
    let support = min(profile_support(profile, log2_opacity), view.range.w);
    if (!g.ok || support < 0.0) {
        hide(i);
        return;
    }
    let scale = vec2(LOG2_SCALE, LOG2_SCALE_LOW);
    let w0 = d_mul(g.whitening[0], scale);
    let w1 = d_mul(g.whitening[1], scale);
    let w2 = d_mul(g.whitening[2], scale);
    let at = STRIDE * i;
    projected[at] = vec4(g.center[0].x, g.center[1].x, g.center[0].y, g.center[1].y);
    projected[at + 1u] = vec4(w0.x, w1.x, w2.x, log2_opacity);
    projected[at + 2u] = vec4(w0.y, w1.y, w2.y, depth.x);
    projected[at + 3u] = vec4(0.0, 0.0, 0.0, support * 1.00001 + 1e-4);
    if (HAS_PROFILE) {
        projected[at + 4u] = profile;
    }
    keys[i] = bitcast<u32>(depth.x);
    low_keys[i] = low_key(depth);
}
