//! Which crate may depend on which: the arrows of docs/architecture.md, and no others.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Package, folder, and the packages of this workspace it may depend on.
const GRAPH: &[(&str, &str, &[&str])] = &[
    ("gs-core", "gs-core", &[]),
    ("gs-raster", "gs-raster", &["gs-core"]),
    ("gs-gpu", "gs-raster/gpu", &["gs-core", "gs-raster"]),
    ("gs-fft", "gs-metrics/fft", &[]),
    ("gs-metrics", "gs-metrics", &["gs-core", "gs-fft"]),
    ("gs-deform", "gs-deform", &["gs-core"]),
    ("gs-anchor", "gs-anchor", &["gs-core", "gs-deform"]),
    ("gs-physics", "gs-physics", &["gs-core"]),
    ("gs-texel", "gs-texel", &["gs-core"]),
    ("gs-data", "gs-train/data", &["gs-core", "gs-texel"]),
    ("gs-synth", "gs-train/synth", &["gs-core", "gs-data", "gs-physics", "gs-texel"]),
    ("gs-train", "gs-train", &["gs-core", "gs-data", "gs-metrics", "gs-raster"]),
    ("gs-train-gpu", "gs-train/gpu", &["gs-core", "gs-data", "gs-deform", "gs-gpu", "gs-raster", "gs-train"]),
    ("gs-method-field", "gs-train/methods/field", &["gs-core", "gs-deform", "gs-train"]),
    ("gs-method-anchor", "gs-train/methods/anchor", &["gs-anchor", "gs-core", "gs-deform", "gs-raster", "gs-train"]),
    ("gs-method-physics", "gs-train/methods/physics", &["gs-core", "gs-deform", "gs-physics", "gs-raster", "gs-train"]),
    ("gs-method-texel", "gs-train/methods/texel", &["gs-core", "gs-data", "gs-raster", "gs-texel", "gs-train"]),
    (
        "gs-methods",
        "gs-train/methods",
        &["gs-method-anchor", "gs-method-field", "gs-method-physics", "gs-method-texel", "gs-train"],
    ),
];

/// Libraries under `apps`: each may depend on every library above, and on these of its own kind.
const APPS: &[(&str, &[&str])] = &[
    ("gs4d-report", &[]),
    ("gs4d-player", &[]),
    ("gs4d-eval", &["gs4d-player", "gs4d-report"]),
    ("gs4d-run", &["gs4d-eval", "gs4d-report"]),
    ("gs4d-doctor", &["gs4d-report", "gs4d-run"]),
    ("gs4d-import", &[]),
    ("gs4d-checkpoints", &[]),
    ("gs4d-lab", &["gs4d-eval", "gs4d-report", "gs4d-run"]),
    ("gs4d-reproduce", &["gs4d-eval", "gs4d-lab", "gs4d-report", "gs4d-run"]),
    ("gs4d-view", &["gs4d-eval", "gs4d-player", "gs4d-report", "gs4d-run"]),
    (
        "gs4d",
        &[
            "gs4d-checkpoints",
            "gs4d-doctor",
            "gs4d-eval",
            "gs4d-import",
            "gs4d-lab",
            "gs4d-player",
            "gs4d-report",
            "gs4d-reproduce",
            "gs4d-run",
            "gs4d-view",
        ],
    ),
    ("gs4d-mpi", &["gs4d"]),
    ("gs4d-py", &["gs4d-run"]),
];

fn manifest(folder: &str) -> toml::Table {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(folder).join("Cargo.toml");
    let text = std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    text.parse().unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

/// The packages of this workspace in `[dependencies]`.
fn dependencies(folder: &str) -> BTreeSet<String> {
    let table = manifest(folder);
    let found = table.get("dependencies").and_then(toml::Value::as_table);
    found.into_iter().flatten().map(|(name, _)| name.clone()).filter(|n| n.starts_with("gs")).collect()
}

/// Folders of all members of the workspace.
fn members() -> BTreeSet<String> {
    let members = manifest("")["workspace"]["members"].as_array().expect("members").clone();
    members.iter().filter_map(|m| m.as_str().map(str::to_owned)).collect()
}

#[test]
fn libraries_depend_on_what_the_graph_says_and_nothing_else() {
    for (name, folder, allowed) in GRAPH {
        let allowed: BTreeSet<String> = allowed.iter().map(|n| (*n).to_owned()).collect();
        assert_eq!(dependencies(folder), allowed, "{name}");
    }
}

#[test]
fn apps_depend_on_libraries_and_on_each_other_in_one_direction() {
    let order: BTreeMap<&str, usize> = APPS.iter().enumerate().map(|(i, a)| (a.0, i)).collect();
    for (name, allowed) in APPS {
        for found in dependencies(&format!("apps/{name}")).iter().filter(|d| d.starts_with("gs4d")) {
            assert!(allowed.contains(&found.as_str()), "{name} depends on {found}");
            assert!(order[found.as_str()] < order[name], "{name} and {found} form a circle");
        }
    }
}

/// A page that plays needs splats, no trainer.
#[test]
fn the_player_knows_no_trainer() {
    assert_eq!(dependencies("apps/gs4d-player"), BTreeSet::from(["gs-core".to_owned()]));
}

/// What is particular to a method reaches the report as data of `gs_train::report`.
#[test]
fn the_report_knows_no_method() {
    let allowed = ["gs-core", "gs-metrics", "gs-raster", "gs-train"].map(str::to_owned);
    assert_eq!(dependencies("apps/gs4d-report"), BTreeSet::from(allowed));
}

#[test]
fn every_member_of_the_workspace_is_in_the_graph() {
    let known = GRAPH.iter().map(|g| g.1.to_owned()).chain(APPS.iter().map(|a| format!("apps/{}", a.0)));
    assert_eq!(members(), known.chain(["tests", "fuzz"].map(str::to_owned)).collect());
}

/// Helpers of tests are a feature `testkit`, which no build but that of tests and benches may turn on.
#[test]
fn testkits_are_turned_on_by_tests_alone() {
    for folder in members() {
        let table = manifest(&folder);
        for part in ["dependencies", "build-dependencies", "target"] {
            assert!(!table.get(part).is_some_and(|p| p.to_string().contains("testkit")), "{folder}, [{part}]");
        }
        for (name, turns_on) in table.get("features").and_then(toml::Value::as_table).into_iter().flatten() {
            assert!(!turns_on.to_string().contains("testkit"), "{folder}, feature `{name}`");
        }
    }
}
