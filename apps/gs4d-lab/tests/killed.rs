//! Experiments killed at every operation on the disk and begun again: they end with the bits of undisturbed ones. A sweep, which is
//! contests, is killed at every third.

use gs_core::io::is_temporary;
use gs_core::testkit::faults::VARIABLE;
use gs_synth::{SynthOptions, write};
use gs_train::checkpoint::load_newest;
use gs4d_lab::contest::{Contest, Entry, Length, Results};
use gs4d_lab::continual;
use gs4d_lab::sweep::{Sweep, Vary};
use gs4d_run::Training;
use gs4d_run::settings::{Request, resolve};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;
use tempfile::TempDir;

/// Set for a child: the folder with the data, and the experiment, whose folder in it is `out`.
const FOLDER: &str = "GS4D_KILLED_TEST_FOLDER";
const EXPERIMENT: &str = "GS4D_KILLED_TEST_EXPERIMENT";

const SETS: [&str; 3] = ["run.checkpoint_every=2", "run.log_every=2", "init.points=60"];

fn train(folder: &Path) {
    let request = Request {
        method: "static3d".into(),
        preset: "tiny".into(),
        data: Some(folder.join("data")),
        steps: Some(3),
        sets: SETS.map(String::from).to_vec(),
        ..Request::default()
    };
    let resolved = resolve(gs_methods::registry(), &request).unwrap();
    let mut training = Training::begin(&folder.join("out"), true, resolved).unwrap();
    training.train(&AtomicBool::new(false), &mut |_, _| {}).unwrap();
}

fn contest(folder: &Path) -> Contest {
    Contest {
        registry: gs_methods::registry().clone(),
        data: folder.join("data"),
        root: folder.join("out"),
        preset: "tiny".into(),
        entries: vec![Entry::new("static3d")],
        seeds: vec![0],
        length: Length::Steps(3),
        sets: SETS.map(String::from).to_vec(),
    }
}

fn rounds(folder: &Path) -> continual::Plan {
    continual::Plan {
        registry: gs_methods::registry().clone(),
        request: Request {
            method: "defgs".into(),
            preset: "tiny".into(),
            data: Some(folder.join("data")),
            steps: Some(3),
            sets: SETS.map(String::from).to_vec(),
            ..Request::default()
        },
        rounds: continual::Rounds::Times { until: vec![0.4, 0.7], future: 0.2 },
        later_steps: 2,
        later_sets: Vec::new(),
        score_views: 1,
        command: String::new(),
    }
}

fn finished(results: Results) {
    assert!(results.missing.is_empty(), "{:?}", results.missing);
}

fn act(experiment: &str, folder: &Path) {
    let go = AtomicBool::new(false);
    match experiment {
        "train" => train(folder),
        "continual" => drop(continual::run(&rounds(folder), &folder.join("out"), false, &go, &mut |_| {}).unwrap()),
        "contest" => finished(contest(folder).run(&go, &mut |_| {}).unwrap()),
        _ => {
            let vary = [Vary::parse("schedule.lambda_dssim=0.5").unwrap()];
            let sweep = Sweep::new(contest(folder), &Entry::new("static3d"), &vary).unwrap();
            finished(sweep.contest.run(&go, &mut |_| {}).unwrap());
        }
    }
}

/// What a child does; nothing in the test itself.
#[test]
fn child() {
    if let Some(folder) = std::env::var_os(FOLDER) {
        act(&std::env::var(EXPERIMENT).unwrap(), Path::new(&folder));
    }
}

/// A folder with data of 16x16 pixels.
fn prepared(scene: &str) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    write(&dir.path().join("data"), scene, &SynthOptions::of_views(16, 6, 2), false).unwrap();
    dir
}

/// Everything below a folder.
fn below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.is_symlink() {
            found.extend(below(&path));
        }
        found.push(path);
    }
    found.sort();
    found
}

/// Names and bits of all tensors of a checkpoint.
type Bits = Vec<(String, Vec<u32>)>;

/// The folders of checkpoints below a folder, with the bits of the newest in each.
fn bits(folder: &Path) -> Vec<(PathBuf, Bits)> {
    let runs = below(folder).into_iter().filter(|path| path.ends_with("checkpoints"));
    let of = |path: PathBuf| {
        let tensors = load_newest(&path).unwrap().checkpoint.tensors;
        let bits = tensors.into_iter().map(|(name, t)| (name, t.iter().map(|v| v.to_bits()).collect()));
        (path.strip_prefix(folder).unwrap().to_owned(), bits.collect())
    };
    runs.map(of).collect()
}

/// Kills the experiment at the first operation and at every `step`-th after it, and begins it again; returns the number of operations,
/// or up to `step` - 1 more.
fn killed_at_operations(experiment: &str, scene: &str, step: usize) -> u64 {
    let dir = prepared(scene);
    let out = dir.path().join("out");
    act(experiment, dir.path());
    let undisturbed = bits(&out);
    assert!(!undisturbed.is_empty());
    for operation in (1..).step_by(step) {
        fs::remove_dir_all(&out).unwrap();
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "child", "--nocapture"]).env(FOLDER, dir.path()).env(EXPERIMENT, experiment);
        command.env(VARIABLE, format!("{operation}:kill")).stdout(Stdio::null()).stderr(Stdio::null());
        if command.status().unwrap().success() {
            return operation - 1;
        }
        act(experiment, dir.path());
        assert_eq!(bits(&out), undisturbed, "{experiment} killed at operation {operation}");
        let left: Vec<_> =
            below(dir.path()).into_iter().filter(|p| is_temporary(&p.file_name().unwrap().to_string_lossy())).collect();
        assert!(left.is_empty(), "{experiment} killed at operation {operation}: {left:?}");
    }
    unreachable!("the operations end")
}

#[test]
fn train_with_force_begins_again() {
    assert!(killed_at_operations("train", "static", 1) >= 30);
}

#[test]
fn a_contest_goes_on() {
    assert!(killed_at_operations("contest", "static", 1) >= 35);
}

#[test]
fn a_sweep_goes_on() {
    assert!(killed_at_operations("sweep", "static", 3) >= 70);
}

#[test]
fn rounds_go_on() {
    assert!(killed_at_operations("continual", "balls", 1) > 60);
}
