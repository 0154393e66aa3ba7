// One thread a value: the gradient of columns of a layer's weight, and of its bias, summed over the chunks of rows, in order.

struct Sum {
    outputs: u32,
    inputs: u32,  // columns
    chunks: u32,
    first: u32,   // the first of the columns
    stride: u32,  // columns of the whole weight
    bias: u32,    // 1: the bias comes behind the columns
    unused_0: u32,
    unused_1: u32,
}

@group(0) @binding(0) var<uniform> sizes: Sum;
@group(0) @binding(1) var<storage, read> parts: array<f32>; // [chunks, outputs, inputs + bias]
@group(0) @binding(2) var<storage, read_write> d_weight: array<f32>;
@group(0) @binding(3) var<storage, read_write> d_bias: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let at = 256u * workgroup_index(group, groups) + lane;
    let width = sizes.inputs + sizes.bias;
    let size = sizes.outputs * width;
    if (at >= size) {
        return;
    }
    var sum = 0.0;
    for (var chunk = 0u; chunk < sizes.chunks; chunk++) {
        sum += parts[chunk * size + at];
    }
    let o = at / width;
    let i = at % width;
    if (i == sizes.inputs) {
        d_bias[o] = sum;
    } else {
        d_weight[sizes.stride * o + sizes.first + i] = sum;
    }
}
