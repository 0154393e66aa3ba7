// One thread a splat: its colour seen from the camera.

@group(0) @binding(1) var<storage, read> means: array<f32>;
@group(0) @binding(2) var<storage, read> colors: array<f32>;
@group(0) @binding(3) var<storage, read_write> projected: array<vec4<f32>>;

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
    let at = STRIDE * i + 3u;
    let support = projected[at].w;
    if (support < 0.0) {
        return;
    }
    var rgb = vec3(colors[3u * i], colors[3u * i + 1u], colors[3u * i + 2u]);
    if (view.flags.z != 0u) {
        let degree = view.counts.z;
        let count = (degree + 1u) * (degree + 1u);
        let mean = vec3(means[3u * i], means[3u * i + 1u], means[3u * i + 2u]);
        // Finite, with room for sums over splats.
        rgb = clamp(color_of(basis(direction(mean).xyz, degree), 3u * count * i, count), vec3(0.0, 0.0, 0.0), vec3(1e37, 1e37, 1e37));
    }
    projected[at] = vec4(rgb, support);
}
