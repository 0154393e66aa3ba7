//! Frames of a person that arrive while somebody watches.

use crate::support::{ask, greeted};
use gs_core::Splats;
use gs_raster::RasterOptions;
use gs_synth::avatar::{self, AvatarOptions};
use gs_train::device::Device;
use gs4d_view::{Options, Packing, REQUEST_TIME, Show, Stage, start};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use tungstenite::Message;

#[test]
fn a_page_hears_of_each_frame_and_how_old_its_image_is() {
    let options = AvatarOptions { size: 32, frames: 3, rings: 1, points: 200, ..AvatarOptions::default() };
    let film = avatar::generate(&options).unwrap();
    let cloud = film.points.clone().unwrap();
    let splats = |color: f32| Splats {
        means: cloud.positions.clone(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; cloud.positions.len()],
        scales: vec![[0.01; 3].into(); cloud.positions.len()],
        opacities: vec![0.9; cloud.positions.len()],
        color: gs_core::Color::Rgb(vec![[color; 3]; cloud.positions.len()]),
        ..Splats::default()
    };
    let raster = RasterOptions { near: 0.05, dilation: 0.1, antialias: true, ..RasterOptions::default() };
    let show = Show::live_film("film".into(), splats(0.2), raster, [0.0; 3], &film);
    let (host, packing, device) = ([127, 0, 0, 1].into(), Packing::Png, Device::default());
    let options = Options { host, port: 18_340, packing, share: None, request_time: REQUEST_TIME, device };
    let server = start(Stage::new(vec![show]), &options).unwrap();
    let (mut socket, about) = greeted(&server);
    let about = &about["shows"][0];
    assert_eq!((about["views"].as_array().unwrap().len(), &about["moving"]), (8, &json!(false)), "one of each camera");
    let layers = about["layers"].as_array().unwrap();
    assert!(!layers.contains(&json!("truth")), "there is no image to compare with: {layers:?}");
    let question = json!({"id": 1, "what": {"show": 0, "layer": "color"}, "time": 0.0, "look": {"view": [0, 0]}, "width": 32, "height": 32});
    let (header, dark) = ask(&mut socket, &question);
    assert_eq!(header["frame"], Value::Null);
    let written = Instant::now().checked_sub(Duration::from_millis(250)).unwrap();
    server.show_frame(splats(0.8), 7, written);
    let Message::Text(news) = socket.read().unwrap() else { panic!("no news") };
    let news: Value = serde_json::from_str(&news).unwrap();
    assert_eq!(news["news"]["frame"], json!({"number": 7, "splats": cloud.positions.len()}));
    let (header, bright) = ask(&mut socket, &question);
    assert_eq!(header["frame"]["number"], 7);
    let latency = header["frame"]["latency_ms"].as_f64().unwrap();
    assert!(latency >= 250.0 && latency <= written.elapsed().as_secs_f64() * 1e3, "{latency}");
    assert_ne!(dark, bright);
    // The browser draws them as they are trained to be drawn.
    let mut splats_of = question.clone();
    splats_of["save"] = json!("splats");
    let drawn = ask(&mut socket, &splats_of).0["raster"].clone();
    assert_eq!(drawn, json!({"near": 0.05, "dilation": 0.1, "antialias": true}));
    // A page that opens later hears of the newest frame.
    assert_eq!(greeted(&server).1["news"]["frame"]["number"], 7);
}
