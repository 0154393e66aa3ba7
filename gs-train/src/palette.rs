//! Colours for overlays: a scale for numbers, colours for labels, and the legend of vectors.

/// What colours say that stand for vectors.
pub const DIRECTIONS: &str = "red, green and blue are the x, y and z of a vector: grey for none, the longest component of all at the end of \
     its channel";

/// A colour for a share: from dark blue over teal to pale yellow, ever lighter, so that it can be read in grey and by
/// colour-blind eyes. What is not finite is dark.
pub fn color_scale(share: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 5] =
        [[0.05, 0.03, 0.30], [0.10, 0.25, 0.55], [0.10, 0.50, 0.53], [0.45, 0.74, 0.35], [0.99, 0.93, 0.55]];
    let at = if share.is_finite() { share.clamp(0.0, 1.0) * 4.0 } else { 0.0 };
    let k = (at as usize).min(3);
    std::array::from_fn(|c| STOPS[k][c] + (STOPS[k + 1][c] - STOPS[k][c]) * (at - k as f32))
}

/// A colour for an id, display-encoded; black for 0, the background. Neighbouring ids differ by the golden angle in hue.
pub fn label_color(id: u32) -> [f32; 3] {
    if id == 0 {
        return [0.0; 3];
    }
    let turn = f64::from(id - 1) * 0.618_033_988_749_895;
    let value = if (id - 1) % 4 < 2 { 1.0 } else { 0.7 };
    let hue = (turn - turn.floor()) * 6.0;
    let ramp = |shift: f64| {
        let h = (hue + shift).rem_euclid(6.0);
        (value * ((h - 3.0).abs() - 1.0).clamp(0.1, 1.0)) as f32
    };
    [ramp(0.0), ramp(4.0), ramp(2.0)]
}
