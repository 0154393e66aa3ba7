//! Settings are resolved, scaled and refused by name.

use super::*;
use gs_train::registry::section;
use gs_train::schedule::{Decay, Schedule};

pub(super) fn request(sets: &[&str]) -> Request {
    let sets = sets.iter().map(|s| (*s).to_owned()).collect();
    Request { method: "static3d".into(), preset: "tiny".into(), sets, ..Request::default() }
}

/// Every option of the data is described, and nothing else.
#[test]
fn options_of_the_data_say_what_they_are() {
    let about: Table = DATA_ABOUT.parse().unwrap();
    let all: DataOptions = about["data"].clone().try_into().unwrap();
    // All that may be absent are given there, so that every field is written.
    let written: Table = toml::to_string(&all).unwrap().parse().unwrap();
    let keys = |t: &Table| t.keys().cloned().collect::<std::collections::BTreeSet<_>>();
    assert_eq!(keys(&written), keys(about["data"].as_table().unwrap()));
    let text = defaults(gs_methods::registry(), "fourdgs").unwrap().to_commented_toml();
    for key in written.keys() {
        let line = text.lines().find(|l| l.trim_start_matches("# ").starts_with(&format!("{key} = "))).unwrap();
        assert!(line.contains("; "), "{line}");
    }
    assert!(text.contains("# time_range = \"0..1\""), "{text}");
}

#[test]
fn every_method_resolves_with_every_preset_and_reads_back() {
    for entry in gs_methods::registry() {
        for (preset, _) in entry.presets {
            let request = Request { method: entry.name.into(), preset: (*preset).into(), ..Request::default() };
            let resolved =
                resolve(gs_methods::registry(), &request).unwrap_or_else(|e| panic!("{} {preset}: {e}", entry.name));
            assert!(resolved.steps() > 0, "{} {preset}", entry.name);
            let back = Resolved::read(gs_methods::registry(), &resolved.to_toml().unwrap(), "x").unwrap();
            assert_eq!((&back.run, &back.data, &back.method), (&resolved.run, &resolved.data, &resolved.method));
        }
    }
}

#[test]
fn a_preset_for_a_kind_of_data_sets_how_they_are_read() {
    let of = |preset: &str, sets: &[&str]| {
        let sets = sets.iter().map(|s| (*s).to_owned()).collect();
        let request = Request { method: "modec".into(), preset: preset.into(), sets, ..Request::default() };
        resolve(gs_methods::registry(), &request).unwrap()
    };
    let raw = of("iphone", &[]);
    assert!(!raw.data.normalise && of("paper", &[]).data.normalise);
    let source = &raw.config.get("data.normalise").unwrap().source;
    assert_eq!(source, &Source::Preset("iphone".into()));
    assert!(of("iphone", &["data.normalise=true"]).data.normalise, "a setting wins");
}

#[test]
fn steps_stretch_the_whole_recipe() {
    let plain = resolve(gs_methods::registry(), &request(&[])).unwrap();
    let short = resolve(gs_methods::registry(), &Request { steps: Some(30), ..request(&[]) }).unwrap();
    assert_eq!((plain.steps(), short.steps()), (300, 30));
    let value = |r: &Resolved, key: &str| r.config.get(key).unwrap().value.as_integer().unwrap();
    for key in ["schedule.density.until", "schedule.lr.cloud.means.steps", "schedule.sh_every"] {
        assert_eq!(value(&short, key), (value(&plain, key) + 9) / 10, "{key}");
    }
    assert_eq!((value(&plain, "schedule.density.every"), value(&short, "schedule.density.every")), (50, 10));
    let mut said = request(&["schedule.density.until=7"]);
    said.steps = Some(30);
    assert_eq!(
        value(&resolve(gs_methods::registry(), &said).unwrap(), "schedule.density.until"),
        7,
        "--set has the last word"
    );
    assert!(resolve(gs_methods::registry(), &Request { steps: Some(0), ..request(&[]) }).is_err());
    let modec = Request { method: "modec".into(), preset: "tiny".into(), ..Request::default() };
    let (plain, short) = (
        resolve(gs_methods::registry(), &modec).unwrap(),
        resolve(gs_methods::registry(), &Request { steps: Some(60), ..modec }).unwrap(),
    );
    assert_eq!(plain.steps(), 600);
    for key in ["adapt.observe_from", "adapt.from", "adapt.until", "intervals.until", "intervals.period"] {
        assert_eq!(10 * value(&short, key), value(&plain, key), "{key}");
    }
    assert_eq!(value(&short, "adapt.every"), 10);
}

#[test]
fn lengths_are_shares_of_the_run_unless_they_are_set() {
    let value = |sets: &[&str], key: &str| {
        let resolved = resolve(gs_methods::registry(), &request(sets)).unwrap();
        resolved.config.get(key).unwrap().value.as_integer().unwrap()
    };
    let until = "schedule.density.until";
    assert_eq!(value(&[], until), 250);
    assert_eq!(value(&["schedule.stages.all.steps=600"], until), 500, "twice the run");
    assert_eq!(value(&["schedule.stages.all.steps=600", "schedule.density.until=70"], until), 70);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("own.toml");
    std::fs::write(&file, "[schedule.density]\nuntil = 50\n[schedule.stages.all]\nsteps = 100").unwrap();
    let own = Request { file: Some(file), steps: Some(1000), ..request(&[]) };
    let own = resolve(gs_methods::registry(), &own).unwrap();
    let of = |key: &str| own.config.get(key).unwrap().clone();
    assert_eq!((of(until).value, of("schedule.density.from").value), (Value::Integer(500), Value::Integer(167)));
    assert!(of(until).source.to_string().ends_with("50 of 100 steps"), "{}", of(until).source);
}

/// The coarse stage of 4DGS and the stage that follows count their own steps.
#[test]
fn lengths_are_shares_of_the_clock_that_they_are_counted_on() {
    let of = |coarse: u32| {
        let sets = vec![format!("schedule.stages.coarse.steps={coarse}")];
        let request = Request { method: "fourdgs".into(), preset: "paper".into(), sets, ..Request::default() };
        let resolved = resolve(gs_methods::registry(), &request).unwrap();
        ["schedule.lr.cloud.means.steps", "schedule.density.until"]
            .map(|key| resolved.config.get(key).unwrap().value.as_integer().unwrap())
    };
    for coarse in [0, 3000, 10_000] {
        assert_eq!(of(coarse), [20_000, 15_000], "{coarse} steps before a clock of its own");
    }
}

#[test]
fn rates_of_the_kernel_rise_in_shorter_runs_unless_they_are_set() {
    let rate = |steps, sets: &[&str]| {
        let request = Request { method: "fags".into(), steps, ..request(sets) };
        let resolved = resolve(gs_methods::registry(), &request).unwrap();
        ["lambda", "beta"].map(|key| {
            let key = format!("schedule.lr.cloud.{key}.start");
            resolved.config.get(&key).unwrap().value.as_float().unwrap()
        })
    };
    let [plain, _] = rate(None, &[]);
    assert_eq!((rate(Some(1600), &[]), rate(Some(1), &[])), ([plain / 2.0; 2], [5e-2; 2]), "of 800 steps");
    assert_eq!(rate(Some(1600), &["schedule.lr.cloud.lambda.start=0.3"]), [0.3, plain / 2.0]);
}

#[test]
fn every_rate_takes_every_field_and_only_stated_ones_are_listed() {
    for entry in gs_methods::registry() {
        let plain = defaults(gs_methods::registry(), entry.name).unwrap();
        let rates: Vec<String> = plain
            .iter()
            .filter_map(|(key, _)| key.strip_prefix("schedule.lr.")?.strip_suffix(".start"))
            .map(str::to_owned)
            .collect();
        assert!(!rates.is_empty(), "{}", entry.name);
        for rate in rates {
            for field in ["decay=step", "eps=1e-8", "from=3", "ramp=5", "sparse=true", "weight_decay=1e-5"] {
                plain.clone().set(&format!("schedule.lr.{rate}.{field}")).unwrap();
            }
        }
    }
    let fields = ["decay", "sparse", "ramp", "weight_decay"];
    let listed = |r: &Resolved| {
        let text = r.to_toml().unwrap();
        fields
            .map(|field| text.lines().filter(|l| l.trim_start_matches("# ").starts_with(&format!("{field} ="))).count())
    };
    let plain = resolve(gs_methods::registry(), &request(&[])).unwrap();
    let stepped = resolve(gs_methods::registry(), &request(&["schedule.lr.cloud.means.decay=step"])).unwrap();
    assert_eq!((listed(&plain), listed(&stepped)), ([0; 4], [1, 0, 0, 0]));
    let back = Resolved::read(gs_methods::registry(), &stepped.to_toml().unwrap(), "x").unwrap();
    let schedule: Schedule = section("static3d", &back.method, "schedule").unwrap();
    assert_eq!(schedule.lr["cloud"]["means"].decay, Decay::Step);
}

#[test]
fn the_timeline_lists_what_has_an_effect() {
    let text = |method: &str| {
        let request = Request { method: method.into(), preset: "fast".into(), ..Request::default() };
        resolve(gs_methods::registry(), &request).unwrap().to_toml().unwrap()
    };
    let (lambda, anchors) = ("# learning rate cloud.lambda", "passes that grow and prune");
    for (method, has) in
        [("static3d", [false; 2]), ("fags", [true, false]), ("scaffold", [false, true]), ("modec", [false, true])]
    {
        assert_eq!([lambda, anchors].map(|line| text(method).contains(line)), has, "{method}");
    }
}

/// What is left out has no rate, whether `ablate` or another setting says so; nothing else changes.
#[test]
fn the_timeline_is_of_the_parts_that_are_left() {
    let resolved = |method: &str, sets: &[&str]| {
        let sets = sets.iter().map(|s| (*s).to_owned()).collect();
        let request = Request { method: method.into(), preset: "paper".into(), sets, ..Request::default() };
        resolve(gs_methods::registry(), &request).unwrap().to_toml()
    };
    let timeline = |method: &str, sets: &[&str]| -> Vec<String> {
        let text = resolved(method, sets).unwrap();
        text.lines().take_while(|line| !line.is_empty()).map(str::to_owned).collect()
    };
    let (kernel, global): (&[&str], &[&str]) = (&["cloud.lambda", "cloud.beta"], &["gad.", "anchors.dynamics"]);
    let cases: [(&str, &str, &[&str]); 9] = [
        ("fags", "ablate=fdgk", kernel),
        ("fags", "cloud.kernel.kind=gaussian", kernel),
        ("fags", "ablate=beta", &["cloud.beta"]),
        ("fags", "ablate=lambda,hfe,gate,fre", &[]),
        ("modec", "ablate=gad", global),
        ("modec", "global=false", global),
        ("modec", "ablate=lgd,tia", &["lgd."]),
        ("trace", "ablate=field", &["field."]),
        ("trace-4dgs", "ablate=field", &["field."]),
    ];
    for (method, set, gone) in cases {
        let is_of = |line: &str, rate: &str| line.strip_prefix("# learning rate ").is_some_and(|l| l.starts_with(rate));
        let mut kept = timeline(method, &[]);
        for rate in gone {
            let before = kept.len();
            kept.retain(|line| !is_of(line, rate));
            assert!(kept.len() < before, "{method} has no rate {rate}");
        }
        assert_eq!(timeline(method, &[set]), kept, "{method} {set}");
    }
    let encoder = |of: &str| {
        let set = format!("lgd.encoder={of}");
        let lines = timeline("modec", &[set.as_str()]);
        ["lgd.planes", "lgd.grids"].map(|rate| lines.iter().any(|line| line.contains(rate)))
    };
    assert_eq!((encoder("planes"), encoder("hash")), ([true, false], [false, true]));
    let error = resolved("fags", &["ablate=fdkg"]).unwrap_err().to_string();
    assert!(error.contains("`fdkg`") && error.contains("fdgk, hfe, gate"), "{error}");
}

#[test]
fn bad_settings_are_refused_by_name() {
    let error = |sets: &[&str]| resolve(gs_methods::registry(), &request(sets)).unwrap_err().to_string();
    assert!(error(&["run.log_every=0"]).contains("run.log_every"));
    assert!(error(&["run.time_budget=-1"]).contains("time_budget"));
    assert!(error(&["schedule.lambda_dsim=1"]).contains("schedule.lambda_dssim"));
    assert!(error(&["data.time_range=1..0"]).contains("time range"));
    assert!(resolve(gs_methods::registry(), &request(&["data.time_range=0..2"])).unwrap().data.time_range.is_some());
    let unknown = Request { preset: "huge".into(), ..request(&[]) };
    assert!(
        resolve(gs_methods::registry(), &unknown).unwrap_err().to_string().contains("fast, tiny"),
        "presets are listed"
    );
    assert!(resolve(gs_methods::registry(), &Request { method: "nerf".into(), ..request(&[]) }).is_err());
}
