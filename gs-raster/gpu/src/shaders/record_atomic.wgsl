// Where the sums of an entry go: onto the splat's, in whatever order the device takes. Two runs differ.

struct Sums {
    a: vec4<f32>, // o, s a, s b, s aa
    b: vec4<f32>, // s ab, s bb, r, g
    c: vec4<f32>, // b, depth, two of the kernel's parameters
}

@group(0) @binding(8) var<storage, read_write> totals: array<atomic<f32>>; // twelve a splat

fn add4(at: u32, v: vec4<f32>) {
    atomicAdd(&totals[at], v.x);
    atomicAdd(&totals[at + 1u], v.y);
    atomicAdd(&totals[at + 2u], v.z);
    atomicAdd(&totals[at + 3u], v.w);
}

fn write_record(entry: u32, splat: u32, sums: Sums) {
    add4(12u * splat, sums.a);
    add4(12u * splat + 4u, sums.b);
    add4(12u * splat + 8u, sums.c);
}

fn clear_record(entry: u32) {}
