//! Stored hashes of trained states: 200 steps of every method end in the same bits as when the table below was made.
//!
//! Hashed are the names, lengths and `f32` bits of all tensors of a checkpoint (values, both moments of the optimiser,
//! buffers), sorted by name, with FNV-1a in 64 bits. Growth, pruning, opacity resets and every change of stage lie inside
//! the 200 steps. A hash changes with any change of a number, an order of summation, a random stream or a tensor's name.
//!
//! The bits belong to an instruction set and to what a machine computes in its own way: `exp`, `sin` and their like come
//! from the C library, estimates of reciprocals from the processor. Both are fingerprinted, and a machine without an entry
//! in [`STORED`] is skipped by name. (Matrix products depend on the sizes of caches too, but only where the inner dimension
//! is above 512; networks work on blocks of 256 rows.) Neither `gemm` nor `fearless_simd` can be told to leave AVX-512 out, so an
//! entry is made on a machine of its kind, after a change that is meant to change numbers as well:
//! ```text
//! GS4D_PRINT_HASHES=1 cargo test -p gs-tests --test training hashes -- --nocapture
//! ```

use crate::support;
use crate::support::*;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f32x16};
use gs_data::Dataset;
use gs_train::densify::DensifyStats;
use gs_train::registry::overlay;
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

const STEPS: u32 = 200;

/// What one kind of machine computes.
struct Stored {
    /// As [`instruction_set`] names it.
    set: &'static str,
    /// [`arithmetic`] of the machine.
    arithmetic: u64,
    /// Hash of the last state by method.
    states: &'static [(&'static str, u64)],
}

// Methods without a hash are skipped by name.
const STORED: &[Stored] = &[
    Stored {
        set: "avx512",
        arithmetic: 0x8928a9ce870d1cc8,
        states: &[
            ("static3d", 0xe4a99bf1bd138058),
            ("scaffold", 0x800e4d94772b7ae5),
            ("defgs", 0xb07b513b71baf99a),
            ("fourdgs", 0xac197aa42ec95e2b),
            ("grid4d", 0xfbb0fe231c89c111),
            ("fags", 0x66aa6fd36b2e2726),
            ("acutance", 0x4198ac63b84a5356),
            ("modec", 0x019cc4520fce67cf),
            ("trace", 0xa2bd61ce37370cd8),
            ("trace-4dgs", 0x54b30781dbc6cd5b),
            ("defgs-nvfi", 0x070d0f7f456db645),
        ],
    },
    Stored {
        set: "avx2",
        arithmetic: 0x475d0f7f43d99348,
        states: &[
            ("static3d", 0x548458d92057655a),
            ("scaffold", 0xb1569a97f6eaab99),
            ("fourdgs", 0xc0df094f4ac19bb6),
            ("modec", 0x317113d8142f45bf),
            ("dut", 0x0437dd3953f45ce1),
        ],
    },
];

/// FNV-1a, 64 bits.
struct Fnv(u64);

impl Fnv {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    fn add_values(&mut self, values: &[f32]) {
        values.iter().for_each(|v| self.add(&v.to_bits().to_le_bytes()));
    }
}

#[test]
fn fnv_has_its_published_values() {
    let hash = |text: &str| {
        let mut fnv = Fnv::new();
        fnv.add(text.as_bytes());
        fnv.0
    };
    assert_eq!(hash(""), 0xcbf2_9ce4_8422_2325);
    assert_eq!(hash("a"), 0xaf63_dc4c_8601_ec8c);
    assert_eq!(hash("foobar"), 0x8594_4171_f739_67e8);
}

/// The instruction set that kernels and matrix products choose at run time.
fn instruction_set() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        let avx2 = std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma");
        let [avx512f, vbmi2] = [std::is_x86_feature_detected!("avx512f"), std::is_x86_feature_detected!("avx512vbmi2")];
        match (avx2, avx512f, vbmi2) {
            (true, true, true) => return "avx512",
            (true, false, _) => return "avx2",
            // Matrix products would have wider vectors than our kernels.
            _ => {}
        }
    }
    "other"
}

/// Hash of what the C library and the processor compute in their own ways.
fn arithmetic() -> u64 {
    let mut fnv = Fnv::new();
    for i in 0..4096 {
        let x = 0.003 * i as f32 + 0.001;
        let of = [
            x.exp(),
            (-x).exp(),
            x.ln(),
            x.sin(),
            x.cos(),
            x.tanh(),
            x.exp2(),
            x.powf(0.3),
            x.atan2(0.7),
            x.hypot(0.3),
        ];
        fnv.add_values(&of);
        fnv.add(&f64::from(x).exp().to_bits().to_le_bytes());
        fnv.add(&f64::from(x).sin().to_bits().to_le_bytes());
        let mut estimate = [x; 16];
        dispatch!(Level::new(), simd => estimate_reciprocals(simd, &mut estimate));
        fnv.add_values(&estimate);
    }
    fnv.0
}

#[inline(always)]
fn estimate_reciprocals<S: Simd>(simd: S, values: &mut [f32; 16]) {
    f32x16::from_slice(simd, values).approximate_recip().store_slice(values);
}

/// Growth, pruning and resets of clouds …
const CLOUD: &str = "
batch = 2
lr_batch = 2
density.from = 20
density.until = 180
density.every = 20
density.dense_share = 0.05
density.min_opacity = 0.009
density.reset_every = 90
density.max_splats = 300
sh_every = 60
";

/// … and of anchors …
const ANCHORS: &str = "
schedule = { batch = 2, lr_batch = 2 }
[adapt]
observe_from = 0
from = 20
until = 180
every = 20
grad = 2e-5
";

/// … whose intervals move.
const INTERVALS: &str = "
[intervals]
from = 100
until = 180
period = 20
";

/// DUT on the smallest maps, every stage in turn, mean textures made anew, images under changing light.
const AVATAR: &str = "
jitter = 0.3
surface.refresh = 20
schedule.stages.geometry.steps = 60
schedule.stages.warm_up.steps = 40
schedule.stages.main.steps = 100
";

/// The `tiny` preset of a method with all its stages inside the steps.
fn plan(method: &str) -> toml::Table {
    let anchored = tiny(method, "").contains_key("adapt");
    let mut config = tiny(method, if anchored { "" } else { CLOUD });
    if anchored {
        overlay(&mut config, ANCHORS.parse().expect("TOML"));
    }
    if config.contains_key("intervals") {
        overlay(&mut config, INTERVALS.parse().expect("TOML"));
    }
    let stages = config["schedule"]["stages"].as_table_mut().expect("stages");
    let count = stages.len() as u32;
    for (i, (_, stage)) in stages.iter_mut().enumerate() {
        let stage = stage.as_table_mut().expect("stage");
        let rest = if i == 0 { STEPS % count } else { 0 };
        stage.insert("steps".into(), (STEPS / count + rest).into());
        if let Some(until) = stage.get_mut("window_until") {
            *until = 0.56.into();
        }
    }
    config["init"].as_table_mut().expect("init").insert("points".into(), 100.into());
    config
}

/// The hash after the last step, and how often density control cloned, split, pruned and reset.
fn trained(data: &Arc<Dataset>, method: &str, config: &toml::Table) -> (u64, [u32; 4]) {
    let options = TrainOptions { seed: 3, ..TrainOptions::default() };
    let mut trainer = Trainer::new(gs_methods::registry(), data.clone(), method, config, options).expect("trainer");
    assert_eq!(trainer.steps(), STEPS, "{method}");
    let mut edits = [0; 4];
    for DensifyStats { cloned, split, pruned, reset } in support::run(&mut trainer, STEPS).iter().map(|r| r.adapted) {
        edits.iter_mut().zip([cloned, split, pruned, reset.into()]).for_each(|(sum, n)| *sum += n);
    }
    let mut tensors = trainer.state().tensors;
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    let mut fnv = Fnv::new();
    for (name, values) in &tensors {
        fnv.add(name.as_bytes());
        fnv.add(&(values.len() as u64).to_le_bytes());
        fnv.add_values(values);
    }
    (fnv.0, edits)
}

#[test]
fn states_after_200_steps_have_their_stored_hashes() {
    let print = std::env::var_os("GS4D_PRINT_HASHES").is_some();
    let (set, arithmetic) = (instruction_set(), arithmetic());
    let stored = STORED.iter().find(|s| s.set == set && s.arithmetic == arithmetic);
    if stored.is_none() && !print {
        println!("SKIPPED hashes: none are stored for {set} with arithmetic {arithmetic:#018x}");
        return;
    }
    let (balls, film) = (scene("balls", 32, 7), film("cylinder", 32, 2));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("pool");
    let mut found = Vec::new();
    for entry in gs_methods::registry() {
        let config = if entry.needs_avatar { film_config(&[SHORT_FILM, AVATAR]) } else { plan(entry.name) };
        let data = if entry.needs_avatar { &film } else { &balls };
        let (hash, edits) = pool.install(|| trained(data, entry.name, &config));
        // Anchors are added and pruned; DUT has no density control.
        let wanted = match (entry.needs_avatar, config.contains_key("adapt")) {
            (true, _) => [false; 4],
            (_, true) => [true, false, true, false],
            _ => [true; 4],
        };
        assert_eq!(edits.map(|n| n > 0), wanted, "{}: cloned, split, pruned, reset {edits:?}", entry.name);
        found.push((entry.name, hash));
    }
    if print {
        let states: String =
            found.iter().map(|(name, hash)| format!("        (\"{name}\", {hash:#018x}),\n")).collect();
        println!(
            "Stored {{\n    set: \"{set}\",\n    arithmetic: {arithmetic:#018x},\n    states: &[\n{states}    ],\n}}"
        );
        return;
    }
    let stored = stored.map_or(&[][..], |s| s.states);
    let known = |name: &str| stored.iter().find(|s| s.0 == name).map(|s| s.1);
    let unknown: Vec<&str> = found.iter().filter(|f| known(f.0).is_none()).map(|f| f.0).collect();
    if !unknown.is_empty() {
        println!("SKIPPED hashes: none are stored for {set} of {}", unknown.join(", "));
    }
    let changed: Vec<&str> = found.iter().filter(|f| known(f.0).is_some_and(|h| h != f.1)).map(|f| f.0).collect();
    assert!(changed.is_empty(), "other bits than stored for {set}: {}", changed.join(", "));
}
