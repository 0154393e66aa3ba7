//! A run is a function of data, configuration and seed, not of interruptions. Compared bit for bit.

use crate::support::*;
use gs_core::Rng;
use gs_data::Dataset;
use gs_train::checkpoint::Checkpoint;
use gs_train::saved;
use gs_train::testkit::{self, timeless};
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

#[test]
fn resuming_at_any_step_continues_bit_for_bit() {
    let data = scene("balls", 32, 7);
    for (row, entry) in of_scenes().enumerate() {
        let mut whole = start(entry.name, &data);
        let mut states = vec![whole.state()];
        let mut grown = 0;
        for _ in 0..60 {
            let report = whole.step().expect("step");
            grown += report.adapted.cloned + report.adapted.split;
            states.push(whole.state());
        }
        assert!(grown > 0, "{}: growth took part", entry.name);
        let last = timeless(whole.state());
        // At the beginning, the reset (25), growth and the change of stage (30), after it, and where the dice of each method fall.
        let dice = Rng::new(9, "resume", 0, row as u64).below(60);
        for from in [0, 25, 30, 31, dice] {
            let state = &states[from as usize];
            let mut resumed =
                Trainer::resume(gs_methods::registry(), data.clone(), state, None, 1 << 20).expect("resume");
            assert_eq!(timeless(resumed.state()), timeless(state.clone()), "{} at {from}: save and load", entry.name);
            run(&mut resumed, 60 - from);
            assert!(timeless(resumed.state()) == last, "{}: resumed at {from}", entry.name);
        }
    }
}

/// A field has the time nodes that the moments of its first images can teach, and keeps them when more come.
#[test]
fn the_shape_of_a_field_stays_when_views_come() {
    let all = scene("balls", 32, 12);
    let first = Arc::new(Dataset { train: all.train[..6].to_vec(), ..Dataset::clone(&all) });
    for (method, section) in [("fourdgs", "field"), ("modec", "lgd"), ("trace-4dgs", "field")] {
        let over = format!("{section}.rows_per_moment = 0.5");
        let config = testkit::short(gs_methods::registry(), method, &[&over]);
        let planes = |trainer: &Trainer| {
            let mut values = 0;
            trainer.model().visit(&mut |p| values += if p.name.contains("planes") { p.len() } else { 0 });
            values
        };
        let mut trainer = testkit::start(gs_methods::registry(), &first, method, &config, 1);
        let few = planes(&trainer);
        assert!(few < planes(&testkit::start(gs_methods::registry(), &first, method, &short(method), 1)), "{method}");
        run(&mut trainer, 10);
        let mut more = trainer.with_more_views(gs_methods::registry(), all.clone(), &config).expect("more views");
        assert_eq!(planes(&more), few, "{method}");
        run(&mut more, 10);
    }
}

#[test]
fn seeds_matter() {
    let data = scene("balls", 32, 4);
    let state = |seed| {
        let options = TrainOptions { seed, ..TrainOptions::default() };
        let mut trainer =
            Trainer::new(gs_methods::registry(), data.clone(), "fourdgs", &short("fourdgs"), options).expect("trainer");
        run(&mut trainer, 3);
        trainer.state().tensors
    };
    assert_eq!(state(1), state(1));
    assert_ne!(state(1), state(2));
}

#[test]
fn damaged_states_are_refused_by_name() {
    let data = scene("balls", 32, 4);
    let state = start("fourdgs", &data).state();
    let refuse = |change: &dyn Fn(&mut Checkpoint)| {
        let mut damaged = state.clone();
        change(&mut damaged);
        saved::load(gs_methods::registry(), &damaged, None).err().expect("refused")
    };
    assert!(refuse(&|c| c.tensors.retain(|t| t.0 != "cloud.quats")).contains("`cloud.quats` is missing"));
    assert!(refuse(&|c| c.tensors[0].1.truncate(4)).contains("cloud.means"));
    assert!(refuse(&|c| c.tensors[3].1.truncate(8)).contains("cloud.quats"));
    assert!(refuse(&|c| c.tensors[1].1.truncate(3)).contains("cloud.means#m1"));
    assert!(refuse(&|c| c.tensors[0].1[4] = f32::NAN).contains("not finite at 4"));
    assert!(refuse(&|c| c.meta = serde_json::Value::Null).contains("meta"));
    assert!(refuse(&|c| c.meta["method"] = "none".into()).contains("`none`"));
    assert!(refuse(&|c| c.meta["extent"] = 0.into()).contains("extent"));
    let mut other = scene("balls", 32, 5);
    let error =
        Trainer::resume(gs_methods::registry(), other.clone(), &state, None, 0).err().expect("refused").to_string();
    assert!(error.contains("5 training views"), "{error}");
    Arc::make_mut(&mut other).train.truncate(4);
    assert!(Trainer::resume(gs_methods::registry(), other, &state, None, 0).is_ok());
}
