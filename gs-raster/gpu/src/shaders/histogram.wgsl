// One pass of a stable radix sort over four bits: how often each digit occurs in each block of 2048 keys, digit by digit.

struct Pass {
    shift: u32,
    identity: u32, // the values are the positions
    pad: vec2<u32>,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> count: array<u32>; // the last entry is the number of keys
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> histogram: array<u32>;

var<workgroup> bins: array<atomic<u32>, 128>; // eight copies of each digit's count

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = workgroup_index(group, groups);
    let blocks = arrayLength(&histogram) / 16u;
    if (lane < 128u) {
        atomicStore(&bins[lane], 0u);
    }
    workgroupBarrier();
    let n = min(count[arrayLength(&count) - 1u], arrayLength(&keys));
    for (var k = 0u; k < 8u; k++) {
        let i = block * 2048u + k * 256u + lane;
        if (i < n) {
            let digit = (keys[i] >> pass_.shift) & 15u;
            atomicAdd(&bins[8u * digit + (lane & 7u)], 1u);
        }
    }
    workgroupBarrier();
    if (lane < 16u && block < blocks) {
        var sum = 0u;
        for (var k = 0u; k < 8u; k++) {
            sum += atomicLoad(&bins[8u * lane + k]);
        }
        histogram[lane * blocks + block] = sum;
    }
}
