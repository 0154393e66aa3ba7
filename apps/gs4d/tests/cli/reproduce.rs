//! Tables of the papers: listed, shown, planned, run, collected; tables of the documents against presets.

use crate::support::{Call, good, gs4d, text};
use gs_metrics::testkit::{alex, file, vgg16};
use serde_json::Value;
use std::fs;
use std::path::Path;

const VIEWS: [&str; 6] = ["--train-views", "6", "--val-views", "1", "--test-views", "2"];

fn scene(folder: &Path) {
    good(&[&["synth", "balls", "--size", "24", "-o", text(folder)][..], &VIEWS].concat());
}

#[test]
fn tables_are_listed_and_shown_with_what_is_there() {
    let dir = tempfile::tempdir().unwrap();
    scene(&dir.path().join("dnerf/hook"));
    fs::create_dir_all(dir.path().join("dnerf/trex")).unwrap();
    let roots = ["--data", text(dir.path())];
    let list = good(&[&["reproduce"][..], &roots].concat()).out;
    let row = |name: &str| list.lines().find(|l| l.split_whitespace().nth(1) == Some(name)).unwrap().to_owned();
    assert!(row("dnerf").contains("1 of 7") && list.contains("gs4d bench RUN"), "{list}");
    let json = good(&["reproduce", "trace", "--json"]).json();
    assert!(json.as_array().unwrap().iter().all(|t| t["paper"] == "trace" && t["table"].is_string()));
    let shown = good(&[&["reproduce", "fags", "dnerf"][..], &roots].concat()).out;
    for part in [
        "44.16",
        "albertpumarola",
        "dnerf/hook",
        "mutant             not below --data",
        "dnerf/trex holds no data set",
        "sheet-a",
    ] {
        assert!(shown.contains(part), "`{part}` is not in {shown}");
    }
    // Each scene that is there comes with its check.
    let folder = dir.path().join("dnerf/hook");
    let checks: Vec<&str> = shown.lines().filter_map(|l| l.trim().strip_prefix("check it: ")).collect();
    assert_eq!(checks, [format!("gs4d doctor {}", text(&folder))], "{shown}");
    let rounds = good(&[&["reproduce", "trace", "continual"][..], &roots].concat()).out;
    for part in ["our side: gs4d continual DATA", "particlenerf", "robot-task         not below --data"] {
        assert!(rounds.contains(part), "`{part}` is not in {rounds}");
    }
    assert!(!rounds.contains("run the table") && shown.contains("run the table"), "{rounds}");
    gs4d(&["reproduce", "nerf"]).fails(2, &["there is no paper `nerf`", "trace"]);
    gs4d(&["reproduce", "fags", "nosuch"]).fails(2, &["fags nosuch", "modec iphone"]);
    gs4d(&["reproduce", "dut", "runtime", "-o", text(&dir.path().join("o"))]).fails(2, &["gs4d bench RUN"]);
}

#[test]
fn a_table_is_run_beside_its_figures_and_collected() {
    let dir = tempfile::tempdir().unwrap();
    let (captures, out, plan) = (dir.path().join("captures"), dir.path().join("out"), dir.path().join("jobs.txt"));
    scene(&captures.join("hook"));
    let base = ["reproduce", "fags", "dnerf", "--data", text(&captures), "--preset", "tiny", "--steps", "3"];
    let with = |call: fn(&[&str]) -> Call, more: &[&str]| {
        call(&[&base[..], &["--seeds", "0,1", "-o", text(&out)], more].concat())
    };
    with(good, &["--plan", text(&plan)]);
    let lines = fs::read_to_string(&plan).unwrap();
    assert_eq!(lines.lines().filter(|l| l.contains("captures/hook") && l.contains("--steps 3")).count(), 8, "{lines}");
    let call = with(gs4d, &["--collect"]);
    assert!(call.code == 7 && call.err.contains("trials without a result: 8"), "{}", call.err);

    let answer = with(good, &[]).out;
    for part in ["hook", "40.18", "FAGS less Grid4D: published +1.29 dB", "(95 %, 2 pairs): no order is shown"] {
        assert!(answer.contains(part), "`{part}` is not in {answer}");
    }
    let json = with(good, &["--collect", "--json"]).json();
    let entry = &json["scenes"][0]["entries"][0];
    assert_eq!((entry["entry"].as_str(), entry["seeds"].as_array().unwrap().len()), (Some("FAGS"), 2));
    assert_eq!(entry["values"][0]["published"], 40.18);
    assert!(entry["values"][0]["ours"]["mean"].as_f64().unwrap() > 3.0 && entry["values"][2]["ours"].is_null());
    let not_run: Vec<&str> = json["not_run"].as_array().unwrap().iter().map(|n| n["what"].as_str().unwrap()).collect();
    assert!(["mutant", "SC-GS", "lpips"].iter().all(|what| not_run.contains(what)), "{not_run:?}");
    let page = fs::read_to_string(out.join("fags-dnerf.html")).unwrap();
    assert!(page.contains("copying errors") && page.contains("The order of methods") && !page.contains("src=\"http"));
}

/// What has no result, and why.
fn without_a_result<'a>(json: &'a Value, what: &str) -> Option<&'a str> {
    json["not_run"].as_array().unwrap().iter().find(|n| n["what"] == what)?["why"].as_str()
}

#[test]
fn tof_and_lpips_are_measured_where_a_table_asks_and_kept() {
    let dir = tempfile::tempdir().unwrap();
    let still = ["--cameras", "2", "--held-out", "1", "--moments", "9", "--size", "48"];
    let data = dir.path().join("data/reach-g");
    good(&[&["synth", "balls", "-o", text(&data)][..], &still].concat());
    let weights = |name: &str, shapes: &[(String, Vec<usize>)]| {
        let path = dir.path().join(name);
        fs::write(&path, file(shapes)).unwrap();
        path
    };
    let (alex, vgg) = (weights("alex.safetensors", &alex()), weights("vgg.safetensors", &vgg16()));
    let base = ["reproduce", "modec", "nvidia", "--scenes", "reach-g", "--entries", "4DGS", "--preset", "tiny"];
    let more = ["--steps", "3", "--seeds", "0", "-o", text(dir.path()), "--json"];
    let with = |lpips: &[&str]| good(&[&base[..], &more, lpips].concat());
    let ours = |json: &Value, column: usize| json["scenes"][0]["entries"][0]["values"][column]["ours"]["mean"].as_f64();

    // The table's network is vgg: weights of another are not used.
    let call = with(&["--lpips", text(&alex)]);
    let json = call.json();
    assert_eq!(json["columns"][3], "tof");
    assert!(ours(&json, 3).unwrap() > 0.0 && ours(&json, 2).is_none(), "{}", json["scenes"]);
    assert!(without_a_result(&json, "lpips").unwrap().contains("network vgg"), "{}", json["not_run"]);
    assert_eq!(without_a_result(&json, "tof"), None);
    assert!(call.err.contains("LPIPS and tOF of"), "{}", call.err);

    let scored = with(&["--lpips", text(&alex), "--lpips", text(&vgg)]).json();
    assert!(ours(&scored, 2).unwrap() > 0.0, "{}", scored["scenes"]);
    assert_eq!((ours(&scored, 3), without_a_result(&scored, "lpips")), (ours(&json, 3), None));
    let conditions = scored["conditions"].as_str().unwrap();
    for part in ["lpips: vgg ", "colours in [0, 1]", "tof: mean distance", "psnr: the mean of the images' PSNR"] {
        assert!(conditions.contains(part), "`{part}` is not in {conditions}");
    }
    // Kept with the run, they need neither its checkpoints nor another rendering.
    let run = fs::read_dir(dir.path().join("reach-g")).unwrap().next().unwrap().unwrap().path().join("seed-0");
    fs::remove_dir_all(run.join("checkpoints")).unwrap();
    let again = with(&["--lpips", text(&vgg)]);
    assert_eq!(again.json()["scenes"], scored["scenes"]);
    assert!(!again.err.contains("LPIPS and tOF of"), "{}", again.err);
    // Without them and the checkpoints they are left out by name.
    let metrics = run.join("metrics.json");
    let mut json: Value = serde_json::from_str(&fs::read_to_string(&metrics).unwrap()).unwrap();
    json.as_object_mut().unwrap().remove("columns").unwrap();
    fs::write(&metrics, json.to_string()).unwrap();
    let lost = with(&["--collect"]).json();
    assert!(without_a_result(&lost, "tof").unwrap().contains("checkpoint"), "{}", lost["not_run"]);
    assert_eq!(ours(&lost, 0), ours(&scored, 0));

    let twice = [&base[..], &more, &["--lpips", text(&vgg), "--lpips", text(&vgg)]].concat();
    gs4d(&twice).fails(2, &["two files of --lpips are of the same network"]);
}

#[test]
fn a_scene_without_a_video_has_no_tof() {
    let dir = tempfile::tempdir().unwrap();
    scene(&dir.path().join("data/reach-a"));
    let call = ["reproduce", "modec", "hypernerf-vrig", "--scenes", "reach-a", "--entries", "4DGS", "--preset", "tiny"];
    let json = good(&[&call[..], &["--steps", "2", "--seeds", "0", "-o", text(dir.path()), "--json"]].concat()).json();
    assert!(without_a_result(&json, "tof").unwrap().contains("one camera"), "{}", json["not_run"]);
    assert!(json["scenes"][0]["entries"][0]["values"][3]["ours"].is_null());
}

#[test]
fn generated_scenes_stand_in_and_are_averaged() {
    let dir = tempfile::tempdir().unwrap();
    // What stands where a generated scene belongs is taken as it is.
    ["sheet-a", "sheet-b"].iter().for_each(|name| scene(&dir.path().join("data").join(name)));
    let call = ["reproduce", "fags", "ablation", "--preset", "tiny", "--steps", "2", "--seeds", "0"];
    let json = good(&[&call[..], &["--scenes", "sheet-a,sheet-b", "-o", text(dir.path()), "--json"]].concat()).json();
    let scenes = json["scenes"].as_array().unwrap();
    assert_eq!((scenes.len(), scenes[2]["scene"].as_str()), (3, Some("mean over these scenes")));
    assert!(scenes.iter().all(|s| s["generated"] == true));
    let psnr = |k: usize| scenes[k]["entries"][0]["values"][0]["ours"]["mean"].as_f64().unwrap();
    assert!((psnr(2) - 0.5 * (psnr(0) + psnr(1))).abs() < 1e-9);
    assert_eq!(json["orders"][0]["pairs"], 2);
    assert!(scenes[0]["entries"][0]["values"][0]["published"].is_null(), "the paper has no figure of it");
}

#[test]
fn the_papers_orders_are_listed_run_and_go_on() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let list = good(&["reproduce", "nightly"]).out;
    let row = |name: &str| list.lines().find(|l| l.starts_with(name)).unwrap_or_else(|| panic!("{list}")).to_owned();
    assert!(row("fags-ablation").contains("waves-a") && row("modec-settings").contains(" 25 "), "{list}");
    assert!(row("dut-stages").contains("gown-a"), "{list}");
    gs4d(&["reproduce", "nightly", "--scenes", "waves-a"]).fails(2, &["--scenes"]);
    gs4d(&["reproduce", "nightly", "fags-dnerf"]).fails(2, &["`fags-dnerf`", "trace-ablation-object"]);
    gs4d(&["reproduce", "fags", "-o", text(&out)]).fails(2, &["no table"]);

    scene(&out.join("fags-ablation/data/waves-a"));
    let base = ["reproduce", "nightly", "fags-ablation", "--preset", "tiny", "--steps", "2", "--seeds", "0,1,2"];
    let with = |call: fn(&[&str]) -> Call, more: &[&str]| call(&[&base[..], &["-o", text(&out)], more].concat());
    let call = with(gs4d, &["--collect"]);
    assert!(call.code == 7 && call.err.contains("trials without a result: 21"), "{}", call.err);
    assert!(!out.join("nightly.md").exists(), "a page of nothing");
    let call = with(good, &[]);
    assert!(call.out.contains("Of 6 published orders, on waves-a, "), "{}", call.out);
    assert!(call.err.contains("fags-ablation / waves-a / fags:tiny "), "{}", call.err);
    let page = fs::read_to_string(out.join("nightly.md")).unwrap();
    assert!(call.out.starts_with(&page) && out.join("fags-ablation/fags-ablation.html").is_file());

    let entry = fs::read_dir(out.join("fags-ablation/waves-a")).unwrap().next().unwrap().unwrap().path();
    fs::remove_dir_all(entry.join("seed-1")).unwrap();
    let call = with(gs4d, &["--collect", "--json"]);
    let json: Value = serde_json::from_str(&call.out).unwrap();
    assert!(call.code == 7 && json["missing"].as_array().unwrap().len() == 1, "{}", call.err);
    with(good, &[]);
    assert_eq!(fs::read_to_string(out.join("nightly.md")).unwrap(), page);
}

#[test]
fn documents_of_another_folder_are_refused_and_ours_are_not_old() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let json = good(&["reproduce", "--check", text(&root), "--json"]).json();
    assert!(json["tables"].as_array().unwrap().iter().all(|t| !t[1]["rows"].as_array().unwrap().is_empty()));
    let dir = tempfile::tempdir().unwrap();
    gs4d(&["reproduce", "--check", text(dir.path())]).fails(3, &["docs/tables.toml", "README.md"]);
}
