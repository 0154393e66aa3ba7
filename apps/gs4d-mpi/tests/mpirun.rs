//! `mpirun -n N gs4d-mpi`: the bits of one rank, resuming with other numbers of ranks, ranks that are killed.
//!
//! Needs Open MPI and the cargo feature:
//! ```text
//! cargo test -p gs4d-mpi --features mpi -- --ignored
//! ```
#![cfg(feature = "mpi")]

use gs_synth::SynthOptions;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

const STEPS: &str = "40";

/// A folder with data and runs.
struct Place {
    _folder: tempfile::TempDir,
    root: PathBuf,
}

fn place() -> Place {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().to_owned();
    gs_synth::write(&root.join("data"), "balls", &SynthOptions::of_views(32, 7, 1), false).unwrap();
    Place { _folder: folder, root }
}

impl Place {
    fn path(&self, name: &str) -> String {
        self.root.join(name).display().to_string()
    }

    fn train(&self, method: &str, run: &str, more: &[&str]) -> Vec<String> {
        let (data, out) = (self.path("data"), self.path(run));
        let all = ["train", &data, "-m", method, "--preset", "tiny", "--steps", STEPS, "-q", "--threads", "1"];
        let sets = ["--set", "schedule.batch=3", "--set", "init.points=150", "--out", &out];
        all.iter().chain(&sets).chain(more).map(|word| (*word).to_owned()).collect()
    }
}

/// The command on so many ranks, which may be more than cores.
fn on_ranks(ranks: usize, words: &[String]) -> Command {
    let mut command = Command::new("mpirun");
    command.args(["-n", &ranks.to_string(), "--oversubscribe", env!("CARGO_BIN_EXE_gs4d-mpi")]).args(words);
    for (name, value) in [
        ("OMPI_ALLOW_RUN_AS_ROOT", "1"),
        ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1"),
        ("OMPI_MCA_btl", "self,vader,tcp"),
        ("OMPI_MCA_plm_rsh_agent", "/bin/false"),
        ("OMPI_MCA_odls_base_sigkill_timeout", "1"),
    ] {
        command.env(name, value);
    }
    command
}

fn run(ranks: usize, words: &[String]) -> Output {
    on_ranks(ranks, words).output().expect("mpirun: install openmpi-bin")
}

fn good(ranks: usize, words: &[String]) {
    let output = run(ranks, words);
    assert!(output.status.success(), "{words:?} on {ranks} ranks:\n{}", String::from_utf8_lossy(&output.stderr));
}

/// The tensors of the newest checkpoint: all bytes of the file but its metadata, which holds seconds.
fn tensors(run: &Path) -> Vec<(String, Vec<u32>)> {
    let newest = gs_train::checkpoint::load_newest(&run.join("checkpoints")).unwrap();
    let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect();
    newest.checkpoint.tensors.into_iter().map(|(name, values)| (name, bits(values))).collect()
}

#[test]
#[ignore = "needs Open MPI"]
fn any_number_of_ranks_gives_the_same_bits_and_files() {
    let place = place();
    for method in ["static3d", "grid4d", "modec", "trace"] {
        let name = |ranks: usize| format!("{method}-{ranks}");
        for ranks in [1, 2, 3] {
            good(ranks, &place.train(method, &name(ranks), &[]));
        }
        let one = tensors(&place.root.join(name(1)));
        for ranks in [2, 3] {
            let run = place.root.join(name(ranks));
            assert!(one == tensors(&run), "{method} on {ranks} ranks");
            assert!(run.join("metrics.json").is_file() && run.join("report.html").is_file());
        }
    }
}

#[test]
#[ignore = "needs Open MPI"]
fn a_run_goes_on_with_another_number_of_ranks() {
    let place = place();
    good(1, &place.train("fourdgs", "whole", &[]));
    good(3, &place.train("fourdgs", "parts", &["--time-budget", "0.001s"]));
    let resume = |steps: &str| {
        ["resume", &place.path("parts"), "--threads", "1", "-q"]
            .map(str::to_owned)
            .to_vec()
            .into_iter()
            .chain(["--steps".into(), steps.into()])
            .collect::<Vec<_>>()
    };
    good(2, &resume(STEPS));
    assert!(tensors(&place.root.join("whole")) == tensors(&place.root.join("parts")));
}

#[test]
#[ignore = "needs Open MPI"]
fn a_rank_that_is_killed_costs_the_steps_since_the_last_checkpoint() {
    let place = place();
    let sets = ["--set", "run.checkpoint_every=5"];
    good(1, &place.train("fourdgs", "whole", &sets));
    let words = place.train("fourdgs", "killed", &[&sets[..], &["--continue"]].concat());
    let (mut killed, mut rng) = (0, gs_core::Rng::new(5, "kill", 0, 0));
    for _ in 0..30 {
        let mut job = on_ranks(3, &words).stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_secs_f32(rng.range(0.2, 0.9)));
        let victim = rank_of(job.id(), rng.below(3) as usize);
        if let Some(pid) = victim {
            Command::new("kill").args(["-KILL", &pid]).status().unwrap();
        }
        let status = job.wait().unwrap();
        killed += usize::from(!status.success());
        let checkpoints = place.root.join("killed/checkpoints");
        if checkpoints.is_dir() && fs::read_dir(&checkpoints).unwrap().next().is_some() {
            gs_train::checkpoint::load_newest(&checkpoints).expect("a good checkpoint");
        }
    }
    assert!(killed > 0, "no job was met while it ran");
    println!("{killed} of 30 jobs killed");
    good(2, &words);
    assert!(tensors(&place.root.join("whole")) == tensors(&place.root.join("killed")));
}

/// The process of a rank of a job, by its parent.
fn rank_of(job: u32, rank: usize) -> Option<String> {
    let output = Command::new("pgrep").args(["-P", &job.to_string(), "gs4d-mpi"]).output().ok()?;
    String::from_utf8_lossy(&output.stdout).lines().nth(rank).map(str::to_owned)
}

#[test]
#[ignore = "needs Open MPI"]
fn what_cannot_begin_ends_all_ranks() {
    let place = place();
    good(2, &place.train("static3d", "run", &[]));
    let again = run(2, &place.train("static3d", "run", &[]));
    assert!(!again.status.success());
    assert!(String::from_utf8_lossy(&again.stderr).contains("holds a run already"));
    let wrong = run(2, &["train".to_owned()]);
    assert_eq!(wrong.status.code(), Some(2), "{}", String::from_utf8_lossy(&wrong.stderr));
    good(3, &["methods".to_owned()]);
}
