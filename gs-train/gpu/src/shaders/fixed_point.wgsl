// Sums in integers: see planes_backward.wgsl.

// 2^exponent, for exponents of normal numbers.
fn power_of_two(exponent: i32) -> f32 {
    return bitcast<f32>(u32(clamp(exponent + 127, 1, 254)) << 23u);
}

// By which power of two contributions are multiplied, where the bits of the largest are `peak`: it then is below 2^spread. Contributions
// that are all below 2^-60 are treated as if the largest were 2^-60.
fn unit_exponent(peak: u32, spread: u32) -> i32 {
    let exponent = i32((peak >> 23u) & 0xffu) - 127;
    return i32(spread) - 1 - max(exponent, -60);
}
