//! Adam, with its error against a closed form: under a constant gradient `g` each step is `−lr · sign(g)` (ε → 0).

use super::Case;
use gs_core::Param;
use gs_core::speed::BenchRow;
use gs_train::adam::{Adam, Refused, Update};

const VALUES: usize = 1 << 20;
const STEPS: usize = 50;
const RATE: f32 = 1e-3;
/// Plain Adam.
pub(super) const UPDATE: Update = Update { rate: RATE, eps: 1e-15, sparse: false, weight_decay: 0.0, ramp: 0 };

pub(super) fn rows() -> Vec<BenchRow> {
    let error = constant_gradient_error();
    let mut p = Param::rows("p", 4, vec![0.0; VALUES]);
    let (mut adam, mut refused) = (Adam::default(), Refused::default());
    let case = Case {
        krate: "gs-train",
        case: "adam".to_owned(),
        variant: "fused update",
        error_kind: "largest, after 50 equal gradients, closed form",
    };
    let row = case.row(VALUES, VALUES as f64, error, 9, || {
        p.grad.fill(0.5);
        adam.update(&mut p, UPDATE, &mut refused);
    });
    vec![row]
}

fn constant_gradient_error() -> f64 {
    let gradients = [1.0f32, -1e-4, 3.7, -250.0];
    let mut p = Param::rows("p", 4, vec![0.0; 4]);
    let (mut adam, mut refused) = (Adam::default(), Refused::default());
    for _ in 0..STEPS {
        p.grad.copy_from_slice(&gradients);
        adam.update(&mut p, UPDATE, &mut refused);
    }
    let want = |g: f32| -f64::from(RATE) * STEPS as f64 * f64::from(g.signum());
    p.value.iter().zip(gradients).map(|(v, g)| (f64::from(*v) - want(g)).abs()).fold(0.0, f64::max)
}
