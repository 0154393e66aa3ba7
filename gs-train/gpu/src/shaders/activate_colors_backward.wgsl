// One thread a value: gradients of stored colours; of those that are not rendered they are zero.

@group(0) @binding(1) var<storage, read> d_colors: array<f32>;
@group(0) @binding(2) var<storage, read_write> d_sh_dc: array<f32>;
@group(0) @binding(3) var<storage, read_write> d_sh_rest: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = 256u * workgroup_index(group, groups) + lane;
    if (at >= cloud.splats * cloud.stored) {
        return;
    }
    let i = at / cloud.stored;
    let k = at % cloud.stored;
    var d = 0.0;
    if (k < cloud.rendered) {
        d = d_colors[cloud.rendered * i + k];
    }
    if (k < 3u) {
        d_sh_dc[3u * i + k] = d;
    } else {
        d_sh_rest[(cloud.stored - 3u) * i + k - 3u] = d;
    }
}
