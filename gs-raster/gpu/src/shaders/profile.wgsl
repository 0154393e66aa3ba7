// Kernel profiles, as gs_raster's `kernel.rs` states them. A profile is (u, κ, foot, cut); κ = −1 stands for clamped knots.
// STRIDE and HAS_PROFILE come from the host: four or five vectors a splat.

const SUPPORT_MARGIN: f32 = 0.999998;
// A sample is visible down to an alpha of 2^-126.
const MAX_SUPPORT: f32 = 128.0;

// 2^x for −126 ≤ x ≤ 127, relative error below 2.5e-7.
fn exp2_accurate(x: f32) -> f32 {
    if (NATIVE_EXP2) {
        return exp2(x);
    }
    let n = round(x);
    let f = x - n;
    var p = fma(1.3276473e-3, f, 9.675542e-3);
    p = fma(p, f, 5.550713e-2);
    p = fma(p, f, 0.2402212);
    p = fma(p, f, 0.69314694);
    p = fma(p, f, 1.0000001);
    return bitcast<f32>(bitcast<u32>(p) + (bitcast<u32>(i32(n)) << 23u));
}

// Smallest g at which a bent profile reaches the threshold, a little less; −1 if there is none.
fn inverse(profile: vec4<f32>, threshold: f32) -> f32 {
    let foot = profile.z;
    let r = 1.0 + profile.x;
    let on_inner = 0.5 + (threshold - 0.5) / r - 5e-7;
    if (profile.y < 0.0) {
        return select(-1.0, max(on_inner, 0.0), threshold <= 0.5 * (1.0 + r));
    }
    let at_knot = foot * 0.5 / (1.0 + profile.y);
    if (threshold > 1.0) {
        return -1.0;
    }
    if (threshold <= at_knot) {
        return threshold / foot;
    }
    if (threshold <= 1.0 - at_knot || foot <= 0.0) {
        return clamp(on_inner, 0.0, 1.0);
    }
    return clamp(1.0 - (1.0 - threshold) / foot - 5e-7, 0.0, 1.0);
}

// Largest visible a² + b² of a splat; negative if it is visible nowhere.
fn profile_support(profile: vec4<f32>, log2_opacity: f32) -> f32 {
    let gaussian = log2_opacity - view.thresholds.y;
    if (!HAS_PROFILE || profile.x == 0.0) {
        return gaussian;
    }
    let g = inverse(profile, exp2(-gaussian) * SUPPORT_MARGIN);
    if (g < 0.0) {
        return -1.0;
    }
    let reach = select(-log2(max(g, 1e-30)), MAX_SUPPORT, g < 1e-30);
    return min(reach, profile.w);
}

struct Sample {
    gaussian: f32, // o' g
    raw: f32,      // o' ψ(g)
    visible: bool,
}

// M, H and E of the profile's equations.
fn folded(profile: vec4<f32>, opacity: f32, gaussian: f32) -> vec3<f32> {
    let h = min(gaussian, opacity - gaussian);
    return vec3(gaussian - 0.5 * opacity, h, select(h * profile.y, 1.0, profile.y < 0.0));
}

// A sample at p = log2(o' g); `b` is the row's.
fn sample_at(b: vec4<f32>, profile: vec4<f32>, p: f32) -> Sample {
    var s: Sample;
    s.visible = p >= view.thresholds.y;
    if (!HAS_PROFILE) {
        if (s.visible) {
            s.raw = exp2_accurate(p);
        }
        s.gaussian = s.raw;
        return s;
    }
    s.gaussian = exp2_accurate(max(p, -126.0));
    s.raw = s.gaussian;
    if (profile.x != 0.0) {
        let m = folded(profile, b.z, s.gaussian);
        s.raw = fma(clamp(m.x, -m.z, m.z), profile.x, s.gaussian);
        s.visible = s.raw >= view.thresholds.x && p >= max(b.y - profile.w, -126.0);
    }
    return s;
}
