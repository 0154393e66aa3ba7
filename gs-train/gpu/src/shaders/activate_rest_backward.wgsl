// One thread a splat: gradients of raw means and opacities from those of the splat.

@group(0) @binding(1) var<storage, read> grads: array<f32>; // column after column: see gs-gpu
@group(0) @binding(2) var<storage, read> opacities: array<f32>;
@group(0) @binding(3) var<storage, read_write> d_means: array<f32>;
@group(0) @binding(4) var<storage, read_write> d_logits: array<f32>;

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
        d_means[3u * i + k] = grads[3u * i + k];
    }
    let o = opacities[i];
    d_logits[i] = grads[10u * cloud.splats + i] * o * (1.0 - o);
}
