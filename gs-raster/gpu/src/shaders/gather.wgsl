// One thread a splat: the sum of its records in the order of its tiles.

@group(0) @binding(1) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> sums: array<vec4<f32>>;

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
    let span = spans[i];
    for (var k = 0u; k < 3u; k++) {
        var high = vec4(0.0, 0.0, 0.0, 0.0);
        var low = vec4(0.0, 0.0, 0.0, 0.0);
        for (var e = span.x; e < span.x + span.y; e++) {
            let value = records[3u * e + k];
            for (var c = 0u; c < 4u; c++) {
                let s = two_sum(high[c], value[c]);
                high[c] = s.x;
                low[c] += s.y;
            }
        }
        sums[3u * i + k] = high + low;
    }
}
