// Blend constants from a projected splat, and a sample's place in them.

fn row_of(splat: u32, origin: vec2<f32>) -> Row {
    let at = STRIDE * splat;
    let center = projected[at];
    let high = projected[at + 1u];
    let low = projected[at + 2u];
    let color = projected[at + 3u];
    let dx = d_add(two_sum(origin.x + 0.5, -center.x), d_from(-center.z));
    let dy = d_add(two_sum(origin.y + 0.5, -center.y), d_from(-center.w));
    let a0 = d_add(d_mul(vec2(high.x, low.x), dx), d_mul(vec2(high.y, low.y), dy)).x;
    let b0 = d_mul(vec2(high.z, low.z), dy).x;
    var row: Row;
    row.a = vec4(a0, b0, high.x, high.y);
    row.b = vec4(high.z, high.w, 0.0, 0.0);
    row.color = vec4(color.xyz, low.w);
    if (HAS_PROFILE) {
        row.profile = projected[at + 4u];
        row.b.z = exp2_accurate(high.w);
    }
    return row;
}

fn whitened(a: vec4<f32>, b: vec4<f32>, pixel: vec2<f32>) -> vec2<f32> {
    return vec2(fma(pixel.x, a.z, fma(pixel.y, a.w, a.x)), fma(pixel.y, b.x, a.y));
}

fn log2_raw(b: vec4<f32>, e: vec2<f32>) -> f32 {
    return fma(-e.x, e.x, fma(-e.y, e.y, b.y));
}
