// One thread four channels of a point.

@group(0) @binding(3) var<storage, read_write> features: array<vec4<f32>>; // [points, levels, channels]

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = 256u * workgroup_index(group, groups) + lane;
    if (index >= planes.points * quads()) {
        return;
    }
    let s = samples(task_of(index));
    features[index] = (s[0].value * s[1].value) * (s[3].value * s[2].value) * (s[4].value * s[5].value);
}
