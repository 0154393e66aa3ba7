use super::*;
use crate::settings::{Request, resolve};
use gs_core::testkit::faults::{Fault, Faults, with_faults};
use gs_synth::{SynthOptions, write};
use gs_train::checkpoint::{CheckpointError, load_newest, steps_in};
use gs_train::device::Device;
use gs_train::method::MethodError;
use gs_train::registry::Registry;
use gs_train::testkit::{fake_device, threads_as_ranks};
use serde_json::Value;
use std::sync::{Arc, Mutex};
use tempfile::TempDir;

/// A folder with data of 16x16 pixels.
fn prepared() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join("data"), "static", &SynthOptions::of_views(16, 3, 1), false).unwrap();
    dir
}

/// Settings of six steps that log every step and save every second.
fn settings(dir: &TempDir, time_budget: Option<f64>) -> Resolved {
    settings_that_log(dir, time_budget, 1)
}

/// The same that log every so many steps.
fn settings_that_log(dir: &TempDir, time_budget: Option<f64>, every: u32) -> Resolved {
    let log = format!("run.log_every={every}");
    let sets = ["run.checkpoint_every=2", &log, "init.points=60"].map(String::from).to_vec();
    let (method, preset, data) = ("static3d".into(), "tiny".into(), Some(dir.path().join("data")));
    let request = Request { method, preset, data, steps: Some(6), time_budget, sets, ..Request::default() };
    resolve(gs_methods::registry(), &request).unwrap()
}

/// A run of six steps, with the warnings it will give.
fn begin(dir: &TempDir, tries: usize) -> (Training, Arc<Mutex<Vec<String>>>) {
    let mut training = Training::begin(&dir.path().join("run"), true, settings(dir, None)).unwrap();
    let warnings = Arc::new(Mutex::new(Vec::new()));
    let told = Arc::clone(&warnings);
    let pauses = vec![Duration::from_millis(1); tries - 1];
    training.when_the_disk_refuses(pauses, move |text| told.lock().unwrap().push(text.to_owned()));
    (training, warnings)
}

fn train(training: &mut Training, faults: Option<Faults>) -> (Result<Outcome, RunError>, u64) {
    with_faults(faults, || training.train(&AtomicBool::new(false), &mut |_, _| {}))
}

fn logged(training: &Training) -> Vec<u64> {
    let lines = training.folder.log_lines(folder::LOG).unwrap();
    lines.iter().filter_map(|line| line["step"].as_u64()).collect()
}

#[test]
fn a_disk_that_is_full_for_a_while_ends_no_training() {
    let dir = prepared();
    let (mut undisturbed, _) = begin(&dir, 4);
    let (outcome, operations) = train(&mut undisturbed, None);
    assert_eq!((outcome.unwrap(), logged(&undisturbed)), (Outcome::Finished, (1..=6).collect()));
    let expected = undisturbed.trainer.state().tensors;
    drop(undisturbed);
    assert!(operations > 30, "{operations}");
    for kind in [Fault::Full, Fault::Files, Fault::Device] {
        for first in 1..=operations {
            let (mut training, warnings) = begin(&dir, 4);
            let (outcome, _) = train(&mut training, Some(Faults { first, count: 3, kind }));
            let name = format!("{kind:?} from {first}: {:?}", warnings.lock().unwrap());
            assert_eq!(outcome.unwrap(), Outcome::Finished, "{name}");
            assert_eq!(logged(&training), (1..=6).collect::<Vec<_>>(), "{name}");
            assert_eq!(load_newest(&training.folder.checkpoints()).unwrap().checkpoint.tensors, expected, "{name}");
        }
    }
}

#[test]
fn a_disk_that_stays_full_ends_the_training_after_the_last_try() {
    let dir = prepared();
    let (mut training, warnings) = begin(&dir, 4);
    // Steps 1 and 2 are logged, step 2 is saved; then the disk is full.
    let (outcome, _) = train(&mut training, Some(Faults { first: 12, count: 10_000, kind: Fault::Full }));
    let error = outcome.unwrap_err();
    assert!(matches!(&error, RunError::Checkpoint(CheckpointError::Write(_))), "{error}");
    let warnings = warnings.lock().unwrap();
    let tries: Vec<_> = warnings.iter().filter(|w| w.contains("trying again in 0.001 s")).collect();
    assert_eq!(tries.len(), 3, "{warnings:?}");
    assert!(tries.iter().all(|w| w.contains("step-000004.gs4d") && w.contains("bytes are free")), "{warnings:?}");
    assert_eq!(warnings.len(), 4, "one warning for the log: {warnings:?}");
    assert_eq!(steps_in(&training.folder.checkpoints()).unwrap(), [2]);
}

#[test]
fn a_run_is_begun_goes_on_and_is_finished_when_its_end_is_scored() {
    let dir = prepared();
    let (root, plain) = (dir.path().join("run"), settings(&dir, None));
    assert_eq!(Stage::of(&root, &plain).unwrap(), Stage::Missing);
    let stop = AtomicBool::new(false);
    let mut training = Training::go_on(&root, plain.clone()).unwrap();
    training.train(&stop, &mut |p, _| stop.store(p.step == 2, Ordering::Relaxed)).unwrap();
    training.score().unwrap();
    drop(training);
    assert_eq!(Stage::of(&root, &plain).unwrap(), Stage::Begun(2), "scores of step 2 are not the result");
    let other = settings(&dir, Some(1e3));
    assert!(matches!(Training::go_on(&root, other), Err(RunError::OtherSettings { .. })));

    let mut training = Training::go_on(&root, plain.clone()).unwrap();
    assert_eq!(training.trainer.steps_done(), 2);
    assert_eq!(train(&mut training, None).0.unwrap(), Outcome::Finished);
    assert_eq!(Stage::of(&root, &plain).unwrap(), Stage::Begun(6));
    let scored = Scored { scores: training.score().unwrap(), step: 6 };
    assert_eq!(Stage::of(&root, &plain).unwrap(), Stage::Finished(Box::new(scored)));
}

#[test]
fn a_run_goes_on_up_to_its_own_time_budget() {
    let dir = prepared();
    let (root, short) = (dir.path().join("run"), settings_that_log(&dir, Some(1e-9), 10));
    for _ in 0..2 {
        let mut training = Training::go_on(&root, short.clone()).unwrap();
        assert!(matches!(train(&mut training, None).0, Ok(Outcome::BudgetSpent(_))));
        assert_eq!(training.trainer.steps_done(), 1, "one step spends it");
        assert_eq!(logged(&training), [1], "what a session ends with is logged");
        training.score().unwrap();
    }
    assert!(matches!(Stage::of(&root, &short).unwrap(), Stage::Finished(scored) if scored.step == 1));
}

/// The devices that the provenance names: of the first session and of those that went on.
fn devices(training: &Training) -> Vec<String> {
    let provenance: Value = serde_json::from_str(&training.folder.read(folder::PROVENANCE).unwrap()).unwrap();
    let resumed = provenance["resumed"].as_array().into_iter().flatten();
    let machines = [&provenance].into_iter().chain(resumed).map(|session| &session["machine"]);
    machines.map(|machine| machine["device"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn a_device_that_is_lost_leaves_the_last_checkpoint_and_the_provenance_names_it() {
    let dir = prepared();
    let (mut undisturbed, _) = begin(&dir, 1);
    train(&mut undisturbed, None).0.unwrap();
    let expected = undisturbed.trainer.state().tensors;
    drop(undisturbed);
    // Forward and backward of three steps, then the fourth fails.
    let mut training = begin(&dir, 1).0.on(&fake_device(7).0).unwrap();
    assert_eq!((devices(&training), training.warnings()), (vec!["fake".to_owned()], &[][..]));
    let error = train(&mut training, None).0.unwrap_err();
    assert!(matches!(error, RunError::Train(TrainError::Method(MethodError::Device(_)))), "{error}");
    assert_eq!(steps_in(&training.folder.checkpoints()).unwrap(), [2]);
    let root = training.folder.root().to_owned();
    drop(training);
    let registry = gs_methods::registry();
    let resumed = Training::resume(registry, &root, &ResumeRequest::default()).unwrap();
    let mut resumed = resumed.on(&Device::default()).unwrap();
    assert_eq!(devices(&resumed), ["fake", "cpu"]);
    assert!(resumed.warnings()[0].contains("rendered on fake and goes on on cpu"), "{:?}", resumed.warnings());
    assert_eq!(train(&mut resumed, None).0.unwrap(), Outcome::Finished);
    assert!(resumed.trainer.state().tensors == expected, "the bits of a run never interrupted");
}

/// The second rank knows no method, so it cannot begin.
#[test]
fn an_older_run_stays_where_another_rank_cannot_begin() {
    let dir = prepared();
    let (mut older, _) = begin(&dir, 1);
    train(&mut older, None).0.unwrap();
    let (root, log) = (older.folder.root().to_owned(), logged(&older));
    drop(older);
    let mut ranks = threads_as_ranks(2);
    let (second, first) = (ranks.remove(1), ranks.remove(0));
    let begun = std::thread::scope(|scope| {
        let follow = move || crate::ranks::follow(&Registry::default(), &second, || {}).unwrap();
        let followed = scope.spawn(follow);
        let begun = Training::begin_with_ranks(&root, true, settings(&dir, None), first.clone()).map(drop);
        crate::ranks::dismiss(&*first, 2);
        assert_eq!(followed.join().unwrap(), 2);
        begun
    });
    let error = begun.unwrap_err();
    assert!(matches!(&error, RunError::Train(TrainError::Rank { rank: 1, .. })), "{error}");
    let older = RunFolder::open(&root).unwrap();
    assert_eq!(steps_in(&older.checkpoints()).unwrap(), [6, 4]);
    assert_eq!(older.log_lines(folder::LOG).unwrap().len(), log.len());
}

#[test]
fn a_run_that_never_decides_which_splats_are_still_says_so() {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join("data"), "balls", &SynthOptions::of_views(16, 3, 1), false).unwrap();
    let warnings = |every: u32| {
        let every = format!("still.every={every}");
        let sets = ["still.pixels=0.5", &every, "init.points=60"].map(String::from).to_vec();
        let (method, preset, data) = ("fourdgs".into(), "tiny".into(), Some(dir.path().join("data")));
        let request = Request { method, preset, data, steps: Some(60), sets, ..Request::default() };
        let resolved = resolve(gs_methods::registry(), &request).unwrap();
        Training::begin(&dir.path().join("run"), true, resolved).unwrap().warnings().to_vec()
    };
    assert_eq!(warnings(1), [""; 0]);
    assert!(matches!(&warnings(200)[..], [warning] if warning.contains("still.every = 200")));
}
