//! Roll-outs of motions with a closed form; the error is the distance of the end point from the true one.

use super::Case;
use glam::Vec3;
use gs_core::speed::BenchRow;
use gs_physics::truth::{self, Truth};
use gs_physics::{Integrator, Rollout};

const PARTICLES: usize = 20_000;
const STEPS: f64 = 30.0;
const RUNS: usize = 7;
const RULES: [(Integrator, &str); 3] =
    [(Integrator::Rk2, "rk2"), (Integrator::Se3Mid, "se3_mid"), (Integrator::Se3Magnus4, "se3_magnus4")];

pub(super) fn rows() -> Vec<BenchRow> {
    let scenes = [("circle", truth::circle()), ("rolling wheel", truth::wheel()), ("tumble", truth::tumble())];
    let all = scenes.iter().flat_map(|scene| RULES.iter().map(move |rule| row(scene, *rule)));
    all.collect()
}

fn row((name, truth): &(&str, Truth), (rule, variant): (Integrator, &'static str)) -> BenchRow {
    let rollout = Rollout { rule, dt: truth.span / STEPS, origin: Vec3::ZERO };
    let motions = vec![truth.motion.to_f32(); PARTICLES];
    let start = Vec3::from_array(truth.start.map(|v| v as f32));
    let (mut means, mut quats) = (vec![start; PARTICLES], vec![[1.0, 0.0, 0.0, 0.0]; PARTICLES]);
    rollout.advance(&motions, [0.0, truth.span], &mut means, &mut quats);
    let error = truth.position_error(means[0].to_array().map(f64::from));
    let case = Case {
        krate: "gs-physics",
        case: format!("{name}, {STEPS} steps"),
        variant,
        error_kind: "distance from the true end, world units",
    };
    case.row(PARTICLES, PARTICLES as f64 * STEPS, error, RUNS, || {
        rollout.advance(&motions, [0.0, truth.span], &mut means, &mut quats);
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rigid_rules_are_nearer_to_the_truth() {
        let rows = rows();
        let error = |case: &str, variant: &str| {
            rows.iter().find(|r| r.case.starts_with(case) && r.variant == variant).and_then(|r| r.error).unwrap()
        };
        for case in ["circle", "rolling wheel", "tumble"] {
            assert!(error(case, "se3_mid") < error(case, "rk2"), "{case}");
            assert!(error(case, "se3_magnus4") < error(case, "rk2"), "{case}");
        }
    }
}
