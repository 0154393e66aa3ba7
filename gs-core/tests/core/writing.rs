//! Processes that write into one folder: at once, killed at every operation, and paused.

use gs_core::io::write_file;
use gs_core::testkit::faults::VARIABLE;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Set for a child: the file to write.
const TARGET: &str = "GS4D_WRITING_TEST_TARGET";
/// Set for a child: how often it writes, or [`PAUSE`].
const ROUNDS: &str = "GS4D_WRITING_TEST_ROUNDS";
/// The child stops amid its content until it is told to go on.
const PAUSE: &str = "pause";
/// More than the buffer holds, so that a file is written in several operations.
const LENGTH: usize = 600_000;

fn save(path: &Path, byte: u8) {
    write_file(path, true, |out| out.write_all(&vec![byte; LENGTH])).unwrap();
}

/// What a child does; nothing in the test itself.
#[test]
fn child() {
    let Some(path) = std::env::var_os(TARGET).map(PathBuf::from) else { return };
    let rounds = std::env::var(ROUNDS).unwrap();
    if rounds != PAUSE {
        (0..rounds.parse().unwrap()).for_each(|round: u8| save(&path, round));
        return;
    }
    let paused = write_file(&path, true, |out| {
        out.write_all(b"half and ")?;
        println!("paused");
        std::io::stdin().read_exact(&mut [0])?;
        out.write_all(b"half")
    });
    paused.unwrap();
}

fn begin(path: &Path, rounds: &str, faults: &str) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "writing::child", "--nocapture"]).env(TARGET, path).env(ROUNDS, rounds);
    if !faults.is_empty() {
        command.env(VARIABLE, faults);
    }
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The one byte of which a whole file is made.
fn byte(path: &Path) -> u8 {
    let content = fs::read(path).unwrap();
    assert_eq!(content.len(), LENGTH);
    assert!(content.iter().all(|&b| b == content[0]), "a mixture");
    content[0]
}

#[test]
fn processes_that_write_one_file_leave_one_of_their_contents() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.ply");
    save(&path, 0);
    let mut children: Vec<Child> = (0..3).map(|_| begin(&path, "60", "")).collect();
    let mut looks = 0;
    while children.iter_mut().any(|c| c.try_wait().unwrap().is_none()) {
        byte(&path);
        looks += 1;
    }
    assert!(children.iter_mut().all(|c| c.wait().unwrap().success()), "every writer succeeds");
    assert!(looks > 3, "{looks}");
    assert_eq!((byte(&path), names(dir.path())), (59, vec!["scene.ply".to_owned()]));
}

#[cfg(target_os = "linux")]
#[test]
fn a_writer_killed_at_any_operation_leaves_the_older_file_or_the_newer_and_what_it_left_is_removed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.ply");
    let mut left = 0;
    for operation in 1.. {
        save(&path, 200);
        let mut child = begin(&path, "1", &format!("{operation}:kill"));
        if child.wait().unwrap().success() {
            assert_eq!((operation, left), (6, 3), "create, write, flush, rename, flush of the folder");
            break;
        }
        assert_eq!(byte(&path), if operation <= 4 { 200 } else { 0 }, "killed at operation {operation}");
        left += names(dir.path()).len() - 1;
        write_file(&dir.path().join("other.txt"), true, |out| out.write_all(b"x")).unwrap();
        assert_eq!(names(dir.path()), ["other.txt", "scene.ply"], "killed at operation {operation}");
        fs::remove_file(dir.path().join("other.txt")).unwrap();
    }
}

#[test]
fn a_living_writer_is_not_disturbed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.ply");
    let mut child = begin(&path, PAUSE, "");
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("paused")));
    write_file(&dir.path().join("other.txt"), true, |out| out.write_all(b"x")).unwrap();
    assert_eq!(names(dir.path()).len(), 2, "the temporary file stays: {:?}", names(dir.path()));
    child.stdin.take().unwrap().write_all(b"!").unwrap();
    assert!(lines.all(|line| line.is_ok()) && child.wait().unwrap().success());
    assert_eq!(fs::read(&path).unwrap(), b"half and half");
    assert_eq!(names(dir.path()), ["other.txt", "scene.ply"]);
}
