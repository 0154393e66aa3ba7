//! `mpirun -n N gs4d-mpi`: the bits of one rank, resuming with other numbers of ranks, ranks that fail or are killed.
//!
//! Needs Open MPI and the cargo feature:
//! ```text
//! cargo test -p gs4d-mpi --features mpi -- --ignored
//! ```
#![cfg(feature = "mpi")]

use gs_synth::SynthOptions;
use gs_synth::avatar::{self, AvatarOptions};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

const STEPS: u32 = 40;

/// A folder with data and runs.
struct Place {
    _folder: tempfile::TempDir,
    root: PathBuf,
}

fn place() -> Place {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().to_owned();
    gs_synth::write(&root.join("data"), "balls", &SynthOptions::of_views(32, 7, 1), false).unwrap();
    let film = AvatarOptions { template: "builtin:cylinder".into(), frames: 4, size: 32, ..AvatarOptions::default() };
    avatar::write(&root.join("film"), &film, false, false).unwrap();
    Place { _folder: folder, root }
}

impl Place {
    fn path(&self, name: &str) -> String {
        self.root.join(name).display().to_string()
    }

    fn train(&self, method: &str, run: &str, steps: u32, more: &[&str]) -> Vec<String> {
        let (data, out) = (self.path(if method == "dut" { "film" } else { "data" }), self.path(run));
        let all =
            ["train", &data, "-m", method, "--preset", "tiny", "--steps", &steps.to_string(), "-q", "--threads", "1"];
        let sets = ["--set", "schedule.batch=3", "--set", "init.points=150", "--out", &out];
        all.iter().chain(&sets).chain(more).map(|word| (*word).to_owned()).collect()
    }

    /// The folder of a run of [`STEPS`] steps.
    fn trained(&self, ranks: usize, method: &str, run: &str, more: &[&str]) -> PathBuf {
        good(ranks, &self.train(method, run, STEPS, more));
        self.root.join(run)
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

fn run_on(ranks: usize, words: &[String]) -> Output {
    on_ranks(ranks, words).output().expect("mpirun: install openmpi-bin")
}

fn good(ranks: usize, words: &[String]) {
    let output = run_on(ranks, words);
    assert!(output.status.success(), "{words:?} on {ranks} ranks:\n{}", String::from_utf8_lossy(&output.stderr));
}

/// The tensors of the newest checkpoint: all bytes of the file but its metadata, which holds seconds.
fn tensors(run: &Path) -> Vec<(String, Vec<u32>)> {
    let newest = gs_train::checkpoint::load_newest(&run.join("checkpoints")).unwrap();
    let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect();
    newest.checkpoint.tensors.into_iter().map(|(name, values)| (name, bits(values))).collect()
}

/// The scores of a run, without the seconds it took.
fn scores(run: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(run.join("metrics.json")).unwrap();
    let mut scores: serde_json::Value = serde_json::from_str(&text).unwrap();
    scores.as_object_mut().unwrap().remove("train_seconds").expect("seconds");
    scores
}

/// Runs of every method on each of these numbers of ranks end with the bits of one rank, and with its files.
fn compare_with_one_rank(counts: &[usize]) {
    let place = place();
    for method in gs_methods::registry().iter().map(|entry| entry.name) {
        let name = |ranks: usize| format!("{method}-{ranks}");
        let alone = place.trained(1, method, &name(1), &[]);
        let (one, scores) = (tensors(&alone), scores(&alone));
        for &ranks in counts {
            let run = place.trained(ranks, method, &name(ranks), &[]);
            assert!(one == tensors(&run), "{method} on {ranks} ranks");
            assert_eq!(scores, self::scores(&run), "{method} on {ranks} ranks");
            assert!(run.join("report.html").is_file());
        }
    }
}

/// The files below a folder, with their bytes.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        files.push((path.strip_prefix(folder).unwrap().to_owned(), std::fs::read(&path).unwrap()));
    }
    files.sort();
    files
}

#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn renders_scores_and_files_of_three_ranks_are_those_of_one() {
    let place = place();
    let run = place.trained(1, "fourdgs", "run", &[]);
    let (out, one) = (place.root.join("out"), place.root.join("one"));
    let words = |line: &str| -> Vec<String> {
        let all = line.replace("RUN", &run.display().to_string()).replace("OUT", &out.display().to_string());
        all.split(' ').map(str::to_owned).collect()
    };
    for line in [
        "render RUN --camera orbit --times 0..1:7 -o OUT",
        "render RUN --camera orbit --times 0..1:7 --format y4m -o OUT",
        "render RUN --camera dataset:0 --format exr -o OUT",
        "export RUN --times 0..1.5:5 -o OUT",
    ] {
        good(1, &words(line));
        std::fs::rename(&out, &one).unwrap();
        good(3, &words(line));
        assert!(!files(&one).is_empty() && files(&one) == files(&out), "{line}");
        let again = run_on(3, &words(line));
        let error = String::from_utf8_lossy(&again.stderr);
        assert!(!again.status.success() && error.contains("exist"), "{error}");
        [&one, &out].iter().for_each(|folder| std::fs::remove_dir_all(folder).unwrap());
    }
    let whole = words("export RUN -o OUT.gs4d --json");
    let compact = |ranks: usize| {
        let output = run_on(ranks, &whole);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let again = run_on(ranks, &whole);
        let error = String::from_utf8_lossy(&again.stderr);
        assert!(!again.status.success() && error.contains("exists already"), "{error}");
        let file = out.with_extension("gs4d");
        let bytes = std::fs::read(&file).unwrap();
        std::fs::remove_file(&file).unwrap();
        (output.stdout, bytes)
    };
    assert!(compact(1) == compact(3), "export of a run whole");
    let eval = words("eval RUN --json");
    let answer = |ranks: usize| {
        std::fs::remove_file(run.join("metrics.json")).unwrap();
        let output = run_on(ranks, &eval);
        assert!(output.status.success() && !output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
        (output.stdout, std::fs::read(run.join("metrics.json")).unwrap())
    };
    assert!(answer(1) == answer(3), "eval");
}

/// The step of the newest checkpoint of a folder.
fn newest_step(checkpoints: &Path) -> Option<u32> {
    gs_train::checkpoint::steps_in(checkpoints).ok()?.first().copied()
}

#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn two_ranks_give_the_bits_of_one() {
    compare_with_one_rank(&[2]);
}

#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn more_ranks_give_the_bits_of_one() {
    compare_with_one_rank(&[3, 4]);
}

#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn a_run_goes_on_with_another_number_of_ranks() {
    let place = place();
    for method in gs_methods::registry().iter().map(|entry| entry.name) {
        let [whole, parts] = ["whole", "parts"].map(|name| format!("{method}-{name}"));
        let whole = place.trained(1, method, &whole, &[]);
        let parts = place.trained(3, method, &parts, &["--time-budget", "0.001s"]);
        let begun = newest_step(&parts.join("checkpoints")).unwrap();
        assert!(begun < STEPS, "{method}: {begun}");
        let words = ["resume", &parts.display().to_string(), "--threads", "1", "-q", "--steps", &STEPS.to_string()];
        good(2, &words.map(str::to_owned));
        assert!(tensors(&whole) == tensors(&parts), "{method}");
    }
}

#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn a_rank_that_is_killed_costs_the_steps_since_the_last_checkpoint() {
    let place = place();
    let (steps, every) = (5000, 5);
    let every_few = ["--set", &format!("run.checkpoint_every={every}")];
    good(1, &place.train("fourdgs", "whole", steps, &every_few));
    let words = place.train("fourdgs", "killed", steps, &[&every_few[..], &["--continue"]].concat());
    let checkpoints = place.root.join("killed/checkpoints");
    let (mut step, mut rng) = (0, gs_core::Rng::new(5, "kill", 0, 0));
    for kill in 0..30 {
        let mut job = on_ranks(3, &words).stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
        let victim = ranks_of(&mut job, 3)[rng.below(3) as usize].clone();
        std::thread::sleep(Duration::from_secs_f32(rng.range(0.0, 1.0)));
        assert!(Command::new("kill").args(["-KILL", &victim]).status().unwrap().success(), "kill {kill}: it is done");
        assert!(!job.wait().unwrap().success(), "kill {kill}");
        if let Some(newest) = newest_step(&checkpoints) {
            let loaded = gs_train::checkpoint::load_newest(&checkpoints).expect("a good checkpoint");
            assert!(newest >= step && loaded.skipped.is_empty(), "kill {kill}");
            step = newest;
        }
    }
    println!("30 jobs killed, the last at step {step} or up to {every} later");
    assert!(step > 0 && step < steps);
    good(2, &words);
    assert!(tensors(&place.root.join("whole")) == tensors(&place.root.join("killed")));
}

#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn a_job_that_is_told_to_stop_is_saved() {
    let place = place();
    good(1, &place.train("fourdgs", "whole", 1000, &["--set", "run.checkpoint_every=100000"]));
    let words = place.train("fourdgs", "stopped", 1000, &["--continue", "--set", "run.checkpoint_every=100000"]);
    let mut job = on_ranks(3, &words).stderr(Stdio::null()).spawn().unwrap();
    let begun = place.root.join("stopped/log.jsonl");
    wait_until(&mut job, || std::fs::metadata(&begun).is_ok_and(|log| log.len() > 0));
    assert!(Command::new("kill").args(["-USR1", &job.id().to_string()]).status().unwrap().success());
    assert_eq!(job.wait().unwrap().code(), Some(130));
    let step = newest_step(&place.root.join("stopped/checkpoints")).expect("a checkpoint");
    assert!(step < 1000, "{step}");
    good(2, &words);
    assert!(tensors(&place.root.join("whole")) == tensors(&place.root.join("stopped")));
}

/// Waits until a running job has come so far.
fn wait_until(job: &mut Child, come: impl Fn() -> bool) {
    while !come() {
        assert!(job.try_wait().unwrap().is_none(), "the job ended");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// What a job ends with, which it does within a minute.
fn ended(mut job: Child) -> Output {
    let begun = Instant::now();
    while job.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_secs(60) {
            Command::new("kill").arg(job.id().to_string()).status().unwrap();
            panic!("the job hangs");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    job.wait_with_output().unwrap()
}

/// Every step draws all seven views; the last of three ranks has the last of them, and decodes it in each.
#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn a_rank_that_fails_in_a_step_ends_the_job_with_its_name_and_the_reason() {
    let place = place();
    let more = ["--set", "schedule.batch=7", "--set", "run.checkpoint_every=2", "--image-cache", "0"];
    let words = place.train("fourdgs", "run", 100_000, &more);
    let mut job = on_ranks(3, &words).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let checkpoints = place.root.join("run/checkpoints");
    wait_until(&mut job, || newest_step(&checkpoints).is_some());
    std::fs::remove_file(place.root.join("data/train/r_006.png")).unwrap();
    let output = ended(job);
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{error}");
    assert!(error.contains("rank 2: ") && error.contains("r_006.png"), "{error}");
    gs_train::checkpoint::load_newest(&checkpoints).expect("a good checkpoint");
}

/// The processes of a job, when all are there.
fn ranks_of(job: &mut Child, ranks: usize) -> Vec<String> {
    loop {
        let output = Command::new("pgrep").args(["-P", &job.id().to_string(), "gs4d-mpi"]).output().unwrap();
        let found: Vec<String> = String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect();
        if found.len() == ranks {
            return found;
        }
        assert!(job.try_wait().unwrap().is_none(), "the job ended");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
#[ignore = "needs Open MPI: cargo test -p gs4d-mpi --features mpi -- --ignored"]
fn what_cannot_begin_ends_all_ranks() {
    let place = place();
    good(2, &place.train("static3d", "run", STEPS, &[]));
    let again = run_on(2, &place.train("static3d", "run", STEPS, &[]));
    assert!(!again.status.success());
    assert!(String::from_utf8_lossy(&again.stderr).contains("holds a run already"));
    let wrong = run_on(2, &["train".to_owned()]);
    assert_eq!(wrong.status.code(), Some(2), "{}", String::from_utf8_lossy(&wrong.stderr));
    good(3, &["methods".to_owned()]);
}
