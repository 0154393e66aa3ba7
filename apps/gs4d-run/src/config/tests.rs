use super::*;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize, Debug, PartialEq)]
#[serde(deny_unknown_fields)]
struct Density {
    until: u32,
    grad: f32,
}

#[derive(Serialize, Deserialize, Debug, PartialEq)]
#[serde(deny_unknown_fields)]
struct Demo {
    steps: u32,
    ssim: bool,
    kind: String,
    levels: Vec<f32>,
    density: Density,
}

fn demo() -> Demo {
    let density = Density { until: 15_000, grad: 2e-4 };
    Demo { steps: 30_000, ssim: true, kind: "plain".into(), levels: vec![1.0, 2.0], density }
}

fn config() -> Config {
    Config::of_table(&Table::try_from(demo()).unwrap())
}

#[test]
fn later_sources_win_and_are_remembered() {
    let mut c = config();
    c.overlay_toml("steps = 100\n[density]\nuntil = 50", &Source::Preset("tiny".into())).unwrap();
    c.overlay_toml("density.until = 60", &Source::File("my.toml".into())).unwrap();
    c.set("density.grad = 1").unwrap();
    c.set("kind=fancy").unwrap();
    c.set("levels=[3, 4.5]").unwrap();
    let built: Demo = c.build().unwrap();
    let density = Density { until: 60, grad: 1.0 };
    assert_eq!(built, Demo { steps: 100, ssim: true, kind: "fancy".into(), levels: vec![3.0, 4.5], density });
    assert_eq!(c.get("ssim").unwrap().source, Source::Default);
    assert_eq!(c.get("steps").unwrap().source, Source::Preset("tiny".into()));
    assert_eq!(c.get("density.until").unwrap().source, Source::File("my.toml".into()));
    assert_eq!(c.get("density.grad").unwrap().source, Source::Flag("--set density.grad = 1".into()));
}

#[test]
fn unknown_keys_name_the_nearest() {
    let error = |text: &str| config().set(text).unwrap_err().to_string();
    assert!(error("density.untl=5").contains("did you mean `density.until`?"));
    assert!(error("until=5").contains("did you mean `density.until`?"));
    assert!(error("density=5").contains("its keys are density.grad, density.until"));
    let far = error("completely.other.thing=5");
    assert!(far.contains("unknown setting") && !far.contains("did you mean"), "{far}");
    let e = config().overlay_toml("steps = 5\nstps = 4", &Source::File("f.toml".into())).unwrap_err();
    assert!(e.to_string().contains("`stps` (file f.toml); did you mean `steps`?"));
    let mut rates = Config::of_toml("[lr.cloud]\nmeans.eps = 1.0\nopacities.eps = 1.0").unwrap();
    let error = rates.set("lr.means.eps=2").unwrap_err().to_string();
    assert!(error.contains("did you mean `lr.cloud.means.eps`?"), "{error}");
}

#[test]
fn wrong_kinds_and_values_are_refused() {
    let error = |text: &str| config().set(text).unwrap_err().to_string();
    assert!(error("steps=1.5").contains("must be a whole number, got 1.5"));
    assert!(error("steps=\"many\"").contains("must be a whole number"));
    assert!(error("density.grad=nan").contains("must be a finite number"));
    assert!(error("levels=[1, inf]").contains("list of such values"));
    assert!(error("ssim=1").contains("true or false"));
    assert!(error("steps").contains("key=value") && error("=3").contains("key=value"));
    assert!(matches!(config().set("steps=[").unwrap_err(), ConfigError::Syntax { .. }));
    let mut c = config();
    c.set("steps=-4").unwrap();
    let why = c.build::<Demo>().unwrap_err().to_string();
    assert!(why.contains("-4") && why.contains("steps"), "{why}");
}

#[test]
fn a_refused_overlay_changes_nothing() {
    let mut c = config();
    assert!(c.overlay_toml("steps = 7\nwrong = 1", &Source::File("f".into())).is_err());
    assert_eq!(c, config());
}

#[test]
fn the_written_form_reads_back_and_says_whence() {
    let mut c = config();
    c.set("density.until=77").unwrap();
    let text = c.to_commented_toml();
    assert!(text.contains("grad = 0.0002") && text.contains("# default"), "{text}");
    assert!(text.contains("# flag --set density.until=77"), "{text}");
    let back: Demo = toml::from_str(&text).unwrap();
    assert_eq!(back, c.build().unwrap());
}

#[test]
fn optional_keys_appear_once_given() {
    let mut c = config();
    assert!(c.set("range=0..2").is_err());
    c.allow("range", "0..1");
    assert!(!c.to_commented_toml().contains("range"), "it is not described");
    c.describe("range = \"0..1\" # times");
    assert!(c.to_commented_toml().contains("# range = \"0..1\""), "{}", c.to_commented_toml());
    c.set("range=0..2").unwrap();
    assert_eq!(c.get("range").unwrap().value.as_str(), Some("0..2"));
    assert!(!c.to_commented_toml().contains("# range"));
    assert!(c.set("rnage=0..2").unwrap_err().to_string().contains("did you mean `range`?"));
}

#[test]
fn comments_become_descriptions() {
    let text = "steps = 30 # optimiser steps [Kerbl 2023]\n[lr]\nmeans = 1.6e-4 # world units\nname = \"a#b\"\n";
    let c = Config::of_toml(text).unwrap();
    assert_eq!(c.get("steps").unwrap().about, "optimiser steps [Kerbl 2023]");
    assert_eq!(c.get("lr.means").unwrap().about, "world units");
    assert_eq!(c.get("lr.name").unwrap().about, "");
    assert!(c.to_commented_toml().contains("# default; world units"));
}
