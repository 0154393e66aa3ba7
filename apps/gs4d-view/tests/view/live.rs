//! A run that is watched while it trains: what browsers see of it, and that it comes out the same.

use crate::support::{ask, greeted};
use gs_synth::{self as synth, SynthOptions};
use gs_train::checkpoint::Checkpoint;
use gs_train::device::Device;
use gs4d_run::{Outcome, Request, Training, settings};
use gs4d_view::{Options, Packing, REQUEST_TIME, Server, Show, Stage, start};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use tungstenite::Message;

fn training(data: &Path, run: &Path, method: &str) -> Training {
    let request = Request {
        method: method.into(),
        preset: "tiny".into(),
        data: Some(data.to_owned()),
        steps: Some(80),
        ..Request::default()
    };
    Training::begin(run, false, settings::resolve(gs_methods::registry(), &request).unwrap()).unwrap()
}

/// Everything of a state that does not tell the time.
fn state(training: &Training) -> Checkpoint {
    let mut state = training.trainer().state();
    state.meta["train_seconds"] = Value::Null;
    state
}

fn serve(show: Show) -> Server {
    let (host, packing, share) = ([127, 0, 0, 1].into(), Packing::Png, Some(0.5));
    let options = Options { host, port: 18_300, packing, share, request_time: REQUEST_TIME, device: Device::default() };
    start(Stage::new(vec![show]), &options).unwrap()
}

fn picture(id: u64) -> Value {
    json!({"id": id, "what": {"show": 0, "layer": "color"}, "time": 0.4, "look": {"view": [0, 0]}, "width": 48, "height": 48})
}

#[test]
fn a_watched_run_moves_on_and_ends_as_an_unwatched_one() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let small = SynthOptions::of_views(32, 8, 1);
    synth::write(&data, "balls", &small, false).unwrap();
    for method in ["fourdgs", "modec"] {
        let mut alone = training(&data, &dir.path().join(format!("{method}-alone")), method);
        assert_eq!(alone.train(&AtomicBool::new(false), &mut |_, _| ()).unwrap(), Outcome::Finished);

        let mut watched = training(&data, &dir.path().join(format!("{method}-watched")), method);
        let show = Show::live("run".into(), &watched).unwrap();
        let server = serve(show);
        let mut feed = server.feed(gs_methods::registry().clone(), None).unwrap();
        let (mut socket, about) = greeted(&server);
        assert!(about["shows"][0]["layers"].as_array().unwrap().contains(&json!("truth")));
        let first = ask(&mut socket, &picture(0)).1;
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            // Asks for one picture after the other and keeps the news.
            let looking = scope.spawn(|| {
                let (mut steps, mut pictures, mut id) = (Vec::new(), 0, 0);
                while !over.load(Ordering::SeqCst) || steps.last() != Some(&80) {
                    id += 1;
                    socket.send(Message::Text(picture(id).to_string().into())).unwrap();
                    loop {
                        match socket.read().unwrap() {
                            Message::Text(text) => {
                                let said: Value = serde_json::from_str(&text).unwrap();
                                let history = said["news"]["history"].as_array().unwrap();
                                assert!(!history.is_empty() && history[0][1][0].is_number(), "{said}");
                                steps.push(said["news"]["training"]["step"].as_u64().unwrap());
                            }
                            Message::Binary(_) => break,
                            _ => {}
                        }
                    }
                    pictures += 1;
                }
                let mut parts = picture(id + 2);
                parts["what"]["layer"] = json!("segment");
                let legend = ask(&mut socket, &parts).0["legend"].clone();
                assert!(legend["words"].as_str().unwrap().starts_with("rigid parts: "), "{legend}");
                (steps, pictures, ask(&mut socket, &picture(id + 1)).1)
            });
            let outcome = watched.train(&AtomicBool::new(false), &mut |p, trainer| {
                feed.offer(p, trainer);
                // The last state is shown as well, whatever is being built.
                while p.step == p.steps && !feed.has_shown(p.step) {
                    std::thread::sleep(std::time::Duration::from_millis(20));
                    feed.offer(p, trainer);
                }
            });
            assert_eq!(outcome.unwrap(), Outcome::Finished);
            over.store(true, Ordering::SeqCst);
            let (steps, pictures, last) = looking.join().unwrap();
            assert!(steps.len() > 1 && steps.is_sorted(), "{steps:?}");
            assert!(pictures > 2 && last != first, "{pictures} pictures, a changed one at the end");
        });
        assert_eq!(state(&watched), state(&alone), "{method}");
    }
}

#[test]
fn a_page_pauses_a_training_until_it_leaves() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    synth::write(&data, "balls", &SynthOptions::of_views(32, 8, 1), false).unwrap();
    let mut watched = training(&data, &dir.path().join("run"), "fourdgs");
    let server = serve(Show::live("run".into(), &watched).unwrap());
    let mut feed = server.feed(gs_methods::registry().clone(), None).unwrap();
    let (mut socket, _) = greeted(&server);
    socket.send(Message::Text(json!({"pause": true}).to_string().into())).unwrap();
    loop {
        let Message::Text(text) = socket.read().unwrap() else { continue };
        if serde_json::from_str::<Value>(&text).unwrap()["paused"] == true {
            break;
        }
    }
    let (stop, done) = (AtomicBool::new(false), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let run = scope.spawn(|| {
            let outcome = watched.train(&stop, &mut |p, trainer| {
                feed.offer(p, trainer);
                feed.wait_while_paused(&stop);
            });
            done.store(true, Ordering::SeqCst);
            outcome.unwrap()
        });
        std::thread::sleep(std::time::Duration::from_secs(2));
        assert!(!done.load(Ordering::SeqCst), "a step is waited for");
        drop(socket);
        assert_eq!(run.join().unwrap(), Outcome::Finished);
    });
}
