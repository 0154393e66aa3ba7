//! The viewer as a person uses it: headless Chromium opens runs of every method, drags, scrubs, compares, picks, poses.
//!
//! Screenshots are left in `tmp/browser` of the build folder. Without Chromium the tests say so and pass.

mod chromium;
mod desk;
mod others;
mod player;

use chromium::Chromium;
use desk::{COLORS, Desk, PIXELS, Viewer, at_rest, good, text};
use std::path::Path;

#[test]
#[ignore = "minutes: cargo test -p gs4d --test browser -- --ignored --nocapture"]
fn every_method_is_opened_dragged_scrubbed_compared_and_picked() {
    let Some(mut desk) = Desk::new() else { return };
    let (balls, film) = (desk.balls(), desk.film());
    for method in gs_methods::registry() {
        let data = if method.needs_avatar { &film } else { &balls };
        let run = desk.train(data, method.name, &["--steps", "80"]);
        let viewer = Viewer::start(&["view", text(&run), "--port", "18500"]);
        println!("{}", method.name);
        look_at(&mut desk, &viewer.url, method.name);
    }
}

fn look_at(desk: &mut Desk, url: &str, name: &str) {
    desk.open(url);
    let first = desk.browser.eval(PIXELS);
    assert!(desk.browser.eval(COLORS).as_u64() > Some(50), "{name} is blank");
    desk.browser.until("$('status').textContent.includes('PSNR of this held-out view')");
    desk.shot(&format!("{name}-1-opened"));

    desk.drag();
    assert!(desk.changed(&first), "{name}: dragging turns the scene");
    let turned = desk.browser.eval(PIXELS);
    desk.browser.set("t", "0.6");
    let still = ["static3d", "scaffold"].contains(&name);
    assert_eq!(desk.changed(&turned), !still, "{name}: time moves what moves");
    assert!(desk.browser.eval("$('seconds').textContent").as_str().unwrap().contains("0.600"));

    let [x, y] = desk.browser.middle("stage");
    desk.browser.drag(&[[x, y]]);
    desk.browser.until("$('picked').querySelector('td') !== null");
    desk.shot(&format!("{name}-2-picked"));

    desk.browser.set("view", "0");
    desk.compare("wipe");
    desk.browser.set("layer-b", "truth");
    desk.browser.until(&at_rest('b'));
    desk.browser.until("$('label-b').textContent.endsWith('truth')");
    desk.shot(&format!("{name}-3-compared"));
    desk.compare("");

    let layers = desk.browser.eval("about().layers");
    for layer in layers.as_array().unwrap().iter().filter_map(|l| l.as_str()) {
        desk.layer(layer);
        desk.browser.until(&format!("document.body.dataset.a.startsWith('{layer} ')"));
        desk.browser.until(&at_rest('a'));
    }
    desk.shot(&format!("{name}-4-{}", layers.as_array().unwrap().last().unwrap().as_str().unwrap().replace(' ', "-")));
    desk.layer("color");
    desk.browser.resize(360, 740);
    desk.browser.until(&at_rest('a'));
    let wide = desk.browser.eval("document.documentElement.scrollWidth - innerWidth");
    assert!(wide.as_i64() <= Some(0), "{name}: {wide} pixels too wide");
    desk.shot(&format!("{name}-5-narrow"));
    desk.no_complaints(name);
    // A page whose viewer has ended would rightly complain.
    desk.browser.leave();
}

#[test]
#[ignore = "a minute: cargo test -p gs4d --test browser -- --ignored --nocapture"]
fn checkpoints_differences_boxes_and_cameras() {
    let Some(mut desk) = Desk::new() else { return };
    let balls = desk.balls();
    let run = desk.train(&balls, "fourdgs", &["--steps", "200", "--set", "run.checkpoint_every=100"]);
    let other = desk.train(&balls, "static3d", &["--steps", "100"]);
    let viewer = Viewer::start(&["view", text(&run), text(&other), "--port", "18520"]);
    desk.open(&viewer.url);
    let end = desk.browser.eval(PIXELS);
    assert_eq!(desk.browser.eval("about().checkpoints"), serde_json::json!([200, 100]));
    desk.browser.set("step-a", "100");
    assert!(desk.changed(&end), "step 100 looks otherwise");
    desk.browser.set("step-a", "-1");
    desk.compare("difference");
    desk.browser.set("show-b", "0");
    desk.browser.set("step-b", "100");
    desk.browser.until("$('status').textContent.includes('PSNR between the two')");
    desk.browser.until(&at_rest('a'));
    desk.shot("difference");
    desk.compare("flicker");
    desk.browser.until(&at_rest('b'));
    desk.browser.eval("stage.focus()");
    desk.browser.key("x");
    desk.browser.until("!$('b').hidden && $('label-a').textContent.includes('step 100')");
    desk.browser.key("x");
    desk.browser.until("$('b').hidden");
    desk.compare("");
    desk.browser.until(&at_rest('a'));

    desk.browser.eval("stage.focus()");
    desk.browser.key("v");
    desk.browser.until("document.querySelectorAll('#lines .arrow').length > 10");
    desk.shot("velocities");
    desk.browser.key("v");
    desk.browser.click("cameras");
    desk.browser.until("thumbs.filter((t) => t.group === 'thumbs' && t.asked && t.canvas.width === 64).length > 2");
    desk.browser.eval("stage.focus()");
    (0..12).for_each(|_| desk.browser.key("-"));
    desk.browser.until(&at_rest('a'));
    assert!(desk.browser.eval("document.querySelectorAll('#lines .camera').length").as_u64() > Some(3));
    desk.shot("cameras");
    desk.browser.click("cameras");

    desk.browser.key("Escape");
    desk.browser.set("view", "0");
    desk.browser.until(&at_rest('a'));
    let whole = desk.browser.eval(PIXELS);
    desk.browser.eval("$('selecting').open = true");
    desk.browser.click("boxing");
    let [x, y] = desk.browser.middle("stage");
    desk.browser.drag(&[[x - 60.0, y - 60.0], [x, y], [x + 60.0, y + 60.0]]);
    desk.browser.until("$('count').textContent.includes('centre in the box') && $('spread').children.length > 2");
    desk.shot("box");
    desk.browser.click("save-chosen");
    desk.browser.until("$('status').textContent.startsWith('saved')");
    good(&["inspect", text(&desk.browser.downloaded("_chosen.ply"))]);
    desk.browser.click("hide");
    assert!(desk.changed(&whole), "what is hidden is not seen");
    // The address holds all of it.
    desk.browser.until("location.hash.includes('%22h%22%3A%5B%7B')");
    let again = desk.browser.eval("location.href");
    desk.open(again.as_str().unwrap());
    desk.browser.until("!$('unhide').hidden && state.hidden.length === 1");
    desk.browser.until("document.body.dataset.a.endsWith('fine')");
    desk.browser.click("unhide");
    desk.browser.until("state.hidden.length === 0");
    desk.browser.eval("stage.focus()");
    desk.browser.key("u");
    desk.browser.until("state.view === -1");
    desk.browser.until(&at_rest('a'));
    desk.no_complaints("the end");
}

#[test]
#[ignore = "a minute: cargo test -p gs4d --test browser -- --ignored --nocapture"]
fn a_person_takes_other_poses() {
    let Some(mut desk) = Desk::new() else { return };
    let film = desk.film();
    let run = desk.train(&film, "dut", &["--steps", "60"]);
    let viewer = Viewer::start(&["view", text(&run), "--port", "18540"]);
    desk.open(&viewer.url);
    let inputs = desk.browser.eval("$('inputs').textContent");
    assert!(inputs.as_str().unwrap().contains("in the pose it was filmed in"), "{inputs}");
    let filmed = desk.browser.eval(PIXELS);
    let arm = desk.browser.eval("about().joints.findIndex((n) => /arm|elbow|shoulder/i.test(n))");
    desk.browser.set("joint", &arm.to_string());
    desk.browser.set("turn-0", "60");
    desk.browser.set("turn-2", "60");
    assert!(desk.changed(&filmed), "a turned arm is seen");
    let inputs = desk.browser.eval("$('inputs').textContent");
    assert!(inputs.as_str().unwrap().contains("turned by you"), "{inputs}");
    desk.shot("posed");
    let turned = desk.browser.eval(PIXELS);
    desk.browser.click("unpose");
    assert!(desk.changed(&turned));
    let filmed = desk.browser.eval(PIXELS);
    desk.browser.click("borrow");
    desk.browser.set("from", "1");
    assert!(desk.changed(&filmed), "the pose of another time");
    desk.shot("borrowed");
    desk.no_complaints("dut");
}

#[test]
#[ignore = "a minute: cargo test -p gs4d --test browser -- --ignored --nocapture"]
fn training_is_watched() {
    let Some(mut desk) = Desk::new() else { return };
    let (balls, run) = (desk.balls(), desk.dir.path().join("live"));
    let recipe = ["-m", "fourdgs", "--preset", "fast", "--view", "--view-port", "18560", "--quiet"];
    let viewer = Viewer::start(&[&["train", text(&balls), "-o", text(&run)][..], &recipe].concat());
    desk.open(&viewer.url);
    desk.browser.until("!$('training').hidden && $('progress').textContent.includes('step')");
    desk.browser.until(&at_rest('a'));
    let (before, early) = (desk.browser.eval(PIXELS), desk.browser.eval("$('progress').textContent"));
    desk.browser.until(&format!("$('progress').textContent !== {early}"));
    desk.browser.until("$('curves').children.length === 2");
    desk.browser.until(&format!("{PIXELS} !== {before}"));
    desk.browser.until("thumbs.every((t) => t.name === 'segment' || (t.asked && t.canvas.width <= 128))");
    desk.shot("training");
    // While the camera moves the browser draws the splats of a copy, and of a later one after a while.
    desk.browser.until("locals.a.clip && locals.a.clip.ready");
    desk.browser.eval("orbit(0.1, 0)");
    desk.browser.until("locals.a.drawn && !$('local-a').hidden");
    let step = desk.browser.eval("locals.a.clip.step");
    desk.browser.until(&format!("locals.a.clip.step > {step}"));
    desk.drag();
    desk.browser.until(&at_rest('a'));
    desk.browser.click("pause");
    desk.browser.until("$('pause').textContent === 'Go on'");
    std::thread::sleep(std::time::Duration::from_secs(1));
    let paused = desk.browser.eval("$('progress').textContent");
    std::thread::sleep(std::time::Duration::from_secs(3));
    assert_eq!(desk.browser.eval("$('progress').textContent"), paused);
    desk.browser.click("pause");
    desk.browser.until(&format!("$('progress').textContent !== {paused}"));
    desk.no_complaints("training");
}

/// Width and height of a PNG.
fn size_of(png: &Path) -> [usize; 2] {
    let bytes = std::fs::read(png).unwrap();
    let image = gs_core::io::images::decode_rgba8(&bytes, "saved.png", &gs_core::io::Limits::default()).unwrap();
    [image.width, image.height]
}

/// PSNR between what the browser draws on a side and the server's image of the same camera and time, dB.
fn apart(side: char) -> String {
    let call = "(async (side) => {
    const shown = $(side), { width, height } = shown, at = (c) => { const d = document.createElement('canvas');
        d.width = width; d.height = height; const g = d.getContext('2d'); g.drawImage(c, 0, 0); return g.getImageData(0, 0, width, height).data; };
    const server = at(shown);
    await locals[side].renderer.settled(cameraOf(width, height), state.t);
    const here = at($('local-' + side));
    let sum = 0, n = 0;
    for (let k = 0; k < here.length; k++) if (k % 4 < 3) { sum += ((here[k] - server[k]) / 255) ** 2; n++; }
    return -10 * Math.log10(sum / n);
})";
    format!("{call}('{side}')")
}

/// Whether the side of that name holds all splats that it draws.
fn all_fetched(side: char) -> String {
    format!(
        "locals.{side}.clip && locals.{side}.clip.ready && locals.{side}.clip.have.size === locals.{side}.clip.times.length"
    )
}

#[test]
#[ignore = "a minute: cargo test -p gs4d --test browser -- --ignored --nocapture"]
fn the_browser_draws_what_moves_as_the_server_does() {
    let Some(mut desk) = Desk::new() else { return };
    let balls = desk.balls();
    for method in ["fourdgs", "fags", "modec"] {
        let many = ["--set", "init.points=25000", "--set", "schedule.density.max_splats=25000"];
        let more = if method == "modec" { &[][..] } else { &many };
        let run = desk.train(&balls, method, &[&["--steps", "80"], more].concat());
        let viewer = Viewer::start(&["view", text(&run), "--port", "18580"]);
        desk.open(&viewer.url);
        desk.browser.until(&all_fetched('a'));
        desk.drag();
        // At rest and not supersampled, at the time of a key.
        desk.browser.eval("setTime(locals.a.clip.times[5])");
        desk.browser.until("document.body.dataset.a.endsWith(' rest')");
        let apart = desk.browser.eval(&apart('a')).as_f64().unwrap();
        // Colours and shapes of modec's Gaussians depend on the camera: those of the clip are of the camera it was fetched for.
        assert!(apart > if method == "modec" { 25.0 } else { 40.0 }, "{method}: {apart} dB");
        let rate = desk.browser.eval(
            "new Promise((done) => { let n = 0; const go = () => { orbit(0.02, 0); n++ < 90 ? requestAnimationFrame(go) : done(frames.rate()); }; go(); })",
        );
        let size = desk.browser.eval("`${about().splats} splats at ${$('local-a').width}x${$('local-a').height}`");
        let rate = rate.as_f64().unwrap();
        println!("{method}, {size}: {apart:.1} dB from the server's image, {rate:.0} images a second");
        assert_eq!(desk.browser.eval("$('local-a').hidden"), false, "{method}");
        desk.browser.until(&at_rest('a'));
        assert_eq!(desk.browser.eval("$('local-a').hidden"), true, "{method}: the server's image takes its place");
        desk.no_complaints(method);
        desk.browser.leave();
    }
}

#[test]
#[ignore = "a minute: cargo test -p gs4d --test browser -- --ignored --nocapture"]
fn the_browser_draws_both_sides_of_a_comparison() {
    let Some(mut desk) = Desk::new() else { return };
    let balls = desk.balls();
    let runs = ["fourdgs", "static3d"].map(|method| desk.train(&balls, method, &["--steps", "120"]));
    let viewer = Viewer::start(&["view", text(&runs[0]), text(&runs[1]), "--port", "18620"]);
    desk.open(&viewer.url);
    desk.browser.eval("setTime(0.3)");
    desk.compare("wipe");
    for side in ['a', 'b'] {
        desk.browser.until(&all_fetched(side));
    }
    desk.browser.eval("orbit(0.3, 0.1)");
    desk.browser.until("locals.a.drawn && locals.b.drawn && !$('local-a').hidden && !$('local-b').hidden");
    assert_eq!(desk.browser.eval("$('local-b').style.clipPath"), "inset(0px 0px 0px 50%)");
    desk.browser.eval("setTime(locals.a.clip.times[5])");
    for side in ['a', 'b'] {
        desk.browser.until(&format!("document.body.dataset.{side}.endsWith(' rest')"));
        let apart = desk.browser.eval(&apart(side)).as_f64().unwrap();
        println!("side {side}: {apart:.1} dB from the server's image");
        assert!(apart > 40.0, "{side}: {apart} dB");
    }
    let go = "{ let n = 0; const go = () => { orbit(0.02, 0); n++ < 60 && requestAnimationFrame(go); }; go(); }";
    desk.browser.eval(go);
    desk.browser.until("locals.a.drawn && locals.b.drawn");
    desk.shot("wipe-drawn-here");
    desk.browser.until(&at_rest('a'));
    desk.browser.until(&at_rest('b'));
    assert_eq!(desk.browser.eval("[$('local-a').hidden, $('local-b').hidden]"), serde_json::json!([true, true]));
    // The splats of the second side are given back, and fetched again when they are wanted.
    desk.compare("");
    desk.browser.until("!locals.b.renderer && !locals.b.clip");
    desk.compare("flicker");
    desk.browser.until(&all_fetched('b'));
    desk.browser.eval("stage.focus()");
    desk.browser.key("x");
    desk.browser.eval("orbit(0.1, 0)");
    desk.browser.until("locals.b.drawn && !$('local-b').hidden && $('local-b').style.clipPath === ''");
    // What has no splats comes from the server beside what is drawn here.
    desk.compare("wipe");
    desk.browser.set("layer-b", "depth");
    desk.browser.until(&at_rest('b'));
    desk.browser.eval("orbit(0.1, 0)");
    desk.browser.until("locals.a.drawn && !locals.b.drawn && document.body.dataset.b.startsWith('depth ')");
    desk.browser.until(&at_rest('b'));
    desk.no_complaints("both sides");
}

#[test]
#[ignore = "a minute: cargo test -p gs4d --test browser -- --ignored --nocapture"]
fn images_cameras_paths_and_dropped_files() {
    let Some(mut desk) = Desk::new() else { return };
    let balls = desk.balls();
    let run = desk.train(&balls, "fourdgs", &["--steps", "80"]);
    // Without its data a run keeps time, views and background.
    std::fs::rename(&balls, desk.dir.path().join("elsewhere")).unwrap();
    let viewer = Viewer::start(&["view", text(&run), "--port", "18600"]);
    desk.open(&viewer.url);
    assert_eq!(
        desk.browser.eval("[$('time').hidden, about().times.length, about().views.length]"),
        serde_json::json!([false, 16, 19])
    );
    assert!(!desk.browser.eval("about().layers").as_array().unwrap().contains(&"truth".into()));
    desk.shot("without-data");

    desk.drag();
    desk.browser.until(&at_rest('a'));
    desk.browser.eval("$('picture-size').closest('details').open = true");
    desk.browser.set("picture-size", "1280x720");
    desk.browser.click("save-image");
    assert_eq!(size_of(&desk.browser.downloaded(".png")), [1280, 720]);

    desk.browser.eval("addBookmark()");
    for _ in 0..3 {
        desk.browser.click("add-key");
        desk.drag();
    }
    desk.browser.until(&at_rest('a'));
    desk.browser.click("save-path");
    let path = format!("path:{}", desk.browser.downloaded("path.json").display());
    let out = desk.dir.path().join("flight");
    let size = ["--size", "64x48", "--times", "0..1:4"];
    good(&[&["render", text(&run), "--camera", &path, "-o", text(&out)][..], &size].concat());
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 4);
    // The camera that was copied renders what was shown.
    let entry = desk.browser.eval("JSON.stringify(cameraEntry())");
    let camera = desk.dir.path().join("camera.json");
    std::fs::write(&camera, entry.as_str().unwrap()).unwrap();
    good(&["render", text(&run), "--camera", text(&camera), "-o", text(&desk.dir.path().join("copied"))]);
    let copied = size_of(&desk.dir.path().join("copied/view.png"));
    let shown = desk.browser.eval("(async () => { again(); await new Promise((r) => setTimeout(r, 600)); return [$('a').width, $('a').height]; })()");
    assert_eq!(shown, serde_json::json!(copied));

    desk.browser.eval("document.querySelector('#marks button').click()");
    desk.browser.until(&at_rest('a'));
    let export = desk.dir.path().join("still.ply");
    good(&["export", text(&run), "-o", text(&export), "--no-eval"]);
    let mut other = Chromium::start(&chromium::find().unwrap());
    other.resize(1000, 800);
    other.open(&viewer.url);
    other.until("document.readyState === 'complete' && (document.body.dataset.a ?? '').endsWith(' fine')");
    let bytes: Vec<String> = std::fs::read(&export).unwrap().iter().map(u8::to_string).collect();
    desk.browser.eval(&format!("dropped([new File([new Uint8Array([{}])], 'still.ply')])", bytes.join(",")));
    desk.browser.until("shows.length === 2 && about().name === 'still.ply' && $('time').hidden");
    desk.browser.until(&at_rest('a'));
    assert!(desk.browser.eval(COLORS).as_u64() > Some(50));
    // A page that was open before has it in its list, and goes on showing what it showed.
    other.until("[...$('show-a').options].map((o) => o.textContent).join() === 'run-fourdgs,still.ply'");
    assert_eq!(other.eval("[state.a[0], about().name, $('show-a').value]"), serde_json::json!([0, "run-fourdgs", "0"]));
    assert_eq!(other.eval("$('status').textContent"), "new under Show: still.ply");
    other.eval("$('show-a').size = 2");
    other.shot(&desk.shots.join("listed-elsewhere.png"));
    other.eval("$('show-a').size = 0");
    other.set("show-a", "1");
    other.until("about().name === 'still.ply'");
    other.until(&at_rest('a'));
    other.shot(&desk.shots.join("opened-elsewhere.png"));
    assert!(other.complaints.is_empty(), "{:?}", other.complaints);
    desk.no_complaints("tools");
}
