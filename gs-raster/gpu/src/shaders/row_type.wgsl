// Blend constants of one entry relative to the first pixel of a tile: a = a0 + w0 x + w1 y, b = b0 + w2 y and
// log2(o' g) = log2_opacity − a² − b², with x and y in whole pixels.
struct Row {
    a: vec4<f32>,       // a0, b0, w0, w1
    b: vec4<f32>,       // w2, log2 opacity, opacity (where there is a profile), -
    color: vec4<f32>,   // rgb, depth
    profile: vec4<f32>,
}
