//! Connections that ask for nothing, are slow to ask, or do not read: what they may take from the process that serves them.
#![cfg(target_os = "linux")]

mod support;

use gs_core::testkit::alloc::{Counting, held};
use gs_raster::measure;
use gs_synth::{self as synth, SynthOptions};
use gs_train::device::Device;
use gs4d_run::{Outcome, Request, Training, settings};
use gs4d_view::{Options, Packing, REQUEST_TIME, Server, Show, Stage, start};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use support::{ask, connect, greeted, key};
use tungstenite::Message;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The tests measure descriptors and memory of their process: one at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Connections of each of two other processes; together more than the usual limit of descriptors of a process.
const IDLE: usize = 550;
/// Names the server to the other processes.
const ADDRESS: &str = "GS4D_VIEW_TEST_ADDRESS";

fn serve(show: Show, port: u16, share: Option<f64>, request_time: Duration) -> Server {
    let (host, device) = ([127, 0, 0, 1].into(), Device::default());
    let options = Options { host, port, packing: Packing::Png, share, request_time, device };
    start(Stage::new(vec![show]), &options).unwrap()
}

fn open_files() -> usize {
    std::fs::read_dir("/proc/self/fd").unwrap().count()
}

fn question(id: u64, width: u32, height: u32) -> Value {
    let camera = measure::camera(width);
    let (eye, target) = (camera.position(), camera.position() + camera.forward());
    json!({
        "id": id, "what": {"show": 0, "layer": "color"}, "time": 0.0, "width": width, "height": height,
        "look": {"free": [eye.to_array(), target.to_array(), (-camera.rotation.row(1)).to_array(), 0.8]},
    })
}

/// Not a test of its own: opens connections and holds them until its input ends.
#[test]
fn idle_process() {
    let Some(address) = std::env::var_os(ADDRESS) else { return };
    let address = address.into_string().unwrap();
    let held: Vec<_> = (0..IDLE).map(|_| TcpStream::connect(&address).unwrap()).collect();
    println!("holding {}", held.len());
    std::io::stdin().read_to_end(&mut Vec::new()).unwrap();
}

/// Another process with [`IDLE`] open connections.
fn idle_process_of(server: &Server) -> Child {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "idle_process", "--nocapture"])
        .env(ADDRESS, server.address.to_string())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut out = child.stdout.take().unwrap();
    while !said.contains("holding") {
        let mut byte = [0];
        assert_eq!(out.read(&mut byte).unwrap(), 1, "the process ended: {said}");
        said.push(char::from(byte[0]));
    }
    child.stdout = Some(out);
    child
}

#[test]
fn a_thousand_idle_connections_end_no_training_and_keep_nobody_out() {
    let _alone = alone();
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    synth::write(&data, "balls", &SynthOptions::of_views(32, 8, 1), false).unwrap();
    let request = Request {
        method: "fourdgs".into(),
        preset: "tiny".into(),
        data: Some(data),
        steps: Some(20),
        ..Request::default()
    };
    let resolved = settings::resolve(gs_methods::registry(), &request).unwrap();
    let mut training = Training::begin(&dir.path().join("run"), false, resolved).unwrap();
    let server = serve(Show::live("run".into(), &training).unwrap(), 18_500, Some(0.5), REQUEST_TIME);
    let mut feed = server.feed(gs_methods::registry().clone(), None).unwrap();
    let before = open_files();
    let idle = [idle_process_of(&server), idle_process_of(&server)];
    let (mut most, mut greetings) = (0, 0);
    let outcome = training.train(&AtomicBool::new(false), &mut |p, trainer| {
        feed.offer(p, trainer);
        drop(greeted(&server));
        (most, greetings) = (most.max(open_files()), greetings + 1);
    });
    assert_eq!(outcome.unwrap(), Outcome::Finished);
    assert!(std::fs::read_dir(dir.path().join("run/checkpoints")).unwrap().count() > 0);
    assert!(greetings == 20 && most < before + 64 + 8, "{most} open files, {before} before");
    for mut process in idle {
        drop(process.stdin.take());
        assert!(process.wait().unwrap().success());
    }
    let (header, _) = ask(&mut greeted(&server).0, &question(3, 32, 32));
    assert_eq!(header["id"], 3);
}

#[test]
fn a_request_has_a_limited_time_however_busy_it_looks() {
    let _alone = alone();
    let limit = Duration::from_millis(200);
    let server = serve(Show::splats("empty".into(), gs_core::Splats::default()), 18_540, None, limit);
    let begun = Instant::now();
    let mut slow = TcpStream::connect(server.address).unwrap();
    slow.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let closed = loop {
        // A byte each time: no pause is long.
        let wrote = slow.write_all(b"G");
        match slow.read(&mut [0; 64]) {
            Ok(0) => break true,
            Err(e) if matches!(e.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {}
            Ok(_) | Err(_) => break true,
        }
        if wrote.is_err() || begun.elapsed() > Duration::from_secs(8) {
            break wrote.is_err();
        }
    };
    assert!(closed && begun.elapsed() >= limit && begun.elapsed() < 20 * limit, "{closed} {:?}", begun.elapsed());
    // A browser that is let in stays.
    let (mut socket, _) = greeted(&server);
    std::thread::sleep(2 * limit);
    assert_eq!(ask(&mut socket, &question(1, 16, 16)).0["id"], 1);
}

/// Small splats of many colours: an image that packs badly.
fn noise() -> gs_core::Splats {
    let mut splats = measure::scene(150_000, 3);
    splats.scales.iter_mut().for_each(|s| *s *= 0.6);
    splats
}

/// Memory that this process has asked for and not given back, MiB.
fn held_mib() -> f64 {
    held() as f64 / f64::from(1 << 20)
}

#[test]
fn readers_that_do_not_read_hold_little_memory_and_delay_nobody() {
    let _alone = alone();
    const SLOW: usize = 20;
    let server = serve(Show::splats("noise".into(), noise()), 18_560, None, REQUEST_TIME);
    let (mut quick, _) = greeted(&server);
    quick.get_mut().set_read_timeout(Some(Duration::from_secs(300))).unwrap();
    let begun = Instant::now();
    let large = ask(&mut quick, &question(1, 3840, 2160)).1.len();
    let once = begun.elapsed();
    // Buffers of the renderer included, which are kept while a browser is connected.
    let before = held_mib();
    let slow: Vec<_> = (0..SLOW as u64)
        .map(|id| {
            let (mut socket, _) = greeted(&server);
            socket.send(Message::Text(question(id, 3840, 2160).to_string().into())).unwrap();
            socket
        })
        .collect();
    let begun = Instant::now();
    assert_eq!(ask(&mut quick, &question(2, 64, 48)).0["id"], 2);
    let waited = begun.elapsed();
    // Asked for last, it comes after those of the slow readers.
    assert_eq!(ask(&mut quick, &question(3, 3840, 2160)).0["id"], 3);
    let (queued, grown) = (server.queued_bytes(), held_mib() - before);
    eprintln!("{large} bytes in {once:?}; {waited:?} for a small one; {queued} bytes wait, {grown:.0} MiB more");
    assert!(SLOW * large > 2 * (64 << 20), "the images are large enough to tell: {large} bytes");
    assert!(waited < 3 * once, "{waited:?}, a large one takes {once:?}");
    assert!(queued <= 64 << 20 && queued > 0, "{queued} bytes wait");
    // The outbox, and parts on their way to each.
    assert!(grown < 64.0 + SLOW as f64, "{grown} MiB more");
    drop((slow, quick));
    let until = Instant::now() + Duration::from_secs(10);
    while (server.queued_bytes() > 0 || held_mib() > before - 100.0) && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(50));
    }
    let left = held_mib();
    assert!(server.queued_bytes() == 0 && left < before - 100.0, "{left} MiB left of {before}");
    assert!(connect(&server, key(&server), None).is_ok());
}
