use super::*;
use crate::kept::Kept;
use glam::Vec3;
use gs_core::Rng;
use gs_data::PointCloud;
use gs_train::scene::SceneInfo;
use gs_train::timestamp::Timestamp;
use gs4d_report::needs::neutral_camera;

/// An untrained scene of 200 splats whose values have been shaken.
fn loaded(method: &str) -> Loaded {
    let entry = gs_methods::registry().find(method).unwrap();
    let config = entry.config("tiny").unwrap();
    let mut rng = Rng::new(1, "compact", 0, 0);
    let positions: Vec<Vec3> =
        (0..200).map(|_| Vec3::from_array(std::array::from_fn(|_| rng.range(-1.0, 1.0)))).collect();
    let points = PointCloud { colors: vec![[0.5; 3]; positions.len()], positions };
    let bounds = [Vec3::NEG_ONE, Vec3::ONE];
    let scene = SceneInfo {
        points,
        extent: 2.0,
        bounds,
        views: 4,
        timestamps: 4,
        last_time: 1.0,
        frame_interval: 0.25,
        first_interval: 0.25,
        view_spacing: 6.0,
        seed: 1,
        avatar: None,
        max_parameters: gs_train::scene::MAX_PARAMETERS,
    };
    let mut model = entry.model(&config, &scene).unwrap();
    model.visit_mut(&mut |p| {
        p.value.iter_mut().for_each(|v| *v += 0.05 * rng.normal());
        p.moment1.fill(0.5);
    });
    let state = RunState {
        config: &config,
        scene: &scene,
        step: 40,
        adam_updates: &BTreeMap::from([("cloud.means".to_owned(), 40)]),
        train_seconds: 1.5,
    };
    saved::load(gs_methods::registry(), &saved::save(&model, &state), None).unwrap()
}

fn written(loaded: &Loaded, bits: Bits, deflate: bool) -> (CompactReport, Loaded) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.gs4d");
    let scene = CompactScene::of(&loaded.model, &loaded.config);
    let settings = toml::Table::from_iter([("run".to_owned(), toml::Value::from("settings"))]);
    let report = scene.write(&path, loaded, &settings, &Kept::default(), Packing { bits, deflate }).unwrap();
    assert_eq!(report.file_bytes as u64, std::fs::metadata(&path).unwrap().len());
    let checkpoint = Checkpoint::load(&path).unwrap();
    assert_eq!(checkpoint.meta[SETTINGS], "run = \"settings\"\n");
    (report, saved::load(gs_methods::registry(), &checkpoint, None).unwrap())
}

fn values(loaded: &Loaded) -> Vec<(String, Vec<f32>)> {
    let mut values = Vec::new();
    loaded.model.visit(&mut |p| {
        assert!(p.grad.iter().all(|g| *g == 0.0) && p.grad.len() == p.len(), "{}", p.name);
        values.push((p.name.clone(), p.value.clone()));
    });
    values
}

#[test]
fn nothing_is_lost_at_32_bits_but_what_only_training_needs() {
    for method in ["fourdgs", "static3d"] {
        let before = loaded(method);
        for deflate in [false, true] {
            let (report, after) = written(&before, Bits::Full, deflate);
            assert_eq!(values(&after), values(&before));
            after.model.visit(&mut |p| assert!(p.moment1.iter().all(|m| *m == 0.0)));
            assert_eq!((after.step, after.scene.extent, after.train_seconds), (40, 2.0, 1.5));
            assert!(after.adam_updates.is_empty());
            let at: Timestamp = Timestamp::normalised(0.3);
            let camera = neutral_camera();
            let means = |loaded: &Loaded| loaded.model.splats(&at, &camera).unwrap().means;
            assert_eq!(means(&after), means(&before));
            let packed: usize = report.blocks.iter().map(|b| b.bytes).sum();
            assert!(packed < report.file_bytes && 4 * before.model.param_count() == report.value_bytes);
        }
    }
}

#[test]
fn fewer_bits_keep_each_value_near() {
    let before = loaded("fourdgs");
    for (bits, share, ratio) in [(Bits::Half, 6e-4, 1.8), (Bits::Byte, 2.1e-3, 3.2)] {
        let (report, after) = written(&before, bits, false);
        assert!(report.value_bytes as f64 > ratio * report.file_bytes as f64, "{}", report.to_text());
        for ((name, old), (_, new)) in values(&before).iter().zip(values(&after)) {
            let span = old.iter().fold(0.0f32, |m, v| m.max(v.abs())) * 2.0;
            let share = if old.len() <= SMALL {
                0.0
            } else if name == "cloud.means" {
                1e-5
            } else {
                share
            };
            for (v, w) in old.iter().zip(&new) {
                assert!((v - w).abs() <= share * span, "{name} at {bits:?}: {v} became {w}");
            }
        }
    }
}

#[test]
fn known_lattices_and_fixed_state_stay_exact() {
    let loaded = loaded("static3d");
    let mut scene = CompactScene::of(&loaded.model, &loaded.config);
    let means = scene.tensors.iter_mut().find(|t| t.name == "cloud.means").unwrap();
    means.values.iter_mut().for_each(|v| *v = (*v / 0.01).round() * 0.01);
    means.lattice = Some(0.01);
    let want = means.values.clone();
    let state: Vec<f32> = (0..200).map(|i| (i as f32).sqrt()).collect();
    let tensor = |name: &str, exact| CompactTensor {
        name: name.into(),
        row_width: None,
        values: state.clone(),
        exact,
        lattice: None,
    };
    scene.tensors.extend([tensor("state", true), tensor("block", false)]);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.gs4d");
    scene
        .write(&path, &loaded, &toml::Table::new(), &Kept::default(), Packing { bits: Bits::Byte, deflate: true })
        .unwrap();
    let back = Checkpoint::load(&path).unwrap();
    assert_eq!((back.tensor("cloud.means").unwrap(), back.tensor("state").unwrap()), (&want[..], &state[..]));
    assert_ne!(back.tensor("block").unwrap(), state);
}

#[test]
fn a_damaged_file_is_refused_wherever_it_is_hurt() {
    let loaded = loaded("static3d");
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.gs4d");
    let scene = CompactScene::of(&loaded.model, &loaded.config);
    scene
        .write(&path, &loaded, &toml::Table::new(), &Kept::default(), Packing { bits: Bits::Byte, deflate: true })
        .unwrap();
    let whole = std::fs::read(&path).unwrap();
    let hurt = dir.path().join("hurt.gs4d");
    for at in (0..whole.len()).step_by(29) {
        std::fs::write(&hurt, &whole[..at]).unwrap();
        assert!(Checkpoint::load(&hurt).is_err(), "cut at {at}");
        let mut flipped = whole.clone();
        flipped[at] ^= 1 << (at % 8);
        std::fs::write(&hurt, &flipped).unwrap();
        assert!(Checkpoint::load(&hurt).is_err(), "flipped at {at}");
    }
}

#[test]
fn a_scene_with_other_sizes_does_not_load() {
    let loaded = loaded("fourdgs");
    let refuse = |change: fn(&mut CompactTensor) -> bool| {
        let mut scene = CompactScene::of(&loaded.model, &loaded.config);
        assert!(scene.tensors.iter_mut().any(change));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.gs4d");
        scene
            .write(&path, &loaded, &toml::Table::new(), &Kept::default(), Packing { bits: Bits::Half, deflate: false })
            .unwrap();
        saved::load(gs_methods::registry(), &Checkpoint::load(&path).unwrap(), None).err().unwrap()
    };
    let shorter = |t: &mut CompactTensor| t.row_width.is_none() && t.values.pop().is_some();
    assert!(refuse(shorter).contains("are needed"));
    let wild = |t: &mut CompactTensor| t.name == "cloud.means" && std::mem::replace(&mut t.values[5], f32::NAN) != 0.0;
    assert!(refuse(wild).contains("not finite at 5"));
}

#[test]
fn no_file_of_this_machine_is_named() {
    let text = "ablate = \"gad\"\n[run]\ndata = \"scenes/reach\"\n[schedule]\nmrf_weights = \"/home/me/vgg19.safetensors\"\nbackground = \"white\"\n";
    let kept: toml::Table = without_path(&text.parse().unwrap()).unwrap().parse().unwrap();
    assert_eq!(kept["run"]["data"].as_str(), Some(""));
    assert_eq!(kept["schedule"]["mrf_weights"].as_str(), Some(""));
    assert_eq!((kept["ablate"].as_str(), kept["schedule"]["background"].as_str()), (Some("gad"), Some("white")));
}
