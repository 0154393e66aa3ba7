//! Pipes where files should be: refused at once, instead of waiting for somebody to write to them.
#![cfg(unix)]

use crate::support::{command, data, good, run, text};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Longest a refusal may take, on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// Puts a pipe in the place of a file.
fn pipe(path: &Path) {
    let _ = fs::remove_file(path);
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// The call ends by itself and fails; gives what it says.
fn refused(arguments: &[&str]) -> String {
    let mut child = command(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if begun.elapsed() > PATIENCE => {
                child.kill().unwrap();
                panic!("{arguments:?} waits for a pipe");
            }
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    };
    let said = std::io::read_to_string(child.stderr.take().unwrap()).unwrap();
    assert!(!status.success() && said.contains("regular file"), "{arguments:?}: {said}");
    said
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        match entry.file_type().unwrap() {
            kind if kind.is_dir() => copy(&entry.path(), &target),
            kind if kind.is_file() => drop(fs::copy(entry.path(), target).unwrap()),
            _ => {}
        }
    }
}

#[test]
fn a_pipe_in_a_data_folder_is_refused() {
    for name in ["train/r_000.png", "transforms_test.json", "scene.toml"] {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("data");
        copy(data(), &root);
        pipe(&root.join(name));
        let out = dir.path().join("run");
        refused(&["train", text(&root), "-m", "static3d", "--preset", "tiny", "--steps", "2", "-o", text(&out)]);
    }
}

#[test]
fn a_pipe_in_a_run_is_refused() {
    let verbs: [(&str, &[&str]); 3] = [
        ("log.jsonl", &["resume", "RUN", "--steps", "44"]),
        ("checkpoints/step-000040.gs4d", &["eval", "RUN"]),
        ("log.jsonl", &["compare", "RUN", "RUN"]),
    ];
    for (name, verb) in verbs {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("run");
        copy(run(), &root);
        pipe(&root.join(name));
        let call: Vec<&str> = verb.iter().map(|part| if *part == "RUN" { text(&root) } else { part }).collect();
        refused(&call);
    }
}

#[test]
fn a_pipe_on_the_command_line_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let fifo = dir.path().join("pipe");
    pipe(&fifo);
    let out = dir.path().join("out");
    refused(&["train", text(data()), "-m", "static3d", "--config", text(&fifo), "-o", text(&out)]);
    refused(&["render", text(run()), "--camera", text(&fifo), "-o", text(&out)]);
    let named = dir.path().join("pipe.gs4d");
    pipe(&named);
    refused(&["inspect", text(&named)]);
    good(&["inspect", text(run())]);
}
