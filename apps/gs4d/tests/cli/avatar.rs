//! Films of people: made, read, trained on by a method that knows nothing of templates.

use crate::support::{good, gs4d, text};
use gs_core::testkit::shared;
use serde_json::Value;

const SMALL: [&str; 8] = ["--cams", "8x1", "--frames", "4", "--size", "40", "--points", "500"];

#[test]
fn a_film_is_made_and_trained_on() {
    let dir = tempfile::tempdir().unwrap();
    let (film, run) = (dir.path().join("film"), dir.path().join("run"));
    let made = good(&[&["synth", "avatar", "-o", text(&film), "--truth", "--json"][..], &SMALL].concat()).json();
    assert_eq!(made["views"], serde_json::json!([16, 0, 16]));
    assert_eq!((made["conditioning_cameras"].as_u64(), made["layout"].as_str()), (Some(4), Some("avatar")));
    for file in ["scene.json", "cameras.json", "images/007/000003.png", "points/000000.ply", "gt/000/000001.exr"] {
        assert!(film.join(file).is_file(), "{file}");
    }
    let recipe = ["-m", "defgs", "--preset", "tiny", "--steps", "30", "--quiet"];
    good(&[&["train", text(&film), "-o", text(&run)][..], &recipe].concat());
    let scores = good(&["eval", text(&run), "--json"]).json();
    let psnr = scores["mean"]["psnr"].as_f64().unwrap_or_default();
    assert!(psnr > 10.0, "{scores}");
    gs4d(&["synth", "avatar", "-o", text(&film)]).fails(6, &["is not empty", "-f"]);
    let rig = film.join("intri.yml");
    gs4d(&["init", text(&film), "--cameras", text(&rig)]).fails(6, &["cameras.json"]);
    gs4d(&["init", text(&film), "--cameras", text(&rig), "-f"]).fails(6, &["intri.yml"]);
    gs4d(&["init", text(&film), "--held-out", "1"]).fails(2, &["--cameras"]);
}

/// By the method's own section, which `inspect` prints, too; other methods have none.
#[test]
fn offsets_of_the_template_are_scored_where_the_truth_is_known() {
    let dir = tempfile::tempdir().unwrap();
    let (film, run) = (dir.path().join("film"), dir.path().join("run"));
    good(&[&["synth", "avatar", "-o", text(&film)][..], &SMALL].concat());
    let train = ["train", text(&film), "-m", "dut", "--preset", "direct", "--steps", "8", "-o", text(&run), "--quiet"];
    let small = ["textures.unproject=48", "textures.geo=32", "textures.gau=48"];
    good(&[&train[..], &small.map(|set| ["--set", set]).concat()].concat());
    let table = good(&["eval", text(&run), "--quiet"]).out;
    assert!(table.contains("error of offsets") && table.contains("error along normals"), "{table}");
    let read =
        |name: &str| -> Value { serde_json::from_str(&std::fs::read_to_string(run.join(name)).unwrap()).unwrap() };
    let kept = read("metrics.json")["section"]["offsets"].clone();
    for (what, k) in [("error", 0), ("error", 1), ("length_m", 0), ("length_m", 1)] {
        assert!(kept[what][k].as_f64().is_some_and(|v| v > 0.0), "{what} {k}: {kept}");
    }
    let said = good(&["eval", text(&run), "--split", "train", "--json"]).json();
    assert_eq!(said["section"]["offsets"], kept, "of all frames, whatever the split");
    let inspected = good(&["inspect", text(&run), "--moments", "4", "--json"]).json();
    assert_eq!(inspected["journal"]["offsets"], kept);
    let other = good(&["eval", text(crate::support::run()), "--json"]).json();
    assert!(other["section"].is_null() && other["mean"]["psnr"].is_number(), "{other}");
}

#[test]
fn a_palette_is_laid_out_anew_and_told() {
    let Some(knight) = shared("data/gltf_public/KayKit_Knight.glb") else { return };
    let dir = tempfile::tempdir().unwrap();
    let film = dir.path().join("film");
    let few = ["--cams", "4x1", "--frames", "1", "--size", "64", "--points", "0"];
    let made = good(&[&["synth", "avatar", "-o", text(&film), "--template", text(&knight)][..], &few].concat());
    assert!(made.err.contains("laid out anew"), "{}", made.err);
    let scene: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(film.join("scene.json")).unwrap()).unwrap();
    assert_eq!((&scene["auto_uv"], &scene["generated"]["atlas"]), (&true.into(), &"anew".into()));
    let tex =
        ["lab", "tex", "--sizes", "128", "--template", text(&knight), "--film-frames", "1", "--size", "96", "--json"];
    let found = good(&[&tex[..], &["-o", text(&dir.path().join("lab"))]].concat()).json();
    assert!(found["rows"][0]["texture dB"].as_f64().unwrap() > 20.0, "{found}");
}

#[test]
fn wrong_flags_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("film");
    let film = |more: &[&str]| gs4d(&[&["synth", "avatar", "-o", text(&out)][..], more].concat());
    film(&["--clip", "fly"]).fails(2, &["fly", "walk, wave, turn"]);
    film(&["--cams", "6x2"]).fails(2, &["multiple of 4"]);
    film(&["--cams", "8"]).fails(2, &["8x2"]);
    film(&["--template", "builtin:horse"]).fails(2, &["builtin:horse", "builtin:person"]);
    film(&["--template", "nobody.glb"]).fails(3, &["nobody.glb"]);
    film(&["--light", "0,0,0"]).fails(2, &["direction"]);
    film(&["--cameras", "3"]).fails(2, &["--cams 8x2"]);
    film(&["--train-views", "40"]).fails(2, &["--train-views", "--frames"]);
    gs4d(&["synth", "balls", "-o", text(&out), "--frames", "9"]).fails(2, &["--frames", "avatar"]);
    assert!(good(&["synth"]).out.contains("avatar "));
    assert!(!out.exists(), "nothing was written");
}
