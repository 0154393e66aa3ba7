//! Stored inputs, and the same mutations of every target's seeds each time: none breaks a rule. The run that is guided by coverage
//! has a command of its own (README.md).

use std::path::{Path, PathBuf};
use std::process::Command;

/// More than any target has seeds.
const SEEDS: u64 = 50;

/// Runs the program, which must succeed; what it printed.
fn fuzz(arguments: &[&str]) -> String {
    let out = Command::new(env!("CARGO_BIN_EXE_gs4d-fuzz")).args(arguments).output().expect("the program starts");
    let printed = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success(), "{}\n{printed}{}", out.status, String::from_utf8_lossy(&out.stderr));
    printed
}

fn entries(dir: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir).unwrap_or_else(|e| panic!("{}: {e}", dir.display()));
    entries.map(|entry| entry.expect("an entry").path()).collect()
}

/// Target and number of inputs, from the rows of the table.
fn rows(printed: &str) -> Vec<(&str, u64)> {
    let lines = printed.lines().map(|line| line.split('|').map(str::trim));
    let rows = lines.filter_map(|mut cells| Some((cells.nth(1)?, cells.next()?.parse::<u64>().ok()?)));
    rows.filter(|(target, _)| *target != "total").collect()
}

#[test]
fn regressions() {
    let printed = fuzz(&["--regressions"]);
    let targets = entries(&Path::new(env!("CARGO_MANIFEST_DIR")).join("regressions"));
    let inputs: Vec<PathBuf> = targets.iter().flat_map(|target| entries(target)).collect();
    assert!(!inputs.is_empty());
    for input in inputs {
        assert!(printed.contains(&format!("{}: ", input.display())), "{} was not run:\n{printed}", input.display());
    }
}

/// The number of inputs ends it, on a slow machine the time.
#[test]
fn mutations_of_every_target() {
    let printed = fuzz(&["--inputs", "1000", "--seconds", "60"]);
    let rows = rows(&printed);
    assert!(!rows.is_empty() && rows.iter().all(|(_, inputs)| *inputs > SEEDS), "{printed}");
}
