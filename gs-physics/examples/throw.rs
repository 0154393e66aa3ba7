//! Throws a ball, rolls a wheel and spins a body about two axes, and prints how far each integrator ends from the truth.
//!
//! ```sh
//! cargo run --release -p gs-physics --example throw
//! ```

use glam::Vec3;
use gs_physics::truth::{self, Truth};
use gs_physics::{ClassRule, Extrapolator, Integrator, Motion, Rollout, RowsError};

const STEPS: [u32; 5] = [5, 15, 30, 60, 120];
const UNIT: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

/// The particle of a truth, to be asked for at any time.
fn particle(truth: &Truth, rule: Integrator, steps: u32) -> Result<Extrapolator, RowsError> {
    let start = Vec3::from_array(truth.start.map(|v| v as f32));
    let rollout = Rollout { rule, dt: truth.span / f64::from(steps), origin: Vec3::ZERO };
    Extrapolator::new(rollout, 0.0, vec![truth.motion.to_f32()], vec![start], vec![UNIT])
}

/// Distance of the particle's end from the exact one.
fn position_error(truth: &Truth, rule: Integrator, steps: u32) -> Result<f64, RowsError> {
    let mut particle = particle(truth, rule, steps)?;
    let (means, _) = particle.at(truth.span);
    Ok(truth.position_error(means[0].as_dvec3().to_array()))
}

fn table(what: &str, truth: &Truth) -> Result<(), RowsError> {
    let rule = ClassRule { tolerance: 1e-6, horizon: truth.span };
    println!("\n{what}: {:.3?} -> {:.3?} in {} s, {:?}", truth.start, truth.end, truth.span, class(truth, &rule));
    print!("{:<12}", "steps");
    STEPS.iter().for_each(|n| print!("{n:>11}"));
    println!("   error in f32");
    for rule in Integrator::ALL {
        print!("{:<12}", format!("{rule:?}"));
        for n in STEPS {
            print!("{:>11.1e}", position_error(truth, rule, n)?);
        }
        println!();
    }
    Ok(())
}

fn class(truth: &Truth, rule: &ClassRule) -> gs_physics::MotionClass {
    rule.classify(&truth.motion, truth.start, 0.1).class
}

fn main() -> Result<(), RowsError> {
    table("A ball thrown", &truth::throw())?;
    table("A point on the rim of a rolling wheel", &truth::wheel())?;
    let mut without = truth::wheel();
    without.motion = Motion { twist: without.motion.twist, ..Motion::default() };
    table("The same wheel without the -w x v_c of its acceleration", &without)?;
    table("A body that spins about two axes", &truth::tumble())?;

    println!("\nThe rim of the wheel over time (Se3Mid, 30 steps):");
    let mut rim = particle(&truth::wheel(), Integrator::Se3Mid, 30)?;
    for k in 0..=8 {
        let t = f64::from(k) / 8.0;
        let (means, quats) = rim.at(t);
        println!(
            "t = {t:.3}   at {:>7.4} {:>7.4}   rotated by {:>6.2} degrees",
            means[0].x,
            means[0].z,
            degrees(quats[0])
        );
    }
    Ok(())
}

fn degrees(q: [f32; 4]) -> f32 {
    let sin = (q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    2.0 * sin.atan2(q[0]).to_degrees()
}
