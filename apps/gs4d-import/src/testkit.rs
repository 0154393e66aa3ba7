//! Films of a corner of a room with texture on everything and two balls that move, from any camera at any time, as video files.
//!
//! The texture is value noise of four octaves over the surface: it repeats nowhere, as features want it.

use glam::DVec3;
use gs_core::cast::{to_f32, to_usize};
use gs_core::io::y4m;
use gs_core::{Camera, Image};
use gs_data::Lens;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

/// Frames per second of films.
pub const FPS: u32 = 20;

/// Cameras on an arc around the corner, `degrees` from the first to the last, at a distance of 4; `k` of `n`.
pub fn arc(k: f64, n: f64, degrees: f64, size: [u32; 2]) -> Camera {
    let azimuth = (45.0 + degrees * (k / (n - 1.0).max(1.0) - 0.5)).to_radians();
    let height = 0.35 + 0.12 * (2.1 * k).sin();
    let eye = 4.0 * DVec3::new(azimuth.cos() * height.cos(), azimuth.sin() * height.cos(), height.sin());
    let target = DVec3::new(0.0, 0.0, 0.4);
    Camera::look_at(size[0], size[1], 0.9, eye + target, target, DVec3::Z).expect("a camera outside the room's middle")
}

/// What a camera sees at a time, seconds: `[height, width, 3]`, the mean of four rays per pixel.
pub fn picture(camera: &Camera, seconds: f64) -> Image {
    through(&Lens::default(), camera, seconds)
}

/// The same through a lens; grey where it sees nothing before the camera.
pub fn through(lens: &Lens, camera: &Camera, seconds: f64) -> Image {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let eye = camera.position();
    let balls = balls(seconds);
    let mut data = Vec::with_capacity(width * height * 3);
    for at in 0..width * height {
        let (x, y) = ((at % width) as f64, (at / width) as f64);
        let rays = [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]];
        let seen = |[u, v]: [f64; 2]| lens.pinhole_pixel(camera, x + u, y + v);
        let colors = rays.map(|at| seen(at).map_or([0.5; 3], |p| trace(eye, camera.ray(p.x, p.y), &balls)));
        data.extend((0..3).map(|c| to_f32(colors.iter().map(|p| p[c]).sum::<f64>() / 4.0)));
    }
    Image { width, height, channels: 3, data }
}

/// Centre and radius of the balls.
fn balls(t: f64) -> [(DVec3, f64); 2] {
    // Hops of different lengths: what moves when is different at every moment.
    let hop = |from: f64, length: f64| {
        let s = ((t - from) / length).clamp(0.0, 1.0);
        s * s * (3.0 - 2.0 * s)
    };
    let path = hop(0.1, 0.5) - 0.7 * hop(0.9, 0.3) + 0.9 * hop(1.4, 0.25) - 1.1 * hop(1.9, 0.7);
    let rise = hop(0.4, 0.4) - hop(1.25, 0.2) + 0.8 * hop(2.1, 0.4);
    [(DVec3::new(0.5 - 0.8 * path, -0.3 + 0.5 * path, 0.35), 0.35), (DVec3::new(-0.5, 0.6, 0.3 + 0.6 * rise), 0.28)]
}

fn trace(eye: DVec3, ray: DVec3, balls: &[(DVec3, f64); 2]) -> [f64; 3] {
    // The floor z = 0 and the walls x = −1.6, y = −1.6.
    let walls = [(DVec3::Z, 0.0), (DVec3::X, -1.6), (DVec3::Y, -1.6)];
    let mut best = (f64::INFINITY, [0.5; 3]);
    for (k, (normal, at)) in walls.iter().enumerate() {
        let s = (at - eye.dot(*normal)) / ray.dot(*normal);
        if s > 1e-6 && s < best.0 {
            let p = eye + s * ray;
            best = (s, texture(p * 2.2 + DVec3::splat(17.0 * (k as f64 + 1.0)), k));
        }
    }
    for (k, (centre, radius)) in balls.iter().enumerate() {
        let o = eye - *centre;
        let (b, c) = (o.dot(ray), o.length_squared() - radius * radius);
        let s = -b - (b * b - c).max(0.0).sqrt();
        if b * b > c && s > 1e-6 && s < best.0 {
            best = (s, texture((o + s * ray) * 4.0 + DVec3::splat(90.0 + 30.0 * k as f64), 3 + k));
        }
    }
    best.1
}

/// Colours of the texture where it is low and where it is high.
const TINTS: [[[f64; 3]; 2]; 5] = [
    [[0.10, 0.09, 0.08], [0.95, 0.90, 0.80]],
    [[0.08, 0.12, 0.20], [0.80, 0.90, 1.00]],
    [[0.18, 0.10, 0.06], [1.00, 0.85, 0.60]],
    [[0.45, 0.02, 0.02], [1.00, 0.75, 0.60]],
    [[0.02, 0.30, 0.08], [0.75, 1.00, 0.60]],
];

fn texture(p: DVec3, kind: usize) -> [f64; 3] {
    let octaves = [(1.0, 0.5), (2.1, 0.4), (4.3, 0.35), (8.9, 0.3)];
    let sum: f64 = octaves.iter().map(|(scale, weight)| weight * (noise(p * *scale) - 0.5)).sum();
    let w = (0.5 + 1.3 * sum).clamp(0.0, 1.0);
    let [low, high] = TINTS[kind];
    std::array::from_fn(|c| low[c] + (high[c] - low[c]) * w)
}

/// Cells of noise begin so far below zero.
const FAR: f64 = 1e9;

/// Value noise: smooth between random values at whole coordinates.
fn noise(p: DVec3) -> f64 {
    let (cell, f) = (p.floor(), p - p.floor());
    let ease = |s: f64| s * s * (3.0 - 2.0 * s);
    let weights = [ease(f.x), ease(f.y), ease(f.z)];
    let corner = |k: usize| {
        let whole = [cell.x, cell.y, cell.z].map(|c| to_usize(c + FAR));
        let at = |axis: usize| (whole[axis] + (k >> axis & 1)) as u64;
        let mut h = at(0).wrapping_mul(0x9E37_79B9_7F4A_7C15)
            ^ at(1).wrapping_mul(0xC2B2_AE3D_27D4_EB4F)
            ^ at(2).wrapping_mul(0x1656_67B1_9E37_79F9);
        h = (h ^ h >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        (h >> 40) as f64 / (1u64 << 24) as f64
    };
    (0..8)
        .map(|k| {
            let weight: f64 =
                (0..3).map(|axis| if k >> axis & 1 == 1 { weights[axis] } else { 1.0 - weights[axis] }).product();
            weight * corner(k)
        })
        .sum()
}

/// Whether a program can be called.
pub fn has(program: &str, argument: &str) -> bool {
    let quiet =
        Command::new(program).arg(argument).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    quiet.is_ok_and(|status| status.success())
}

/// Writes frames as an H.264 video of high quality.
///
/// # Errors
/// If ffmpeg cannot be started or fails.
pub fn write_video(path: &Path, frames: &[Image]) -> std::io::Result<()> {
    let mut child = Command::new("ffmpeg")
        .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "yuv4mpegpipe", "-i", "pipe:0"])
        .args(["-c:v", "libx264", "-preset", "veryfast", "-crf", "12", "-pix_fmt", "yuv420p"])
        .arg(crate::probe::input(path))
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()?;
    if let (Some(mut input), Some(first)) = (child.stdin.take(), frames.first()) {
        y4m::write_header(first.width, first.height, FPS.into(), &mut input)?;
        frames.iter().try_for_each(|f| y4m::write_frame(f, &mut input))?;
        input.flush()?;
    }
    match child.wait()?.success() {
        true => Ok(()),
        false => Err(std::io::Error::other("ffmpeg failed")),
    }
}
