// One workgroup a tile, one thread a pixel: front-to-back blending (see gs_raster's `blend.rs`).

@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> entry_splats: array<u32>;
@group(0) @binding(4) var<storage, read> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> rgb_out: array<f32>;
@group(0) @binding(6) var<storage, read_write> depth_out: array<f32>;
@group(0) @binding(7) var<storage, read_write> transmittance_out: array<f32>;
@group(0) @binding(8) var<storage, read_write> last_out: array<u32>; // one past the slot last blended, from the tile's first

const BATCH: u32 = 128u;
const PROFILES: u32 = select(1u, BATCH, HAS_PROFILE);

var<workgroup> rows_a: array<vec4<f32>, BATCH>;
var<workgroup> rows_b: array<vec4<f32>, BATCH>;
var<workgroup> colors: array<vec4<f32>, BATCH>;
var<workgroup> profiles: array<vec4<f32>, PROFILES>;
var<workgroup> open_votes: atomic<u32>;
var<workgroup> any_open: u32;

@compute @workgroup_size(16, 16)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let range = ranges[group.y * view.sizes.z + group.x];
    let corner = vec2(group.x * TILE, group.y * TILE);
    let pixel = corner + local.xy;
    let inside = pixel.x < view.sizes.x && pixel.y < view.sizes.y;
    let offset = vec2<f32>(local.xy);
    var open = inside;
    var transmittance = 1.0;
    var sum = vec4(0.0, 0.0, 0.0, 0.0); // colour and depth
    var last = 0u;
    for (var first = range.x; first < range.y; first += BATCH) {
        let n = min(BATCH, range.y - first);
        if (lane < n) {
            let row = row_of(entry_splats[order[first + lane]], vec2<f32>(corner));
            rows_a[lane] = row.a;
            rows_b[lane] = row.b;
            colors[lane] = row.color;
            if (HAS_PROFILE) {
                profiles[lane] = row.profile;
            }
        }
        if (lane == 0u) {
            atomicStore(&open_votes, 0u);
        }
        workgroupBarrier();
        for (var i = 0u; i < n && open; i++) {
            let b = rows_b[i];
            var profile = vec4(0.0, 0.0, 0.0, 0.0);
            if (HAS_PROFILE) {
                profile = profiles[i];
            }
            let s = sample_at(b, profile, log2_raw(b, whitened(rows_a[i], b, offset)));
            if (s.visible) {
                let alpha = min(s.raw, view.thresholds.z);
                let next = fma(-alpha, transmittance, transmittance);
                if (next <= view.thresholds.w) {
                    open = false;
                } else {
                    let weight = transmittance * alpha;
                    sum = fma(vec4(weight), colors[i], sum);
                    transmittance = next;
                    last = first + i + 1u - range.x;
                }
            }
        }
        if (open) {
            atomicOr(&open_votes, 1u);
        }
        workgroupBarrier();
        if (lane == 0u) {
            any_open = atomicLoad(&open_votes);
        }
        if (workgroupUniformLoad(&any_open) == 0u) {
            break;
        }
    }
    if (inside) {
        let at = pixel.y * view.sizes.x + pixel.x;
        let over = fma(vec3(transmittance), view.background.xyz, sum.xyz);
        rgb_out[3u * at] = over.x;
        rgb_out[3u * at + 1u] = over.y;
        rgb_out[3u * at + 2u] = over.z;
        depth_out[at] = sum.w;
        transmittance_out[at] = transmittance;
        last_out[at] = last;
    }
}
