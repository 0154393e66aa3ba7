//! Bilinear resizing with aligned corners, `source = target (n − 1)/(side − 1)`, and its transpose.

use gs_core::{Image, cast};

/// Two source rows (or columns) and the weight of the second, for each target row.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let step = (from - 1) as f64 / (to.max(2) - 1) as f64;
    let tap = |t: usize| {
        let source = t as f64 * step;
        let low = cast::to_usize(source).min(from - 1);
        (low, (low + 1).min(from - 1), cast::to_f32(source - low as f64))
    };
    (0..to).map(tap).collect()
}

/// The image resized to `side × side` pixels.
pub(super) fn resize(image: &Image, side: usize) -> Image {
    let mut out = Image::zeros(side, side, image.channels);
    let columns = taps(image.width, side);
    for (y, (top, bottom, v)) in taps(image.height, side).into_iter().enumerate() {
        for (x, &(left, right, u)) in columns.iter().enumerate() {
            let corners = [(left, top), (right, top), (left, bottom), (right, bottom)].map(|(x, y)| image.pixel(x, y));
            for (c, out) in out.pixel_mut(x, y).iter_mut().enumerate() {
                let [a, b, d, e] = corners.map(|p| p[c]);
                *out = (1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * d + u * e);
            }
        }
    }
    out
}

/// The transpose of [`resize`] from an image of `width × height` pixels.
pub(super) fn resize_backward(d: &Image, width: usize, height: usize) -> Image {
    let mut out = Image::zeros(width, height, d.channels);
    let columns = taps(width, d.width);
    for (y, (top, bottom, v)) in taps(height, d.height).into_iter().enumerate() {
        for (x, &(left, right, u)) in columns.iter().enumerate() {
            let weights = [(1.0 - v) * (1.0 - u), (1.0 - v) * u, v * (1.0 - u), v * u];
            for ((x_to, y_to), weight) in
                [(left, top), (right, top), (left, bottom), (right, bottom)].into_iter().zip(weights)
            {
                out.pixel_mut(x_to, y_to).iter_mut().zip(d.pixel(x, y)).for_each(|(o, d)| *o += weight * d);
            }
        }
    }
    out
}
