//! Hard scenes for the rasteriser's tests, generated from a seed.
#![allow(dead_code, reason = "each test binary uses its own part")]

pub mod golden;
pub mod table;

use glam::{DVec3, Vec3};
use gs_core::kernel::effective_beta;
use gs_core::{BetaMode, Camera, Color, Kernel, Rng, Splats};

/// The kinds of hard scenes, by name.
pub const KINDS: [&str; 8] =
    ["ordinary", "needles", "near plane", "opaque stack", "odd quaternions", "huge", "equal depths", "one pixel"];

pub struct Case {
    pub kind: &'static str,
    pub splats: Splats,
    pub camera: Camera,
    pub background: [f32; 3],
}

/// Scene number `seed`; its kind is `seed % 8`. It has at most `max_splats` splats, an opaque stack at least 300.
pub fn case(seed: u64, max_splats: usize) -> Case {
    let kind = KINDS[seed as usize % KINDS.len()];
    let mut rng = Rng::new(seed, "hard scene", 0, 0);
    let n = match kind {
        "opaque stack" => max_splats.max(300),
        _ => 1 + rng.below(max_splats as u32) as usize,
    };
    let camera = camera(kind, &mut rng);
    let degree = rng.below(4) as u8;
    let rows: Vec<Row> = (0..n).map(|i| row(kind, i, &camera, &mut rng)).collect();
    let coeffs = gs_core::sh::coeffs(degree) * 3;
    let sh = (0..n * coeffs).map(|_| 0.5 * rng.normal()).collect();
    let splats = Splats {
        means: rows.iter().map(|r| r.mean).collect(),
        quats: rows.iter().map(|r| r.quat).collect(),
        scales: rows.iter().map(|r| r.scale).collect(),
        opacities: rows.iter().map(|r| r.opacity).collect(),
        color: Color::Sh { degree, coeffs: sh },
        kernel: Kernel::Gaussian,
    };
    splats.check().expect("the generator makes legal scenes");
    Case { kind, splats, camera, background: std::array::from_fn(|_| rng.uniform()) }
}

/// The kinds of kernels, by name.
pub const KERNELS: [&str; 4] = ["frequency", "literal", "acutance", "neutral"];

/// Kernel number `seed`, of kind `KERNELS[seed % 4]`, for `n` splats: the effective β of each mode, λ and β to the ends
/// of their domain but for the vicinity of `β = ½ + λ`, where derivatives have no bound.
pub fn kernel(seed: u64, n: usize) -> Kernel {
    let mut rng = Rng::new(seed, "kernel", 0, 0);
    match KERNELS[seed as usize % KERNELS.len()] {
        "acutance" => Kernel::Acutance { acutances: (0..n).map(|_| rng.range(-0.9, 0.9)).collect() },
        "neutral" => Kernel::Frequency { lambdas: vec![0.5; n], betas: (0..n).map(|_| rng.uniform()).collect() },
        kind => {
            let mode = if kind == "literal" { BetaMode::Literal } else { BetaMode::Capped };
            let row = |_| loop {
                let (l, b) = (rng.uniform(), rng.uniform());
                let beta = effective_beta(mode, f64::from(l), f64::from(b)) as f32;
                if (0.5 + l - beta).abs() > 0.05 {
                    return (l, beta);
                }
            };
            let (lambdas, betas) = (0..n).map(row).unzip();
            Kernel::Frequency { lambdas, betas }
        }
    }
}

struct Row {
    mean: Vec3,
    quat: [f32; 4],
    scale: Vec3,
    opacity: f32,
}

fn camera(kind: &str, rng: &mut Rng) -> Camera {
    let (w, h) = if kind == "one pixel" { (1, 1) } else { (9 + rng.below(40), 9 + rng.below(40)) };
    let eye = DVec3::new(f64::from(rng.range(-1.0, 1.0)), f64::from(rng.range(-1.0, 1.0)), -3.0);
    let target = DVec3::new(f64::from(rng.range(-0.3, 0.3)), f64::from(rng.range(-0.3, 0.3)), 0.0);
    let mut c = Camera::look_at(w, h, 0.8, eye, target, DVec3::NEG_Y).expect("a legal camera");
    c.fy *= f64::from(rng.range(0.8, 1.2));
    c.cx += f64::from(rng.range(-0.2, 0.2)) * f64::from(w);
    c.cy += f64::from(rng.range(-0.2, 0.2)) * f64::from(h);
    c
}

fn row(kind: &str, i: usize, camera: &Camera, rng: &mut Rng) -> Row {
    let log_uniform = |rng: &mut Rng, lo: f32, hi: f32| (rng.range(lo.ln(), hi.ln())).exp();
    let mut r = Row {
        mean: Vec3::from_array(std::array::from_fn(|_| rng.range(-0.8, 0.8))),
        quat: std::array::from_fn(|_| rng.normal()),
        scale: Vec3::from_array(std::array::from_fn(|_| log_uniform(rng, 0.01, 0.3))),
        opacity: 1.0 / (1.0 + (-1.8 * rng.normal()).exp()),
    };
    let on_axis = |depth: f64| (camera.position() + camera.forward() * depth).as_vec3();
    match kind {
        "needles" => r.scale = Vec3::from_array(std::array::from_fn(|_| log_uniform(rng, 1e-4, 1.0))),
        // Centres around and behind the near plane, some far outside the frustum.
        "near plane" => {
            let depth = f64::from(rng.range(-0.5, 0.6));
            r.mean = on_axis(depth) + Vec3::from_array(std::array::from_fn(|_| rng.range(-0.3, 0.3)));
        }
        "opaque stack" => {
            r.mean = on_axis(2.0 + 0.005 * i as f64) + Vec3::new(rng.range(-0.1, 0.1), rng.range(-0.1, 0.1), 0.0);
            r.opacity = 1.0 / (1.0 + (-rng.range(-4.0, 12.0)).exp());
        }
        "odd quaternions" => {
            let size = [0.0, 1e-6, 1e-3, 1.0, 1e6][rng.below(5) as usize];
            r.quat = r.quat.map(|v| v * size);
        }
        "huge" => {
            if i.is_multiple_of(3) {
                r.scale *= 100.0;
            }
            if i.is_multiple_of(5) {
                r.scale.x = 0.0;
            }
        }
        "equal depths" => {
            let local = Vec3::new(rng.range(-0.5, 0.5), rng.range(-0.5, 0.5), 0.0);
            let back = camera.rotation.transpose().as_mat3();
            r.mean = on_axis(3.0) + back * local;
            if i % 2 == 1 {
                // The same centre for half the splats, and often the same depth bits for the others.
                r.mean = on_axis(3.0);
            }
        }
        _ => {}
    }
    r
}

/// Deterministic cotangents for a frame.
pub fn weights(seed: u64, n: usize) -> Vec<f32> {
    let mut rng = Rng::new(seed, "frame weights", 0, 0);
    (0..n).map(|_| rng.normal()).collect()
}
