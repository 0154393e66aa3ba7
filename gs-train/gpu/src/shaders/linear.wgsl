// C = A B, in tiles of 64 x 64: one workgroup a tile, four rows of four values a thread. Matrices are given by their strides, so the same
// kernel serves a layer forward and backward. With several chunks of the inner dimension each gives its own C.

struct Product {
    rows: u32,      // of A and C
    inner: u32,
    columns: u32,   // of C, and of B but for `ones`
    chunk: u32,     // inner values of a chunk
    a_at: u32,      // A[m, k] stands at a_at + a_row m + a_column k
    a_row: u32,
    a_column: u32,
    b_row: u32,     // B[k, n] at b_at + b_row k + b_column n
    b_column: u32,
    b_at: u32,
    c_at: u32,      // C[m, n] at c_at + c_row m + n
    c_row: u32,
    after: u32,     // what is done to the product: see below
    extra_at: u32,  // where the bias begins; the mask is laid out as C and begins here
    ones: u32,      // 1: the last column of B is all ones
    leak: f32,      // slope of a rectifier below zero
}

@group(0) @binding(0) var<uniform> product: Product;
@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read> b: array<f32>;
@group(0) @binding(3) var<storage, read> extra: array<f32>;
@group(0) @binding(4) var<storage, read_write> c: array<f32>;

const ADD: u32 = 1u;     // added to what C holds
const BIAS: u32 = 2u;    // then a bias is added
const RECTIFY: u32 = 4u; // then values below zero are multiplied by the leak
const MASK: u32 = 8u;    // then values where the mask is not above zero are

const TILE: u32 = 64u;
const DEPTH: u32 = 16u;

var<workgroup> tile_a: array<f32, 1024>; // [DEPTH, TILE]
var<workgroup> tile_b: array<f32, 1024>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let p = product;
    let index = workgroup_index(group, groups);
    let tiles = (p.columns + TILE - 1u) / TILE;
    let all = tiles * ((p.rows + TILE - 1u) / TILE);
    let chunk = index / all;
    let m0 = TILE * ((index % all) / tiles);
    let n0 = TILE * (index % tiles);
    let begin = chunk * p.chunk;
    if (chunk > 0u && begin >= p.inner) {
        return;
    }
    let end = min(begin + p.chunk, p.inner);
    let given = p.columns - p.ones;
    let row = lane / 16u;
    let column = lane % 16u;
    var sum: array<vec4<f32>, 4>;
    for (var k0 = begin; k0 < end; k0 += DEPTH) {
        for (var e = lane; e < TILE * DEPTH; e += 256u) {
            // Neighbouring threads read what lies side by side.
            let inner_first = p.a_column == 1u;
            let ka = select(e / TILE, e % DEPTH, inner_first);
            let ma = select(e % TILE, e / DEPTH, inner_first);
            var value = 0.0;
            if (m0 + ma < p.rows && k0 + ka < end) {
                value = a[p.a_at + p.a_row * (m0 + ma) + p.a_column * (k0 + ka)];
            }
            tile_a[TILE * ka + ma] = value;
            let inner_of_b = p.b_row == 1u;
            let kb = select(e / TILE, e % DEPTH, inner_of_b);
            let nb = select(e % TILE, e / DEPTH, inner_of_b);
            value = 0.0;
            if (k0 + kb < end) {
                if (n0 + nb < given) {
                    value = b[p.b_at + p.b_row * (k0 + kb) + p.b_column * (n0 + nb)];
                } else if (n0 + nb < p.columns) {
                    value = 1.0;
                }
            }
            tile_b[TILE * kb + nb] = value;
        }
        workgroupBarrier();
        for (var k = 0u; k < DEPTH; k++) {
            let at = TILE * k + 4u * column;
            let values = vec4(tile_b[at], tile_b[at + 1u], tile_b[at + 2u], tile_b[at + 3u]);
            for (var r = 0u; r < 4u; r++) {
                sum[r] += tile_a[TILE * k + 4u * row + r] * values;
            }
        }
        workgroupBarrier();
    }
    for (var r = 0u; r < 4u; r++) {
        let m = m0 + 4u * row + r;
        if (m >= p.rows) {
            break;
        }
        for (var s = 0u; s < 4u; s++) {
            let n = n0 + 4u * column + s;
            if (n >= p.columns) {
                break;
            }
            let at = p.c_row * m + n;
            var value = sum[r][s];
            let place = p.c_at + chunk * p.rows * p.columns + at;
            if ((p.after & ADD) != 0u) {
                value += c[place];
            }
            if ((p.after & BIAS) != 0u) {
                value += extra[p.extra_at + n];
            }
            if ((p.after & RECTIFY) != 0u) {
                value = max(value, p.leak * value);
            }
            if ((p.after & MASK) != 0u && extra[p.extra_at + at] <= 0.0) {
                value *= p.leak;
            }
            c[place] = value;
        }
    }
}
