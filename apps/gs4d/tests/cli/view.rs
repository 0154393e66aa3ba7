//! `gs4d view`: prints an address that answers those who have its key, and ends.

use crate::support::{STEPS, command, data, gs4d, ply, run, text};
use gs_train::checkpoint::{Checkpoint, file_name};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Stdio;

#[test]
fn the_printed_address_shows_a_run_and_a_file() {
    let all = ["view", text(run()), text(ply()), "--port", "18400", "--seconds", "8"];
    let mut child = command(&all).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let url = lines.find_map(|l| l.unwrap().split_once("http://").map(|(_, url)| url.to_owned())).unwrap();
    let (address, path) = url.split_once('/').unwrap();
    let get = |path: &str| {
        let mut stream = TcpStream::connect(address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    let page = get(&format!("/{path}"));
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("app.js"), "{page}");
    assert!(get("/").starts_with("HTTP/1.1 403"));
    assert!(get("/ask.js").contains("WebSocket"));
    assert!(child.wait().unwrap().success(), "it ends by itself");
}

/// Everything a finished run has learnt.
fn learnt(run: &Path) -> Vec<(String, Vec<f32>)> {
    Checkpoint::load(&run.join("checkpoints").join(file_name(STEPS))).unwrap().tensors
}

#[test]
fn training_is_served_beside_a_taken_port_and_comes_out_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let watched = dir.path().join("watched");
    let taken = TcpListener::bind(("127.0.0.1", 18_440));
    let steps = STEPS.to_string();
    let recipe = ["-m", "fourdgs", "--preset", "tiny", "--steps", &steps, "--view", "--view-port", "18440"];
    let all = [&["train", text(data()), "-o", text(&watched)][..], &recipe, &["--view-share", "5%"]].concat();
    let mut child = command(&all).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let said: Vec<String> = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap).collect();
    assert!(child.wait().unwrap().success(), "{said:?}");
    let address = said.iter().find(|l| l.contains("http://127.0.0.1:184") && l.contains("/?k=")).unwrap();
    assert!(taken.is_err() || !address.contains(":18440/"), "{address}");
    assert!(said.iter().any(|l| l.contains("ssh -L 184")), "{said:?}");
    assert_eq!(learnt(&watched), learnt(run()));
}

#[test]
fn training_goes_on_without_a_viewer_that_cannot_start() {
    let dir = tempfile::tempdir().unwrap();
    let lone = dir.path().join("lone");
    let held: Vec<_> = (0..=20).map(|k| TcpListener::bind(("127.0.0.1", 18_460 + k))).collect();
    let recipe = ["-m", "fourdgs", "--preset", "tiny", "--steps", "3", "--view", "--view-port", "18460"];
    let call = gs4d(&[&["train", text(data()), "-o", text(&lone)][..], &recipe].concat());
    assert_eq!(call.code, 0, "{}", call.err);
    assert!(call.err.contains("training goes on without a viewer: no free port"), "{}", call.err);
    drop(held);
    gs4d(&["train", text(data()), "-m", "fourdgs", "-o", "x", "--view-share", "0", "--view"]).fails(2, &["up to 1"]);
    gs4d(&["resume", text(&lone), "--view-port", "9000"]).fails(2, &["--view"]);
}

#[test]
fn what_cannot_be_shown_is_said() {
    gs4d(&["view"]).fails(2, &["RUN|SCENE"]);
    gs4d(&["view", "no-such-thing.ply"]).fails(6, &["no-such-thing.ply"]);
}
