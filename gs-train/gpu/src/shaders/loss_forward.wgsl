// One workgroup a tile of one channel, one thread a pixel: local means and variances of s = x + y and d = x - y, with zeros outside,
//
//   ssim = (1 - mean_d^2 / B1) (1 - var_d / B2)    B1 = (mean_s^2 + mean_d^2) / 2 + C1    B2 = (var_s + var_d) / 2 + C2
//
// (see gs_metrics::ssim), and what the gradient needs of them: those with respect to the variances, and to the means at fixed E[s^2], E[d^2].

@group(0) @binding(3) var<storage, read_write> maps: array<f32>;          // [3, 3, H, W]: channel; means, var_s, var_d
@group(0) @binding(4) var<storage, read_write> partials: array<vec4<f32>>; // per workgroup: sums of ssim, |x - y|, (x - y)^2

var<workgroup> pairs: array<vec2<f32>, 676>;   // s - shift, d, over the tile and its margin
var<workgroup> moments: array<vec4<f32>, 416>; // rows of the tile and its margin: s, s^2, d, d^2 under the horizontal window
var<workgroup> tree: array<vec4<f32>, 256>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let channel = group.y / loss.rows;
    let corner = SIDE * vec2(group.x, group.y % loss.rows);
    // Variances do not depend on where s is counted from; near its values in this tile less is lost to rounding.
    let middle = min(corner + vec2(8u, 8u), vec2(loss.width - 1u, loss.height - 1u));
    let shift = 2.0 * truth_at(middle.y * loss.width + middle.x, channel);
    for (var e = lane; e < WIDE * WIDE; e += 256u) {
        let x = corner.x + e % WIDE;
        let y = corner.y + e / WIDE;
        var pair = vec2(-shift, 0.0);
        if (x >= RADIUS && y >= RADIUS && x < loss.width + RADIUS && y < loss.height + RADIUS) {
            let pixel = (y - RADIUS) * loss.width + x - RADIUS;
            let rendered = frame[3u * pixel + channel];
            let wanted = truth_at(pixel, channel);
            pair = vec2(rendered + wanted - shift, rendered - wanted);
        }
        pairs[e] = pair;
    }
    workgroupBarrier();
    for (var e = lane; e < WIDE * SIDE; e += 256u) {
        let at = (e / SIDE) * WIDE + e % SIDE;
        var sum = vec4(0.0, 0.0, 0.0, 0.0);
        for (var k = 0u; k <= 2u * RADIUS; k++) {
            let p = pairs[at + k];
            sum += weight(k) * vec4(p.x, p.x * p.x, p.y, p.y * p.y);
        }
        moments[e] = sum;
    }
    workgroupBarrier();
    let x = corner.x + lane % SIDE;
    let y = corner.y + lane / SIDE;
    var value = vec4(0.0, 0.0, 0.0, 0.0);
    if (x < loss.width && y < loss.height) {
        var m = vec4(0.0, 0.0, 0.0, 0.0);
        for (var k = 0u; k <= 2u * RADIUS; k++) {
            m += weight(k) * moments[lane + SIDE * k];
        }
        let mean_s = m.x + shift;
        let mean_d = m.z;
        let var_s = max(m.y - m.x * m.x, 0.0);
        let var_d = max(m.w - m.z * m.z, 0.0);
        let b1 = 0.5 * (mean_s * mean_s + mean_d * mean_d) + C1;
        let b2 = 0.5 * (var_s + var_d) + C2;
        let first = 1.0 - mean_d * mean_d / b1;
        let second = 1.0 - var_d / b2;
        let d_mean_s = second * (mean_d / b1) * (mean_d / b1) * mean_s;
        let d_mean_d = second * (mean_d / b1) * (mean_d * mean_d / b1 - 2.0);
        let d_var_s = first * 0.5 * var_d / (b2 * b2);
        let d_var_d = first * (0.5 * var_d / b2 - 1.0) / b2;
        let pixels = loss.width * loss.height;
        let at = 3u * channel * pixels + y * loss.width + x;
        maps[at] = d_mean_s + d_mean_d - 2.0 * (d_var_s * mean_s + d_var_d * mean_d);
        maps[at + pixels] = d_var_s;
        maps[at + 2u * pixels] = d_var_d;
        let d = pairs[(lane / SIDE + RADIUS) * WIDE + lane % SIDE + RADIUS].y;
        value = vec4(first * second, abs(d), d * d, 0.0);
    }
    tree[lane] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (lane < half) {
            tree[lane] += tree[lane + half];
        }
        workgroupBarrier();
    }
    if (lane == 0u) {
        partials[group.y * loss.columns + group.x] = tree[0];
    }
}
