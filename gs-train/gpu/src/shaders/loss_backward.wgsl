// One workgroup a tile of one channel, one thread a pixel: the cotangent of the frame,
//
//   dL/dx = l1 sign(x - y) - dssim (w * M + 2 s (w * V_s) + 2 d (w * V_d))
//
// with the maps of the forward kernel under the window w, and zero for alpha and depth.

@group(0) @binding(3) var<storage, read> maps: array<f32>;
@group(0) @binding(4) var<storage, read_write> d_frame: array<f32>; // [H, W, 3], then [H, W] of alpha and of depth

// The three maps over the tile and its margin, and under the horizontal window.
var<workgroup> wide: array<array<f32, 3>, 676>;
var<workgroup> rows: array<array<f32, 3>, 416>;

fn vector(v: array<f32, 3>) -> vec3<f32> {
    return vec3(v[0], v[1], v[2]);
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let channel = group.y / loss.rows;
    let corner = SIDE * vec2(group.x, group.y % loss.rows);
    let pixels = loss.width * loss.height;
    for (var e = lane; e < WIDE * WIDE; e += 256u) {
        let x = corner.x + e % WIDE;
        let y = corner.y + e / WIDE;
        var map = array(0.0, 0.0, 0.0);
        if (x >= RADIUS && y >= RADIUS && x < loss.width + RADIUS && y < loss.height + RADIUS) {
            let at = 3u * channel * pixels + (y - RADIUS) * loss.width + x - RADIUS;
            map = array(maps[at], maps[at + pixels], maps[at + 2u * pixels]);
        }
        wide[e] = map;
    }
    workgroupBarrier();
    for (var e = lane; e < WIDE * SIDE; e += 256u) {
        let at = (e / SIDE) * WIDE + e % SIDE;
        var sum = vec3(0.0, 0.0, 0.0);
        for (var k = 0u; k <= 2u * RADIUS; k++) {
            sum += weight(k) * vector(wide[at + k]);
        }
        rows[e] = array(sum.x, sum.y, sum.z);
    }
    workgroupBarrier();
    let x = corner.x + lane % SIDE;
    let y = corner.y + lane / SIDE;
    if (x >= loss.width || y >= loss.height) {
        return;
    }
    var sum = vec3(0.0, 0.0, 0.0);
    for (var k = 0u; k <= 2u * RADIUS; k++) {
        sum += weight(k) * vector(rows[lane + SIDE * k]);
    }
    let pixel = y * loss.width + x;
    let rendered = frame[3u * pixel + channel];
    let wanted = truth_at(pixel, channel);
    let d = rendered - wanted;
    let d_ssim = sum.x + 2.0 * ((rendered + wanted) * sum.y + d * sum.z);
    d_frame[3u * pixel + channel] = loss.l1 * sign(d) - select(0.0, loss.dssim * d_ssim, loss.dssim > 0.0);
    if (channel == 0u) {
        d_frame[3u * pixels + pixel] = 0.0;
        d_frame[4u * pixels + pixel] = 0.0;
    }
}
