// One workgroup of 32 threads a tile, one thread an entry: entries back to front in buckets of 32, pixels four at a time on a
// diagonal schedule, so that each pixel meets the entries in order. A thread sums its entry over the pixels in a fixed order
// and writes one record: no atomics, no reduction. (See gs_raster's `blend_backward.rs` for the equations.)

@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> entry_splats: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> transmittances: array<f32>;
@group(0) @binding(6) var<storage, read> lasts: array<u32>;
@group(0) @binding(7) var<storage, read> d_frame: array<f32>; // all rgb, then all alpha, then all depth

const LANES: u32 = 32u;
const STEPS: u32 = 64u; // blocks of 2×2 pixels; no fewer than lanes, so that buckets follow without a pause

// Pixel i of block q lies at 64 i + q.
var<workgroup> transmittance: array<f32, 256>;
var<workgroup> behind: array<f32, 256>;
var<workgroup> last: array<u32, 256>;
var<workgroup> d_color: array<vec4<f32>, 256>; // rgb and depth
var<workgroup> deepest: array<u32, LANES>;
var<workgroup> used: u32;

// Position in the tile of pixel i of block q.
fn position(q: u32, i: u32) -> vec2<u32> {
    return vec2(2u * (q & 7u) + (i & 1u), 2u * (q >> 3u) + (i >> 1u));
}

fn load_pixel(corner: vec2<u32>, slot: u32) -> u32 {
    let pixel = corner + position(slot & 63u, slot >> 6u);
    transmittance[slot] = 1.0;
    behind[slot] = 0.0;
    last[slot] = 0u;
    d_color[slot] = vec4(0.0, 0.0, 0.0, 0.0);
    if (pixel.x < view.sizes.x && pixel.y < view.sizes.y) {
        let at = pixel.y * view.sizes.x + pixel.x;
        let pixels = view.sizes.x * view.sizes.y;
        let d = vec3(d_frame[3u * at], d_frame[3u * at + 1u], d_frame[3u * at + 2u]);
        transmittance[slot] = transmittances[at];
        behind[slot] = transmittances[at] * (dot(view.background.xyz, d) - d_frame[3u * pixels + at]);
        last[slot] = lasts[at];
        d_color[slot] = vec4(d, d_frame[4u * pixels + at]);
    }
    return last[slot];
}

// What one pixel adds to the sums of the entry in `slot`, and what the entry does to the pixel's state.
fn pixel_backward(row: Row, slot: u32, at: u32, pixel: vec2<f32>, sums: ptr<function, Sums>) {
    if (slot >= last[at]) {
        return;
    }
    let e = whitened(row.a, row.b, pixel);
    let s = sample_at(row.b, row.profile, log2_raw(row.b, e));
    if (!s.visible) {
        return;
    }
    let alpha = min(s.raw, view.thresholds.z);
    let inverse = 1.0 / (1.0 - alpha);
    let t = transmittance[at] * inverse;
    let d = d_color[at];
    let light = dot(d, row.color);
    let d_alpha = t * light - behind[at] * inverse;
    let weight = t * alpha;
    transmittance[at] = t;
    behind[at] = fma(weight, light, behind[at]);
    let c = weight * d;
    (*sums).b.z += c.x;
    (*sums).b.w += c.y;
    (*sums).c.x += c.z;
    (*sums).c.y += c.w;
    if (s.raw > view.thresholds.z && view.flags.y == 0u) {
        return;
    }
    let d_ln_opacity = s.raw * d_alpha;
    var d_ln_g = d_ln_opacity;
    if (HAS_PROFILE) {
        let m = folded(row.profile, row.b.z, s.gaussian);
        let outer = m.z < abs(m.x);
        let signed_h = select(-m.y, m.y, m.x <= 0.0);
        d_ln_g = s.gaussian * select(1.0 + row.profile.x, row.profile.z, outer) * d_alpha;
        (*sums).c.z += select(0.0, signed_h * d_alpha, outer);
        (*sums).c.w += select(m.x * d_alpha, 0.0, outer);
    }
    let sa = d_ln_g * e.x;
    let sb = d_ln_g * e.y;
    (*sums).a += vec4(d_ln_opacity, sa, sb, sa * e.x);
    (*sums).b.x = fma(sa, e.y, (*sums).b.x);
    (*sums).b.y = fma(sb, e.y, (*sums).b.y);
}

fn empty() -> Sums {
    return Sums(vec4(0.0, 0.0, 0.0, 0.0), vec4(0.0, 0.0, 0.0, 0.0), vec4(0.0, 0.0, 0.0, 0.0));
}

@compute @workgroup_size(LANES)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let range = ranges[group.y * view.sizes.z + group.x];
    let corner = vec2(group.x * TILE, group.y * TILE);
    var own = 0u;
    for (var slot = lane; slot < 256u; slot += LANES) {
        own = max(own, load_pixel(corner, slot));
    }
    deepest[lane] = own;
    workgroupBarrier();
    if (lane == 0u) {
        for (var k = 1u; k < LANES; k++) {
            own = max(own, deepest[k]);
        }
        used = own;
    }
    let blended = workgroupUniformLoad(&used);
    for (var slot = blended + lane; slot < range.y - range.x; slot += LANES) {
        clear_record(order[range.x + slot]);
    }
    let buckets = (blended + LANES - 1u) / LANES;
    var row: Row;
    var slot = 0u;
    var entry = 0u;
    var active_row = false;
    var sums = empty();
    for (var bucket = 0u; bucket <= buckets; bucket++) {
        // The next entry of this thread, back to front; it takes over when the pixels of the last one are done.
        var next_row: Row;
        var next_slot = 0u;
        var next_entry = 0u;
        let depth = bucket * LANES + lane;
        let has_next = depth < blended;
        if (has_next) {
            next_slot = blended - 1u - depth;
            next_entry = order[range.x + next_slot];
            next_row = row_of(entry_splats[next_entry], vec2<f32>(corner));
        }
        // After the last bucket only what its later threads have left.
        let steps = select(STEPS, LANES, bucket == buckets);
        for (var step = 0u; step < steps; step++) {
            if (step == lane) {
                if (active_row) {
                    write_record(entry, entry_splats[entry], sums);
                }
                row = next_row;
                slot = next_slot;
                entry = next_entry;
                active_row = has_next;
                sums = empty();
            }
            if (active_row) {
                let block = (step - lane) & (STEPS - 1u);
                for (var i = 0u; i < 4u; i++) {
                    pixel_backward(row, slot, 64u * i + block, vec2<f32>(position(block, i)), &sums);
                }
            }
            workgroupBarrier();
        }
    }
}
