//! The doctor on data sets that are whole, on copies that are each broken in one way, and on real captures.

mod folder;
mod starts;

use folder::{Folder, blurred, copy_all, each, matrix, rows};
use glam::{DMat4, DVec3};
use gs_core::io::images::{load_image, save_png};
use gs4d_doctor::{CheckOptions, Checkup, CostOptions, Verdict, apply, examine, examine_and_tell, page};
use serde_json::{Value, json};

fn codes(c: &Checkup) -> Vec<&'static str> {
    c.findings.iter().filter(|f| f.verdict > Verdict::Note).map(|f| f.code).collect()
}

/// The finding of a code, with something to do.
#[track_caller]
fn must_name(c: &Checkup, code: &str, verdict: Verdict) -> String {
    let found = c.findings.iter().find(|f| f.code == code);
    let found = found.unwrap_or_else(|| panic!("{code} is not among {:?}", c.findings));
    assert_eq!(found.verdict, verdict, "{found:?}");
    assert!(found.fix.as_ref().is_some_and(|f| !f.is_empty()), "{found:?}");
    format!("{} {}", found.what, found.places.join(", "))
}

/// A note of a code.
#[track_caller]
fn must_note(c: &Checkup, code: &str) {
    let found = c.findings.iter().find(|f| f.code == code);
    assert_eq!(found.map(|f| f.verdict), Some(Verdict::Note), "{:?}", c.findings);
}

#[test]
fn whole_scenes_have_no_fault() {
    for scene in ["static", "balls", "falling"] {
        let folder = Folder::of(scene);
        let checkup = folder.look();
        assert_eq!(codes(&checkup), Vec::<&str>::new(), "{scene}: {:?}", checkup.findings);
        let topics: Vec<&str> = checkup.findings.iter().map(|f| f.topic).collect();
        for topic in ["layout", "images", "masks", "time", "poses", "init", "bound"] {
            assert!(topics.contains(&topic), "{scene}: {topic} was not looked at: {topics:?}");
        }
        let html = page(&checkup).expect("page");
        assert!(html.contains("doctor") && html.matches("<img").count() >= 5, "{scene}");
        assert!(!html.contains("http://") && !html.contains("https://"));
    }
}

/// What happens between two checks shows in the later one: nothing is kept back to the end.
#[test]
fn each_finding_is_told_when_its_check_ends() {
    let folder = Folder::of("static-opaque");
    let (first, mut told) = (folder.photo(0), Vec::new());
    let checkup = examine_and_tell(folder.dir(), &CheckOptions::default(), &mut |finding| {
        if finding.topic == "layout" {
            std::fs::write(&first, "no image").expect("written");
        }
        told.push(finding.clone());
    });
    must_name(&checkup, "data.image", Verdict::Problem);
    assert_eq!(told, checkup.findings);
}

#[test]
fn of_many_images_a_sample_is_read_unless_all_are_asked_for() {
    let folder = Folder::of("static-opaque");
    let names: Vec<String> = (0..320).map(|k| format!("./train/many_{k:03}")).collect();
    for name in &names {
        std::fs::copy(folder.photo(0), folder.path(&format!("{name}.png"))).expect("copied");
    }
    folder.edit("train", |v| {
        let frame = v["frames"][0].clone();
        let named = |n: &String| {
            let mut frame = frame.clone();
            frame["file_path"] = json!(n);
            frame
        };
        v["frames"] = names.iter().map(named).collect();
    });
    let read = |all: bool| examine(folder.dir(), &CheckOptions { all, ..CheckOptions::default() });
    let some = read(false);
    must_note(&some, "images.sample");
    let twice = |c: &Checkup| c.findings.iter().find(|f| f.code == "images.twice").expect("copies").places.join("");
    let read_twice = twice(&some).matches(" = ").count();
    assert!(
        (280..300).contains(&read_twice),
        "{read_twice} copies among 300 images, nearly all of them training views"
    );
    let all = read(true);
    assert!(!all.findings.iter().any(|f| f.code == "images.sample"));
    assert_eq!(twice(&all).matches(" = ").count(), 319);
}

#[test]
fn files_that_cannot_be_used_are_named() {
    let folder = Folder::of("static-opaque");
    std::fs::remove_file(folder.photo(3)).expect("removed");
    let cut = std::fs::read(folder.photo(5)).expect("image");
    std::fs::write(folder.photo(5), &cut[..cut.len() / 2]).expect("written");
    let checkup = folder.look();
    let missing = must_name(&checkup, "data.missing", Verdict::Problem);
    assert!(missing.contains("1 of 60"), "{missing}");
    // A missing file does not hide the damaged one.
    let stem = folder.photo(5).file_stem().expect("name").to_string_lossy().into_owned();
    assert!(must_name(&checkup, "data.image", Verdict::Problem).contains(&stem));

    let folder = Folder::of("static-opaque");
    std::fs::write(folder.photo(2), "no image").expect("written");
    must_name(&folder.look(), "data.image", Verdict::Problem);
}

#[test]
fn images_that_show_the_wrong_thing_are_named() {
    let folder = Folder::of("static");
    folder.paint(4, |i| each(i, |_, _, p| vec![0.2; p.len()]));
    std::fs::copy(folder.photo(10), folder.photo(11)).expect("copied");
    folder.paint(20, |i| each(i, |_, _, p| vec![0.2 * p[0], 0.2 * p[1], 0.2 * p[2], p[3]]));
    folder.paint(30, blurred);
    let checkup = folder.look();
    let named = |k: usize| folder.photo(k).file_stem().expect("name").to_string_lossy().into_owned();
    for (code, verdict, view) in [
        ("images.blank", Verdict::Problem, 4),
        ("images.twice", Verdict::Warning, 11),
        ("images.exposure", Verdict::Warning, 20),
        ("images.blurred", Verdict::Warning, 30),
    ] {
        let text = must_name(&checkup, code, verdict);
        assert!(text.contains(&named(view)), "{code}: {text}");
    }
    let folder = Folder::of("static");
    (0..60).for_each(|k| folder.paint(k, |i| each(i, |_, _, p| vec![p[0], p[1], p[2], 1.0 - p[3]])));
    must_name(&folder.look(), "images.alpha", Verdict::Problem);
}

#[test]
fn views_that_are_learnt_and_scored_are_named() {
    let folder = Folder::of("static-opaque");
    let text = std::fs::read_to_string(folder.path("transforms_test.json")).expect("file");
    let test: Value = serde_json::from_str(&text).expect("JSON");
    let frame = test["frames"][1].clone();
    folder.edit("train", |v| v["frames"][0] = frame.clone());
    must_name(&folder.look(), "split.leak", Verdict::Problem);
}

#[test]
fn poses_of_another_convention_are_told_which() {
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let folder = Folder::of("static");
    folder.poses(|_, m| m * flip);
    let checkup = folder.look();
    assert!(must_name(&checkup, "poses.convention", Verdict::Problem).contains("OpenCV"), "{:?}", checkup.findings);
    let folder = Folder::of("static");
    folder.poses(|_, m| m.inverse());
    assert!(must_name(&folder.look(), "poses.convention", Verdict::Problem).contains("inverted"));
}

#[test]
fn single_wrong_poses_are_named() {
    let folder = Folder::of("static");
    let frames = folder.frames();
    let pose = |k: usize| frames[k]["transform_matrix"].clone();
    folder.edit("train", |v| {
        v["frames"][7]["transform_matrix"] = pose(38);
        v["frames"][38]["transform_matrix"] = pose(7);
    });
    let checkup = folder.look();
    let text = must_name(&checkup, "poses.view", Verdict::Problem);
    let named = |k: usize| folder.photo(k).file_stem().expect("name").to_string_lossy().into_owned();
    let [a, b] = [7, 38].map(named);
    assert!(text.contains("2 views") && text.contains(&format!("{a}: has the pose of {b}")), "{text}");
    assert!(checkup.figures.iter().any(|f| f.caption.starts_with(&format!("{b}: has the pose of {a}"))));

    // A held-out image that shows something else, alone and beside one that cannot be read.
    let folder = Folder::of("static");
    let test = folder.path("test/r_001.png");
    let image = load_image(&test, &Default::default()).expect("image");
    let (w, h) = (image.width, image.height);
    let turned = each(&image, |x, y, _| {
        let p = image.pixel(w - 1 - x, h - 1 - y);
        vec![p[1], p[2], p[0], p[3]]
    });
    save_png(&test, &turned, true).expect("written");
    let foreign = "r_001 (test): shows something that the others do not";
    let text = must_name(&folder.look(), "poses.view", Verdict::Problem);
    assert!(text.contains(foreign), "{text}");
    let other = folder.path("test/r_000.png");
    let whole = std::fs::read(&other).expect("image");
    std::fs::write(&other, &whole[..whole.len() / 2]).expect("written");
    let checkup = folder.look();
    assert!(must_name(&checkup, "data.image", Verdict::Problem).contains("r_000"), "{:?}", checkup.findings);
    let text = must_name(&checkup, "poses.view", Verdict::Problem);
    assert!(text.contains(foreign), "{text}");

    let folder = Folder::of("static-opaque");
    folder.poses(|k, m| if k == 5 { DMat4::from_translation(DVec3::splat(300.0)) * m } else { m });
    must_name(&folder.look(), "poses.far", Verdict::Problem);
}

#[test]
fn scales_that_do_not_fit_are_told() {
    let folder = Folder::of("static-opaque");
    folder.poses(|_, mut m| {
        m.w_axis = (m.w_axis.truncate() * 1e5).extend(1.0);
        m
    });
    must_name(&folder.look(), "poses.scale", Verdict::Warning);
}

#[test]
fn matrices_that_are_no_poses_are_named() {
    for (change, code) in [
        (DMat4::from_scale(DVec3::splat(1.3)), "data.pose"),
        (DMat4::from_scale(DVec3::new(1.0, 1.0, -1.0)), "data.pose"),
    ] {
        let folder = Folder::of("static");
        folder.poses(|k, m| if k == 2 { m * change } else { m });
        let text = must_name(&folder.look(), code, Verdict::Problem);
        assert!(text.contains("frames[2]"), "{text}");
    }
    let folder = Folder::of("static");
    let file = folder.path("transforms_train.json");
    let text = std::fs::read_to_string(&file).expect("file");
    folder.edit("train", |v| v["frames"][3]["transform_matrix"][1][3] = json!("BROKEN"));
    let broken = std::fs::read_to_string(&file).expect("file").replace("\"BROKEN\"", "NaN");
    std::fs::write(&file, broken).expect("written");
    assert!(must_name(&folder.look(), "data.field", Verdict::Problem).contains("frames[3]"));
    std::fs::write(&file, &text[..text.len() / 2]).expect("written");
    must_name(&folder.look(), "data.syntax", Verdict::Problem);
}

#[test]
fn lists_that_lead_nowhere_are_named() {
    let folder = Folder::of("static");
    folder.edit("train", |v| v["frames"] = json!([]));
    must_name(&folder.look(), "data.empty", Verdict::Problem);
    let folder = Folder::of("static");
    folder.edit("train", |v| v["frames"][0]["file_path"] = json!("../../secret"));
    must_name(&folder.look(), "data.escape", Verdict::Problem);
    let empty = tempfile::tempdir().expect("folder");
    must_name(&examine(empty.path(), &CheckOptions::default()), "data.layout", Verdict::Problem);
    must_name(&examine(&empty.path().join("none"), &CheckOptions::default()), "data.path", Verdict::Problem);
    let folder = Folder::of("static");
    std::fs::write(folder.path("scene.toml"), "[time]\nboundry = 0.5\n").expect("written");
    assert!(must_name(&folder.look(), "data.syntax", Verdict::Problem).contains("boundry"));
}

#[test]
fn times_that_cannot_be_are_named() {
    let folder = Folder::of("balls-opaque");
    folder.edit("train", |v| v["frames"][17]["time"] = json!(1.3));
    assert!(must_name(&folder.look(), "data.time", Verdict::Problem).contains("frames[17].time"));
    let folder = Folder::of("balls-opaque");
    folder.edit("train", |v| {
        v["frames"]
            .as_array_mut()
            .expect("frames")
            .retain(|f| !(0.4..0.6).contains(&f["time"].as_f64().expect("time")));
    });
    must_name(&folder.look(), "time.gap", Verdict::Warning);
    let folder = Folder::of("balls-opaque");
    folder.edit("train", |v| {
        v["frames"].as_array_mut().expect("frames").retain(|f| f["time"].as_f64().expect("time") < 0.5)
    });
    must_name(&folder.look(), "time.outside", Verdict::Warning);
    let folder = Folder::of("falling-opaque");
    folder.edit("train", |v| v["frames"][1]["time"] = v["frames"][0]["time"].clone());
    must_name(&folder.look(), "time.twice", Verdict::Problem);
    let folder = Folder::of("falling-opaque");
    let first = folder.photo(0);
    let frames = folder.frames();
    let of_first = (0..frames.len()).filter(|&k| frames[k]["transform_matrix"] == frames[0]["transform_matrix"]);
    of_first.skip(1).for_each(|k| {
        std::fs::copy(&first, folder.photo(k)).expect("copied");
    });
    must_name(&folder.look(), "time.frozen", Verdict::Warning);
}

#[test]
fn cameras_that_run_late_are_named() {
    let folder = Folder::of("reach");
    assert_eq!(codes(&folder.look()), Vec::<&str>::new());
    let frames = folder.frames();
    let own: Vec<usize> =
        (0..frames.len()).filter(|&k| frames[k]["transform_matrix"] == frames[0]["transform_matrix"]).collect();
    let photos: Vec<Vec<u8>> = own.iter().map(|&k| std::fs::read(folder.photo(k)).expect("photo")).collect();
    for k in 3..own.len() {
        std::fs::write(folder.photo(own[k]), &photos[k - 3]).expect("written");
    }
    let name = folder.photo(own[0]).file_stem().expect("name").to_string_lossy().into_owned();
    let checkup = folder.look();
    let text = must_name(&checkup, "time.late", Verdict::Warning);
    assert!(text.contains(&format!("camera 0 ({name}): +3 moments")), "{text}");
    // The setting it names fixes it, and is written on request.
    let written = apply(folder.dir(), &checkup.findings).expect("written");
    assert_eq!(written, ["data.time_shift=0:-3"]);
    assert_eq!(codes(&folder.look()), Vec::<&str>::new());
}

#[test]
fn a_run_is_tried() {
    let folder = Folder::of("balls");
    let options = |sets: &[&str]| CostOptions {
        registry: gs_methods::registry().clone(),
        method: "fourdgs".into(),
        preset: "tiny".into(),
        sets: sets.iter().map(|s| (*s).to_owned()).collect(),
        limit_mib: Some(10.0),
    };
    let exam = |o| CheckOptions { cost: Some(o), ..CheckOptions::default() };
    let checkup = examine(folder.dir(), &exam(options(&[])));
    must_name(&checkup, "memory.limit", Verdict::Problem);
    let cost = checkup.cost.as_ref().expect("cost");
    assert_eq!(cost.stages.len(), 2);
    assert!(cost.splats[0] == 400 && cost.splats[1] == 1500 && cost.seconds[1] >= cost.seconds[0]);
    assert!(
        cost.seconds[0] > 0.0
            && cost.memory_mib[0] > 24.0
            && cost.memory_mib[1] > cost.memory_mib[0]
            && cost.memory_mib[1] < 400.0,
        "{cost:?}"
    );
    let anchored = CostOptions { method: "modec".into(), limit_mib: Some(4096.0), ..options(&[]) };
    let checkup = examine(folder.dir(), &exam(anchored));
    assert!(checkup.findings.iter().any(|f| f.topic == "memory" && f.verdict == Verdict::Ok), "{:?}", checkup.findings);
    let cost = checkup.cost.expect("cost");
    assert!(cost.splats[0] < 3200 && cost.splats[1] == 3200 && cost.memory_mib[1] > cost.memory_mib[0], "{cost:?}");
    let short = examine(folder.dir(), &exam(options(&["schedule.stages.coarse.steps=2"])));
    let cost = short.cost.expect("cost");
    assert!(cost.stages[0].ms[0] > 0.0 && cost.seconds.iter().all(|s| s.is_finite()), "{cost:?}");
    let broken = examine(folder.dir(), &exam(options(&["no.such=1"])));
    assert!(broken.findings.iter().any(|f| f.code == "cost.begin" && f.what.contains("no.such")));
}

#[test]
#[ignore = "a minute: cargo test --release -p gs4d-doctor --test doctor -- --ignored"]
fn real_captures_are_sound() {
    for name in
        ["dnerf_mutant_400", "fox_270x480", "neu3d_flame_steak_5view_llff_colmap", "panoptic_basketball_f040-069"]
    {
        let Some(dir) = gs_core::testkit::shared(&format!("data/{name}")) else { continue };
        let checkup = examine(&dir, &CheckOptions::default());
        let problems: Vec<_> = checkup.findings.iter().filter(|f| f.verdict == Verdict::Problem).collect();
        assert!(problems.is_empty(), "{name}: {problems:?}");
    }
}

/// Poses of the fox's images, which have no alpha: corners alone must tell.
#[test]
fn corners_tell_wrong_poses_of_images() {
    let Some(dir) = gs_core::testkit::shared("data/fox_270x480") else { return };
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    for (change, word) in [(true, "OpenCV"), (false, "inverted")] {
        let copy = tempfile::tempdir().expect("folder");
        copy_all(&dir, copy.path());
        let file = copy.path().join("transforms.json");
        let mut v: Value = serde_json::from_str(&std::fs::read_to_string(&file).expect("file")).expect("JSON");
        for f in v["frames"].as_array_mut().expect("frames") {
            let m = matrix(&f["transform_matrix"]);
            f["transform_matrix"] = rows(if change { m * flip } else { m.inverse() });
        }
        std::fs::write(&file, v.to_string()).expect("written");
        let checkup = examine(copy.path(), &CheckOptions::default());
        assert!(must_name(&checkup, "poses.convention", Verdict::Problem).contains(word));
    }
    let copy = tempfile::tempdir().expect("folder");
    copy_all(&dir, copy.path());
    let file = copy.path().join("transforms.json");
    let mut v: Value = serde_json::from_str(&std::fs::read_to_string(&file).expect("file")).expect("JSON");
    for key in ["fl_x", "fl_y"] {
        v[key] = json!(v[key].as_f64().expect("focal length") / 1.7);
    }
    std::fs::write(&file, v.to_string()).expect("written");
    must_name(&examine(copy.path(), &CheckOptions::default()), "poses.focal", Verdict::Problem);
}
