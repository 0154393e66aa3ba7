// The other half of a radix pass: every pair goes to its digit's place, in the order it came.

struct Pass {
    shift: u32,
    identity: u32, // the values are the positions
    pad: vec2<u32>,
}

@group(0) @binding(0) var<uniform> pass_: Pass;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
@group(0) @binding(4) var<storage, read> histogram: array<u32>; // scanned
@group(0) @binding(5) var<storage, read> sums: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(7) var<storage, read_write> values_out: array<u32>;

// Two digits share a word, sixteen bits each: word w of thread t lies at 256 w + t.
var<workgroup> words: array<u32, 2048>;
var<workgroup> parts: array<u32, 256>;

// Exclusive sums of every word over the threads.
fn scan_words(lane: u32) {
    workgroupBarrier();
    let first = (lane >> 5u) * 256u + (lane & 31u) * 8u;
    var sum = 0u;
    for (var i = 0u; i < 8u; i++) {
        sum += words[first + i];
    }
    parts[lane] = sum;
    workgroupBarrier();
    var before = 0u;
    for (var j = lane & 0xe0u; j < lane; j++) {
        before += parts[j];
    }
    for (var i = 0u; i < 8u; i++) {
        let own = words[first + i];
        words[first + i] = before;
        before += own;
    }
    workgroupBarrier();
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = workgroup_index(group, groups);
    let blocks = arrayLength(&histogram) / 16u;
    let n = min(count[arrayLength(&count) - 1u], arrayLength(&keys));
    let first = block * 2048u + 8u * lane;
    for (var w = 0u; w < 8u; w++) {
        words[256u * w + lane] = 0u;
    }
    var own: array<u32, 8>;
    for (var k = 0u; k < 8u; k++) {
        if (first + k < n) {
            own[k] = keys[first + k];
            let digit = (own[k] >> pass_.shift) & 15u;
            words[256u * (digit >> 1u) + lane] += 1u << (16u * (digit & 1u));
        }
    }
    scan_words(lane);
    for (var k = 0u; k < 8u; k++) {
        let i = first + k;
        if (i < n) {
            let digit = (own[k] >> pass_.shift) & 15u;
            let half = 16u * (digit & 1u);
            let word = 256u * (digit >> 1u) + lane;
            let rank = (words[word] >> half) & 0xffffu;
            words[word] += 1u << half;
            let bin = digit * blocks + block;
            let to = histogram[bin] + sums[bin / 1024u] + rank;
            keys_out[to] = own[k];
            if (pass_.identity != 0u) {
                values_out[to] = i;
            } else {
                values_out[to] = values[i];
            }
        }
    }
}
