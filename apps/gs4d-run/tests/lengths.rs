//! Recipes in other lengths than their own: what holds for every method at a hundredth, a tenth, once and three times its length.

use gs_data::{Dataset, ImageCache, Split};
use gs_synth::testkit::{film, scene};
use gs_train::evaluate::evaluate;
use gs_train::registry::MethodEntry;
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_run::settings::{Request, Resolved, resolve};
use std::collections::BTreeSet;
use std::sync::Arc;

/// A recipe at a share of its length, with settings of its own.
fn at_length(method: &MethodEntry, preset: &str, share: f64, sets: &[&str]) -> Resolved {
    let registry = gs_methods::registry();
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let request = |steps| Request {
        method: method.name.into(),
        preset: preset.into(),
        steps,
        sets: sets.clone(),
        ..Request::default()
    };
    let own = resolve(registry, &request(None)).expect("settings").steps() as f64;
    resolve(registry, &request(Some((own * share).ceil() as u32))).expect("settings")
}

/// PSNR over all training views, dB.
fn psnr(trainer: &Trainer, data: &Dataset) -> f64 {
    let (model, images) = (trainer.model(), ImageCache::new(64 << 20, 1.0));
    let report = evaluate(model, data, Split::Train, model.background(), &images).expect("scores");
    report.mean.psnr.expect("finite scores")
}

/// The last step of each stage.
fn borders(trainer: &Trainer) -> Vec<u32> {
    let stages = trainer.schedule().ordered();
    (1..=stages.len()).map(|n| stages[..n].iter().map(|s| s.1.steps).sum()).collect()
}

/// Trains, and asserts that every view is drawn and that training views have not lost a decibel a twentieth of the run after a
/// border of stages.
fn trains_whole(method: &MethodEntry, preset: &str, share: f64, sets: &[&str], data: &Arc<Dataset>) {
    let resolved = at_length(method, preset, share, sets);
    let options = TrainOptions { seed: 1, ..TrainOptions::default() };
    let trainer = Trainer::new(&resolved.registry, data.clone(), method.name, &resolved.method, options);
    let mut trainer = trainer.expect("trainer");
    let (steps, what) = (trainer.steps(), format!("{} {preset} at {share} of its length", method.name));
    let (borders, later) = (borders(&trainer), (steps / 20).max(1));
    let (mut drawn, mut before) = (BTreeSet::new(), None);
    for step in 1..=steps {
        let report = trainer.step().expect("step");
        drawn.extend(data.train.iter().map(|v| v.name.clone()).filter(|name| report.view.contains(name.as_str())));
        if let Some((border, was)) = before.filter(|b: &(u32, f64)| step == b.0 + later) {
            let now = psnr(&trainer, data);
            assert!(
                now > was - 1.0,
                "{what}: {was:.2} dB after step {border}, the last of a stage, {now:.2} after {step}"
            );
        }
        if borders.contains(&step) && step < steps {
            before = Some((step, psnr(&trainer, data)));
        }
    }
    assert_eq!(drawn.len(), data.train.len(), "{what}: views drawn in {steps} steps");
    println!("{what}: {steps} steps, {:.2} dB", psnr(&trainer, data));
}

/// Presets, the shares of their lengths, and settings.
type Recipes = [(&'static str, &'static [f64], &'static [&'static str])];
/// Borders and draws of views are the same with few splats.
const SHORT: &Recipes = &[("fast", &[0.01], &["init.points=800"]), ("tiny", &[0.1], &[])];
/// A tenth of `tiny` of a person takes a minute.
const SHORT_OF_A_PERSON: &Recipes = &[("fast", &[0.01], &[]), ("tiny", &[0.03], &[])];
const LONG: &Recipes = &[("fast", &[0.01, 0.1, 1.0, 3.0], &[]), ("tiny", &[1.0], &[])];
/// A whole `tiny` of a person takes too long.
const LONG_OF_A_PERSON: &Recipes = &[("fast", &[0.01, 0.1, 1.0, 3.0], &[])];

fn trains(method: &MethodEntry, recipes: &Recipes) {
    let data = if method.needs_avatar { film("cylinder", 32, 2) } else { scene("balls", 32, 8) };
    for (preset, shares, sets) in recipes {
        shares.iter().for_each(|share| trains_whole(method, preset, *share, sets, &data));
    }
}

fn method(name: &str) -> &'static MethodEntry {
    gs_methods::registry().iter().find(|m| m.name == name).expect("a method")
}

/// Tests of each method by name, so that they run side by side: that short recipes draw every view and no stage undoes the one before,
/// and the same of long ones.
macro_rules! any_length {
    ($($name:ident: $method:literal),* $(,)?) => {
        mod short {
            $(
                #[test]
                fn $name() {
                    let method = super::method($method);
                    super::trains(method, if method.needs_avatar { super::SHORT_OF_A_PERSON } else { super::SHORT });
                }
            )*
        }

        mod long {
            $(
                #[test]
                #[ignore = "long: RAYON_NUM_THREADS=1 cargo test --release -p gs4d-run --test lengths -- --ignored"]
                fn $name() {
                    let method = super::method($method);
                    super::trains(method, if method.needs_avatar { super::LONG_OF_A_PERSON } else { super::LONG });
                }
            )*
        }

        #[test]
        fn every_method_has_its_tests() {
            assert!(gs_methods::registry().iter().map(|m| m.name).eq([$($method),*]));
        }
    };
}

any_length! {
    static3d: "static3d",
    scaffold: "scaffold",
    defgs: "defgs",
    fourdgs: "fourdgs",
    grid4d: "grid4d",
    fags: "fags",
    acutance: "acutance",
    modec: "modec",
    trace: "trace",
    trace_4dgs: "trace-4dgs",
    defgs_nvfi: "defgs-nvfi",
    dut: "dut",
}
