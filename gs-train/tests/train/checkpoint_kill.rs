//! A process that writes checkpoints back to back is killed at random moments: the newest file that was acknowledged must
//! always be readable.

use gs_core::Rng;
use gs_train::checkpoint::{Checkpoint, load_newest};
use serde_json::json;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Set for the child: the folder to write to.
const CHILD: &str = "GS4D_KILL_TEST_FOLDER";

fn state(step: u32) -> Checkpoint {
    let values = (0..20_000).map(|i| i as f32 * 0.5 + step as f32).collect();
    Checkpoint { meta: json!({ "step": step }), tensors: vec![("x".into(), values), ("y".into(), vec![step as f32])] }
}

/// The child: writes until it is killed, and says each step once it is safe.
fn write_forever(dir: &Path) -> ! {
    let first = load_newest(dir).map_or(0, |n| n.checkpoint.meta["step"].as_u64().unwrap() as u32 + 1);
    for step in first.. {
        state(step).save_step(dir, step).unwrap();
        println!("safe {step}");
        std::io::stdout().flush().unwrap();
    }
    unreachable!("steps do not end");
}

/// Kills a writer after a random number of milliseconds; returns the last step it called safe, if any.
fn one_cycle(dir: &Path, cycle: u32) -> Option<u32> {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "checkpoint_kill::survives_fifty_kills", "--nocapture"])
        .env(CHILD, dir)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let out = child.stdout.take().unwrap();
    let reader = std::thread::spawn(move || {
        let lines = BufReader::new(out).lines().map_while(Result::ok);
        lines.filter_map(|l| l.split("safe ").nth(1)?.trim().parse::<u32>().ok()).last()
    });
    std::thread::sleep(Duration::from_micros(u64::from(4_000 + Rng::new(1, "kill", cycle, 0).below(30_000))));
    child.kill().unwrap();
    child.wait().unwrap();
    reader.join().unwrap()
}

fn kill_cycles(cycles: u32) {
    let dir = tempfile::tempdir().unwrap();
    let (mut safe, mut written) = (None, 0u32);
    for cycle in 0..cycles {
        safe = one_cycle(dir.path(), cycle).or(safe);
        let Some(safe) = safe else { continue };
        let newest = load_newest(dir.path()).unwrap_or_else(|e| panic!("cycle {cycle}: {e}"));
        assert!(newest.skipped.is_empty(), "cycle {cycle}: {:?}", newest.skipped);
        let step = newest.checkpoint.meta["step"].as_u64().unwrap() as u32;
        assert!(step >= safe, "cycle {cycle}: step {safe} was safe, {step} is the newest");
        assert_eq!(newest.checkpoint, state(step), "cycle {cycle}");
        written = step;
    }
    assert!(written >= cycles / 10, "the writer hardly ran: {written} checkpoints in {cycles} cycles");
    println!("{cycles} kills, {written} checkpoints written, none unreadable");
}

#[test]
fn survives_fifty_kills() {
    if let Some(dir) = std::env::var_os(CHILD) {
        write_forever(Path::new(&dir));
    }
    kill_cycles(50);
}

#[test]
#[ignore = "a minute long: cargo test -p gs-train --test train checkpoint_kill -- --ignored"]
fn survives_a_thousand_kills() {
    kill_cycles(1000);
}
