//! Bent kernels and the parts of FAGS: what they change, and that nothing changes without them.

use gs_core::Kernel;
use gs_method_field::METHODS;
use gs_synth::testkit::scene;
use gs_train::checkpoint::Checkpoint;
use gs_train::registry::Registry;
use gs_train::testkit::{config, run, short, start};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::StepReport;

/// The methods of this crate.
fn registry() -> Registry {
    Registry::new(METHODS.to_vec())
}

/// A run of 60 steps with growth, a reset and a change of stage, with TOML laid over its configuration.
fn short_run(method: &str, over: &str) -> Checkpoint {
    let config = short(&registry(), method, &[over]);
    let mut trainer = start(&registry(), &scene("balls", 32, 7), method, &config, 3);
    run(&mut trainer, 60);
    trainer.state()
}

fn column<'a>(state: &'a Checkpoint, name: &str) -> Option<&'a Vec<f32>> {
    state.tensors.iter().find(|t| t.0 == name).map(|t| &t.1)
}

/// Every tensor of `plain` stands in `other` too, with the same bits.
fn same(plain: &Checkpoint, other: &Checkpoint) -> bool {
    plain.tensors.iter().all(|(name, values)| column(other, name) == Some(values))
}

#[test]
fn a_frozen_kernel_is_the_gaussian_bit_for_bit() {
    for method in ["static3d", "fourdgs", "grid4d"] {
        let plain = short_run(method, "");
        let frozen = short_run(method, "[cloud.kernel]\nkind = 'frequency'\nlearn_lambda = false");
        assert!(same(&plain, &frozen), "{method}");
        let lambdas = column(&frozen, "cloud.lambda").expect("lambda");
        assert!(lambdas.iter().all(|&l| l == 0.0) && column(&plain, "cloud.lambda").is_none());
        let late = short_run(method, "[cloud.kernel]\nkind = 'acutance'\nfrom_step = 61");
        assert!(same(&plain, &late), "{method}");
        let learnt = short_run(method, "[cloud.kernel]\nkind = 'frequency'\nfrom_step = 25");
        assert!(!same(&plain, &learnt), "{method}: the kernel learns from step 25");
    }
}

#[test]
fn without_its_parts_fags_is_grid4d_bit_for_bit() {
    let plain = short_run("grid4d", "");
    let frozen = "ablate = 'hfe,gate,fre'\n[cloud.kernel]\nlearn_lambda = false";
    for (method, over) in [("fags", frozen), ("fags", "ablate = 'fdgk,hfe,gate,fre'"), ("acutance", "ablate = 'fdgk'")]
    {
        assert!(same(&plain, &short_run(method, over)), "{method} {over}");
    }
    for part in ["fdgk,hfe,gate", "fdgk,hfe,fre", "hfe,gate,fre"] {
        assert!(!same(&plain, &short_run("fags", &format!("ablate = '{part}'"))), "one part is left: {part}");
    }
}

#[test]
fn lambda_and_beta_are_left_out_by_name() {
    let one = short_run("fags", "ablate = 'lambda'");
    let lambda = column(&one, "cloud.lambda").expect("lambda");
    assert!(lambda.len() == 1 && lambda[0] != 0.0, "{lambda:?}");
    let still = short_run("fags", "ablate = 'beta'");
    let betas = column(&still, "cloud.beta").expect("beta");
    assert!(betas.iter().all(|b| b == &betas[0]) && betas.len() == column(&still, "cloud.lambda").expect("rows").len());
    let full = short_run("fags", "");
    assert!(column(&full, "cloud.beta").expect("beta").iter().any(|b| b != &betas[0]));
}

/// λ and β as drawn, and the smoothed loss before and after.
fn learnt(method: &str, scene_name: &str, over: &str) -> (Vec<f32>, Vec<f32>, [f64; 2]) {
    let data = scene(scene_name, 48, 60);
    let mut trainer = start(&registry(), &data, method, &config(&registry(), method, "tiny", &[over]), 0);
    let steps = trainer.steps().min(500);
    let reports = run(&mut trainer, steps);
    let mean = |r: &[StepReport]| r.iter().map(|r| r.loss.total).sum::<f64>() / r.len() as f64;
    let loss = [mean(&reports[..50]), mean(&reports[reports.len() - 50..])];
    let splats = trainer.model().splats(&Timestamp::new(data.test[0].time), &data.test[0].camera).expect("splats");
    let Kernel::Frequency { lambdas, betas } = splats.kernel else { panic!("frequency") };
    (lambdas, betas, loss)
}

/// FAGS weighs spectra so that they neither vanish beside L1 nor drown it.
#[test]
fn the_spectral_loss_is_of_the_size_of_l1() {
    let longer = "[schedule.stages]\ndynamic.steps = 1000";
    let config = config(&registry(), "fags", "tiny", &[longer]);
    let mut trainer = start(&registry(), &scene("sheet", 48, 60), "fags", &config, 0);
    let reports = run(&mut trainer, 1000);
    let mean = |of: &dyn Fn(&StepReport) -> f64| reports[900..].iter().map(of).sum::<f64>() / 100.0;
    let spectra = 0.3 * mean(&|r| r.loss.term("fre").expect("a term of FAGS"));
    let share = spectra / mean(&|r| r.loss.l1);
    println!("spectra, weighted, are {share:.2} of L1");
    assert!((0.1..=10.0).contains(&share), "weighted, {share} of L1");
}

#[test]
fn fall_offs_are_learnt_on_moving_and_on_still_scenes() {
    let frequency = "[cloud.kernel]\nkind = 'frequency'\n[schedule.lr.cloud]\nlambda.start = 2e-2\nbeta.start = 2e-2";
    for (method, scene, over) in [("fags", "sheet", ""), ("static3d", "static", frequency)] {
        let (lambdas, betas, [before, after]) = learnt(method, scene, over);
        assert!(after < 0.6 * before, "{method}: loss {before} before, {after} after");
        let away = lambdas.iter().filter(|l| (*l - 0.5).abs() > 0.02).count();
        assert!(2 * away > lambdas.len(), "{method}: {away} of {} kernels differ from the Gaussian", lambdas.len());
        assert!(betas.iter().any(|b| (b - 0.5).abs() > 0.02), "{method}: beta follows");
    }
}
