//! Contests and sweeps as lists of jobs: planned, run by a shell or a scheduler, collected. The recipes are those of the guide.
#![cfg(unix)]

use crate::guide::{blocks, guide, run_line};
use crate::runs::state;
use crate::support::{Call, command, data, good, gs4d, text};
use serde_json::Value;
use std::fs;
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use tempfile::TempDir;

/// The folder of a user whose `PATH` has this build of gs4d.
struct Desk {
    dir: TempDir,
}

impl Desk {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("bin")).unwrap();
        symlink(env!("CARGO_BIN_EXE_gs4d"), dir.path().join("bin/gs4d")).unwrap();
        Self { dir }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// A script in the folder; it replaces a program of that name.
    fn program(&self, name: &str, script: &str) {
        let path = self.at("bin").join(name);
        fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn sh(&self, script: &str) -> Call {
        let path = format!("{}:{}", text(&self.at("bin")), std::env::var("PATH").unwrap_or_default());
        let mut sh = Command::new("sh");
        sh.args(["-c", script]).current_dir(self.dir.path()).env("PATH", path).env("HOME", self.dir.path());
        Call::of(&sh.output().unwrap())
    }

    fn good_sh(&self, script: &str) -> Call {
        let call = self.sh(script);
        assert_eq!(call.code, 0, "{script}: {}{}", call.out, call.err);
        call
    }
}

/// The chapter about clusters: plans, runs the jobs, collects. The list of jobs has two lines.
fn chapter(run_jobs: impl Fn(&Desk, &str)) {
    let desk = Desk::new();
    let chapter = fs::read_to_string(guide().join("cluster.md")).unwrap();
    let [plan, collect] = &blocks(&chapter, "sh")[..] else { panic!("one block to plan, one to collect") };
    plan.lines().for_each(|line| run_line("cluster.md", line, desk.dir.path()));
    run_jobs(&desk, &chapter);
    collect.lines().for_each(|line| run_line("cluster.md", line, desk.dir.path()));
}

/// The block of a chapter that holds a word.
fn block(chapter: &str, language: &str, word: &str) -> String {
    blocks(chapter, language).into_iter().find(|b| b.contains(word)).unwrap_or_else(|| panic!("no block has {word}"))
}

/// Whether a program is there; says that a test is skipped if not.
fn there(program: &str, test: &str, sign: &str) -> bool {
    let version = Command::new(program).arg("--version").output();
    let there = version.is_ok_and(|v| String::from_utf8_lossy(&v.stdout).contains(sign));
    if !there {
        let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {program} is absent");
    }
    there
}

#[test]
fn the_guide_with_sh() {
    chapter(|desk, text| drop(desk.good_sh(&block(text, "bash", "sh jobs.txt"))));
}

#[test]
fn the_guide_with_gnu_parallel() {
    if there("parallel", "the_guide_with_gnu_parallel", "GNU parallel") {
        chapter(|desk, text| drop(desk.good_sh(&block(text, "bash", "parallel"))));
    }
}

#[test]
fn the_guide_with_snakemake() {
    if there("snakemake", "the_guide_with_snakemake", ".") {
        chapter(|desk, text| {
            fs::write(desk.at("Snakefile"), block(text, "python", "rule train")).unwrap();
            desk.good_sh(&block(text, "bash", "snakemake"));
        });
    }
}

/// Slurm's own programs are stand-ins.
#[test]
fn the_guide_with_the_script_for_slurm() {
    chapter(|desk, text| {
        desk.program("srun", "exec \"$@\"");
        desk.program("scontrol", "echo \"$@\" > requeued");
        fs::write(desk.at("job.sh"), block(text, "bash", "#SBATCH")).unwrap();
        for task in 1..=2 {
            desk.good_sh(&format!("SLURM_ARRAY_TASK_ID={task} sh job.sh"));
        }
        assert!(!desk.at("requeued").exists());
        desk.program("srun", "exit 130");
        assert_eq!(desk.sh("SLURM_ARRAY_TASK_ID=1 SLURM_JOB_ID=7 sh job.sh").code, 130);
        assert_eq!(fs::read_to_string(desk.at("requeued")).unwrap(), "requeue 7\n");
    });
}

/// The result without what differs between two trainings of the same: seconds and folders.
fn timeless(mut json: Value) -> Value {
    for entry in json["entries"].as_array_mut().unwrap() {
        entry["over_seeds"].as_object_mut().unwrap().remove("seconds");
        entry.as_object_mut().unwrap().remove("trials");
    }
    json
}

#[test]
fn a_plan_trains_what_the_contest_trains() {
    let desk = Desk::new();
    let odd = desk.at("it's \"$HOME\" a|b");
    symlink(data(), &odd).unwrap();
    let (own, planned) = (desk.at("own"), desk.at("planned; $(rm) `x`"));
    let entries = ["-e", "static3d", "-e", "fourdgs:tiny init.points=90"];
    let shared = ["--preset", "tiny", "--steps", "12", "--seeds", "0,1", "--set", "run.log_every=3"];
    let base = [&["contest", text(&odd)][..], &entries, &shared].concat();
    let with = |out: &Path, more: &[&str]| gs4d(&[&base[..], &["-o", text(out)], more].concat());

    let trained = with(&own, &["--json"]);
    assert_eq!(with(&own, &["--json", "--collect"]).out, trained.out, "collected with the same bytes");
    let jobs = desk.at("jobs.txt");
    let plan = with(&planned, &["--plan", text(&jobs), "--threads", "1", "--json"]).json();
    assert!(plan["pilots"] == false && plan["jobs"].as_array().unwrap().len() == 4, "{plan}");
    assert!(!planned.exists() && fs::read_to_string(&jobs).unwrap().starts_with("gs4d --threads 1 train "));
    with(&planned, &["--plan", text(&jobs)]).fails(6, &["list of jobs exists", "-f"]);
    assert_eq!(with(&planned, &["--collect", "--json"]).code, 7);

    desk.good_sh("sh jobs.txt");
    let first = with(&planned, &["--collect", "--json"]);
    assert_eq!(timeless(first.json()), timeless(trained.json()));
    for run in ["static3d/seed-1", "fourdgs_tiny_init.points=90/seed-0"] {
        assert_eq!(state(&own.join(run)), state(&planned.join(run)), "{run}");
    }
    let scores = planned.join("static3d/seed-0/metrics.json");
    let before = fs::metadata(&scores).unwrap().modified().unwrap();
    assert!(desk.good_sh("sh jobs.txt").err.contains("nothing is left to train"));
    assert_eq!(fs::metadata(&scores).unwrap().modified().unwrap(), before);
    assert_eq!(with(&planned, &["--collect", "--json"]).out, first.out);
}

#[test]
fn relative_paths_and_another_program_stand_as_typed() {
    let desk = Desk::new();
    symlink(data(), desk.at("data")).unwrap();
    let vary = ["--vary", "init.points=50|60", "--preset", "tiny", "--steps", "4", "-o", "out"];
    let sweep = |more: &[&str]| {
        let all = [&["sweep", "data", "-m", "static3d"][..], &vary, more].concat();
        Call::of(&command(&all).current_dir(desk.dir.path()).output().unwrap())
    };
    assert_eq!(sweep(&["--plan", "jobs.txt", "--relative", "--program", "nice -n 1 gs4d"]).code, 0);
    let lines = fs::read_to_string(desk.at("jobs.txt")).unwrap();
    assert!(lines.starts_with("nice -n 1 gs4d train data --method static3d "), "{lines}");
    assert!(lines.lines().count() == 3 && lines.ends_with(" --out out/static3d_init.points=60/seed-0\n"), "{lines}");
    desk.good_sh("sh jobs.txt");
    let collected = sweep(&["--collect"]);
    let files = || ["sweep.json", "sweep.csv", "sweep.html"].map(|name| fs::read(desk.at("out").join(name)).unwrap());
    let first = files();
    assert_eq!((collected.code, sweep(&[]).out, files()), (0, collected.out.clone(), first));

    fs::remove_dir_all(desk.at("out/static3d_init.points=50")).unwrap();
    let partly = sweep(&["--collect"]);
    assert!(partly.code == 7 && partly.out.contains("init.points=50  "), "{}", partly.out);
    assert!(partly.err.contains("missing: static3d init.points=50 / seed-0"), "{}", partly.err);
    let json: Value = serde_json::from_slice(&files()[0]).unwrap();
    assert!(json["missing"].as_array().unwrap().len() == 1 && json["rows"][1]["psnr"].is_null(), "{json}");
    let nothing = ["--collect", "-o", "nowhere", "--json"];
    let all = [&["sweep", "data", "-m", "static3d"][..], &vary[..6], &nothing].concat();
    let nothing = Call::of(&command(&all).current_dir(desk.dir.path()).output().unwrap());
    assert!(nothing.code == 7 && nothing.out.contains("\"missing\""), "{}{}", nothing.out, nothing.err);
}

#[test]
fn a_line_goes_on_after_sigterm_with_the_same_bits() {
    let desk = Desk::new();
    let base = ["contest", text(data()), "-e", "static3d", "--preset", "tiny", "--steps", "300"];
    let own = desk.at("own");
    good(&[&base[..], &["-o", text(&own), "-q"]].concat());
    let (out, jobs) = (desk.at("out"), desk.at("jobs.txt"));
    let with = |more: &[&str]| gs4d(&[&base[..], &["-o", text(&out)], more].concat());
    assert_eq!(with(&["--plan", text(&jobs), "--program", env!("CARGO_BIN_EXE_gs4d")]).code, 0);
    let line = fs::read_to_string(&jobs).unwrap();

    let exec = format!("exec {line}");
    let mut child = Command::new("sh").args(["-c", &exec]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let run = out.join("static3d/seed-0");
    while !run.join("log.jsonl").exists() {
        assert!(child.try_wait().unwrap().is_none(), "the training ended too early");
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let collected = with(&["--collect", "--json"]);
    assert!(collected.code == 7 && collected.err.contains("static3d / seed-0: "), "{}", collected.err);
    assert!(collected.out.contains(" of 300"), "{}", collected.out);

    desk.good_sh("sh jobs.txt");
    assert_eq!(state(&run), state(&own.join("static3d/seed-0")));
    assert_eq!(with(&["--collect"]).code, 0);
    let other = line.replace("--steps 300", "--steps 301");
    assert!(desk.sh(&other).err.contains("other settings"));
}

#[test]
fn pilots_are_planned_first() {
    let desk = Desk::new();
    let jobs = desk.at("jobs.txt");
    let base = ["contest", text(data()), "-e", "static3d", "--preset", "tiny", "--time-budget", "0.7s"];
    let with = |more: &[&str]| gs4d(&[&base[..], &["-o", text(&desk.at("out"))], more].concat());
    let plan = ["--plan", text(&jobs), "-f"];
    let first = with(&plan);
    assert!(first.err.contains("plan again") && first.out.starts_with("1 pilots"), "{}{}", first.out, first.err);
    assert!(with(&["--collect"]).err.contains("missing: static3d / pilot"));
    desk.good_sh("sh jobs.txt");
    assert!(with(&plan).out.starts_with("1 trials"));
    assert!(fs::read_to_string(&jobs).unwrap().contains(" --steps "));
    desk.good_sh("sh jobs.txt");
    let collected = with(&["--collect"]);
    assert_eq!((collected.code, with(&[]).out), (0, collected.out.clone()), "nothing is trained again");
}

#[test]
fn a_failing_trial_leaves_the_table_of_the_others() {
    let desk = Desk::new();
    // The folder of the first is taken.
    fs::create_dir_all(desk.at("out/fourdgs/seed-0")).unwrap();
    fs::write(desk.at("out/fourdgs/seed-0/notes.txt"), "mine").unwrap();
    let entries = ["-e", "fourdgs", "-e", "static3d", "--preset", "tiny", "--steps", "4", "--json"];
    let call = gs4d(&[&["contest", text(data()), "-o", text(&desk.at("out"))][..], &entries].concat());
    assert_eq!(call.code, 6, "{}", call.err);
    assert!(
        call.err.contains("failed: fourdgs / seed-0: ") && call.err.contains("in the trial fourdgs"),
        "{}",
        call.err
    );
    let json: Value = serde_json::from_str(&call.out).unwrap();
    assert_eq!(json["missing"][0]["trial"], "fourdgs / seed-0");
    assert!(json["entries"][0]["over_seeds"]["psnr"].is_null());
    assert!(json["entries"][1]["over_seeds"]["psnr"]["mean"].as_f64().unwrap() > 5.0, "{json}");
}

#[test]
fn options_of_jobs_belong_together() {
    let base = ["contest", "data", "-e", "static3d", "-o", "out"];
    for more in [&["--plan", "x", "--collect"][..], &["--relative"], &["--program", "x"]] {
        gs4d(&[&base[..], more].concat()).fails(2, &["--"]);
    }
    gs4d(&["train", "data", "-m", "static3d", "-o", "run", "--continue", "-f"]).fails(2, &["cannot be used with"]);
}
