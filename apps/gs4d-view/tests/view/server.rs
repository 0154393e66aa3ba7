//! The viewer as a browser meets it: what is answered, and what is refused.

use crate::support::{answer, ask, connect, greeted, key};
use gs_core::{Color, Kernel, Splats};
use gs_train::device::Device;
use gs4d_view::{Options, Packing, REQUEST_TIME, Server, Show, Stage, start};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, TcpStream};
use std::time::{Duration, Instant};
use tungstenite::Message;

const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

fn scene() -> Splats {
    Splats {
        means: vec![glam::Vec3::ZERO, glam::Vec3::new(0.0, 0.0, 0.5)],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        scales: vec![glam::Vec3::splat(0.2); 2],
        opacities: vec![0.9, 0.8],
        color: Color::Rgb(vec![[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        kernel: Kernel::Gaussian,
    }
}

fn server(packing: Packing) -> Server {
    let stage = Stage::new(vec![Show::splats("red".into(), scene())]);
    let device = Device::default();
    start(stage, &Options { host: LOCAL, port: 18_200, packing, share: None, request_time: REQUEST_TIME, device })
        .unwrap()
}

/// The status line and body of a plain request.
fn get(server: &Server, path: &str, host: &str) -> String {
    let mut stream = TcpStream::connect(server.address).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// A picture of the first show.
fn question(id: u64, layer: &str) -> Value {
    json!({
        "id": id, "what": {"show": 0, "layer": layer}, "time": 0.0, "width": 64, "height": 48,
        "look": {"free": [[0.0, 0.0, -4.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 0.8]},
    })
}

#[test]
fn a_scene_is_announced_drawn_and_picked() {
    let server = server(Packing::Png);
    let (mut socket, about) = greeted(&server);
    assert_eq!(about["shows"][0]["name"], "red");
    assert_eq!(about["shows"][0]["layers"], json!(["color", "depth", "alpha", "count"]));
    let (header, png) = ask(&mut socket, &question(7, "color"));
    assert_eq!((&header["id"], &header["width"], &header["splats"]), (&json!(7), &json!(64), &json!(2)));
    let picture = gs_core::io::images::decode_rgba8(&png, "answer.png", &gs_core::io::Limits::default()).unwrap();
    let middle = &picture.data[4 * (24 * 64 + 32)..][..3];
    // Red in front of blue.
    assert!(middle[0] > 220 && middle[2] > 10 && middle[2] < 30, "{middle:?}");
    let mut picking = question(8, "color");
    picking["pick"] = json!([0.5, 0.5]);
    let picked = ask(&mut socket, &picking).0["picked"].clone();
    assert_eq!(picked["splats"][0]["splat"], 0);
    let weights: Vec<f64> = (0..2).map(|k| picked["splats"][k]["weight"].as_f64().unwrap()).collect();
    // Half a pixel beside both centres.
    assert!((weights[0] - 0.9).abs() < 0.03 && (weights[1] - 0.08).abs() < 0.02, "{weights:?}");
    let shown = [f64::from(middle[0]) / 255.0, f64::from(middle[2]) / 255.0];
    assert!(weights.iter().zip(shown).all(|(w, s)| (w - s).abs() < 3e-3), "{weights:?} {shown:?}");
    let (header, _) = ask(&mut socket, &question(9, "depth"));
    assert!((header["legend"]["low"].as_f64().unwrap() - 4.0).abs() < 0.2, "{header}");
    let (header, png) = ask(&mut socket, &question(10, "count"));
    assert_eq!((&header["legend"]["high"], &header["legend"]["unit"]), (&json!(2.0), &json!("splats per pixel")));
    let bars: Vec<u64> = serde_json::from_value(header["legend"]["bars"].clone()).unwrap();
    // One and both.
    assert!(bars[12] > 10 && bars[23] > 10 && bars.iter().sum::<u64>() == bars[12] + bars[23], "{bars:?}");
    let picture = gs_core::io::images::decode_rgba8(&png, "answer.png", &gs_core::io::Limits::default()).unwrap();
    assert!(picture.data[4 * (24 * 64 + 32)] > 240 && picture.data[0] < 20);
}

#[test]
fn a_blank_picture_says_why() {
    let server = server(Packing::Jpeg);
    let (mut socket, _) = greeted(&server);
    let mut away = question(1, "color");
    away["look"] = json!({"free": [[0.0, 0.0, -4.0], [0.0, 0.0, -8.0], [0.0, -1.0, 0.0], 0.8]});
    let (header, jpeg) = ask(&mut socket, &away);
    assert!(header["blank"].as_str().unwrap().contains("2 lie behind the camera"), "{header}");
    assert_eq!(jpeg[..2], [0xff, 0xd8]);
}

#[test]
fn what_makes_no_sense_is_answered_with_a_reason() {
    let server = server(Packing::Png);
    let (mut socket, _) = greeted(&server);
    let mut cases = vec![json!("x"), json!({"id": 1}), question(1, "gate"), question(2, "truth")];
    for (field, value) in [
        ("what", json!({"show": 9, "layer": "color"})),
        ("what", json!({"show": 0, "layer": "color", "checkpoint": 5})),
        ("width", json!(1_000_000)),
        ("time", json!(1e30)),
        ("look", json!({"view": [0, 3]})),
    ] {
        let mut bad = question(3, "color");
        bad[field] = value;
        cases.push(bad);
    }
    for case in cases {
        let (answer, _) = ask(&mut socket, &case);
        assert!(answer["error"].as_str().is_some_and(|e| !e.is_empty()), "{case}: {answer}");
        assert_eq!(answer["id"], case["id"], "the page knows which question it was");
    }
    assert_eq!(ask(&mut socket, &question(4, "color")).0["id"], 4, "and goes on");
}

#[test]
fn strangers_are_refused() {
    let server = server(Packing::Png);
    let own = server.address.to_string();
    let good = format!("/?k={}", key(&server));
    let page = get(&server, &good, &own);
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("content-security-policy: default-src 'none'"), "{page}");
    for (path, host) in [("/", &own[..]), ("/?k=0", &own), (&good, "evil.example"), ("/app.js", "evil.example:80")] {
        assert!(get(&server, path, host).starts_with("HTTP/1.1 403"), "{path} {host}");
    }
    for path in ["/../Cargo.toml", "/etc/passwd", "/app.js/..%2f..%2fsecret"] {
        assert!(get(&server, path, &own).starts_with("HTTP/1.1 404"), "{path}");
    }
    assert!(connect(&server, "0123", None).is_err());
    for origin in ["http://evil.example", "null", "https://127.0.0.1"] {
        assert!(connect(&server, key(&server), Some(origin)).is_err(), "{origin}");
    }
    assert!(connect(&server, key(&server), Some(&format!("http://{own}"))).is_ok());
}

#[test]
fn floods_and_long_messages_are_bounded() {
    let server = server(Packing::Png);
    let (mut socket, _) = greeted(&server);
    // Of many questions at once only the newest is worth an answer; it comes last.
    let mut large = question(0, "color");
    (large["width"], large["height"]) = (json!(1600), json!(1200));
    for id in 1..=200u64 {
        large["id"] = json!(id);
        socket.send(Message::Text(large.to_string().into())).unwrap();
    }
    let (mut answers, mut last) = (0, 0);
    while last != 200 {
        let id = answer(&mut socket).0["id"].as_u64().unwrap();
        assert!(id > last, "answers come in order");
        (answers, last) = (answers + 1, id);
    }
    assert!(answers < 200, "{answers} pictures drawn for 200 questions");
    // Longer than the limit: the line is cut.
    socket.send(Message::Text(format!("\"{}\"", "x".repeat(100 << 10)).into())).ok();
    assert!(matches!(socket.read(), Err(_) | Ok(Message::Close(_))));
    greeted(&server);
}

#[test]
fn deep_nesting_ends_the_talk() {
    let server = server(Packing::Png);
    for deep in [16, 17, 5000] {
        let (mut socket, _) = greeted(&server);
        socket.send(Message::Text(format!("{}{}", "[".repeat(deep), "]".repeat(deep)).into())).unwrap();
        let answered = matches!(socket.read(), Ok(Message::Text(_)));
        assert_eq!(answered, deep <= 16, "{deep}");
    }
    greeted(&server);
}

#[test]
fn a_hundred_idle_clients_and_half_requests_keep_nobody_out() {
    let server = server(Packing::Png);
    let mut half: Vec<_> = (0..100).map(|_| TcpStream::connect(server.address).unwrap()).collect();
    half.iter_mut().for_each(|s| s.write_all(b"GET /?k=").unwrap());
    // Connections that ask for nothing, with the key: only so many are let in.
    let idle: Vec<_> = (0..100).filter_map(|_| connect(&server, key(&server), None).ok()).collect();
    assert_eq!(idle.len(), 32);
    let page = get(&server, &format!("/?k={}", key(&server)), &server.address.to_string());
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    drop(idle);
    let free = (0..100).any(|_| {
        std::thread::sleep(Duration::from_millis(50));
        connect(&server, key(&server), None).is_ok()
    });
    assert!(free);
}

#[test]
fn a_slow_reader_delays_nobody_and_holds_few_pictures() {
    let server = server(Packing::Png);
    let (mut slow, _) = greeted(&server);
    // It asks and asks and reads nothing: what the line does not take is not even drawn.
    slow.get_mut().set_write_timeout(Some(Duration::from_millis(200))).unwrap();
    let mut large = question(0, "color");
    (large["width"], large["height"]) = (json!(1600), json!(1200));
    for id in 1..=300u64 {
        large["id"] = json!(id);
        if slow.send(Message::Text(large.to_string().into())).is_err() {
            break;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let (mut quick, _) = greeted(&server);
    let begun = Instant::now();
    assert_eq!(ask(&mut quick, &question(5, "color")).0["id"], 5);
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
}

#[test]
fn boxes_are_described_hidden_and_saved() {
    let server = server(Packing::Png);
    let (mut socket, _) = greeted(&server);
    let red_only = json!({
        "show": 0, "look": {"free": [[0.0, 4.0, 0.25], [0.0, 0.0, 0.25], [0.0, 0.0, 1.0], 0.8]}, "time": 0.0,
        "width": 64, "height": 48, "at": [0.0, 0.5, 1.0, 1.0],
    });
    let mut with = question(1, "color");
    with["chosen"] = red_only.clone();
    let chosen = ask(&mut socket, &with).0["chosen"].clone();
    assert_eq!(
        (&chosen["count"], &chosen["of"], &chosen["spread"][0]["name"]),
        (&json!(1), &json!(2), &json!("opacity"))
    );
    let mut without = question(2, "color");
    without["hidden"] = json!([red_only]);
    let (_, png) = ask(&mut socket, &without);
    let picture = gs_core::io::images::decode_rgba8(&png, "answer.png", &gs_core::io::Limits::default()).unwrap();
    let middle = &picture.data[4 * (24 * 64 + 32)..][..3];
    assert!(middle[0] == 0 && middle[2] > 150, "blue alone: {middle:?}");
    for (part, color) in [("chosen", 0), ("rest", 2)] {
        with["save"] = json!(part);
        let (header, ply) = ask(&mut socket, &with);
        assert_eq!(header["file"], format!("red_t0.000_{part}.ply"));
        let limits = gs_core::io::Limits::default();
        let saved = gs_core::io::ply::read(&ply, "saved.ply", &limits).unwrap().to_splats().unwrap();
        assert_eq!(saved.len(), 1);
        let kept = scene();
        assert!(saved.means[0].distance(kept.means[color / 2]) < 1e-6);
        assert!(saved.color.as_flat()[color] > 0.0 && saved.color.as_flat()[2 - color] < 0.0);
    }
    without["hidden"] = json!([with["chosen"], {"show": 0, "look": with["look"], "time": 0.0, "width": 9, "height": 9, "at": [0, 0, 1, 1]}]);
    without["save"] = json!("rest");
    assert!(ask(&mut socket, &without).0["error"].as_str().unwrap().contains("no splat"));
}

#[test]
fn two_pictures_are_subtracted_and_fine_ones_are_means() {
    let server = server(Packing::Png);
    let (mut socket, _) = greeted(&server);
    let pixels = |png: &[u8]| {
        let decoded = gs_core::io::images::decode_rgba8(png, "answer.png", &gs_core::io::Limits::default()).unwrap();
        decoded.data.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>()
    };
    let mut with = question(1, "color");
    (with["against"], with["gain"], with["score"]) = (json!({"show": 0, "layer": "color"}), json!(8.0), json!(true));
    let (header, png) = ask(&mut socket, &with);
    assert!(header["psnr"].is_null() && pixels(&png).iter().all(|p| *p == [128; 3]), "nothing is left: {header}");
    with["against"]["layer"] = json!("alpha");
    with["gain"] = json!(1.0);
    let (header, png) = ask(&mut socket, &with);
    assert!(header["psnr"].as_f64().unwrap() > 0.0 && header["scored"] == json!([64, 48]), "{header}");
    // Red over white coverage: red nearly stays, green and blue go.
    let middle = pixels(&png)[24 * 64 + 32];
    assert!((i32::from(middle[0]) - 120).abs() < 9 && middle[1] < 10, "{middle:?}");
    let mut fine = question(2, "color");
    let coarse = pixels(&ask(&mut socket, &fine).1);
    fine["fine"] = json!(true);
    let (header, png) = ask(&mut socket, &fine);
    let fine = pixels(&png);
    assert_eq!((&header["width"], fine.len()), (&json!(64), coarse.len()));
    let apart = fine.iter().zip(&coarse).map(|(a, b)| a[0].abs_diff(b[0])).max();
    assert!(fine != coarse && apart < Some(25), "{apart:?}");
}

#[test]
fn splats_are_sent_as_words_and_images_as_files() {
    let server = server(Packing::Jpeg);
    let (mut socket, _) = greeted(&server);
    let mut with = question(1, "color");
    with["save"] = json!("splats");
    let (header, words) = ask(&mut socket, &with);
    assert_eq!((&header["splats"], &header["background"], words.len()), (&json!(2), &json!([0.0, 0.0, 0.0]), 64));
    let z = |k: usize| f32::from_le_bytes(words[32 * k + 8..32 * k + 12].try_into().unwrap());
    assert_eq!([z(0), z(1)], [0.0, 0.5]);
    let plain = gs_raster::RasterOptions::default();
    assert_eq!(header["raster"], json!({"near": plain.near, "dilation": plain.dilation, "antialias": false}));
    with["what"]["layer"] = json!("depth");
    assert!(ask(&mut socket, &with).0["error"].as_str().unwrap().contains("no splats"));
    let mut image = question(2, "color");
    (image["save"], image["background"]) = (json!("image"), json!([0.0, 1.0, 0.0]));
    let (header, png) = ask(&mut socket, &image);
    assert_eq!(header["file"], "red_color_t0.000.png");
    let picture = gs_core::io::images::decode_rgba8(&png, "answer.png", &gs_core::io::Limits::default()).unwrap();
    assert_eq!((picture.width, &picture.data[..3]), (64, &[0, 255, 0][..]), "the corner shows the background");
}

#[test]
fn points_and_ellipsoids_are_opaque() {
    let server = server(Packing::Png);
    let (mut socket, _) = greeted(&server);
    let mut alpha = question(1, "alpha");
    let mut covered = |style: Value| {
        alpha["style"] = style;
        let (_, png) = ask(&mut socket, &alpha);
        let picture = gs_core::io::images::decode_rgba8(&png, "answer.png", &gs_core::io::Limits::default()).unwrap();
        let all = picture.data.chunks_exact(4);
        (all.clone().filter(|p| p[0] > 240).count(), all.filter(|p| p[0] > 8).count())
    };
    let splats = covered(json!("splats"));
    let points = covered(json!({"points": 6.0}));
    let ellipsoids = covered(json!("ellipsoids"));
    assert!((20..45).contains(&points.0) && points.1 < 60, "{points:?}");
    let mut fine = question(2, "alpha");
    (fine["style"], fine["fine"]) = (json!({"points": 6.0}), json!(true));
    let (_, png) = ask(&mut socket, &fine);
    let picture = gs_core::io::images::decode_rgba8(&png, "answer.png", &gs_core::io::Limits::default()).unwrap();
    let solid = picture.data.chunks_exact(4).filter(|p| p[0] > 128).count();
    assert!((20..45).contains(&solid), "points keep their size where four samples make a pixel: {solid}");
    assert!(ellipsoids.0 > 2 * points.0 && ellipsoids.1 < splats.1, "{ellipsoids:?} {splats:?}");
}

/// What a server answers to a file.
fn post(server: &Server, path: &str, origin: Option<&str>, body: &[u8]) -> String {
    let mut stream = TcpStream::connect(server.address).unwrap();
    let origin = origin.map_or(String::new(), |o| format!("Origin: {o}\r\n"));
    let (host, length) = (server.address, body.len());
    write!(
        stream,
        "POST {path} HTTP/1.1\r\nHost: {host}\r\n{origin}Content-Length: {length}\r\nConnection: close\r\n\r\n"
    )
    .unwrap();
    // A server that refuses does not read the body.
    let _ = stream.write_all(body);
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    answer
}

#[test]
fn a_dropped_file_becomes_a_show_and_others_are_refused() {
    let server = server(Packing::Png);
    let raw = gs_core::io::RawSplats::from_splats(&scene()).unwrap();
    let mut ply = Vec::new();
    gs_core::io::ply::write(&raw, &mut ply).unwrap();
    let path = |name: &str| format!("/drop?k={}&name={name}", key(&server));
    let own = format!("http://{}", server.address);
    for (path, origin) in [(path("a.ply"), Some("http://evil.example")), ("/drop?k=0&name=a.ply".to_owned(), None)] {
        assert!(post(&server, &path, origin, &ply).starts_with("HTTP/1.1 403"), "{path}");
    }
    let (mut other, _) = greeted(&server);
    let answer = post(&server, &path("two.ply"), Some(&own), &ply);
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains(r#""number":1"#), "{answer}");
    let news: Value = serde_json::from_str(other.read().unwrap().to_text().unwrap()).unwrap();
    assert_eq!(news["listed"][1]["name"], "two.ply", "a page that was open learns of it");
    let bad = post(&server, &path("bad.ply"), Some(&own), b"ply\nnothing");
    assert!(bad.starts_with("HTTP/1.1 422") && bad.contains("bad.ply"), "{bad}");
    let (mut socket, about) = greeted(&server);
    assert_eq!(about["shows"][1]["name"], "two.ply");
    let mut dropped = question(1, "color");
    dropped["what"]["show"] = json!(1);
    assert_eq!(ask(&mut socket, &dropped).0["splats"], 2);
}

#[test]
fn viewers_are_counted_and_a_taken_port_is_left_alone() {
    let (first, second) = (server(Packing::Png), server(Packing::Png));
    assert_ne!(first.address.port(), second.address.port());
    let mut held: Vec<_> = (0..32).map(|_| connect(&first, key(&first), None).unwrap()).collect();
    assert!(connect(&first, key(&first), None).unwrap_err().contains("503"));
    held.pop();
    let again = (0..100).any(|_| {
        std::thread::sleep(Duration::from_millis(50));
        connect(&first, key(&first), None).is_ok()
    });
    assert!(again, "a place is free again");
    drop(held);
    let url = first.url.clone();
    drop(first);
    let gone = url.strip_prefix("http://").unwrap().split('/').next().unwrap().to_owned();
    assert!(TcpStream::connect(gone).is_err(), "stopped");
}
