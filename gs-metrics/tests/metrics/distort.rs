//! Distortions of images, for the perceptual proxy.

use gs_core::{Image, Rng};

/// Value at `(x, y)`, the nearest one outside the image.
fn near(i: &Image, x: isize, y: isize, c: usize) -> f32 {
    let (x, y) = (x.clamp(0, i.width as isize - 1) as usize, y.clamp(0, i.height as isize - 1) as usize);
    i.data[(y * i.width + x) * i.channels + c]
}

/// A new image from a function of column, row and channel.
fn map(i: &Image, f: impl Fn(isize, isize, usize) -> f32) -> Image {
    let (w, h, c) = i.shape();
    let data = (0..w * h * c).map(|k| f((k / c % w) as isize, (k / c / w) as isize, k % c)).collect();
    Image { data, ..i.clone() }
}

/// Gaussian blur.
pub fn blur(i: &Image, sigma: f32) -> Image {
    let reach = (3.0 * sigma).ceil() as isize;
    let taps: Vec<f32> = (-reach..=reach).map(|t| (-(t * t) as f32 / (2.0 * sigma * sigma)).exp()).collect();
    let sum: f32 = taps.iter().sum();
    let pass = |i: &Image, dx: isize, dy: isize| {
        map(i, |x, y, c| {
            let at = |t: isize| near(i, x + dx * t, y + dy * t, c);
            taps.iter().zip(-reach..=reach).map(|(g, t)| g * at(t)).sum::<f32>() / sum
        })
    };
    pass(&pass(i, 1, 0), 0, 1)
}

/// Gaussian noise, clipped to `[0, 1]`.
pub fn gaussian_noise(i: &Image, sigma: f32) -> Image {
    let mut rng = Rng::new(5, "distort", 0, 0);
    Image { data: i.data.iter().map(|v| (v + sigma * rng.normal()).clamp(0.0, 1.0)).collect(), ..i.clone() }
}

/// A smooth wave of whole pixels: nothing is interpolated, so nothing is blurred.
pub fn warp(i: &Image, amplitude: f32, period: f32) -> Image {
    let wave = |t: isize| (amplitude * (t as f32 * std::f32::consts::TAU / period).sin()).round() as isize;
    map(i, |x, y, c| near(i, x + wave(y), y + wave(x + 17), c))
}

/// Moved by whole pixels to the left.
pub fn shift(i: &Image, by: isize) -> Image {
    map(i, |x, y, c| near(i, x + by, y, c))
}

/// Every square of `side` pixels replaced by its mean.
pub fn blocks(i: &Image, side: isize) -> Image {
    map(i, |x, y, c| {
        let (x0, y0) = (x / side * side, y / side * side);
        let cells = (0..side * side).map(|k| near(i, x0 + k % side, y0 + k / side, c));
        cells.sum::<f32>() / (side * side) as f32
    })
}

/// Contrast and brightness changed: `v·gain + offset`, clipped.
pub fn tone(i: &Image, gain: f32, offset: f32) -> Image {
    map(i, |x, y, c| (near(i, x, y, c) * gain + offset).clamp(0.0, 1.0))
}

/// The part of `w × h` pixels at column `x` and row `y`.
pub fn crop(i: &Image, x: usize, y: usize, w: usize, h: usize) -> Image {
    let rows = (y..y + h).flat_map(|r| &i.data[(r * i.width + x) * i.channels..(r * i.width + x + w) * i.channels]);
    Image { width: w, height: h, channels: i.channels, data: rows.copied().collect() }
}

/// JPEG-like coding of each channel: 8 × 8 cosine transform, coefficient `(u, v)` rounded to multiples of
/// `step·(1 + u + v)`.
pub fn quantised_dct(i: &Image, step: f32) -> Image {
    let basis = |u: usize, x: usize| {
        let scale = if u == 0 { 0.125f32.sqrt() } else { 0.5 };
        scale * ((x as f32 + 0.5) * u as f32 * std::f32::consts::PI / 8.0).cos()
    };
    let forward: Block = std::array::from_fn(|u| std::array::from_fn(|x| basis(u, x)));
    let inverse = transposed(&forward);
    let mut out = i.clone();
    for c in 0..i.channels {
        for (y0, x0) in (0..i.height).step_by(8).flat_map(|y| (0..i.width).step_by(8).map(move |x| (y, x))) {
            let at = |y: usize, x: usize| near(i, (x0 + x) as isize, (y0 + y) as isize, c);
            let block: Block = std::array::from_fn(|y| std::array::from_fn(|x| at(y, x)));
            let mut coefficients = product(&product(&forward, &block), &inverse);
            for (v, row) in coefficients.iter_mut().enumerate() {
                for (u, value) in row.iter_mut().enumerate() {
                    let quantum = step * (1 + u + v) as f32;
                    *value = (*value / quantum).round() * quantum;
                }
            }
            let coded = product(&product(&inverse, &coefficients), &forward);
            for (y, row) in coded.iter().enumerate().take(i.height - y0) {
                for (x, value) in row.iter().enumerate().take(i.width - x0) {
                    out.pixel_mut(x0 + x, y0 + y)[c] = value.clamp(0.0, 1.0);
                }
            }
        }
    }
    out
}

type Block = [[f32; 8]; 8];

fn transposed(a: &Block) -> Block {
    std::array::from_fn(|y| std::array::from_fn(|x| a[x][y]))
}

fn product(a: &Block, b: &Block) -> Block {
    std::array::from_fn(|y| std::array::from_fn(|x| (0..8).map(|k| a[y][k] * b[k][x]).sum()))
}
