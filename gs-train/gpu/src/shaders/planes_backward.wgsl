// The gradient of the planes, summed over points in integers, so that their order does not matter, and that of the points. Two runs: the
// first finds the largest contribution to every plane, from which the second takes the unit of its sums:
//
//   v = (high 2^32 + low) / 2^(32 + scale)      of 64 bits, every contribution below 2^(spread - scale), spread = 30 - b, n <= 2^b points
//
// so that the sum does not overflow, and a contribution is rounded to 2^(b - 61) of the largest one. The two words are added apart, and
// what the low one carries to the high one: whole numbers modulo 2^64, in any order.

@group(0) @binding(3) var<storage, read> d_features: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> peaks: array<atomic<u32>>;    // [levels, 6]: bits of the largest contribution
@group(0) @binding(5) var<storage, read_write> sums: array<atomic<u32>>;     // [texels, 4, 2]: low and high
@group(0) @binding(6) var<storage, read_write> d_points: array<vec4<f32>>;   // [points, quads]

var<workgroup> peaks_here: array<atomic<u32>, 48>;

// Cotangents of the six samples: each is that of the feature times the other five.
fn cotangents(s: array<Sample, 6>, d: vec4<f32>) -> array<vec4<f32>, 6> {
    let first = s[0].value * s[1].value;
    let second = s[3].value * s[2].value;
    let third = s[4].value * s[5].value;
    let d_first = d * (second * third);
    let d_second = d * (first * third);
    let d_third = d * (first * second);
    return array(
        d_first * s[1].value,
        d_first * s[0].value,
        d_second * s[3].value,
        d_second * s[2].value,
        d_third * s[5].value,
        d_third * s[4].value,
    );
}

@compute @workgroup_size(256)
fn find_peaks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if (lane < 48u) {
        atomicStore(&peaks_here[lane], 0u);
    }
    workgroupBarrier();
    let index = 256u * workgroup_index(group, groups) + lane;
    if (index < planes.points * quads()) {
        let task = task_of(index);
        let d = cotangents(samples(task), d_features[index]);
        for (var p = 0u; p < 6u; p++) {
            // Of numbers that are not negative, the bits are in the order of the numbers; those of NaN are above all.
            let bits = bitcast<vec4<u32>>(d[p]) & vec4(0x7fffffffu, 0x7fffffffu, 0x7fffffffu, 0x7fffffffu);
            atomicMax(&peaks_here[6u * task.level + p], max(max(bits.x, bits.y), max(bits.z, bits.w)));
        }
    }
    workgroupBarrier();
    if (lane < 6u * planes.levels) {
        atomicMax(&peaks[lane], atomicLoad(&peaks_here[lane]));
    }
}

fn add(at: u32, v: vec4<f32>, unit: f32) {
    for (var k = 0u; k < 4u; k++) {
        let scaled = abs(v[k]) * unit;
        let whole = floor(scaled);
        var low = u32((scaled - whole) * 4294967296.0);
        var high = u32(whole);
        if (v[k] < 0.0) {
            high = ~high + select(0u, 1u, low == 0u);
            low = 0u - low;
        }
        if (low != 0u) {
            let before = atomicAdd(&sums[8u * at + 2u * k], low);
            high += select(0u, 1u, before + low < before);
        }
        if (high != 0u) {
            atomicAdd(&sums[8u * at + 2u * k + 1u], high);
        }
    }
}

fn scatter(task: Task, plane: u32, first: u32, a: u32, b: u32, cell_a: Cell, cell_b: Cell, d: vec4<f32>) {
    let unit = power_of_two(unit_exponent(atomicLoad(&peaks[6u * task.level + plane]), planes.spread.x));
    let at = texel_at(task, first, a, b, cell_a.index, cell_b.index);
    let next = 4u * planes.all[task.level].nodes[a];
    add(at, (1.0 - cell_a.weight) * (1.0 - cell_b.weight) * d, unit);
    add(at + 4u, cell_a.weight * (1.0 - cell_b.weight) * d, unit);
    add(at + next, (1.0 - cell_a.weight) * cell_b.weight * d, unit);
    add(at + next + 4u, cell_a.weight * cell_b.weight * d, unit);
}

fn total(v: vec4<f32>) -> f32 {
    return (v.x + v.y) + (v.z + v.w);
}

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
    let task = task_of(index);
    let level = planes.all[task.level];
    let s = samples(task);
    let d = cotangents(s, d_features[index]);
    scatter(task, 0u, level.first.x, 0u, 1u, task.x, task.y, d[0]);
    scatter(task, 1u, level.first.y, 0u, 2u, task.x, task.z, d[1]);
    scatter(task, 2u, level.first.z, 0u, 3u, task.x, task.t, d[2]);
    scatter(task, 3u, level.first.w, 1u, 2u, task.y, task.z, d[3]);
    scatter(task, 4u, level.last.x, 1u, 3u, task.y, task.t, d[4]);
    scatter(task, 5u, level.last.y, 2u, 3u, task.z, task.t, d[5]);
    if (planes.spread.y != 0u) {
        let dx = total(d[0] * s[0].along_a + d[1] * s[1].along_a + d[2] * s[2].along_a);
        let dy = total(d[0] * s[0].along_b + d[3] * s[3].along_a + d[4] * s[4].along_a);
        let dz = total(d[1] * s[1].along_b + d[3] * s[3].along_b + d[5] * s[5].along_a);
        d_points[index] = vec4(dx * task.x.slope, dy * task.y.slope, dz * task.z.slope, 0.0);
    }
}
