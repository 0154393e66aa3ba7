//! `gs4d view`: prints an address that answers those who have its key, and ends.

use crate::support::{command, gs4d, ply, run, text};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
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
    assert!(get("/app.js").contains("WebSocket"));
    assert!(child.wait().unwrap().success(), "it ends by itself");
}

#[test]
fn what_cannot_be_shown_is_said() {
    gs4d(&["view"]).fails(2, &["RUN|SCENE"]);
    gs4d(&["view", "no-such-thing.ply"]).fails(6, &["no-such-thing.ply"]);
}
