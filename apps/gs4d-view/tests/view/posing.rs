//! A filmed person in poses of the user's.

use crate::support::{ask, greeted};
use gs_method_texel::Dut;
use gs_synth::avatar::{self, AvatarOptions};
use gs_train::device::Device;
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_run::Training;
use gs4d_run::settings::{Request, resolve};
use gs4d_view::pose::{Posing, inputs, joints};
use gs4d_view::{Options, Packing, REQUEST_TIME, Show, Stage, start};
use serde_json::json;
use std::sync::Arc;

#[test]
fn its_own_pose_changes_nothing_and_a_turned_arm_moves_alone() {
    let template = "builtin:person".to_owned();
    let options = AvatarOptions { template, size: 32, frames: 3, rings: 1, points: 200, ..AvatarOptions::default() };
    let film = Arc::new(avatar::generate(&options).unwrap());
    let config = gs_methods::registry().find("dut").unwrap().config("tiny").unwrap();
    let trainer = Trainer::new(gs_methods::registry(), film.clone(), "dut", &config, TrainOptions::default()).unwrap();
    let method = trainer.model();
    let figure = method.concrete::<Dut>().expect("a person");
    let filmed = method.splats(&Timestamp::normalised(0.0), &film.train[0].camera).unwrap();
    let posed = |posing: &Posing| figure.posed(&Timestamp::normalised(0.0), &posing.of(figure, 0.0).unwrap()).unwrap();
    assert_eq!(posed(&Posing::default()), filmed);

    let names = joints(figure);
    let arm = names.as_array().unwrap().iter().position(|n| n == "left upper arm").unwrap() as u32;
    let turned = posed(&Posing { from: None, turns: vec![(arm, [0.0, 0.0, 1.0])] });
    let moved: Vec<f32> = turned.means.iter().zip(&filmed.means).map(|(a, b)| a.distance(*b)).collect();
    let (far, still) = (moved.iter().filter(|d| **d > 0.05).count(), moved.iter().filter(|d| **d == 0.0).count());
    assert!(far * 50 > moved.len() && still * 2 > moved.len(), "{far} and {still} of {}", moved.len());
    assert_eq!((&turned.color, &turned.opacities), (&filmed.color, &filmed.opacities), "looks stay");

    let borrowed = posed(&Posing { from: Some(1.0), turns: Vec::new() });
    assert!(borrowed.means != filmed.means && borrowed.color == filmed.color);
    assert_eq!(
        (&inputs(figure, 0.0)["frame"], inputs(figure, 0.0)["images"].as_array().unwrap().len()),
        (&0.into(), 4)
    );
    assert!(Posing { from: None, turns: vec![(9999, [0.0; 3])] }.of(figure, 0.0).is_err());
}

#[test]
fn picks_and_boxes_are_of_the_pose_that_is_shown() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (dir.path().join("data"), dir.path().join("run"));
    let template = "builtin:person".to_owned();
    let options = AvatarOptions { template, size: 32, frames: 3, rings: 1, points: 200, ..AvatarOptions::default() };
    avatar::write(&data, &options, false, false).unwrap();
    let (method, preset) = ("dut".to_owned(), "tiny".to_owned());
    let request = Request { method, preset, data: Some(data), ..Request::default() };
    let training = Training::begin(&run, false, resolve(gs_methods::registry(), &request).unwrap()).unwrap();
    let (host, packing, device) = ([127, 0, 0, 1].into(), Packing::Png, Device::default());
    let options = Options { host, port: 18_360, packing, share: None, request_time: REQUEST_TIME, device };
    let server = start(Stage::new(vec![Show::live("person".into(), &training).unwrap()]), &options).unwrap();
    let (mut socket, _) = greeted(&server);
    let mut question = json!({"id": 1, "what": {"show": 0, "layer": "alpha"}, "time": 0.0, "look": {"view": [0, 0]},
        "width": 32, "height": 32, "pick": [0.5, 0.5]});
    let image = |png: &[u8]| {
        let read = gs_core::io::images::decode_rgba8(png, "answer.png", &gs_core::io::Limits::default()).unwrap();
        let (rows, width) = (read.height as usize, read.width as usize);
        let sum = |from: usize, to: usize| {
            read.data[4 * width * from..4 * width * to].iter().step_by(4).map(|v| u64::from(*v)).sum::<u64>()
        };
        [sum(0, rows / 2), sum(rows / 2, rows)]
    };
    // Turned upside down about its root.
    let pose = json!({"turns": [[0, [std::f64::consts::PI, 0.0, 0.0]]]});
    question["pose"] = pose.clone();
    let (header, before) = ask(&mut socket, &question);
    let splats = header["picked"]["splats"].as_array().unwrap();
    assert!(!splats.is_empty() && splats.iter().all(|s| s["path"][0] == s["mean"]), "{header}");
    let boxed = json!({"show": 0, "look": {"view": [0, 0]}, "time": 0.0, "width": 32, "height": 32, "at": [0.0, 0.0, 1.0, 0.5], "pose": pose});
    question["hidden"] = json!([boxed]);
    let (_, after) = ask(&mut socket, &question);
    let ([above, below], [hidden, left]) = (image(&before), image(&after));
    assert!(above > 0 && 5 * hidden < above && 5 * left > 4 * below, "{above} {below}, then {hidden} {left}");
}
