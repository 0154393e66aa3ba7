// A HexPlane at one time, as gs_deform::encode::hexplane states it: per point and four channels, the product of six samples.

struct Level {
    nodes: vec4<u32>,    // along x, y, z, t
    first: vec4<u32>,    // where the planes xy, xz, xt, yz begin, in vectors of four
    last: vec4<u32>,     // yt, zt
    per_unit: vec4<f32>, // nodes per world unit along x, y, z
}

struct Planes {
    points: u32,
    levels: u32,
    channels: u32,
    time_row: u32,     // first of the two rows of time around the timestamp
    low: vec4<f32>,    // corner of the box; weight of the second row of time
    spread: vec4<u32>, // bits left to one contribution (see planes_backward.wgsl), whether points learn
    all: array<Level, 8>,
}

@group(0) @binding(0) var<uniform> planes: Planes;
@group(0) @binding(1) var<storage, read> points: array<f32>;
@group(0) @binding(2) var<storage, read> texels: array<vec4<f32>>; // [channels / 16][nodes_b][nodes_a][16], plane after plane

// The two nodes around a position, and the weight of the second.
struct Cell {
    index: u32,
    weight: f32,
    slope: f32, // nodes per unit; 0 outside the box
}

// A sample of a plane and its slopes, per node.
struct Sample {
    value: vec4<f32>,
    along_a: vec4<f32>,
    along_b: vec4<f32>,
}

// Four channels of one point.
struct Task {
    level: u32,
    quad: u32, // of the level's channels
    x: Cell,
    y: Cell,
    z: Cell,
    t: Cell,
}

fn cell_of(offset: f32, per_unit: f32, nodes: u32) -> Cell {
    let last = f32(nodes - 1u);
    let free = offset * per_unit;
    let position = min(max(free, 0.0), last);
    var cell: Cell;
    cell.index = min(u32(position), nodes - 2u);
    cell.weight = position - f32(cell.index);
    cell.slope = select(0.0, per_unit, free > 0.0 && free < last);
    return cell;
}

// Vectors of four channels per point.
fn quads() -> u32 {
    return planes.levels * planes.channels / 4u;
}

fn task_of(index: u32) -> Task {
    let per_level = planes.channels / 4u;
    let i = index / quads();
    let q = index % quads();
    var task: Task;
    task.level = q / per_level;
    task.quad = q % per_level;
    let level = planes.all[task.level];
    task.x = cell_of(points[3u * i] - planes.low.x, level.per_unit.x, level.nodes.x);
    task.y = cell_of(points[3u * i + 1u] - planes.low.y, level.per_unit.y, level.nodes.y);
    task.z = cell_of(points[3u * i + 2u] - planes.low.z, level.per_unit.z, level.nodes.z);
    task.t.index = planes.time_row;
    task.t.weight = planes.low.w;
    return task;
}

// Where a texel of four channels stands; `a` and `b` are numbers of axes.
fn texel_at(task: Task, first: u32, a: u32, b: u32, index_a: u32, index_b: u32) -> u32 {
    let nodes = planes.all[task.level].nodes;
    return first + (((task.quad / 4u) * nodes[b] + index_b) * nodes[a] + index_a) * 4u + task.quad % 4u;
}

fn sample(task: Task, first: u32, a: u32, b: u32, cell_a: Cell, cell_b: Cell) -> Sample {
    let at = texel_at(task, first, a, b, cell_a.index, cell_b.index);
    let next = 4u * planes.all[task.level].nodes[a];
    let p00 = texels[at];
    let p01 = texels[at + next];
    let d0 = texels[at + 4u] - p00;
    let d1 = texels[at + next + 4u] - p01;
    let row0 = p00 + cell_a.weight * d0;
    let row1 = p01 + cell_a.weight * d1;
    var s: Sample;
    s.along_b = row1 - row0;
    s.value = row0 + cell_b.weight * s.along_b;
    s.along_a = d0 + cell_b.weight * (d1 - d0);
    return s;
}

// Samples of the planes xy, xz, xt, yz, yt, zt.
fn samples(task: Task) -> array<Sample, 6> {
    let level = planes.all[task.level];
    return array(
        sample(task, level.first.x, 0u, 1u, task.x, task.y),
        sample(task, level.first.y, 0u, 2u, task.x, task.z),
        sample(task, level.first.z, 0u, 3u, task.x, task.t),
        sample(task, level.first.w, 1u, 2u, task.y, task.z),
        sample(task, level.last.x, 1u, 3u, task.y, task.t),
        sample(task, level.last.y, 2u, 3u, task.z, task.t),
    );
}
