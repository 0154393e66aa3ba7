//! A run is the same bits on any number of ranks, and when it is resumed with another number.

use crate::support::*;
use gs_data::Dataset;
use gs_train::checkpoint::Checkpoint;
use gs_train::registry::overlay;
use gs_train::testkit::{on_ranks, timeless};
use gs_train::trainer::{TrainError, Trainer};
use std::sync::Arc;

const STEPS: u32 = 40;
/// Leaves of the sums: no power of two, and more than some ranks.
const BATCH: u32 = 3;

/// A short run of every method, with all its stages and density control inside the steps.
fn runs() -> impl Iterator<Item = (&'static str, Arc<Dataset>, toml::Table)> {
    let (balls, film) = (scene("balls", 32, 7), film("cylinder", 32, 2));
    let batch: toml::Table = format!("schedule.batch = {BATCH}").parse().expect("TOML");
    gs_methods::registry().iter().map(move |entry| {
        let data = if entry.needs_avatar { &film } else { &balls };
        let mut config = if entry.needs_avatar { film_config(&[SHORT_FILM]) } else { short(entry.name) };
        overlay(&mut config, batch.clone());
        (entry.name, data.clone(), config)
    })
}

/// The state on so many ranks, after so many steps at most.
fn reached(data: &Arc<Dataset>, trainer: Trainer, ranks: usize, steps: u32) -> Checkpoint {
    let lead = |mut trainer: Trainer| {
        let steps = steps.min(trainer.steps()) - trainer.steps_done();
        run(&mut trainer, steps);
        trainer.gather().expect("state");
        timeless(trainer.state())
    };
    on_ranks(gs_methods::registry(), data, trainer, ranks, lead)
}

/// The first tensor that differs.
fn difference(a: &Checkpoint, b: &Checkpoint) -> Option<String> {
    let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let mut tensors = a.tensors.iter().zip(&b.tensors);
    let tensor = tensors.find(|((a, x), (b, y))| a != b || bits(x) != bits(y));
    tensor.map(|(a, _)| a.0.clone()).or_else(|| (a.meta != b.meta).then(|| "meta".to_owned()))
}

#[test]
fn any_number_of_ranks_gives_the_same_bits() {
    for (name, data, config) in runs() {
        let start = || gs_train::testkit::start(gs_methods::registry(), &data, name, &config, 3);
        let one = reached(&data, start(), 1, STEPS);
        assert_eq!(difference(&one, &reached(&data, start(), 4, STEPS)), None, "{name} on four ranks");
        let resume = |state: &Checkpoint| {
            Trainer::resume(gs_methods::registry(), data.clone(), state, None, 1 << 20).expect("resume")
        };
        let half = reached(&data, start(), 3, STEPS / 2);
        let end = reached(&data, resume(&half), 2, STEPS);
        assert_eq!(difference(&one, &end), None, "{name} on three ranks, then two");
    }
}

#[test]
fn statistics_that_are_kept_for_long_are_the_same_bits_on_any_number_of_ranks() {
    let (_, data, mut config) = runs().find(|run| run.0 == "static3d").expect("method");
    overlay(&mut config, "schedule.density.every = 1000".parse().expect("TOML"));
    let start = || gs_train::testkit::start(gs_methods::registry(), &data, "static3d", &config, 3);
    let one = reached(&data, start(), 1, STEPS);
    for ranks in [2, 4, 5] {
        assert_eq!(difference(&one, &reached(&data, start(), ranks, STEPS)), None, "{ranks} ranks");
    }
}

#[test]
fn an_image_that_one_rank_cannot_read_ends_all_with_its_name() {
    let (_, data, config) = runs().find(|run| run.0 == "fourdgs").expect("method");
    let mut broken = Dataset::clone(&data);
    broken.train.iter_mut().for_each(|view| view.image = gs_data::ImageSource::File("/missing.png".into()));
    let start = gs_train::testkit::start(gs_methods::registry(), &data, "fourdgs", &config, 3);
    // The first rank has its images, the second has none.
    let lead = |mut trainer: Trainer| trainer.step();
    let error = on_ranks(gs_methods::registry(), &Arc::new(broken), start, 2, lead).expect_err("one rank fails");
    assert!(matches!(&error, TrainError::Rank { rank: 1, code: 3, .. }), "{error:?}");
    assert!(error.to_string().contains("missing.png"), "{error}");
}
