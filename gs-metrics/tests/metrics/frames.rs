//! Generated frames for flow, computed in integers so that they are the same on every machine.

use gs_core::Image;

/// A triangle wave between 0 and 255.
fn triangle(at: i64, period: i64) -> i64 {
    (2 * at.rem_euclid(period) - period).abs() * 255 / period
}

/// A texture of several directions and scales at a place in sixteenths of a pixel, 0 to 255.
fn texture(x: i64, y: i64) -> u8 {
    let chirp = triangle(x * y / 512 + 3 * x, 1500);
    let sum =
        3 * triangle(3 * x + y, 800) + 3 * triangle(x - 2 * y, 700) + 2 * triangle(5 * x + 7 * y, 3100) + 2 * chirp;
    (sum / 10) as u8
}

/// One RGB frame of `width × height`: the texture at `place(x, y)`, in sixteenths of a pixel.
fn frame(width: usize, height: usize, place: impl Fn(i64, i64) -> (i64, i64)) -> Image {
    let pixel = |i: usize| {
        let (x, y) = place((i % width) as i64, (i / width) as i64);
        [texture(x, y), texture(x + 900, y), texture(x, y + 500)].map(|v| f32::from(v) / 255.0)
    };
    Image { width, height, channels: 3, data: (0..width * height).flat_map(pixel).collect() }
}

/// A pair whose second frame is shifted by `(dx, dy)` sixteenths of a pixel, slightly rotated and scaled.
pub fn moved(width: usize, height: usize, dx: i64, dy: i64) -> [Image; 2] {
    let second = |x: i64, y: i64| (16 * x - dx - y / 6, 16 * y - dy + x / 9 + y / 11);
    [frame(width, height, |x, y| (16 * x, 16 * y)), frame(width, height, second)]
}

/// Frame `i` of a video that moves by `(dx, dy)` sixteenths of a pixel per frame, and shears.
pub fn video_frame(width: usize, height: usize, i: i64, [dx, dy]: [i64; 2]) -> Image {
    frame(width, height, |x, y| (16 * x - i * dx - i * y / 8, 16 * y - i * dy))
}
