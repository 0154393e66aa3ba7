//! Fits a deformation field to a known motion: a sheet of splats that waves while it spins.
//!
//! ```text
//! cargo run --release -p gs-deform --example fit_motion [-- fourdgs|defgs] [steps]
//! ```
//! Each step samples a training time, deforms the sheet with the field, and takes the squared error of means and
//! rotations against the known motion. The table shows the error at times that are never trained.

use glam::{Quat, Vec3};
use gs_core::rot;
use gs_core::{Geometry, Param, Rng, Time};
use gs_deform::{Aabb, DefGsConfig, DefMlp, Field, FourDgsConfig, HexPlaneField};
use std::time::Instant;

/// A sheet of `side²` splats in the plane z = 0, two units wide.
fn sheet(side: usize) -> Geometry {
    let n = side * side;
    let at = |i: usize| i as f32 / (side - 1) as f32 * 2.0 - 1.0;
    Geometry {
        means: (0..n).map(|i| Vec3::new(at(i % side), at(i / side), 0.0)).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
        scales: vec![Vec3::splat(0.02); n],
    }
}

/// Position and rotation at time `t` of a point of the sheet: a wave along x, then a spin about y.
fn truth(p: Vec3, t: f32) -> (Vec3, Quat) {
    let phase = 3.0 * p.x - std::f32::consts::TAU * t;
    let wave = Vec3::new(p.x, p.y, p.z + 0.15 * phase.sin());
    let tilt = Quat::from_rotation_y(-(0.45 * phase.cos()).atan());
    let spin = Quat::from_rotation_y(0.5 * std::f32::consts::PI * t);
    (spin * wave, spin * tilt)
}

/// Mean squared error of means and of rotations (up to sign), and its cotangents.
fn loss(canonical: &Geometry, moved: &Geometry, t: f32, d: &mut Geometry) -> f32 {
    d.reset(moved.len());
    let scale = 1.0 / moved.len() as f32;
    let mut total = 0.0;
    for (i, p) in canonical.means.iter().enumerate() {
        let (mean, rotation) = truth(*p, t);
        let error = moved.means[i] - mean;
        d.means[i] = error * 2.0 * scale;
        let unit = rot::normalise(moved.quats[i]);
        let want = rot::from_glam(rotation);
        let sign = (0..4).map(|k| unit.wxyz[k] * want[k]).sum::<f32>().signum();
        let d_unit: [f32; 4] = std::array::from_fn(|k| 0.2 * scale * (unit.wxyz[k] - sign * want[k]));
        d.quats[i] = rot::normalise_backward(&unit, d_unit);
        total += scale
            * (error.length_squared() + (0..4).map(|k| 0.1 * (unit.wxyz[k] - sign * want[k]).powi(2)).sum::<f32>());
    }
    total
}

/// One step of Adam (Kingma and Ba 2015).
fn adam(p: &mut Param, step: i32, rate: f32) {
    let (correct1, correct2) = (1.0 - 0.9f32.powi(step), 1.0 - 0.99f32.powi(step));
    for i in 0..p.len() {
        let g = p.grad[i];
        p.moment1[i] += 0.1 * (g - p.moment1[i]);
        p.moment2[i] += 0.01 * (g * g - p.moment2[i]);
        p.value[i] -= rate * (p.moment1[i] / correct1) / ((p.moment2[i] / correct2).sqrt() + 1e-8);
    }
    p.clear_grad();
}

/// Root mean square error of the deformed means at `t`.
fn rms_error<F: Field>(field: &F, canonical: &Geometry, t: Time, tape: &mut F::Tape, moved: &mut Geometry) -> f32 {
    field.forward(canonical.view(), t, tape, moved);
    let squares =
        canonical.means.iter().zip(&moved.means).map(|(p, m)| (*m - truth(*p, t.normalised).0).length_squared());
    (squares.sum::<f32>() / canonical.len() as f32).sqrt()
}

fn fit<F: Field>(mut field: F, steps: u32, rate: impl Fn(&str) -> f32) -> Result<(), Box<dyn std::error::Error>> {
    let canonical = sheet(48);
    let (mut tape, mut moved) = (F::Tape::default(), Geometry::default());
    let (mut d, mut d_canonical) = (Geometry::default(), Geometry::zeros(canonical.len()));
    println!("{} splats, {} parameters", canonical.len(), field.param_count());
    println!("{:>6} {:>10} {:>9}   RMS error at t = 0.05 0.25 0.45 0.65 0.85", "step", "loss", "ms/step");
    let start = Instant::now();
    for step in 1..=steps {
        // Sixteen training times: multiples of 1/15.
        let t = Time::new(Rng::new(1, "times", step, 0).below(16) as f32 / 15.0)?;
        field.forward(canonical.view(), t, &mut tape, &mut moved);
        let value = loss(&canonical, &moved, t.normalised, &mut d);
        field.backward(canonical.view(), &mut tape, d.view(), &mut d_canonical);
        field.regularise(canonical.view(), t, step);
        let fade = 0.1f32.powf(step as f32 / steps as f32);
        field.visit_mut(&mut |p| adam(p, step as i32, rate(&p.name) * fade));
        if step == 1 || step % (steps / 8).max(1) == 0 {
            let spent = start.elapsed().as_secs_f64() * 1e3 / f64::from(step);
            let mut errors = String::new();
            for t in [0.05, 0.25, 0.45, 0.65, 0.85] {
                errors += &format!(" {:.4}", rms_error(&field, &canonical, Time::new(t)?, &mut tape, &mut moved));
            }
            println!("{step:>6} {value:>10.2e} {spent:>9.2}                 {errors}");
        }
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let kind = arguments.next().unwrap_or_else(|| "fourdgs".into());
    let steps = arguments.next().map_or(Ok(800), |s| s.parse())?;
    match kind.as_str() {
        "fourdgs" => {
            let mut config = FourDgsConfig::fast();
            config.hexplane.resolution = [32, 32, 32, 32];
            let grid = |name: &str| if name.starts_with("field.planes") { 1e-2 } else { 2e-3 };
            fit(HexPlaneField::new("field", &config, Aabb::around(&sheet(2).means, 0.1)?, 1)?, steps, grid)
        }
        "defgs" => fit(
            DefMlp::new(&DefGsConfig { bands_position: 4, bands_time: 4, ..DefGsConfig::fast() }, 1)?,
            steps,
            |_| 1e-3,
        ),
        other => Err(format!("unknown field `{other}`; choose fourdgs or defgs").into()),
    }
}
