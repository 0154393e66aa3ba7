//! MoDec-GS with LGD on hash grids.
//!
//! | property | tolerance |
//! |---|---|
//! | a saved state, and training from it; threads; ranks | same bits |
//! | gradients of images against finite differences | those of `gs_train::conformance` |
//! | a file at 8 bits: a value of a table | half a step of its group |
//!
//! Grids are read at the centres as constants. So parameters of LGD are checked as they are, and those of GAD with the tables
//! set to zero: the field is then the same rigid motion everywhere. Anchors and heads do not know what LGD is made of: the
//! conformance tests of all methods have them.

use crate::{registry, splats, trained};
use gs_core::Param;
use gs_synth::testkit::scene;
use gs_train::checkpoint::{Checkpoint, Coding, Encoding};
use gs_train::conformance::Subject;
use gs_train::conformance::gradients::Rules;
use gs_train::saved;
use gs_train::testkit::short;
use gs_train::trainer::{TrainOptions, Trainer};
use std::path::Path;

const HASH: &str = "
lgd.encoder = \"hash\"
lgd.detach_coordinates = true
[lgd.hash]
canonical = { base = [3.0, 3.0, 3.0], end = [12.0, 12.0, 12.0], levels = 3, log2_table = 9 }
temporal = { base = [3.0, 3.0, 2.0], end = [12.0, 12.0, 4.0], levels = 3, log2_table = 9 }
";

/// 60 steps on hash grids.
fn hash(over: &str) -> toml::Table {
    short(&registry(), "modec", &[HASH, over])
}

/// Few splats, so that few pairs change their order in depth.
fn few() -> toml::Table {
    hash("init.points = 20\nadapt.max_anchors = 24")
}

#[test]
fn states_rows_times_threads_and_ranks() {
    let (registry, data, config) = (registry(), scene("balls", 32, 6), few());
    let subject = Subject::new(&registry, "modec", &data, &config);
    let all = || {
        subject.rates()?;
        subject.updates()?;
        subject.rows()?;
        subject.times()?;
        subject.state()?;
        subject.threads()?;
        subject.ranks()
    };
    all().unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn gradients_match_finite_differences() {
    let (registry, data, config) = (registry(), scene("balls", 32, 6), few());
    let check = |rules: Rules<'_>, modify: &(dyn Fn(&mut Param) + Sync)| {
        let subject = Subject { rules, modify, ..Subject::new(&registry, "modec", &data, &config) };
        subject.gradients().unwrap_or_else(|e| panic!("{e}"));
    };
    let elsewhere = "is checked with other tables or in the conformance tests of all methods";
    check(Rules { required: &["lgd."], exempt: &[("", elsewhere)], ..Rules::default() }, &|_| {});
    check(Rules { required: &["gad."], exempt: &[("", elsewhere)], ..Rules::default() }, &|p| {
        if p.name.starts_with("lgd.grids.") {
            p.value.fill(0.0);
        }
    });
}

#[test]
fn every_value_is_counted_and_comes_back_from_eight_bits() {
    let config = hash("");
    let trainer = trained(&config, 60);
    let model = trainer.model();
    let (_, folded) = model.fold(&config).expect("an appearance to fold");
    let table = model.capabilities().inspect.and_then(|i| i.paper_storage()).expect("a table");
    assert_eq!(table.needed_bytes(), 4 * folded.param_count(), "what is counted is what there is");
    let grids = table.rows.iter().find(|r| r.block == "local deformation, hash grids").expect("a row");
    let mut tables = Vec::new();
    model.visit(&mut |p| tables.extend(p.name.starts_with("lgd.grids.").then(|| (p.name.clone(), p.value.clone()))));
    assert_eq!((tables.len(), grids.needed_values), (4, tables.iter().map(|t| t.1.len()).sum()));

    let mut state = trainer.state();
    let packed = |name: &str| if name.starts_with("lgd.grids.") { Coding::Affine8 } else { Coding::F32 };
    let encodings: Vec<Encoding> = state.tensors.iter().map(|(name, _)| packed(name)).map(encoding).collect();
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("modec_hash_packed.gs4d");
    let bytes = state.save_packed(&path, &encodings).expect("written");
    let again = Checkpoint::load(&path).expect("read");
    for ((name, values), bytes) in state.tensors.iter().zip(bytes) {
        let read = again.tensor(name).expect("a tensor");
        if name.starts_with("lgd.grids.") {
            assert!(bytes <= values.len() + 8 * values.len().div_ceil(256) + 32, "{name}: {bytes} bytes");
        }
        for (group, read) in values.chunks(256).zip(read.chunks(256)) {
            let (low, high) = group.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
            let step = if packed(name) == Coding::Affine8 { (high - low) / 255.0 } else { 0.0 };
            assert!(group.iter().zip(read).all(|(a, b)| (a - b).abs() <= 0.51 * step), "{name}");
        }
    }
    // It renders, as a state whose tables are those that were read does.
    for (name, values) in &mut state.tensors {
        values.copy_from_slice(again.tensor(name).expect("a tensor"));
    }
    let camera = &trainer.dataset().train[0].camera;
    let [a, b] =
        [&state, &again].map(|s| splats(&saved::load(&registry(), s, None).expect("state").model, 0.6, camera));
    assert_eq!(a, b);
}

/// As shared blocks are packed.
fn encoding(coding: Coding) -> Encoding {
    Encoding { coding, columns: 1, group: 256, deflate: true }
}

#[test]
fn what_makes_no_sense_is_refused_by_name() {
    let error = |over: &str| {
        let trainer = Trainer::new(&registry(), scene("sheet", 32, 6), "modec", &hash(over), TrainOptions::default());
        trainer.err().expect("refused").to_string()
    };
    assert!(error("lgd_query = \"rest\"").contains("lgd_query = rest"));
    let large = error("lgd.hash.temporal.end = [512.0, 512.0, 512.0]\nlgd.hash.temporal.log2_table = 17");
    assert!(large.contains("log2_table") && large.contains("480000"), "{large}");
    let levels = error("lgd.hash.canonical.levels = 65");
    assert!(levels.contains("`lgd.hash.canonical.levels` = 65"), "{levels}");
    // Logits that can never leave 0.
    assert!(error("gad.dynamics.activation = \"relu\"").contains("activation = relu"));
    assert!(error("gad.dynamics.activation = \"tanh\"").contains("activation = tanh"));
    for learns in ["sparsity.weight = 0.01", "gad.net.zero_init = false"] {
        let over = format!("{learns}\ngad.dynamics.activation = \"tanh\"");
        assert!(
            Trainer::new(&registry(), scene("sheet", 32, 6), "modec", &hash(&over), TrainOptions::default()).is_ok()
        );
    }
    let shared = "logits = 1\ngad.dynamics.activation = \"relu\"";
    assert!(Trainer::new(&registry(), scene("sheet", 32, 6), "modec", &hash(shared), TrainOptions::default()).is_ok());
    let wrong = error("lgd.width = \"wide\"");
    assert!(wrong.contains("lgd"), "{wrong}");
}
