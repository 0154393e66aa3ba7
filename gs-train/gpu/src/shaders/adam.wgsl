// One thread a value: Adam, as gs_train::adam states it. Each workgroup lies within one block. A value with a gradient that is not
// finite is left alone, and its row is counted (the host leaves all of the row). A frame that did not fit changes nothing.

struct Block {
    rate: f32,    // lr / (1 - beta1^t)
    root: f32,    // 1 / sqrt(1 - beta2^t)
    eps: f32,
    keep: f32,    // 1 - lr weight_decay
    end: u32,     // its last value, plus one
    learns: u32,
    start: u32,   // its first value
    width: u32,   // of a row
}

struct Adam {
    beta1: f32,
    beta2: f32,
    entries: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> adam: Adam;
@group(0) @binding(1) var<storage, read> blocks: array<Block>;
@group(0) @binding(2) var<storage, read> owners: array<u32>; // block of each workgroup
@group(0) @binding(3) var<storage, read> totals: array<u32>;
@group(0) @binding(4) var<storage, read> grads: array<f32>;
@group(0) @binding(5) var<storage, read_write> values: array<f32>;
@group(0) @binding(6) var<storage, read_write> moments: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read_write> counters: array<atomic<u32>>; // behind the first: of each block, rows and the first

// From the bits: compilers may assume that every number is finite.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = workgroup_index(group, groups);
    if (index >= arrayLength(&owners)) {
        return;
    }
    let block = blocks[owners[index]];
    let at = 256u * index + lane;
    if (block.learns == 0u || at >= block.end || totals[arrayLength(&totals) - 1u] > adam.entries) {
        return;
    }
    let g = grads[at];
    if (!is_finite(g * g)) {
        // A row is counted by the first such value in it; rows backwards, so that the largest number is the first row.
        let row = (at - block.start) / block.width;
        for (var k = block.start + row * block.width; k < at; k++) {
            if (!is_finite(grads[k] * grads[k])) {
                return;
            }
        }
        let counter = 1u + 2u * owners[index];
        atomicAdd(&counters[counter], 1u);
        atomicMax(&counters[counter + 1u], 0xffffffffu - row);
        return;
    }
    let m = adam.beta1 * moments[at].x + (1.0 - adam.beta1) * g;
    let v = adam.beta2 * moments[at].y + (1.0 - adam.beta2) * (g * g);
    moments[at] = vec2(m, v);
    values[at] = values[at] * block.keep - block.rate * m / (sqrt(v) * block.root + block.eps);
}
