//! What a pass of density control keeps, adds and removes.

use super::*;
use glam::Vec3;

const AT: DensifyContext = DensifyContext { step: 600, clock: 600, extent: 1.0, seed: 5, white: false };

fn cloud(sigmas: &[f32]) -> Cloud {
    let at: Vec<Vec3> = (0..sigmas.len()).map(|i| Vec3::splat(i as f32)).collect();
    Cloud::from_points(&at, &vec![[0.5; 3]; sigmas.len()], sigmas, 0.5, 1).unwrap()
}

fn seen(grad: &[f32]) -> ScreenStats {
    ScreenStats { grad_means2d: grad.iter().map(|&g| [g, 0.0]).collect(), radii: vec![1.2; grad.len()] }
}

#[test]
fn small_clone_large_split_faint_go() {
    let mut c = cloud(&[0.001, 0.5, 0.001, 0.001]);
    c.logit_opacities.value[3] = logit(0.001);
    c.means.moment1.fill(3.0);
    let mut d = Densify::new(4);
    // Half of 100 pixels times 1e-4 is 5e-3 in half-image units: above the threshold.
    d.accumulate(&seen(&[1e-4, 1e-4, 0.0, 0.0]), 100, 100);
    let did = d.densify(&DensifyRules::kerbl2023(), &AT, &mut c).unwrap();
    assert_eq!(did, DensifyStats { cloned: 1, split: 1, pruned: 1, reset: false });
    assert_eq!(c.len(), 5);
    assert_eq!(c.means.value[..3], [0.0; 3]);
    assert_eq!(c.means.value[6..9], [0.0; 3], "the clone is an exact copy");
    for child in 3..5 {
        assert!((c.log_scales.value[3 * child].exp() - 0.5 / 1.6).abs() < 1e-6);
        assert!(c.means.value[3 * child..3 * child + 3].iter().any(|v| *v != 1.0), "children are samples");
    }
    assert_ne!(c.means.value[9..12], c.means.value[12..15]);
    assert_eq!((c.means.moment1[0], c.means.moment1[6], d.seen.len(), d.seen[0]), (3.0, 0.0, 5, 0.0));
}

#[test]
fn children_follow_the_gaussian_of_their_parent() {
    let (mut mean, mut square, runs) = (0.0f64, [0.0f64; 3], 4000);
    for step in 0..runs {
        let mut c = cloud(&[0.5]);
        c.log_scales.value.copy_from_slice(&[0.1f32.ln(), 0.2f32.ln(), 0.4f32.ln()]);
        c.quats.value.copy_from_slice(&[0.5f32.sqrt(), 0.0, 0.0, 0.5f32.sqrt()]);
        place_child(&mut c, 0, 1.6, &mut Rng::new(1, "split", step, 0));
        mean += f64::from(c.means.value[0]) / f64::from(runs);
        for (s, v) in square.iter_mut().zip(&c.means.value) {
            *s += f64::from(v * v) / f64::from(runs);
        }
    }
    // A quarter turn about z swaps the first two axes.
    assert!(mean.abs() < 0.02);
    assert!(square.iter().zip([0.04, 0.01, 0.16]).all(|(a, b)| (a / b - 1.0).abs() < 0.1), "{square:?}");
}

#[test]
fn size_rules_live_after_the_first_reset_only() {
    let rules = DensifyRules::kerbl2023();
    let run = |clock| {
        let mut c = cloud(&[0.2, 0.001, 0.001]);
        let mut d = Densify::new(3);
        d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 3], radii: vec![1.0, 30.0, 1.0] }, 64, 64);
        d.densify(&rules, &DensifyContext { clock, ..AT }, &mut c).unwrap().pruned
    };
    assert_eq!((run(2900), run(3100)), (0, 2));
}

/// As in the reference code: how large a splat is in the world is known without a view, its radius on the screen is not.
#[test]
fn a_splat_too_large_for_the_world_goes_unseen_as_well() {
    let pruned = |radius: f32| {
        let mut c = cloud(&[0.2, 0.001, 0.001]);
        c.logit_opacities.value[2] = logit(0.001);
        let mut d = Densify::new(3);
        d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 3], radii: vec![radius; 3] }, 64, 64);
        let did = d.densify(&DensifyRules::kerbl2023(), &DensifyContext { clock: 3100, ..AT }, &mut c).unwrap();
        (did.pruned, c.means.value[0])
    };
    assert_eq!([0.0, 1.0].map(pruned), [(1, 1.0), (2, 1.0)], "the small one stays, unseen the faint one too");
}

#[test]
fn only_what_was_seen_is_pruned_and_never_below_the_least_number() {
    let run = |seen: f32, min_splats| {
        let mut c = cloud(&[0.001; 4]);
        c.logit_opacities.value[..2].fill(logit(0.001));
        let mut d = Densify::new(4);
        let radii = vec![1.2, seen, 1.2, 1.2];
        d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 4], radii }, 64, 64);
        let rules = DensifyRules { min_splats, ..DensifyRules::kerbl2023() };
        (d.densify(&rules, &AT, &mut c).unwrap().pruned, c.len())
    };
    assert_eq!((run(1.2, 0), run(0.0, 0)), ((2, 2), (1, 3)));
    assert_eq!((run(1.2, 2), run(1.2, 3)), ((2, 2), (0, 4)));
}

/// 4DGS prunes only clouds of some size, and seldom.
#[test]
fn pruning_has_a_turn_and_a_least_size_of_its_own() {
    let run = |clock, prune_above, prune_every| {
        let mut c = cloud(&[0.001; 4]);
        c.logit_opacities.value[0] = logit(0.001);
        let mut d = Densify::new(4);
        d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 4], radii: vec![1.2; 4] }, 64, 64);
        let rules = DensifyRules { prune_above, prune_every, every: 100, ..DensifyRules::kerbl2023() };
        d.densify(&rules, &DensifyContext { clock, ..AT }, &mut c).unwrap().pruned
    };
    assert_eq!([0, 3, 4].map(|above| run(600, above, 0)), [1, 1, 0]);
    assert_eq!([700, 800, 900, 1600].map(|clock| run(clock, 0, 800)), [0, 1, 0, 1]);
    // A turn that is no multiple of the passes comes with the pass after it.
    assert_eq!([700, 800, 1500, 1600].map(|clock| run(clock, 0, 750)), [0, 1, 1, 0]);
}

#[test]
fn below_the_least_number_splats_grow_and_none_is_pruned() {
    let mut c = cloud(&[0.001, 0.5, 0.001]);
    c.logit_opacities.value[2] = logit(0.001);
    let mut d = Densify::new(3);
    d.accumulate(&seen(&[1e-4, 1e-4, 0.0]), 100, 100);
    let rules = DensifyRules { min_splats: 1024, ..DensifyRules::kerbl2023() };
    let did = d.densify(&rules, &AT, &mut c).unwrap();
    assert_eq!(did, DensifyStats { cloned: 1, split: 1, pruned: 0, reset: false });
    assert_eq!((c.len(), c.logit_opacities.value[1]), (5, logit(0.001)));
}

#[test]
fn the_cap_admits_the_largest_gradients() {
    let mut c = cloud(&[0.001; 4]);
    let mut d = Densify::new(4);
    d.accumulate(&seen(&[1e-4, 4e-4, 2e-4, 3e-4]), 100, 100);
    let rules = DensifyRules { max_splats: 6, ..DensifyRules::kerbl2023() };
    assert_eq!(d.densify(&rules, &AT, &mut c).unwrap().cloned, 2);
    assert_eq!((c.means.value[12], c.means.value[15]), (1.0, 3.0));
}

#[test]
fn something_always_stays() {
    let mut c = cloud(&[0.001; 3]);
    c.logit_opacities.value.copy_from_slice(&[-9.0, -8.0, -8.5]);
    let mut d = Densify::new(3);
    d.accumulate(&seen(&[0.0; 3]), 64, 64);
    let did = d.densify(&DensifyRules::kerbl2023(), &AT, &mut c).unwrap();
    assert_eq!((c.len(), c.means.value[0], did.pruned), (1, 1.0, 2));
}

#[test]
fn resets_come_when_due() {
    let rules = DensifyRules::kerbl2023();
    let never = DensifyRules { reset_every: 0, ..rules.clone() };
    assert!((0..20_000).all(|clock| !never.resets_at(clock, true)));
    assert!(rules.resets_at(3000, false) && rules.resets_at(500, true));
    assert!(!rules.resets_at(500, false) && !rules.resets_at(15_000, false) && !rules.resets_at(2999, true));
    let mut c = cloud(&[0.001; 2]);
    c.logit_opacities.value[1] = -5.0;
    c.logit_opacities.moment2.fill(1.0);
    assert!(Densify::new(2).densify(&rules, &DensifyContext { clock: 3000, ..AT }, &mut c).unwrap().reset);
    assert!((sigmoid(c.logit_opacities.value[0]) - 0.01).abs() < 1e-6 && c.logit_opacities.value[1] == -5.0);
    assert_eq!(c.logit_opacities.moment2, [0.0; 2]);
}

#[test]
fn kernels_are_inherited_and_outlive_a_reset() {
    let (mode, beta_hi) = (gs_core::kernel::BetaMode::Capped, 0.98);
    let init = gs_core::cloud::KernelInit::Frequency { mode, beta_hi, shared_lambda: false };
    let mut c = cloud(&[0.001, 0.5]).with_kernel(init).unwrap();
    for p in c.kernel.as_mut().unwrap().params_mut() {
        p.value.copy_from_slice(&[3.0, -2.0]);
        p.moment2.fill(1.0);
    }
    let mut d = Densify::new(2);
    d.accumulate(&seen(&[1e-4, 1e-4]), 100, 100);
    let rules = DensifyRules { reset_every: 600, ..DensifyRules::kerbl2023() };
    let did = d.densify(&rules, &AT, &mut c).unwrap();
    assert_eq!(did, DensifyStats { cloned: 1, split: 1, pruned: 0, reset: true });
    for p in c.kernel.as_ref().unwrap().params() {
        assert_eq!(p.value, [3.0, 3.0, -2.0, -2.0], "{}: the kept, its copy, two children", p.name);
        assert_eq!(p.moment2, [1.0, 0.0, 0.0, 0.0], "{}", p.name);
    }
}

#[test]
fn poisoned_statistics_do_no_harm() {
    let mut d = Densify::new(2);
    d.accumulate(&seen(&[f32::NAN, f32::INFINITY]), 10, 10);
    assert_eq!((d.grad_sum.clone(), d.seen.clone()), (vec![0.0; 2], vec![1.0; 2]));
}
