// What the splats of a workgroup pull back to the camera, summed in a tree of fixed shape: viewmat row by row, then the focal
// lengths and the principal point (see gs_raster's `camera_grad.rs`). After the gradients of the splats.

@group(0) @binding(7) var<storage, read_write> grads: array<f32>; // read: means, with the path through the view direction
@group(0) @binding(8) var<storage, read_write> partial_sums: array<vec4<f32>>;

var<workgroup> tree: array<vec4<f32>, 256>; // four vectors a thread

// Row r of viewmat.
fn viewmat_row(d: SplatGrad, own: array<array<vec2<f32>, 3>, 3>, mean: vec3<f32>, d_view: vec3<f32>, r: u32) -> vec4<f32> {
    let axes = vec3(d.axes.d_axes[0][r], d.axes.d_axes[1][r], d.axes.d_axes[2][r]);
    let turned_back = vec3(
        dot(axes, vec3(own[0][0].x, own[0][1].x, own[0][2].x)),
        dot(axes, vec3(own[1][0].x, own[1][1].x, own[1][2].x)),
        dot(axes, vec3(own[2][0].x, own[2][1].x, own[2][2].x)),
    );
    let seen = dot(view.rotation_h[r].xyz, d_view);
    return vec4(d.point[r] * mean + turned_back + seen * view.position_h.xyz, d.point[r] + seen);
}

fn intrinsics(d: SplatGrad) -> vec4<f32> {
    let g = d.geometry;
    let inv_z = g.inv_z.x;
    let clamped = vec2(g.clamped[0].x, g.clamped[1].x);
    let t = vec2(g.point[0].x, g.point[1].x);
    let focal = inv_z * (t * d.mean2d + d.axes.d_focal - g.unclamped * clamped * d.axes.d_slope);
    let center = d.mean2d + (vec2(1.0, 1.0) - g.unclamped) * inv_z * d.axes.d_slope;
    return vec4(focal, center);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = workgroup_index(group, groups);
    let i = 64u * block + lane;
    for (var k = 0u; k < 4u; k++) {
        tree[64u * k + lane] = vec4(0.0, 0.0, 0.0, 0.0);
    }
    if (is_drawn(i)) {
        let d = splat_backward(i);
        let mean = vec3(means[3u * i], means[3u * i + 1u], means[3u * i + 2u]);
        let d_view = vec3(grads[3u * i], grads[3u * i + 1u], grads[3u * i + 2u]) - d.mean;
        let own = rotation_of(d.geometry.unit);
        tree[lane] = viewmat_row(d, own, mean, d_view, 0u);
        tree[64u + lane] = viewmat_row(d, own, mean, d_view, 1u);
        tree[128u + lane] = viewmat_row(d, own, mean, d_view, 2u);
        tree[192u + lane] = intrinsics(d);
    }
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (lane < half) {
            for (var k = 0u; k < 4u; k++) {
                tree[64u * k + lane] += tree[64u * k + lane + half];
            }
        }
        workgroupBarrier();
    }
    if (lane < 4u && block < arrayLength(&partial_sums) / 4u) {
        partial_sums[4u * block + lane] = tree[64u * lane];
    }
}
