use super::sequence::{bounded, part, timestamps};
use super::*;
use gs_synth::{SynthOptions, generate, write};
use gs_train::checkpoint::load_newest;
use gs4d_run::settings::{lengthen, resolve};
use std::sync::Arc;
use std::sync::atomic::Ordering;

#[test]
fn rounds_are_planned_by_times_and_by_frames() {
    let times = |until: &[f64], future| Rounds::Times { until: until.to_vec(), future }.plan(&[]);
    assert_eq!(times(&[0.25, 0.5], 0.25).unwrap()[1], Round { last: 0.5, end: 0.75 });
    for (until, future) in
        [(&[][..], 0.1), (&[0.5, 0.5], 0.1), (&[0.0, 0.5], 0.1), (&[0.5, 1.0], 0.1), (&[0.5], 0.0), (&[0.5], f64::NAN)]
    {
        assert!(times(until, future).is_err(), "{until:?} {future}");
    }
    let moments: Vec<f64> = (0..150).map(|k| f64::from(k) / 149.0).collect();
    let frames = |first, per_round, next, last| Rounds::Frames { first, per_round, next, last }.plan(&moments);
    // PanopticSports: frames 0 to 14, one more each round, the next ten scored, up to the 135th.
    let rounds = frames(15, 1, 10, Some(135)).unwrap();
    assert_eq!((rounds.len(), rounds[0].last, rounds[0].end), (121, moments[14], moments[24]));
    assert_eq!((rounds[120].last, rounds[120].end), (moments[134], moments[144]));
    assert_eq!(frames(15, 1, 10, None).unwrap().len(), 126, "as long as ten frames are left");
    for (first, per_round, next) in [(0, 1, 1), (1, 0, 1), (1, 1, 0), (141, 1, 10), (1, 1, 150)] {
        assert!(frames(first, per_round, next, None).is_err(), "{first} {per_round} {next}");
    }
}

/// Four cameras and a held-out one, each late by its own thousandth: a frame is what all of them saw.
#[test]
fn frames_are_those_of_all_cameras() {
    let options =
        SynthOptions { size: 8, cameras: 4, held_out: 1, moments: 6, supersample: 1, ..SynthOptions::default() };
    let mut data = generate("balls", &options).unwrap().dataset;
    for view in [&mut data.train, &mut data.test, &mut data.extrapolate].into_iter().flatten() {
        view.time.normalised += 1e-3 * view.camera_id as f32;
    }
    let times = timestamps(&data);
    assert_eq!(times.len(), 6);
    let rounds = Rounds::Frames { first: 3, per_round: 1, next: 1, last: Some(3) }.plan(&times).unwrap();
    let seen = part(&data, rounds[0]);
    assert_eq!((rounds.len(), seen.train.len(), seen.test.len(), seen.extrapolate.len()), (1, 12, 3, 5));
}

fn data(dir: &Path) {
    let o = SynthOptions::of_views(24, 24, 8);
    write(dir, "balls", &o, false).unwrap();
}

fn plan(data: &Path) -> Plan {
    Plan {
        registry: gs_methods::registry().clone(),
        request: Request {
            method: "defgs".into(),
            preset: "tiny".into(),
            data: Some(data.to_owned()),
            steps: Some(12),
            ..Request::default()
        },
        rounds: Rounds::Times { until: vec![0.3, 0.5, 0.7], future: 0.2 },
        later_steps: 5,
        later_sets: vec!["schedule.lr.cloud.sh_dc.start=0.0007".into()],
        score_views: 0,
        command: "gs4d continual".into(),
    }
}

#[test]
fn every_round_sees_more_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let (from, root) = (dir.path().join("data"), dir.path().join("run"));
    data(&from);
    let stop = AtomicBool::new(false);
    let mut steps = Vec::new();
    let rounds = run(&plan(&from), &root, false, &stop, &mut |event| {
        if let Event::Step(p) = event {
            steps.push(p.step);
        }
    });
    let rounds = rounds.unwrap().unwrap();
    assert_eq!(steps, (1..=22).collect::<Vec<_>>(), "one clock for all rounds");
    assert_eq!(rounds.iter().map(|r| r.steps).collect::<Vec<_>>(), [12, 17, 22]);
    assert!(rounds.windows(2).all(|r| r[0].views < r[1].views));
    let finite = |m: &Option<MeanScores>| m.as_ref().is_some_and(|m| m.psnr.is_some_and(|p| p > 3.0));
    assert!(rounds.iter().all(|r| finite(&r.interpolation) && finite(&r.extrapolation)), "{rounds:?}");
    // What it leaves is a run like any other: its data end where the last round did.
    let open = gs4d_run::OpenRun::open(gs_methods::registry(), &root).unwrap();
    assert_eq!((open.loaded.step, open.resolved.data.time_boundary), (22, Some(0.7)));
    let last = open.resolved.open_data().unwrap();
    assert_eq!(last.train.len(), rounds[2].views);
    assert!(
        (open.loaded.scene.last_time - last.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max)).abs() < 1e-9
    );
    let rate = |key: &str| open.resolved.config.get(key).unwrap().value.as_float().unwrap();
    assert_eq!(rate("schedule.lr.cloud.sh_dc.start"), 0.0007);
    assert_eq!(rate("schedule.lr.cloud.means.start"), rate("schedule.lr.cloud.means.end"));
    assert!(root.join(FILE).is_file() && root.join("report.html").is_file());
    let again = dir.path().join("again");
    let same = run(&plan(&from), &again, false, &stop, &mut |_| {}).unwrap().unwrap();
    assert_eq!(
        same.iter().map(|r| r.extrapolation).collect::<Vec<_>>(),
        rounds.iter().map(|r| r.extrapolation).collect::<Vec<_>>(),
        "the same seed, the same bits"
    );
}

#[test]
fn the_trainer_goes_on_with_the_same_parameters() {
    let dir = tempfile::tempdir().unwrap();
    let from = dir.path().join("data");
    data(&from);
    let resolved = bounded(&resolve(gs_methods::registry(), &plan(&from).request).unwrap(), 0.7).unwrap();
    let whole = resolved.open_data().unwrap();
    let of = |last| Arc::new(part(&whole, Round { last, end: 1.0 }));
    let mut training = Training::begin_on(&dir.path().join("run"), false, resolved.clone(), of(0.3), None).unwrap();
    training.train(&AtomicBool::new(false), &mut |_, _| {}).unwrap();
    let before = training.trainer().state();
    let grown = training.grow(lengthen(&resolved, 20, 12).unwrap(), of(0.6)).unwrap();
    let after = grown.trainer().state();
    assert_eq!(before.tensors, after.tensors, "parameters and moments, bit for bit");
    assert_eq!(before.meta["adam_updates"], after.meta["adam_updates"]);
    let last = |c: &gs_train::checkpoint::Checkpoint| c.meta["last_time"].as_f64().unwrap();
    assert!(last(&before) <= 0.3 + 1e-6 && last(&after) > 0.5 && last(&after) <= 0.6 + 1e-6);
    assert_eq!(grown.trainer().steps_done(), 12);
}

/// What a run ends with: the bits of its newest checkpoint, and the scores without the seconds.
fn result(root: &Path, rounds: &[RoundScores]) -> (Vec<(String, Vec<u32>)>, Vec<RoundScores>) {
    let tensors = load_newest(&root.join("checkpoints")).unwrap().checkpoint.tensors;
    let bits = tensors.into_iter().map(|(name, t)| (name, t.iter().map(|v| v.to_bits()).collect()));
    (bits.collect(), rounds.iter().map(|r| RoundScores { seconds: 0.0, ..r.clone() }).collect())
}

#[test]
fn a_run_that_is_interrupted_goes_on_with_the_same_bits() {
    let dir = tempfile::tempdir().unwrap();
    let from = dir.path().join("data");
    data(&from);
    let plan = plan(&from);
    let root = dir.path().join("whole");
    let whole = run(&plan, &root, false, &AtomicBool::new(false), &mut |_| {}).unwrap().unwrap();
    let whole = result(&root, &whole);
    // Steps after which a session ends: each one; in every round; between rounds; before the first step.
    for (name, ends) in [("each", None), ("rounds", Some([5, 14, 19])), ("between", Some([0, 12, 17]))] {
        let root = dir.path().join(name);
        let (mut sessions, mut steps) = (0, Vec::new());
        let rounds = loop {
            let limit = ends.map_or(sessions + 1, |ends: [u32; 3]| ends.get(sessions as usize).copied().unwrap_or(99));
            let stop = AtomicBool::new(limit == 0);
            let made = run(&plan, &root, false, &stop, &mut |event| {
                if let Event::Step(p) = event {
                    steps.push(p.step);
                    stop.store(p.step >= limit, Ordering::Relaxed);
                }
            });
            sessions += 1;
            if let Some(rounds) = made.unwrap() {
                break rounds;
            }
        };
        assert_eq!(sessions, if ends.is_some() { 4 } else { 22 }, "{name}");
        assert_eq!(steps, (1..=22).collect::<Vec<_>>(), "{name}: no step is made twice");
        assert_eq!(result(&root, &rounds), whole, "{name}");
    }
}

#[test]
fn another_plan_and_the_verb_resume_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (from, root) = (dir.path().join("data"), dir.path().join("run"));
    data(&from);
    let plan = plan(&from);
    let go = AtomicBool::new(false);
    let stopped = run(&plan, &root, false, &AtomicBool::new(true), &mut |_| {}).unwrap();
    assert!(stopped.is_none());
    let resumed = Training::resume(&plan.registry, &root, &gs4d_run::ResumeRequest::default()).err().unwrap();
    assert!(resumed.to_string().ends_with("is trained in rounds: go on with `gs4d continual`"), "{resumed}");
    let other = Plan { later_steps: 6, ..plan.clone() };
    let refused = run(&other, &root, false, &go, &mut |_| {}).unwrap_err();
    assert!(matches!(refused, RunError::OtherSettings { .. }), "{refused}");
    let overwritten = run(&other, &root, true, &go, &mut |_| {}).unwrap().unwrap();
    assert_eq!(overwritten.iter().map(|r| r.steps).collect::<Vec<_>>(), [12, 18, 24]);
    std::fs::remove_file(root.join(FILE)).unwrap();
    let error = run(&other, &root, false, &go, &mut |_| {}).unwrap_err();
    assert!(error.to_string().contains("lacks the scores of round 1"), "{error}");
}

#[test]
fn rounds_do_not_go_on_with_other_data() {
    let dir = tempfile::tempdir().unwrap();
    let (from, root) = (dir.path().join("data"), dir.path().join("run"));
    data(&from);
    let plan = plan(&from);
    let go = AtomicBool::new(false);
    // It ends within the second round.
    let stop = AtomicBool::new(false);
    let ended = run(&plan, &root, false, &stop, &mut |event| {
        if let Event::Step(p) = event {
            stop.store(p.step >= 14, Ordering::Relaxed);
        }
    });
    assert!(ended.unwrap().is_none());
    // An image of a later round.
    let last = from.join("train/r_023.png");
    let image = std::fs::read(&last).unwrap();
    std::fs::copy(from.join("train/r_000.png"), &last).unwrap();
    let refused = run(&plan, &root, false, &go, &mut |_| {}).unwrap_err();
    assert!(matches!(refused, RunError::DataChanged { .. }), "{refused}");
    std::fs::write(&last, image).unwrap();
    assert!(run(&plan, &root, false, &go, &mut |_| {}).unwrap().is_some(), "the data it began with");
}
