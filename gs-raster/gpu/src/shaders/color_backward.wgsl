// One thread a splat: the gradient of its colour row, and that of its mean through the view direction.

@group(0) @binding(1) var<storage, read> means: array<f32>;
@group(0) @binding(2) var<storage, read> colors: array<f32>;
@group(0) @binding(3) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> sums: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> d_colors: array<f32>;
@group(0) @binding(6) var<storage, read_write> grads: array<f32>; // means come first

fn write(at: u32, value: vec3<f32>) {
    d_colors[at] = value.x;
    d_colors[at + 1u] = value.y;
    d_colors[at + 2u] = value.z;
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
    var d_rgb = vec3(0.0, 0.0, 0.0);
    if (spans[i].y != 0u) {
        d_rgb = vec3(sums[3u * i + 1u].zw, sums[3u * i + 2u].x);
    }
    if (view.flags.z == 0u) {
        write(3u * i, d_rgb);
        return;
    }
    let degree = view.counts.z;
    let count = (degree + 1u) * (degree + 1u);
    let first = 3u * count * i;
    if (spans[i].y == 0u) {
        for (var k = 0u; k < count; k++) {
            write(first + 3u * k, d_rgb);
        }
        return;
    }
    let mean = vec3(means[3u * i], means[3u * i + 1u], means[3u * i + 2u]);
    let seen = direction(mean);
    let basis_values = basis(seen.xyz, degree);
    let rgb = color_of(basis_values, first, count);
    d_rgb = select(vec3(0.0, 0.0, 0.0), d_rgb, rgb > vec3(0.0, 0.0, 0.0));
    var d_basis: array<f32, 16>;
    for (var k = 0u; k < count; k++) {
        let at = first + 3u * k;
        d_basis[k] = dot(vec3(colors[at], colors[at + 1u], colors[at + 2u]), d_rgb);
        write(at, basis_values[k] * d_rgb);
    }
    // Onto the sphere: the part along the direction has no effect.
    let d = basis_backward(seen.xyz, degree, d_basis);
    let d_mean = (d - seen.xyz * dot(seen.xyz, d)) * seen.w;
    grads[3u * i] += d_mean.x;
    grads[3u * i + 1u] += d_mean.y;
    grads[3u * i + 2u] += d_mean.z;
}
