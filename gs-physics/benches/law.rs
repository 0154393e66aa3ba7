//! Time and error of laws and velocity fields of two sizes, forward and backward, 20 000 particles a step.
//!
//! Each row is printed and appended to `target/speed-error/gs-physics.jsonl`. `work` counts floating-point operations of
//! matrix products, two per multiply-add. Errors are against the `f64` references: of positions and rotations, or of the gradients
//! of weights relative to the largest of their block; the references follow a few particles only.

#[path = "../tests/physics/support/particles.rs"]
mod particles;

use glam::Vec3;
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Params, Rng};
use gs_physics::pinn::point;
use gs_physics::reference::Pose;
use gs_physics::reference::law::LawRef;
use gs_physics::reference::velocity::VelocityRef;
use gs_physics::{Dynamics, Integrator, Law, LawConfig, LawForm, ParticleState, VelocityConfig, VelocityField};
use particles::{CENTROID, cotangents, points, start};

const N: usize = 20_000;
/// Particles that the references compute.
const COMPARED: usize = 100;
const STEP: f64 = 1.0 / 30.0;
/// One step back in time, as in training.
const SPAN: [f64; 2] = [0.5, 0.5 - STEP];
const BOUNDS: [Vec3; 2] = [Vec3::NEG_ONE, Vec3::ONE];

/// Measures `f`, prints the row with the median, and records it.
fn row(case: &str, variant: &str, (n, work): (usize, f64), (error, error_kind): (f64, &'static str), f: impl FnMut()) {
    let line = BenchRow {
        krate: "gs-physics",
        case: case.to_owned(),
        variant: variant.to_owned(),
        n,
        threads: rayon::current_num_threads(),
        ms: 1e3 * median_seconds(9, f),
        work,
        error: Some(error),
        error_kind,
    };
    line.append(env!("CARGO_MANIFEST_DIR"));
}

/// Sets weights of the size of trained ones, so that particles move.
fn randomise_weights(params: &mut impl Params) {
    params.visit_mut(&mut |p| {
        let mut rng = Rng::new(2, &p.name, 0, 0);
        let spread = if p.name.ends_with("bias") { 0.3 } else { 0.1 };
        p.value.iter_mut().for_each(|v| *v += spread * rng.range(-1.0, 1.0));
    });
}

/// Errors of poses, and of gradients, over the compared particles.
fn errors<D: Dynamics>(
    dynamics: &mut D,
    transport: impl Fn([f64; 3]) -> Pose,
    gradient: impl Fn([f64; 3], Pose) -> Vec<Vec<f64>>,
) -> [f64; 2] {
    let (x, d) = (points(COMPARED), cotangents(COMPARED));
    let (mut tape, mut out) = (D::Tape::default(), ParticleState::default());
    dynamics.clear_grads();
    dynamics.integrate(start(&x, SPAN[0]), SPAN[1], &mut tape, &mut out);
    dynamics.integrate_backward(start(&x, SPAN[0]), &mut tape, &d);
    let mut worst = [0.0f64; 2];
    let mut want: Vec<Vec<f64>> = Vec::new();
    let ends = out.means.iter().zip(&out.rotations).zip(d.means.iter().zip(&d.rotations));
    for (x, ((mean, turn), (d_mean, d_turn))) in x.iter().zip(ends) {
        let at = x.as_dvec3().to_array();
        let want_pose = transport(at);
        let got = mean.to_array().into_iter().chain(*turn);
        let far = got.zip(want_pose.0.into_iter().chain(want_pose.1)).map(|(g, w)| (f64::from(g) - w).abs());
        worst[0] = far.fold(worst[0], f64::max);
        let one = gradient(at, (d_mean.as_dvec3().to_array(), d_turn.map(f64::from)));
        want.resize_with(one.len(), Vec::new);
        for (sum, one) in want.iter_mut().zip(&one) {
            sum.resize(one.len(), 0.0);
            sum.iter_mut().zip(one).for_each(|(s, g)| *s += g);
        }
    }
    let mut want = want.iter();
    dynamics.visit(&mut |p| {
        let Some(want) = want.next() else { return };
        worst[1] = worst[1].max(relative(&p.grad, want));
    });
    worst
}

/// Largest difference, relative to the largest wanted value.
fn relative(got: &[f32], want: &[f64]) -> f64 {
    let largest = want.iter().fold(1e-30f64, |m, g| m.max(g.abs()));
    got.iter().zip(want).fold(0.0, |m, (g, w)| m.max((f64::from(*g) - w).abs() / largest))
}

/// Rows of one step of training. `products`: multiply-adds of a particle forward and backward.
fn train<D: Dynamics>(case: &str, mut dynamics: D, products: [usize; 2], [value, gradient]: [f64; 2]) {
    let (x, d) = (points(N), cotangents(N));
    let (mut tape, mut out) = (D::Tape::default(), ParticleState::default());
    let work = |k: usize| (N, 2.0 * (products[k] * N) as f64);
    row(case, "forward", work(0), (value, "positions and rotations against f64"), || {
        dynamics.integrate(start(&x, SPAN[0]), SPAN[1], &mut tape, &mut out);
    });
    row(case, "backward", work(1), (gradient, "weights' gradients relative to f64"), || {
        dynamics.integrate_backward(start(&x, SPAN[0]), &mut tape, &d);
    });
}

/// Multiply-adds of a network of `depth` hidden layers, without and with its first layer.
fn products(inputs: usize, hidden: usize, depth: usize, outputs: usize) -> [usize; 2] {
    let inner = hidden * hidden * (depth - 1) + hidden * outputs;
    [inner, inner + inputs * hidden]
}

fn law(case: &str, config: &LawConfig) -> Result<(), Box<dyn std::error::Error>> {
    let mut law = Law::new(config, Vec3::ZERO, STEP, 1)?;
    randomise_weights(&mut law);
    let mut reference = LawRef::new(&law);
    reference.centroid = CENTROID.as_dvec3().to_array();
    let transport = |x| reference.integrate(x, SPAN);
    let gradient = |x, d| {
        let mut grad = reference.net.zeros();
        reference.gradient(x, SPAN, d, &mut grad);
        grad
    };
    let errors = errors(&mut law, transport, gradient);
    // The time is folded: 21 inputs, not 28. Backward: weights of all layers, inputs of all but the first.
    let [inner, all] = products(21, config.hidden, config.depth, 12);
    train(case, law, [all, inner + all], errors);
    Ok(())
}

fn velocity(case: &str, config: &VelocityConfig) -> Result<(), Box<dyn std::error::Error>> {
    let mut field = VelocityField::new(config, BOUNDS, STEP, 1)?;
    randomise_weights(&mut field);
    let reference = VelocityRef::new(&field);
    let transport = |x| reference.integrate(x, SPAN);
    let gradient = |x, d| {
        let mut grad = reference.net.zeros();
        reference.gradient(x, SPAN, d, &mut grad);
        grad
    };
    let errors = errors(&mut field, transport, gradient);
    let [_, all] = products(28, config.hidden, config.depth, 6);
    // A value with four derivatives, backward twice that.
    let (work, kind) = ((config.points, 2.0 * (15 * all * config.points) as f64), "weights' gradients relative to f64");
    row(case, "losses and backward", work, (losses(&mut field, &reference), kind), || {
        field.regularise(1, 1);
    });
    // A value at the start, a value with three derivatives at the midpoint; backward: evaluated again, then weights and
    // inputs.
    train(case, field, [5 * all, 15 * all], errors);
    Ok(())
}

/// Error of the gradient of the physics-informed loss.
fn losses(field: &mut VelocityField, reference: &VelocityRef) -> f64 {
    let point = |row| {
        let (x, t) = point(field, 1, 1, row);
        (x.as_dvec3().to_array(), f64::from(t))
    };
    let points: Vec<([f64; 3], f64)> = (0..field.config().points).map(point).collect();
    let (mut grad, mut other) = (reference.net.zeros(), reference.acceleration.zeros());
    reference.losses(&points, [&mut grad, &mut other]);
    field.clear_grads();
    field.regularise(1, 1);
    let (mut worst, mut want) = (0.0f64, grad.iter().chain(&other));
    field.visit(&mut |p| {
        let Some(want) = want.next() else { return };
        worst = worst.max(relative(&p.grad, want));
    });
    worst
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let free = LawConfig { accel_clamp: 0.0, ..LawConfig::default() };
    let small = LawConfig { hidden: 64, depth: 3, ..free.clone() };
    law("law 7x128 rk2", &free)?;
    law("law 3x64 rk2", &small)?;
    law("law 3x64 se3_mid", &LawConfig { integrator: Integrator::Se3Mid, ..small.clone() })?;
    law("law 3x64 gvfi13", &LawConfig { form: LawForm::Gvfi13, ..small })?;
    velocity("velocity 5x128", &VelocityConfig::default())?;
    velocity("velocity 3x64", &VelocityConfig::small())
}
