//! Generated images.

use gs_core::{Image, Rng};

/// Uniform noise in `[lo, hi]`.
pub fn noise(w: usize, h: usize, c: usize, lo: f32, hi: f32, seed: u64) -> Image {
    let mut rng = Rng::new(seed, "metrics test", 0, 0);
    let data = (0..w * h * c).map(|_| rng.range(lo, hi)).collect();
    Image { width: w, height: h, channels: c, data }
}

/// A constant image.
pub fn constant(w: usize, h: usize, c: usize, v: f32) -> Image {
    Image { width: w, height: h, channels: c, data: vec![v; w * h * c] }
}

/// Adds uniform noise of the given amplitude.
pub fn with_noise(image: &Image, amplitude: f32, seed: u64) -> Image {
    let (w, h, c) = image.shape();
    let n = noise(w, h, c, -amplitude, amplitude, seed);
    let data = image.data.iter().zip(&n.data).map(|(a, b)| a + b).collect();
    Image { data, ..image.clone() }
}

/// A scene-like image: smooth shading, edges of several directions, and patches of texture, values in `[0, 1]`.
pub fn scene(w: usize, h: usize, c: usize) -> Image {
    Image { width: w, height: h, channels: c, data: (0..w * h * c).map(|i| scene_value(i, w, c)).collect() }
}

fn scene_value(i: usize, w: usize, c: usize) -> f32 {
    let (x, y, ch) = ((i / c % w) as f32, (i / c / w) as f32, (i % c) as f32);
    let shade = 0.45 + 0.2 * (x * 0.011 + ch).sin() + 0.1 * (y * 0.017).cos();
    let disc = if (x % 90.0 - 40.0).hypot(y % 110.0 - 50.0) < 25.0 { 0.25 } else { 0.0 };
    let bars = if y % 140.0 > 90.0 && ((x + 0.4 * y) / 7.0).floor() as i64 % 2 == 0 { -0.2 } else { 0.0 };
    let texture = if x % 150.0 > 80.0 { 0.12 * ((x * 1.1).sin() * (y * 0.9 + 0.3 * x).sin()) } else { 0.0 };
    (shade + disc + bars + texture).clamp(0.0, 1.0)
}

/// Runs `f` in a pool of `threads`.
pub fn in_pool<T: Send>(threads: usize, f: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(f)
}
