// One thread a splat, in depth order: the tiles its ellipse touches, in closed form (see gs_raster's `tiles.rs`). Run twice:
// first it counts, then it writes. It is one pipeline, so that both runs round alike.

@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> offsets: array<u32>;
@group(0) @binding(4) var<storage, read> sums: array<u32>;
@group(0) @binding(5) var<storage, read_write> entry_tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> entry_splats: array<u32>;
@group(0) @binding(7) var<storage, read_write> spans: array<vec2<u32>>; // first entry and number of entries, by row

const SLACK: f32 = 4e-6;
const MARGIN: f32 = 5e-3;

// First and one past the last of `side` pixels whose centre lies in [lo, hi].
fn pixels(lo: f32, hi: f32, side: u32) -> vec2<u32> {
    let start = max(ceil(lo - 0.5), 0.0);
    let end = min(floor(hi - 0.5), f32(side) - 1.0);
    return select(vec2(0u, 0u), vec2(u32(start), u32(max(end, 0.0)) + 1u), start <= end);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let rank = 256u * workgroup_index(group, groups) + lane;
    if (rank >= view.counts.x) {
        return;
    }
    let splat = order[rank];
    let at = STRIDE * splat;
    let support = projected[at + 3u].w;
    let writes = view.flags.w != 0u;
    var first = 0u;
    if (writes) {
        first = offsets[rank] + sums[rank / 1024u];
    }
    var count = 0u;
    if (support >= 0.0) {
        let center = projected[at];
        let w = projected[at + 1u].xyz;
        let radius = sqrt(support);
        let slope = w.y / w.z;
        let extreme = slope / sqrt(1.0 + slope * slope) * radius;
        let inv_w0 = 1.0 / w.x;
        let b0 = -w.z * center.y;
        let reach = abs(slope) * (abs(b0) + radius) + radius + abs(w.x * center.x + w.y * center.y);
        let margin = MARGIN + SLACK * reach * inv_w0;
        let slack = SLACK * (abs(b0) + radius) + MARGIN * w.z;
        let inv = 1.0 / w.z;
        let rows = pixels((-radius - b0 - slack) * inv, (radius - b0 + slack) * inv, view.sizes.y);
        for (var row = rows.x / TILE; row * TILE < rows.y; row++) {
            let y0 = f32(row * TILE) + 0.5;
            let y1 = f32(min(view.sizes.y, (row + 1u) * TILE)) - 0.5;
            let lo = max(b0 + w.z * y0 - slack, -radius);
            let hi = min(b0 + w.z * y1 + slack, radius);
            if (lo > hi) {
                continue;
            }
            let right_b = clamp(-extreme, lo, hi);
            let left_b = clamp(extreme, lo, hi);
            let left = (-sqrt(max(support - left_b * left_b, 0.0)) - slope * left_b) * inv_w0;
            let right = (sqrt(max(support - right_b * right_b, 0.0)) - slope * right_b) * inv_w0;
            let columns = pixels(center.x + left - margin, center.x + right + margin, view.sizes.x);
            for (var column = columns.x / TILE; column * TILE < columns.y; column++) {
                let entry = first + count;
                if (writes && entry < view.counts.y) {
                    entry_tiles[entry] = row * view.sizes.z + column;
                    entry_splats[entry] = splat;
                }
                count++;
            }
        }
    }
    if (writes) {
        spans[splat] = vec2(first, count);
    } else {
        offsets[rank] = count;
    }
}
