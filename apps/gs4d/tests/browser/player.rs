//! The page of `gs4d export -o NAME.html`, opened from the disk: it draws what its clip holds, plays, and shows layers.

use crate::chromium::base64;
use crate::{Desk, good, text};
use gs_core::Camera;
use gs_core::io::Limits;
use gs_core::io::images::load_image;
use gs_raster::{RasterOptions, Workspace, render};
use gs4d_player::Clip;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// The image that the page draws at rest of its own camera, 480 by 360 pixels, at the present time, that camera, and the background.
const DRAWN: &str = "(async () => { const c = camera(480, 360); await renderer.settled(c, state.t); return [$('image').toDataURL(), c, page.background]; })()";
/// The pace of a camera that orbits while the scene plays, images a second.
const PACE: &str = "new Promise((done) => { play(true); let n = 0; const go = () => { orbit(0.02, 0); n++ < 90 ? requestAnimationFrame(go) : (play(false), done(rate.get())); }; go(); })";

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap()
}

/// The camera of a page, as JSON, as ours.
fn camera(json: &Value) -> Camera {
    let m: Vec<f64> = json["viewmat"].as_array().unwrap().iter().map(number).collect();
    let row = |r: usize| glam::DVec3::new(m[4 * r], m[4 * r + 1], m[4 * r + 2]);
    Camera {
        width: 480,
        height: 360,
        fx: number(&json["fx"]),
        fy: number(&json["fy"]),
        cx: number(&json["cx"]),
        cy: number(&json["cy"]),
        rotation: glam::DMat3::from_cols(row(0), row(1), row(2)).transpose(),
        translation: glam::DVec3::new(m[3], m[7], m[11]),
    }
}

/// PSNR of what the page drew against the rasteriser's image of the clip, dB.
fn against_rasteriser(drawn: &Value, clip: &Clip, time: f32, file: &Path) -> f64 {
    std::fs::write(file, base64(drawn[0].as_str().unwrap().split_once(',').unwrap().1)).unwrap();
    let (theirs, camera) = (load_image(file, &Limits::default()).unwrap(), camera(&drawn[1]));
    let background = std::array::from_fn(|c| drawn[2][c].as_f64().unwrap() as f32);
    let gs4d_player::RenderSettings { near, dilation, antialias } = clip.render_settings();
    let options = RasterOptions { background, near, dilation, antialias, ..RasterOptions::default() };
    let ours = render(&clip.splats(time), &camera, &options, &mut Workspace::new()).rgb;
    let sum: f64 = (0..360 * 480)
        .flat_map(|k| (0..3).map(move |c| (k, c)))
        .map(|(k, c)| {
            f64::from(theirs.pixel(k % 480, k / 480)[c] - ours.pixel(k % 480, k / 480)[c].clamp(0.0, 1.0)).powi(2)
        })
        .sum();
    -10.0 * (sum / (3.0 * 360.0 * 480.0)).log10()
}

#[test]
#[ignore = "half a minute: cargo test -p gs4d --test browser -- --ignored --nocapture page_plays"]
fn a_page_plays_the_scene() {
    let Some(mut desk) = Desk::new() else { return };
    let balls = desk.balls();
    for method in ["fourdgs", "fags", "modec", "trace-4dgs"] {
        let many = ["--set", "init.points=25000", "--set", "schedule.density.max_splats=25000"];
        let more = if method == "fourdgs" { &many[..] } else { &[] };
        let run = desk.train(&balls, method, &[&["--steps", "80"], more].concat());
        let page: PathBuf = desk.dir.path().join(format!("{method}.html"));
        good(&["export", text(&run), "--times", "0..1:60", "-q", "-o", text(&page)]);
        let clip = gs4d_player::read(&std::fs::read_to_string(&page).unwrap()).unwrap();
        desk.browser.resize(1000, 800);
        desk.browser.open(&format!("file://{}", page.display()));
        desk.browser.until("document.body && document.body.dataset.ready === '-1'");
        let mut worst = f64::INFINITY;
        for (time, turn) in [(0.0f32, 0.0), (0.37, 0.3), (1.0, -0.2)] {
            desk.browser.eval(&format!("setTime({time}); orbit({turn}, 0.1)"));
            let drawn = desk.browser.eval(DRAWN);
            worst = worst.min(against_rasteriser(&drawn, &clip, time, &desk.shots.join(format!("page-{method}.png"))));
        }
        let pace = number(&desk.browser.eval(PACE));
        let size = desk.browser.eval("`${clip.count} splats at ${$('image').width}x${$('image').height}`");
        let bytes = std::fs::metadata(&page).unwrap().len();
        println!(
            "{method}, {size}, {:.2} MB: {worst:.1} dB from the rasteriser's image, {pace:.0} images a second",
            bytes as f64 / 1e6
        );
        assert!(worst > 35.0, "{method}: {worst} dB");
        desk.browser.eval("setTime(0.5)");
        desk.shot(&format!("page-{method}-window"));
        let layers = desk.browser.eval("clip.layers.map((l) => l.name)");
        assert_eq!(layers[0], "path", "{layers}");
        let before = desk.browser.eval(DRAWN)[0].clone();
        desk.browser.set("layer", "0");
        desk.browser.until("document.body.dataset.ready === '0'");
        assert_ne!(desk.browser.eval(DRAWN)[0], before, "{method}: the layer looks otherwise");
        desk.browser.resize(390, 800);
        desk.shot(&format!("page-{method}-phone"));
        assert!(desk.browser.complaints.is_empty(), "{method}: {:?}", desk.browser.complaints);
        assert_eq!(desk.browser.eval("$('notice').hidden"), json!(true));
        assert_eq!(
            desk.browser.eval("performance.getEntriesByType('resource').length"),
            json!(0),
            "{method}: nothing is fetched"
        );
        desk.browser.leave();
    }
}

#[test]
#[ignore = "half a minute: cargo test -p gs4d --test browser -- --ignored --nocapture page_plays"]
fn a_page_plays_by_buttons_keys_and_fingers() {
    let Some(mut desk) = Desk::new() else { return };
    let balls = desk.balls();
    let run = desk.train(&balls, "fourdgs", &["--steps", "80"]);
    let page = desk.dir.path().join("scene.html");
    good(&["export", text(&run), "--times", "0..1:30", "--no-eval", "-q", "-o", text(&page)]);
    desk.browser.resize(1000, 800);
    desk.browser.open(&format!("file://{}", page.display()));
    desk.browser.until("document.body && document.body.dataset.ready === '-1'");
    buttons_and_keys(&mut desk);
    fingers_and_scheme(&mut desk);
    assert!(desk.browser.complaints.is_empty(), "{:?}", desk.browser.complaints);
    desk.browser.leave();
}

fn buttons_and_keys(desk: &mut Desk) {
    desk.browser.eval("setTime(0)");
    let (first, begun) = (desk.browser.eval(DRAWN)[0].clone(), desk.browser.eval("$('now').textContent"));
    desk.browser.click("play");
    desk.browser.until("state.playing && state.t > 0.2 && $('play').getAttribute('aria-label') === 'Pause'");
    desk.browser.eval("document.activeElement.blur()");
    desk.browser.key(" ");
    desk.browser.until("!state.playing && $('play').getAttribute('aria-label') === 'Play'");
    assert_ne!(desk.browser.eval(DRAWN)[0], first, "the scene has moved");
    assert_ne!(desk.browser.eval("$('now').textContent"), begun);
    // Without a loop it stops at the end, with one it begins anew.
    desk.browser.click("loop");
    desk.browser.eval("document.activeElement.blur(); setTime(0.95)");
    desk.browser.key(" ");
    desk.browser.until("!state.playing && state.t === 1 && $('loop').getAttribute('aria-pressed') === 'false'");
    desk.browser.click("loop");
    desk.browser.eval("document.activeElement.blur(); setTime(0.95)");
    desk.browser.key(" ");
    desk.browser.until("state.playing && state.t < 0.5 && $('loop').getAttribute('aria-pressed') === 'true'");
    desk.browser.eval("setTime(0.5)");
    desk.browser.click("full");
    desk.browser.until("document.fullscreenElement === document.documentElement");
    desk.browser.eval("document.activeElement.blur()");
    desk.browser.key("f");
    desk.browser.until("document.fullscreenElement === null");
}

fn fingers_and_scheme(desk: &mut Desk) {
    let (far, before) = (number(&desk.browser.eval("distance()")), desk.browser.eval(DRAWN)[0].clone());
    let [x, y] = desk.browser.middle("stage");
    // Twice as far apart.
    desk.browser.pinch([[[x - 60.0, y], [x - 120.0, y]], [[x + 60.0, y], [x + 120.0, y]]]);
    desk.browser.until("pointers.size === 0");
    let near = number(&desk.browser.eval("distance()"));
    assert!((near / far - 0.5).abs() < 0.05, "from {far} to {near}");
    assert_ne!(desk.browser.eval(DRAWN)[0], before, "what is nearer looks larger");
    let paper = "getComputedStyle(document.body).backgroundColor";
    for (scheme, color) in [("light", "rgb(244, 245, 247)"), ("dark", "rgb(25, 26, 29)")] {
        desk.browser.prefer(scheme);
        desk.browser.until(&format!("{paper} === '{color}'"));
        desk.shot(&format!("page-{scheme}"));
    }
    desk.browser.prefer("");
}

/// Milliseconds of the page's thread for a frame of a time that was not shown before, and of the worker for a new order.
const WORK: &str = "(async () => {
  const begun = performance.now(), keys = [3, 17, 31, 45, 59].map((k) => clip.key(k, null)), key = (performance.now() - begun) / 5;
  const sorter = renderer.sorter, c = camera(1280, 720), m = [...c.viewmat], times = [];
  await renderer.settled(c, 0.5);
  const own = sorter.onmessage;
  for (let k = 0; k < 12; k++) {
    m[3] += 1e-4;
    const at = performance.now();
    await new Promise((done) => { sorter.onmessage = done; sorter.postMessage({ id: `w${k}`, camera: { ...c, viewmat: m }, time: 0.5, order: null }); });
    times.push(performance.now() - at);
  }
  sorter.onmessage = own;
  return [key, times.sort((a, b) => a - b)[6], keys.length];
})()";

/// What a page of 100 000 splats asks of a computer beside its graphics card.
#[test]
#[ignore = "a minute: cargo test -p gs4d --test browser -- --ignored --nocapture page_of_100_000"]
fn a_page_of_100_000_splats_leaves_time_for_the_graphics_card() {
    let Some(mut desk) = Desk::new() else { return };
    let balls = desk.balls();
    let many = ["--steps", "20", "--set", "init.points=100000", "--set", "schedule.density.max_splats=100000"];
    let run = desk.train(&balls, "fourdgs", &many);
    let page = desk.dir.path().join("many.html");
    good(&["export", text(&run), "--times", "0..1:60", "--no-eval", "-q", "-o", text(&page)]);
    desk.browser.resize(1000, 800);
    desk.browser.open(&format!("file://{}", page.display()));
    desk.browser.until("document.body && document.body.dataset.ready === '-1'");
    desk.browser.eval("play(false)");
    let work = desk.browser.eval(WORK);
    let (key, sort) = (number(&work[0]), number(&work[1]));
    let (count, bytes) = (desk.browser.eval("clip.count"), std::fs::metadata(&page).unwrap().len());
    println!("{count} splats, {:.2} MB: a new frame {key:.1} ms, an order {sort:.1} ms", bytes as f64 / 1e6);
    // An order runs beside the page; a frame is made once and kept.
    assert!(key < 100.0 && sort < 100.0, "{key} {sort}");
    assert!(desk.browser.complaints.is_empty(), "{:?}", desk.browser.complaints);
    desk.browser.leave();
}
