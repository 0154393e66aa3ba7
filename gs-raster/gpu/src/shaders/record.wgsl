// Where the sums of an entry go: a record of its own.

struct Sums {
    a: vec4<f32>, // o, s a, s b, s aa
    b: vec4<f32>, // s ab, s bb, r, g
    c: vec4<f32>, // b, depth, two of the kernel's parameters
}

@group(0) @binding(8) var<storage, read_write> records: array<vec4<f32>>; // three an entry, in the order of listing

fn write_record(entry: u32, splat: u32, sums: Sums) {
    records[3u * entry] = sums.a;
    records[3u * entry + 1u] = sums.b;
    records[3u * entry + 2u] = sums.c;
}

fn clear_record(entry: u32) {
    records[3u * entry] = vec4(0.0, 0.0, 0.0, 0.0);
    records[3u * entry + 1u] = vec4(0.0, 0.0, 0.0, 0.0);
    records[3u * entry + 2u] = vec4(0.0, 0.0, 0.0, 0.0);
}
