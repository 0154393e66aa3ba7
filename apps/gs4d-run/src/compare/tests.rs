use super::*;
use crate::Training;
use crate::compare::page::page;
use crate::settings::{Request, resolve};
use gs_synth::{SynthOptions, write};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

const OPTIONS: Options = Options { split: Split::Test, background: None, shown: 2 };

fn scene(root: &Path, name: &str, size: u32) -> PathBuf {
    let data = root.join(name);
    let options = SynthOptions { val_views: 1, ..SynthOptions::of_views(size, 6, 3) };
    write(&data, "balls", &options, false).unwrap();
    data
}

fn train(root: &Path, data: &Path, name: &str, method: &str, seed: u64, sets: &[&str]) -> Side {
    let request = Request {
        method: method.into(),
        preset: "tiny".into(),
        data: Some(data.to_owned()),
        steps: Some(20),
        seed: Some(seed),
        sets: sets.iter().map(|s| (*s).to_owned()).collect(),
        ..Request::default()
    };
    let out = root.join(name);
    let mut training = Training::begin(&out, false, resolve(gs_methods::registry(), &request).unwrap()).unwrap();
    training.train(&AtomicBool::new(false), &mut |_, _| {}).unwrap();
    drop(training);
    Side::open(gs_methods::registry(), &out, None).unwrap()
}

#[test]
fn runs_of_one_scene_are_compared_view_by_view() {
    let dir = tempfile::tempdir().unwrap();
    let data = scene(dir.path(), "data", 32);
    let sides = [
        train(dir.path(), &data, "a", "fourdgs", 0, &[]),
        train(dir.path(), &data, "b", "fourdgs", 1, &[]),
        train(dir.path(), &data, "<c>", "static3d", 0, &[]),
    ];
    let (compared, pictures) = compare(&sides, &OPTIONS).unwrap();
    assert_eq!(compared.conditions, "3 test views, 32×32, over white, no mask.");
    let first = &compared.runs[0];
    assert_eq!((first.psnr_to_first, first.step), (None, 20), "equal to itself");
    // Differences are those of the scores, view by view.
    let [a, b] = [0, 1].map(|k| compared.runs[k].scores.mean.psnr.unwrap());
    let paired = &compared.differences[0];
    assert!((paired.over_views.unwrap().mean - (b - a)).abs() < 1e-9 && paired.of == 3);
    let [low, high] = paired.range.unwrap();
    assert!(low <= b - a && b - a <= high);
    assert!(compared.seeds.contains("a (seed 0), b (seed 1) are one recipe"), "{}", compared.seeds);
    // Two views, the more unlike first; the largest disagreement is the one named.
    let most = compared.views.iter().map(|v| v.disagreement).fold(0.0, f64::max);
    assert!(pictures.len() == 2 && pictures[0].caption.contains(&format!("{most:.4}")), "{}", pictures[0].caption);
    assert!(pictures.iter().all(|p| p.renders.len() == 3 && p.truth.shape() == (32, 32, 3)));
    assert!(compared.settings.iter().any(|u| u.key == "run.method" && u.values[2].as_deref() == Some("\"static3d\"")));
    assert!(compared.settings.iter().all(|u| u.key != "run.seed"));

    let html = page(&compared, &pictures, &sides, false).unwrap();
    assert!(html.contains("&lt;c&gt;") && !html.contains("<c>"), "names are escaped");
    assert_eq!(html.matches("<figure class=\"view\"").count(), 2);
    assert_eq!(html.matches("src=\"data:image").count(), 2 * (1 + 3 + 3), "truth, drawings, their errors");
    assert!(!html.contains("https://") && html.len() < 1 << 20);
    let against_first = page(&compared, &pictures, &sides, true).unwrap();
    assert_eq!(
        against_first.matches("src=\"data:image").count(),
        2 * (1 + 3 + 2),
        "the first is not held against itself"
    );
}

#[test]
fn runs_of_different_data_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let (small, large) = (scene(dir.path(), "small", 24), scene(dir.path(), "large", 32));
    let a = train(dir.path(), &small, "a", "static3d", 0, &[]);
    let b = train(dir.path(), &large, "b", "static3d", 0, &[]);
    let black = train(dir.path(), &small, "black", "static3d", 0, &["schedule.background=\"black\""]);
    let refused = |sides: &[Side], options: &Options| match compare(sides, options) {
        Err(CompareError::Differ { fields, background_only, .. }) => (fields.join("; "), background_only),
        other => panic!("{:?}", other.map(|c| c.0.conditions)),
    };
    let sides = [a, b];
    let (fields, background_only) = refused(&sides, &OPTIONS);
    assert!(fields.contains("size (24×24, 32×32)") && fields.contains("data digest (") && !background_only, "{fields}");
    let [a, _] = sides;
    let sides = [a, black];
    assert_eq!(refused(&sides, &OPTIONS), ("background (white, black)".to_owned(), true));
    let chosen = Options { background: Some([0.0; 3]), ..OPTIONS };
    assert!(compare(&sides, &chosen).unwrap().0.conditions.contains("over black"));
}

#[test]
fn names_tell_runs_apart() {
    let dir = tempfile::tempdir().unwrap();
    let data = scene(dir.path(), "data", 24);
    let of = |sides: &[Side]| names(sides);
    let a = train(dir.path(), &data, "x/run", "static3d", 0, &[]);
    let b = train(dir.path(), &data, "y/run", "static3d", 0, &[]);
    let again = Side::open(gs_methods::registry(), &dir.path().join("y/run"), None).unwrap();
    assert_eq!(of(&[a])[0], "run");
    let a = Side::open(gs_methods::registry(), &dir.path().join("x/run"), None).unwrap();
    let all = of(&[a, b, again]);
    assert!(all[0].ends_with("x/run") && all[1].ends_with("y/run (2)") && all[2].ends_with("y/run (3)"), "{all:?}");
}
