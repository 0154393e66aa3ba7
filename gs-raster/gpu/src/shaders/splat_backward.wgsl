// From a splat's sums over pixels to the gradients of its mean, quaternion, scale and opacity, for whoever writes or adds them.
// With the whitening W, its transpose Wᵀ and M = Σ s e eᵀ, the cotangent of the factor is d_F = Wᵀ M (W F): W F is of order
// one, so nothing cancels.

@group(0) @binding(1) var<storage, read> means: array<f32>;
@group(0) @binding(2) var<storage, read> quats: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> scales: array<f32>;
@group(0) @binding(4) var<storage, read> opacities: array<f32>;
@group(0) @binding(5) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read> sums: array<vec4<f32>>;

struct SplatGrad {
    mean: vec3<f32>,    // without the path through the view direction
    opacity: f32,
    quat: vec4<f32>,
    scale: vec3<f32>,
    radius: f32,
    mean2d: vec2<f32>,
    kernel: vec2<f32>,
    point: vec3<f32>,   // of the mean in camera space
    axes: Axes,         // of the axes in camera space, and of the Jacobian
    geometry: Geometry,
}

// W times a column.
fn whitened_column(g: Geometry, top: vec2<f32>, bottom: vec2<f32>) -> vec2<f32> {
    let a = d_add(d_mul(g.whitening[0], top), d_mul(g.whitening[1], bottom));
    return vec2(a.x, d_mul(g.whitening[2], bottom).x);
}

// What the three columns of the factor add up to.
struct Axes {
    d_axes: mat3x3<f32>, // column k: cotangent of the k-th axis in camera space
    d_scale: vec3<f32>,
    d_focal: vec2<f32>,
    d_slope: vec2<f32>,
}

// Constants of a splat's backward.
struct Pull {
    second: vec3<f32>,     // Σ s aa, Σ s ab, Σ s bb
    w: vec3<f32>,          // whitening
    j: vec2<f32>,          // focal lengths over depth
    clamped: vec2<f32>,
    // Anti-aliasing, ln comp = ½ (ln |Σ2| − ln |Σ'|): factors of adj(Σ2) F and of F.
    comp_adjugate: f32,
    comp_factor: f32,
}

// Column k of the factor. adj(Σ2) F has the rows f1 × c and c × f0 with c = f0 × f1; `next` and `after` are the columns
// that follow k in the circle.
fn pull_column(g: Geometry, pull: Pull, scale: f32, k: u32, next: u32, after: u32, out: ptr<function, Axes>) {
    let f = g.factor;
    let wf = whitened_column(g, f[0][k], f[1][k]);
    let m = vec2(dot(pull.second.xy, wf), dot(pull.second.yz, wf));
    let unscaled = vec2(g.unscaled[0][k].x, g.unscaled[1][k].x);
    var d_scale = dot(whitened_column(g, g.unscaled[0][k], g.unscaled[1][k]), m);
    var d_f = vec2(pull.w.x * m.x, pull.w.y * m.x + pull.w.z * m.y);
    if (pull.comp_factor != 0.0) {
        let adjugate = vec2(
            f[1][next].x * g.cross[after].x - f[1][after].x * g.cross[next].x,
            g.cross[next].x * f[0][after].x - g.cross[after].x * f[0][next].x,
        );
        let d_comp = adjugate * pull.comp_adjugate - pull.comp_factor * vec2(f[0][k].x, f[1][k].x);
        d_f += d_comp;
        d_scale += dot(d_comp, unscaled);
    }
    let d_jw = d_f * scale;
    (*out).d_scale[k] = d_scale;
    (*out).d_axes[k] = vec3(pull.j * d_jw, -dot(pull.j * pull.clamped, d_jw));
    (*out).d_focal += d_jw * vec2(g.axes[0][k].x, g.axes[1][k].x);
    (*out).d_slope += d_jw * g.axes[2][k].x;
}

// Cotangents of the quaternion from those of the rotation matrix.
fn quat_backward(g: Geometry, d: mat3x3<f32>) -> vec4<f32> {
    // d[c][r] is the cotangent of row r, column c.
    let u = vec4(g.unit[0].x, g.unit[1].x, g.unit[2].x, g.unit[3].x);
    let s01 = d[1][0] + d[0][1];
    let s02 = d[2][0] + d[0][2];
    let s12 = d[2][1] + d[1][2];
    let a10 = d[0][1] - d[1][0];
    let a02 = d[2][0] - d[0][2];
    let a21 = d[1][2] - d[2][1];
    let g4 = 2.0 * vec4(
        u.y * a21 + u.z * a02 + u.w * a10,
        u.x * a21 + u.z * s01 + u.w * s02 - 2.0 * u.y * (d[1][1] + d[2][2]),
        u.x * a02 + u.y * s01 + u.w * s12 - 2.0 * u.z * (d[0][0] + d[2][2]),
        u.x * a10 + u.y * s02 + u.z * s12 - 2.0 * u.w * (d[0][0] + d[1][1]),
    );
    return (g4 - u * (dot(u, g4) * g.quat_free)) * g.inv_norm;
}

fn is_drawn(i: u32) -> bool {
    return i < view.counts.x && spans[i].y != 0u;
}

fn splat_backward(i: u32) -> SplatGrad {
    let mean = vec3(means[3u * i], means[3u * i + 1u], means[3u * i + 2u]);
    let scale = vec3(scales[3u * i], scales[3u * i + 1u], scales[3u * i + 2u]);
    let g = project_splat(mean, quats[i], scale);
    let s0 = sums[3u * i];
    let s1 = sums[3u * i + 1u];
    let s2 = sums[3u * i + 2u];
    let one = 1.0 / LOG2_SCALE;
    let two = one * one;
    let first = vec2(s0.y, s0.z) * one;
    let second = vec3(s0.w, s1.x, s1.y) * two; // aa, ab, bb
    let w = vec3(g.whitening[0].x, g.whitening[1].x, g.whitening[2].x);
    let mean2d = vec2(w.x * first.x, w.y * first.x + w.z * first.y);
    let inv_z = g.inv_z.x;
    let j = view.focal.xy * inv_z;
    let clamped = vec2(g.clamped[0].x, g.clamped[1].x);
    let dilation = view.range.z;
    var pull = Pull(second, w, j, clamped, 0.0, 0.0);
    if (view.flags.x != 0u && g.det0 / g.det > MIN_COMPENSATION * MIN_COMPENSATION) {
        pull.comp_adjugate = s0.x * ((dilation * g.trace + dilation * dilation) / g.det0 / g.det);
        pull.comp_factor = s0.x * (dilation / g.det);
    }
    var axes: Axes;
    pull_column(g, pull, scale.x, 0u, 1u, 2u, &axes);
    pull_column(g, pull, scale.y, 1u, 2u, 0u, &axes);
    pull_column(g, pull, scale.z, 2u, 0u, 1u, &axes);
    // Back to the splat's own axes: R_vᵀ.
    let to_world = mat3x3<f32>(view.rotation_h[0].xyz, view.rotation_h[1].xyz, view.rotation_h[2].xyz);
    let d_rotation = to_world * axes.d_axes;
    let point = vec3(g.point[0].x, g.point[1].x, g.point[2].x);
    let ratios = point.xy * inv_z;
    let through = g.unclamped * j * inv_z * axes.d_slope;
    let d_xy = j * mean2d - through;
    let d_z = s2.y - dot(j * ratios, mean2d) - dot(j * inv_z, axes.d_focal - clamped * axes.d_slope) + dot(through, ratios);
    let d_mean = to_world * vec3(d_xy, d_z);
    var d_opacity = 0.0;
    if (opacities[i] > 0.0) {
        d_opacity = s0.x / opacities[i];
    }
    let mid = 0.5 * (g.covariance.x + g.covariance.z);
    let half = 0.5 * (g.covariance.x - g.covariance.z);
    let radius = 3.0 * sqrt(mid + sqrt(half * half + g.covariance.y * g.covariance.y));
    return SplatGrad(
        d_mean,
        d_opacity,
        quat_backward(g, d_rotation),
        axes.d_scale,
        radius,
        mean2d,
        vec2(s2.z, s2.w),
        vec3(d_xy, d_z),
        axes,
        g,
    );
}
