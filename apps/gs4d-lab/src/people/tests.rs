//! Experiments at their smallest.

use super::learning::SINGLE_UNPROJECTION;
use super::*;
use gs_data::{DataOptions, Dataset};

fn small(frames: u32) -> Setup {
    let film = AvatarOptions { per_ring: 4, frames, size: 64, points: 500, ..Setup::default().film };
    let sets = ["textures.unproject=48", "textures.geo=32", "textures.gau=48"].map(String::from).into();
    let recipe = Some(Recipe { preset: "direct".into(), steps: 6, sets, seed: 0 });
    Setup { film, recipe, texels: 64, ..Setup::default() }
}

/// Rows of an experiment as JSON; its table must be as wide as its head.
fn rows(name: &str, setup: &Setup) -> Vec<serde_json::Value> {
    let found = Experiment::find(name).unwrap().run(setup, &mut |_| ()).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert!(found.rows.iter().all(|row| row.len() == found.heads.len()));
    found.json()["rows"].as_array().unwrap().clone()
}

fn number(row: &serde_json::Value, column: &str) -> f64 {
    row[column].as_f64().unwrap_or_else(|| panic!("no {column} in {row}"))
}

#[test]
fn clothing_is_measured_against_its_true_surface() {
    let mut gown = small(4);
    gown.film.template = Experiment::find("loose").unwrap().template.into();
    let loose = rows("loose", &gown);
    let names: Vec<&str> = loose.iter().map(|r| r["geometry"].as_str().unwrap()).collect();
    assert_eq!(names.len(), 4);
    let of = |k: usize, column: &str| number(&loose[k], column);
    assert_eq!([of(0, "offset error %"), of(3, "offset error %")], [100.0, 0.0]);
    assert!(of(3, "texture dB") > of(0, "texture dB") + 3.0, "the truth is more accurate: {loose:?}");
    assert_eq!(of(1, "texture dB"), of(0, "texture dB"), "its colours are those of the template's texels");
    assert!((0..4).all(|k| of(k, "region PSNR") > 8.0 && of(k, "region SSIM") > 0.0), "{loose:?}");
    // Without training: no offsets are found.
    assert_eq!(rows("loose", &Setup { recipe: None, ..gown.clone() }).len(), 2);
    let still = AvatarOptions { template: "builtin:plate".into(), ..small(2).film };
    let none = Experiment::find("loose").unwrap().run(&Setup { film: still, recipe: None, ..small(2) }, &mut |_| ());
    assert!(matches!(none, Err(LabError::Unfit(why)) if why.contains("nothing")));
}

#[test]
fn contact_is_measured_apart_from_the_rest() {
    let topo = rows("topo", &small(8));
    assert_eq!(topo.len(), 16);
    let of = |name: &str| topo.iter().find(|r| r["of"] == name).unwrap_or_else(|| panic!("no {name}"));
    for state in ["apart", "contact"] {
        let cell = |name: &str, column: &str| number(of(name), &format!("{state} {column}"));
        assert_eq!(cell("1st, ray", "false visible %") + cell("1st, ray", "false hidden %"), 0.0);
        let seen = |rule: &str| cell(&format!("2nd on the true surface, {rule}"), "seen %");
        assert!(seen("neighbours") > seen("four_tap") + 10.0, "{topo:?}");
        for method in ["method, one texture", "method, 2nd on GeoNet's surface"] {
            assert!(cell(method, "PSNR") > 5.0 && cell(method, "SSIM") > 0.0, "{topo:?}");
        }
    }
    let seen = |state: &str| number(of("1st, ray"), &format!("{state} seen %"));
    assert!(seen("contact") < seen("apart"), "the hand hides what it touches");
    // A method without GeoNet has no surface of it.
    let mut single = small(8);
    single.recipe.as_mut().unwrap().sets.extend(SINGLE_UNPROJECTION.iter().map(|s| (*s).to_owned()));
    assert_eq!(rows("topo", &single).len(), 15);
    // A clip without contact.
    let mut apart = Setup { recipe: None, ..small(4) };
    apart.film.clip = Some("turn".into());
    let found = Experiment::find("topo").unwrap().run(&apart, &mut |_| ());
    assert!(matches!(found, Err(LabError::Unfit(why)) if why.contains("fore arm")));
}

#[test]
fn inputs_are_decoded_within_the_limit_of_the_data() {
    let dir = tempfile::tempdir().unwrap();
    // An image takes a little more than 1 MiB.
    let film = AvatarOptions {
        template: "builtin:cylinder".into(),
        size: 520,
        rings: 1,
        per_ring: 4,
        frames: 1,
        points: 0,
        ..AvatarOptions::default()
    };
    gs_synth::avatar::write(dir.path(), &film, false, false).unwrap();
    let fault = |max_image_mib| {
        let options = DataOptions { max_image_mib, ..DataOptions::default() };
        let subject = Subject::of(Dataset::open(dir.path(), &options).unwrap(), 1).unwrap();
        subject.images(&subject.scene.frames[0].inputs).err().map(|e| e.to_string())
    };
    assert_eq!(fault(None), None);
    assert!(fault(Some(1)).is_some_and(|e| e.contains("the limit is 1048576")));
}
