// One thread a splat: its gradients, column after column as the host keeps them: means, quaternions, scales, opacities, centres
// on the screen, radii, and the two sums of the kernel's parameters.

@group(0) @binding(7) var<storage, read_write> grads: array<f32>;

fn write3(at: u32, v: vec3<f32>) {
    grads[at] = v.x;
    grads[at + 1u] = v.y;
    grads[at + 2u] = v.z;
}

fn write2(at: u32, v: vec2<f32>) {
    grads[at] = v.x;
    grads[at + 1u] = v.y;
}

fn write(i: u32, d: SplatGrad) {
    let n = view.counts.x;
    write3(3u * i, d.mean);
    write2(3u * n + 4u * i, d.quat.xy);
    write2(3u * n + 4u * i + 2u, d.quat.zw);
    write3(7u * n + 3u * i, d.scale);
    grads[10u * n + i] = d.opacity;
    write2(11u * n + 2u * i, d.mean2d);
    grads[13u * n + i] = d.radius;
    write2(14u * n + 2u * i, d.kernel);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = 64u * workgroup_index(group, groups) + lane;
    if (i >= view.counts.x) {
        return;
    }
    var none: SplatGrad;
    if (is_drawn(i)) {
        write(i, splat_backward(i));
    } else {
        write(i, none);
    }
}
