//! Helpers shared by tests of dynamics.

pub mod particles;

use gs_core::nn::BLOCK;
use gs_core::{Params, Rng};
use gs_physics::reference::Pose;
use gs_physics::{Dynamics, ParticleState};
use particles::{cotangents, points, start};

/// Row `i` in `f64`.
pub fn pose(moves: &ParticleState, i: usize) -> Pose {
    (moves.means[i].as_dvec3().to_array(), moves.rotations[i].map(f64::from))
}

/// Positions before quaternions.
pub fn flat(p: Pose) -> [f64; 7] {
    std::array::from_fn(|k| if k < 3 { p.0[k] } else { p.1[k - 3] })
}

pub fn dot(a: Pose, b: Pose) -> f64 {
    flat(a).iter().zip(flat(b)).map(|(a, b)| a * b).sum()
}

pub fn close(got: f64, want: f64, tolerance: f64, what: &str) {
    assert!((got - want).abs() < tolerance * (1.0 + want.abs()), "{what}: {got} {want}");
}

/// Spreads weights so that outputs are of order one and every term counts.
pub fn randomise_weights(params: &mut impl Params, weights: f32) {
    params.visit_mut(&mut |p| {
        let mut rng = Rng::new(5, &p.name, 0, 0);
        let spread = if p.name.ends_with("bias") { 0.6 } else { weights };
        p.value.iter_mut().for_each(|v| *v += spread * rng.range(-0.5, 0.5));
    });
}

/// Gradients of the blocks whose names start with `prefix` against the reference's, relative to the largest of each.
pub fn compare_gradients(params: &impl Params, prefix: &str, want: &[Vec<f64>], tolerance: f64) {
    let mut want = want.iter();
    params.visit(&mut |p| {
        if p.name.starts_with(prefix) {
            let want = want.next().unwrap();
            let largest = want.iter().fold(1e-9f64, |m, g| m.max(g.abs()));
            for (g, w) in p.grad.iter().zip(want) {
                assert!((f64::from(*g) - w).abs() < tolerance * largest, "{}: {g} {w} of {largest}", p.name);
            }
        }
    });
    assert!(want.next().is_none());
}

/// An empty span: positions and rotations to the last bit, no gradient, even where the tape is warm.
pub fn empty_span_is_identity<D: Dynamics>(mut dynamics: D) {
    let (x, mut tape, mut out) = (points(BLOCK + 3), D::Tape::default(), ParticleState::default());
    dynamics.integrate(start(&x, 0.2), 0.5, &mut tape, &mut out);
    dynamics.integrate(start(&x, 0.4), 0.4, &mut tape, &mut out);
    assert_eq!(out.means, x);
    assert!(out.rotations.iter().all(|q| *q == [1.0, 0.0, 0.0, 0.0]));
    dynamics.integrate_backward(start(&x, 0.4), &mut tape, &cotangents(x.len()));
    dynamics.visit(&mut |p| assert!(p.grad.iter().all(|g| *g == 0.0)));
}

/// All results of a step, as bits.
fn step<D: Dynamics>(dynamics: &mut D, tape: &mut D::Tape, n: usize) -> Vec<u32> {
    let (x, mut out) = (points(n), ParticleState::default());
    dynamics.clear_grads();
    dynamics.integrate(start(&x, 0.3), 0.38, tape, &mut out);
    dynamics.integrate_backward(start(&x, 0.3), tape, &cotangents(n));
    let mut bits: Vec<u32> = out.means.iter().flat_map(|v| v.to_array()).map(f32::to_bits).collect();
    bits.extend(out.rotations.iter().flatten().map(|v| v.to_bits()));
    bits.extend(dynamics.regularise(3, 7).iter().map(|v| v.1.to_bits()));
    dynamics.visit(&mut |p| bits.extend(p.grad.iter().map(|v| v.to_bits())));
    bits
}

/// Threads and warm tapes change nothing.
pub fn reproducible<D: Dynamics>(make: impl Fn() -> D + Sync) {
    // More blocks than chunks, and a ragged end.
    let n = 11 * BLOCK + 17;
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| step(&mut make(), &mut D::Tape::default(), n))
    };
    let one = on(1);
    assert!(one == on(2) && one == on(4), "results depend on the number of threads");
    let (mut dynamics, mut tape) = (make(), D::Tape::default());
    for n in [n + 300, 0, 1, BLOCK, BLOCK + 1] {
        assert_eq!(step(&mut dynamics, &mut tape, n), step(&mut make(), &mut D::Tape::default(), n), "n = {n}");
    }
    assert!(step(&mut dynamics, &mut tape, n) == one, "a warm tape changes the result");
}
