// One thread a value: the colours that are rendered, and the opacities.

@group(0) @binding(1) var<storage, read> logits: array<f32>;
@group(0) @binding(2) var<storage, read> sh_dc: array<f32>;
@group(0) @binding(3) var<storage, read> sh_rest: array<f32>;
@group(0) @binding(4) var<storage, read_write> opacities: array<f32>;
@group(0) @binding(5) var<storage, read_write> colors: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = 256u * workgroup_index(group, groups) + lane;
    if (at < cloud.splats) {
        opacities[at] = 1.0 / (1.0 + exp(-logits[at]));
    }
    if (at >= cloud.splats * cloud.rendered) {
        return;
    }
    let i = at / cloud.rendered;
    let k = at % cloud.rendered;
    if (k < 3u) {
        colors[at] = sh_dc[3u * i + k];
    } else {
        colors[at] = sh_rest[(cloud.stored - 3u) * i + k - 3u];
    }
}
