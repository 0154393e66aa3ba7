//! A long training with a viewer that is disturbed all the time: its memory stays flat, and its bits are those of a training
//! that nobody watched.
//!
//! `GS4D_SOAK_MINUTES=240 cargo test --release -p gs4d --test cli soak -- --ignored --nocapture`
#![cfg(target_os = "linux")]

use crate::runs::state;
use crate::support::{command, data, good, text};
use serde_json::json;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tungstenite::{Message, connect};

/// Growth of memory that is allowed between the second and the last quarter.
const GROWTH: f64 = 0.05;

fn minutes() -> f64 {
    std::env::var("GS4D_SOAK_MINUTES").ok().and_then(|m| m.parse().ok()).unwrap_or(240.0)
}

/// Trains so many steps without a viewer; seconds it took.
fn unwatched(steps: u32, run: &Path) -> f64 {
    let begun = Instant::now();
    let steps = steps.to_string();
    good(&["train", text(data()), "-m", "fourdgs", "--preset", "tiny", "--steps", &steps, "-o", text(run), "-f", "-q"]);
    begun.elapsed().as_secs_f64()
}

/// Resident memory of a process, MiB.
fn resident(pid: u32) -> Option<f64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}

/// Pictures asked for over one connection, some of them left unread; then the connection is dropped.
fn look(url: &str, round: u64) -> Option<u64> {
    let (mut socket, _) = connect(url.replacen("http", "ws", 1).replacen("/?", "/ws?", 1)).ok()?;
    let mut seen = 0;
    for id in 0..20 {
        let question = json!({
            "id": id, "what": {"show": 0, "layer": "color"}, "time": 0.3, "width": 320, "height": 240,
            "look": {"free": [[0.0, 0.0, -4.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 0.8]},
        });
        socket.send(Message::text(question.to_string())).ok()?;
        // Every third connection never reads.
        if !round.is_multiple_of(3) {
            seen += u64::from(socket.read().ok()?.is_binary());
        }
    }
    Some(seen)
}

/// Connections that say nothing, or half a request.
fn flood(address: &str) {
    let Some(to) = address.to_socket_addrs().ok().and_then(|mut a| a.next()) else { return };
    let open: Vec<_> =
        (0..200).filter_map(|_| TcpStream::connect_timeout(&to, Duration::from_millis(200)).ok()).collect();
    for mut stream in open.iter().take(50) {
        let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: ");
    }
    std::thread::sleep(Duration::from_secs(1));
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

#[test]
#[ignore = "hours: GS4D_SOAK_MINUTES, 240"]
fn a_watched_training_stays_flat_and_exact() {
    let dir = tempfile::tempdir().unwrap();
    let (plain, watched) = (dir.path().join("plain"), dir.path().join("watched"));
    let probe = unwatched(2000, &plain);
    let steps = (minutes() * 60.0 / probe * 2000.0) as u32;
    let count = steps.to_string();
    let recipe = ["-m", "fourdgs", "--preset", "tiny", "--steps", &count, "--view", "--view-port", "18480"];
    let all = [&["train", text(data()), "-o", text(&watched)][..], &recipe].concat();
    let mut child = command(&all).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut url = String::new();
    while !url.contains("http://") {
        url.clear();
        assert!(said.read_line(&mut url).unwrap() > 0, "no address");
    }
    let url = url[url.find("http://").unwrap()..].trim().to_owned();
    let address = url.trim_start_matches("http://").split('/').next().unwrap().to_owned();
    let (over, pictures, rounds) = (AtomicBool::new(false), AtomicU64::new(0), AtomicU64::new(0));
    let (mut memory, mut messages) = (Vec::new(), Vec::new());
    std::thread::scope(|scope| {
        scope.spawn(|| drop(said.read_to_end(&mut messages)));
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                pictures.fetch_add(look(&url, rounds.fetch_add(1, Ordering::Relaxed)).unwrap_or(0), Ordering::Relaxed);
            }
        });
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                flood(&address);
            }
        });
        while child.try_wait().unwrap().is_none() {
            memory.extend(resident(child.id()));
            std::thread::sleep(Duration::from_secs(2));
        }
        over.store(true, Ordering::Relaxed);
    });
    let status = child.wait().unwrap();
    assert!(status.success(), "the watched training ends with {status}: {}", String::from_utf8_lossy(&messages));
    let quarter = memory.len() / 4;
    let (early, late) = (median(&memory[quarter..2 * quarter]), median(&memory[3 * quarter..]));
    let (pictures, rounds) = (pictures.into_inner(), rounds.into_inner());
    eprintln!("{steps} steps, {rounds} connections, {pictures} pictures, {early:.1} MiB early, {late:.1} MiB late");
    assert!(pictures > 10 && late <= early * (1.0 + GROWTH), "{early:.1} MiB, then {late:.1} MiB");
    unwatched(steps, &plain);
    assert!(state(&watched) == state(&plain), "the bits of an unwatched training");
}
