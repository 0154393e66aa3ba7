// One thread a splat: its gradients, four vectors: mean and opacity; quaternion; scale and radius; centre on the screen and
// the kernel's two sums.

@group(0) @binding(7) var<storage, read_write> grads: array<vec4<f32>>;

fn write(i: u32, a: vec4<f32>, b: vec4<f32>, c: vec4<f32>, d: vec4<f32>) {
    grads[4u * i] = a;
    grads[4u * i + 1u] = b;
    grads[4u * i + 2u] = c;
    grads[4u * i + 3u] = d;
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
    if (!is_drawn(i)) {
        let none = vec4(0.0, 0.0, 0.0, 0.0);
        write(i, none, none, none, none);
        return;
    }
    let d = splat_backward(i);
    write(i, vec4(d.mean, d.opacity), d.quat, vec4(d.scale, d.radius), vec4(d.mean2d, d.kernel));
}
