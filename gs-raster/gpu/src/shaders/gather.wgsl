// Sixteen threads a splat: the sum of its records. Each takes every sixteenth; a tree of fixed shape adds the sixteen.

@group(0) @binding(1) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> sums: array<vec4<f32>>;

const LANES: u32 = 16u;

var<workgroup> tree: array<vec4<f32>, 768>; // three vectors a thread

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = (256u / LANES) * workgroup_index(group, groups) + lane / LANES;
    let part = lane % LANES;
    var a = vec4(0.0, 0.0, 0.0, 0.0);
    var b = a;
    var c = a;
    if (i < view.counts.x) {
        let span = spans[i];
        for (var e = span.x + part; e < span.x + span.y; e += LANES) {
            a += records[3u * e];
            b += records[3u * e + 1u];
            c += records[3u * e + 2u];
        }
    }
    for (var half = LANES / 2u; half > 0u; half /= 2u) {
        // The upper half hands over what it has.
        if (part >= half && part < 2u * half) {
            tree[lane] = a;
            tree[256u + lane] = b;
            tree[512u + lane] = c;
        }
        workgroupBarrier();
        if (part < half) {
            a += tree[lane + half];
            b += tree[256u + lane + half];
            c += tree[512u + lane + half];
        }
        workgroupBarrier();
    }
    if (i < view.counts.x && part == 0u) {
        sums[3u * i] = a;
        sums[3u * i + 1u] = b;
        sums[3u * i + 2u] = c;
    }
}
