// Projection of one splat in double precision, as `gs_raster::reference` states it. The screen ellipse is a whitening
// W = [[w0, w1], [0, w2]] with a = w0 dx + w1 dy, b = w2 dy and Mahalanobis distance a² + b².

struct Geometry {
    ok: bool,
    point: array<vec2<f32>, 3>,              // mean in camera space
    center: array<vec2<f32>, 2>,             // pixels
    whitening: array<vec2<f32>, 3>,
    clamped: array<vec2<f32>, 2>,            // x/z, y/z within the bounds
    unclamped: vec2<f32>,                    // 1 where the clamp changed nothing
    inv_z: vec2<f32>,
    unit: array<vec2<f32>, 4>,               // quaternion (w, x, y, z)
    inv_norm: f32,
    quat_free: f32,                          // 1 where the length of the quaternion has a gradient
    axes: array<array<vec2<f32>, 3>, 3>,     // R_v R, rows
    unscaled: array<array<vec2<f32>, 3>, 2>, // J R_v R, rows
    factor: array<array<vec2<f32>, 3>, 2>,   // J R_v R diag(s), rows
    cross: array<vec2<f32>, 3>,              // of the rows of the factor
    covariance: vec3<f32>,                   // dilated: xx, xy, yy
    trace: f32,                              // before dilation
    det0: f32,                               // before dilation
    det: f32,
    compensation: f32,
}

fn view_rotation(r: u32, k: u32) -> vec2<f32> {
    return vec2(view.rotation_h[r][k], view.rotation_l[r][k]);
}

fn in_camera(mean: vec3<f32>, r: u32) -> vec2<f32> {
    let t = vec2(view.rotation_h[r].w, view.rotation_l[r].w);
    let xy = d_add(d_mul_f(view_rotation(r, 0u), mean.x), d_mul_f(view_rotation(r, 1u), mean.y));
    return d_add(d_add(t, xy), d_mul_f(view_rotation(r, 2u), mean.z));
}

// The power of two at or below |x|; 1 for zero.
fn power_below(x: f32) -> f32 {
    let bits = bitcast<u32>(x) & 0x7f800000u;
    return select(bitcast<f32>(bits), 1.0, bits == 0u);
}

fn normalise(g: ptr<function, Geometry>, raw: vec4<f32>) {
    let big = max(max(abs(raw.x), abs(raw.y)), max(abs(raw.z), abs(raw.w)));
    let scale = power_below(big);
    let q = raw / scale;
    let wx = d_add(two_prod(q.x, q.x), two_prod(q.y, q.y));
    let norm = d_sqrt(d_add(wx, d_add(two_prod(q.z, q.z), two_prod(q.w, q.w))));
    (*g).quat_free = select(0.0, 1.0, norm.x * scale > 1e-12);
    let floor = max(norm.x, 1e-12 / scale);
    let divisor = select(d_from(floor), norm, (*g).quat_free > 0.0);
    let inverse = d_div(d_from(1.0), divisor);
    (*g).unit = array(d_mul_f(inverse, q.x), d_mul_f(inverse, q.y), d_mul_f(inverse, q.z), d_mul_f(inverse, q.w));
    (*g).inv_norm = 1.0 / (divisor.x * scale);
}

// 1 − 2 (aa + bb).
fn diagonal(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return d_sub(d_from(1.0), 2.0 * d_add(d_mul(a, a), d_mul(b, b)));
}

fn rotation_of(u: array<vec2<f32>, 4>) -> array<array<vec2<f32>, 3>, 3> {
    let w = u[0];
    let x = u[1];
    let y = u[2];
    let z = u[3];
    let xy = d_mul(x, y);
    let xz = d_mul(x, z);
    let yz = d_mul(y, z);
    let wx = d_mul(w, x);
    let wy = d_mul(w, y);
    let wz = d_mul(w, z);
    var m: array<array<vec2<f32>, 3>, 3>;
    m[0] = array(diagonal(y, z), 2.0 * d_sub(xy, wz), 2.0 * d_add(xz, wy));
    m[1] = array(2.0 * d_add(xy, wz), diagonal(x, z), 2.0 * d_sub(yz, wx));
    m[2] = array(2.0 * d_sub(xz, wy), 2.0 * d_add(yz, wx), diagonal(x, y));
    return m;
}

fn clamp_ratio(g: ptr<function, Geometry>, axis: u32) {
    let low = vec2(view.limits_h[2u * axis], view.limits_l[2u * axis]);
    let high = vec2(view.limits_h[2u * axis + 1u], view.limits_l[2u * axis + 1u]);
    let ratio = d_mul((*g).point[axis], (*g).inv_z);
    let focal = vec2(view.focal[axis], view.focal[axis + 2u]);
    (*g).center[axis] = d_add(d_mul(focal, ratio), vec2(view.center[axis], view.center[axis + 2u]));
    (*g).clamped[axis] = ratio;
    (*g).unclamped[axis] = 1.0;
    if (d_less(ratio, low)) {
        (*g).clamped[axis] = low;
        (*g).unclamped[axis] = 0.0;
    } else if (d_less(high, ratio)) {
        (*g).clamped[axis] = high;
        (*g).unclamped[axis] = 0.0;
    }
}

// Row r of R_v times the splat's rotation.
fn turned(own: array<array<vec2<f32>, 3>, 3>, r: u32) -> array<vec2<f32>, 3> {
    let a = view_rotation(r, 0u);
    let b = view_rotation(r, 1u);
    let c = view_rotation(r, 2u);
    return array(
        d_add(d_add(d_mul(a, own[0][0]), d_mul(b, own[1][0])), d_mul(c, own[2][0])),
        d_add(d_add(d_mul(a, own[0][1]), d_mul(b, own[1][1])), d_mul(c, own[2][1])),
        d_add(d_add(d_mul(a, own[0][2]), d_mul(b, own[1][2])), d_mul(c, own[2][2])),
    );
}

// One entry of J R_v R: j (axis − clamped · forward).
fn unscaled_entry(j: vec2<f32>, axis: vec2<f32>, clamped: vec2<f32>, forward: vec2<f32>) -> vec2<f32> {
    return d_mul(j, d_sub(axis, d_mul(clamped, forward)));
}

fn factor_row(g: ptr<function, Geometry>, r: u32, scale: vec3<f32>) {
    let j = d_mul(vec2(view.focal[r], view.focal[r + 2u]), (*g).inv_z);
    let axis = (*g).axes[r];
    let forward = (*g).axes[2];
    let c = (*g).clamped[r];
    let row = array(
        unscaled_entry(j, axis[0], c, forward[0]),
        unscaled_entry(j, axis[1], c, forward[1]),
        unscaled_entry(j, axis[2], c, forward[2]),
    );
    (*g).unscaled[r] = row;
    (*g).factor[r] = array(d_mul_f(row[0], scale.x), d_mul_f(row[1], scale.y), d_mul_f(row[2], scale.z));
}

// Whether a number is finite, from its bits: compilers may assume that every number is.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn whiten(g: ptr<function, Geometry>) {
    let f = (*g).factor;
    let dilation = d_from(view.range.z);
    let xx0 = d_dot(f[0], f[0]);
    let xy = d_dot(f[0], f[1]);
    let yy0 = d_dot(f[1], f[1]);
    (*g).cross = array(
        d_sub(d_mul(f[0][1], f[1][2]), d_mul(f[0][2], f[1][1])),
        d_sub(d_mul(f[0][2], f[1][0]), d_mul(f[0][0], f[1][2])),
        d_sub(d_mul(f[0][0], f[1][1]), d_mul(f[0][1], f[1][0])),
    );
    let det0 = d_dot((*g).cross, (*g).cross);
    let trace = d_add(xx0, yy0);
    let det = d_add(det0, d_mul(dilation, d_add(trace, dilation)));
    let yy = d_add(yy0, dilation);
    (*g).ok = is_finite(det.x) && det.x > 0.0 && is_finite(yy.x);
    let along = d_sqrt(d_div(yy, det));
    (*g).whitening[0] = along;
    (*g).whitening[1] = -d_mul(d_div(xy, yy), along);
    (*g).whitening[2] = d_div(d_from(1.0), d_sqrt(yy));
    (*g).covariance = vec3(xx0.x + dilation.x, xy.x, yy.x);
    (*g).trace = trace.x;
    (*g).det0 = det0.x;
    (*g).det = det.x;
    (*g).compensation = 1.0;
    if (view.flags.x != 0u) {
        (*g).compensation = sqrt(max(det0.x / det.x, MIN_COMPENSATION * MIN_COMPENSATION));
    }
}

// The splat must lie in front of the camera.
fn project_splat(mean: vec3<f32>, quat: vec4<f32>, scale: vec3<f32>) -> Geometry {
    var g: Geometry;
    g.point = array(in_camera(mean, 0u), in_camera(mean, 1u), in_camera(mean, 2u));
    g.inv_z = d_div(d_from(1.0), g.point[2]);
    clamp_ratio(&g, 0u);
    clamp_ratio(&g, 1u);
    normalise(&g, quat);
    let own = rotation_of(g.unit);
    g.axes = array(turned(own, 0u), turned(own, 1u), turned(own, 2u));
    factor_row(&g, 0u, scale);
    factor_row(&g, 1u, scale);
    whiten(&g);
    return g;
}
