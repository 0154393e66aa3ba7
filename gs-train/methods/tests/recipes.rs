//! Presets of methods that are compared with each other differ in what tells the methods apart, and in nothing else.

use std::collections::{BTreeMap, BTreeSet};
use toml::{Table, Value};

/// Settings of preset `fast` by dotted key.
fn settings(method: &str) -> BTreeMap<String, Value> {
    let table = gs_methods::registry().find(method).expect("method").config("fast").expect("preset");
    let mut all = BTreeMap::new();
    let mut open: Vec<(String, Table)> = vec![(String::new(), table)];
    while let Some((prefix, table)) = open.pop() {
        for (key, value) in table {
            match value {
                Value::Table(inner) => open.push((format!("{prefix}{key}."), inner)),
                value => drop(all.insert(format!("{prefix}{key}"), value)),
            }
        }
    }
    all
}

/// Keys whose values differ, and keys that only one of the methods has.
fn differences(a: &str, b: &str) -> BTreeSet<String> {
    let (a, b) = (settings(a), settings(b));
    a.keys().chain(b.keys()).filter(|key| a.get(*key) != b.get(*key)).cloned().collect()
}

#[test]
fn methods_compared_by_their_forecasts_share_one_recipe() {
    // The field, the dynamics, and the rates of what only one of them learns.
    let own = ["field.", "law.", "physics.", "velocity.", "anneal.", "ablate", "margin"];
    let rates = ["schedule.lr.physics.", "schedule.lr.velocity.", "schedule.lr.acceleration."];
    let planes = ["schedule.lr.field."];
    // Splats left out of the field while training: only some methods have that, and no preset uses it.
    let still = ["still."];
    assert_eq!(settings("defgs")["still.pixels"], Value::Float(0.0));
    for (method, more) in [("defgs", &[][..]), ("defgs-nvfi", &[]), ("trace-4dgs", &planes)] {
        let stated = [&own[..], &rates, &still, more].concat();
        let mut odd = differences("trace", method);
        odd.retain(|key| !stated.iter().any(|begin| key.starts_with(begin)));
        assert!(odd.is_empty(), "trace and {method} differ in {odd:?}");
    }
}

#[test]
fn methods_on_one_body_share_one_recipe() {
    for method in ["fags", "acutance"] {
        let found = differences("grid4d", method);
        assert!(found.iter().eq(["cloud.kernel.kind"]), "grid4d and {method} differ in {found:?}");
    }
}
