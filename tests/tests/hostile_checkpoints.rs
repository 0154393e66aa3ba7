//! Checkpoints whose configuration or scene was changed, checksums repaired: any give a model or an error, without a panic and
//! with at most eight times the bytes of the file plus 64 MiB of memory.

use gs_core::testkit::alloc::{Counting, peak_of};
use gs_data::Dataset;
use gs_train::checkpoint::Checkpoint;
use gs_train::domains::domain;
use gs_train::registry::MethodEntry;
use gs_train::saved;
use gs_train::testkit::{config, start};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The state of a run of few points before its first step.
fn saved_state(entry: &MethodEntry, data: &Arc<Dataset>) -> Checkpoint {
    let registry = gs_methods::registry();
    let over = if entry.needs_avatar { gs_train::testkit::SHORT_FILM } else { "init.points = 50" };
    start(registry, data, entry.name, &config(registry, entry.name, "tiny", &[over]), 1).state()
}

fn data_of(entry: &MethodEntry) -> Arc<Dataset> {
    match entry.needs_avatar {
        true => gs_synth::testkit::film("cylinder", 24, 1),
        false => gs_synth::testkit::scene("balls", 16, 3),
    }
}

/// Loads a state that stands for a file of its size; says whether it was taken, or what went wrong with it.
fn load(entry: &MethodEntry, data: &Dataset, state: &Checkpoint) -> Result<bool, String> {
    let avatar = entry.avatar(data).expect("avatar");
    let values: usize = state.tensors.iter().map(|t| t.1.len()).sum();
    let bytes = 4 * values + state.meta.to_string().len();
    let read = || saved::load_with(gs_methods::registry(), state, None, avatar).is_ok();
    let (loaded, peak) = peak_of(|| catch_unwind(AssertUnwindSafe(read)));
    match loaded {
        Err(_) => Err("panicked".into()),
        Ok(_) if peak > 8 * bytes + (64 << 20) => Err(format!("{} MiB for {bytes} bytes", peak >> 20)),
        Ok(loaded) => Ok(loaded),
    }
}

/// Sides of textures decide the memory of a frame, not of the file: a film is loaded only beside its data.
const TEXTURES: &str = "/config/textures/";

/// Settings that all methods read alike; each number is tried with the first three methods that have it.
const SHARED: [&str; 4] = ["/config/schedule/", "/config/data/", "/config/cameras/", "/config/run/"];

/// Every number of a JSON value, by pointer.
fn numbers(value: &Value, at: &str) -> Vec<String> {
    let inside: Vec<(String, &Value)> = match value {
        Value::Object(map) => map.iter().map(|(k, v)| (format!("{at}/{k}"), v)).collect(),
        Value::Array(list) => list.iter().enumerate().map(|(i, v)| (format!("{at}/{i}"), v)).collect(),
        Value::Number(_) => return vec![at.to_owned()],
        _ => Vec::new(),
    };
    inside.iter().flat_map(|(at, v)| numbers(v, at)).collect()
}

#[test]
fn no_number_of_a_checkpoint_is_believed_before_its_bytes_are_counted() {
    let (mut faults, mut tried) = (Vec::new(), HashMap::<String, u32>::new());
    for entry in gs_methods::registry() {
        let data = data_of(entry);
        let state = saved_state(entry, &data);
        assert_eq!(load(entry, &data, &state), Ok(true), "{}", entry.name);
        for at in numbers(&state.meta, "").into_iter().filter(|at| !at.starts_with(TEXTURES)) {
            if SHARED.iter().any(|section| at.starts_with(section)) {
                let tried = tried.entry(at.clone()).or_default();
                *tried += 1;
                if *tried > 3 {
                    continue;
                }
            }
            let key = at.strip_prefix("/config/").map(|key| key.replace('/', "."));
            let own = key
                .and_then(|key| domain(key.trim_end_matches(|c: char| c.is_ascii_digit() || c == '.'), entry.domains));
            let ends = own.map_or(vec![0.0, 1e9], |d| vec![d.low, d.high]);
            let beyond = [json!(i64::MAX), json!(u32::MAX), json!(-1), json!(1e300)];
            for number in ends.iter().map(|n| json!(*n as i64)).chain(ends.iter().map(|n| json!(n))).chain(beyond) {
                let mut state = state.clone();
                *state.meta.pointer_mut(&at).expect("a number of the state") = number.clone();
                if let Err(why) = load(entry, &data, &state) {
                    faults.push(format!("{} {at} = {number}: {why}", entry.name));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Several settings at once: each within its domain, together far beyond the file.
#[test]
fn products_of_settings_are_counted() {
    let cases: [(&str, &[(&str, i64)]); 5] = [
        ("defgs", &[("field/width", 4096), ("field/depth", 64)]),
        ("fourdgs", &[("field/hexplane/channels", 1024), ("field/width", 4096), ("field/depth", 64)]),
        ("grid4d", &[("field/canonical/log2_table", 28), ("field/canonical/levels", 64), ("field/width", 4096)]),
        ("scaffold", &[("anchors/features", 1024), ("anchors/offsets", 64), ("decoder/appearance", 1024)]),
        ("modec", &[("gad/net/hexplane/channels", 1024), ("lgd/depth", 64), ("anchors/offsets", 64)]),
    ];
    for (method, settings) in cases {
        let entry = gs_methods::registry().find(method).expect("method");
        let data = data_of(entry);
        let mut state = saved_state(entry, &data);
        for (key, value) in settings {
            *state.meta.pointer_mut(&format!("/config/{key}")).expect("setting") = json!(value);
        }
        assert_eq!(load(entry, &data, &state), Ok(false), "{method}");
    }
}
