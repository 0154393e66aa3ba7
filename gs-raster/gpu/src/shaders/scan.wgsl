// Exclusive prefix sums of u32 in blocks of 1024. A reader adds the block's offset: values[i] + sums[i / 1024].

@group(0) @binding(0) var<storage, read_write> values: array<u32>;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;

var<workgroup> partial: array<u32, 256>;

// A sum that stays at the largest number: a frame of so many entries is refused.
fn add(a: u32, b: u32) -> u32 {
    let sum = a + b;
    return select(sum, 0xffffffffu, sum < a);
}

// Exclusive sum over the workgroup, and the total.
fn workgroup_scan(lane: u32, value: u32) -> vec2<u32> {
    partial[lane] = value;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var before = 0u;
        if (lane >= step) {
            before = partial[lane - step];
        }
        workgroupBarrier();
        partial[lane] = add(partial[lane], before);
        workgroupBarrier();
    }
    let result = vec2(partial[lane] - value, partial[255]);
    workgroupBarrier();
    return result;
}

// One workgroup a block.
@compute @workgroup_size(256)
fn blocks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = workgroup_index(group, groups);
    let first = block * 1024u + 4u * lane;
    let n = arrayLength(&values);
    var own: array<u32, 4>;
    var sum = 0u;
    for (var k = 0u; k < 4u; k++) {
        if (first + k < n) {
            own[k] = values[first + k];
        }
        sum = add(sum, own[k]);
    }
    let scanned = workgroup_scan(lane, sum);
    var before = scanned.x;
    for (var k = 0u; k < 4u; k++) {
        if (first + k < n) {
            values[first + k] = before;
        }
        before += own[k];
    }
    let last = arrayLength(&sums) - 1u;
    if (lane == 0u && block < last) {
        // A single block needs no second step.
        sums[block] = select(scanned.y, 0u, last == 1u);
        if (last == 1u) {
            sums[1] = scanned.y;
        }
    }
}

// One workgroup turns the sums of all blocks into offsets; the total goes behind the last. Not for a single block.
@compute @workgroup_size(256)
fn offsets(@builtin(local_invocation_index) lane: u32) {
    let n = arrayLength(&sums) - 1u;
    var carry = 0u;
    for (var first = 0u; first < n; first += 256u) {
        let i = first + lane;
        var own = 0u;
        if (i < n) {
            own = sums[i];
        }
        let scanned = workgroup_scan(lane, own);
        if (i < n) {
            sums[i] = carry + scanned.x;
        }
        carry = add(carry, scanned.y);
    }
    if (lane == 0u) {
        sums[n] = carry;
    }
}
