//! Checkpoints in the layouts of four codes, made by `golden/make.py` with the codes' own modules, and of TRACE, made by `golden/make_trace.py`
//! from its formulas: the scenes of gs4d are theirs, splat by splat, and their renderings agree to 1e-4.
//!
//! | column | tolerance |
//! |---|---|
//! | means, scales (magnitude) | 1e-5 of 1 + the value |
//! | quats (unit, up to sign) | 1e-5 |
//! | opacities | 1e-6 |
//! | SH, colours | 1e-6 of 1 + the value; decoded colours 1e-5 |
//! | rendered image | 1e-4 at every pixel |

use glam::{DVec3, Vec3};
use gs_core::{Camera, Color, Kernel, Splats};
use gs_raster::{RasterOptions, Workspace, render};
use gs_synth::{SynthOptions, write};
use gs_train::timestamp::Timestamp;
use gs4d_checkpoints::{CheckpointError, Scene};
use gs4d_run::{Elsewhere, OpenRun};
use safetensors::SafeTensors;
use safetensors::tensor::TensorView;
use std::collections::BTreeMap;
use std::path::PathBuf;

fn golden(name: &str) -> Vec<u8> {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("{name}.safetensors"));
    std::fs::read(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

/// The run of a checkpoint, on a scene it was not trained on, with images at times 0, 0.1, … 1.
fn opened(scene: Scene, dir: &tempfile::TempDir) -> OpenRun {
    let data = dir.path().join("data");
    write(&data, "balls", &SynthOptions::of_views(16, 11, 1), false).unwrap();
    let Scene { method, settings, tensors, bounds, .. } = scene;
    let origin = serde_json::json!({ "file": "golden" });
    let elsewhere = Elsewhere { method, settings, tensors, bounds, origin };
    let resolved = elsewhere.resolve(gs_methods::registry(), &data, &[]).unwrap();
    elsewhere.write(&dir.path().join("run"), false, &resolved).unwrap();
    OpenRun::open(gs_methods::registry(), &dir.path().join("run")).unwrap()
}

/// The splats that a code made at its `k`-th time.
fn expected(file: &SafeTensors<'_>, k: usize) -> Splats {
    let column = |name: &str| -> Option<Vec<f32>> {
        let view = file.tensor(&format!("{name}.{k}")).ok()?;
        Some(view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    };
    let threes = |name: &str| -> Vec<Vec3> {
        column(name).unwrap().as_chunks().0.iter().map(|v| Vec3::from_array(*v)).collect()
    };
    let color = match column("sh") {
        Some(coeffs) => Color::Sh { degree: 3, coeffs },
        None => Color::Rgb(column("colors").unwrap().as_chunks().0.to_vec()),
    };
    Splats {
        means: threes("means"),
        quats: column("quats").unwrap().as_chunks().0.to_vec(),
        scales: threes("scales").into_iter().map(Vec3::abs).collect(),
        opacities: column("opacities").unwrap(),
        color,
        kernel: Kernel::Gaussian,
    }
}

fn flat(color: &Color) -> &[f32] {
    match color {
        Color::Sh { coeffs, .. } => coeffs,
        Color::Rgb(rows) => rows.as_flattened(),
    }
}

fn assert_near(what: &str, got: &[f32], want: &[f32], tolerance: f32) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (k, (g, w)) in got.iter().zip(want).enumerate() {
        assert!((g - w).abs() <= tolerance * (1.0 + w.abs()), "{what}, value {k}: {g} is not {w}");
    }
}

fn unit(quats: &[[f32; 4]]) -> Vec<f32> {
    let of = |q: &[f32; 4]| {
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        let largest = q.iter().copied().fold(0.0f32, |a, b| if b.abs() > a.abs() { b } else { a });
        q.map(|v| v / length * largest.signum())
    };
    quats.iter().flat_map(of).collect()
}

fn assert_same(name: &str, got: &Splats, want: &Splats, camera: &Camera, decoded: f32) {
    let flat3 = |v: &[Vec3]| v.iter().flat_map(|v| v.to_array()).collect::<Vec<f32>>();
    assert_near(&format!("{name}: means"), &flat3(&got.means), &flat3(&want.means), 1e-5);
    let scales: Vec<Vec3> = got.scales.iter().map(|s| s.abs()).collect();
    assert_near(&format!("{name}: scales"), &flat3(&scales), &flat3(&want.scales), 1e-5);
    assert_near(&format!("{name}: quats"), &unit(&got.quats), &unit(&want.quats), 1e-5);
    assert_near(&format!("{name}: opacities"), &got.opacities, &want.opacities, decoded);
    assert_near(&format!("{name}: colours"), flat(&got.color), flat(&want.color), decoded);
    let (options, mut workspace) = (RasterOptions::default(), Workspace::new());
    let image = render(got, camera, &options, &mut workspace).rgb.data.clone();
    let theirs = &render(want, camera, &options, &mut workspace).rgb.data;
    let worst = image.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let seen = image.iter().any(|v| *v > 0.1);
    assert!(worst <= 1e-4 && seen, "{name}: the renderings differ by {worst}");
    println!("{name}: {} splats, renderings differ by {worst:.1e} at most", got.len());
}

fn camera(eye: DVec3) -> Camera {
    Camera::look_at(96, 80, 0.9, eye, DVec3::ZERO, DVec3::Y).unwrap()
}

/// The clouds of a code at all of its times.
fn assert_moves(name: &str) {
    assert_scene_moves(name, Scene::read(&golden(name)).unwrap());
}

fn assert_scene_moves(name: &str, scene: Scene) {
    let dir = tempfile::tempdir().unwrap();
    let run = opened(scene, &dir);
    let bytes = golden(&format!("{name}.expected"));
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let camera = camera(DVec3::new(0.5, -0.7, -5.0));
    for (k, t) in [0.0, 0.37, 1.0].into_iter().enumerate() {
        let got = run.loaded.model.splats(&Timestamp::normalised(t), &camera).unwrap();
        assert_same(&format!("{name} at {t}"), &got, &expected(&file, k), &camera, 1e-6);
    }
    let moved = |k| expected(&file, k).means;
    assert!(moved(0).iter().zip(&moved(1)).any(|(a, b)| a.distance(*b) > 0.05), "{name}: something moves");
}

#[test]
fn four_d_gaussians() {
    assert_moves("4dgaussians");
}

#[test]
fn deformable_3d_gs_of_generated_scenes_and_of_captures() {
    assert_moves("deformable-blender");
    assert_moves("deformable");
}

#[test]
fn grid4d() {
    assert_moves("grid4d");
}

#[test]
fn trace_before_the_field_ends_and_after() {
    let mut scene = Scene::read(&golden("trace")).unwrap();
    assert!(scene.notes[0].contains("ends at time 0.6 and its steps are 1/15"), "{:?}", scene.notes);
    // The same in intervals of a tenth, before the last image at time 1.
    let intervals = [("physics.back_frames", 4.0), ("physics.step_frames", 2.0 / 3.0)];
    scene.settings.extend(intervals.map(|(key, value)| (key.to_owned(), toml::Value::Float(value))));
    assert_scene_moves("trace", scene);
}

#[test]
fn scaffold_gs() {
    for name in ["scaffold", "scaffold-bank"] {
        let dir = tempfile::tempdir().unwrap();
        let scene = Scene::read(&golden(name)).unwrap();
        assert_eq!(scene.notes.len(), usize::from(name == "scaffold-bank"), "{:?}", scene.notes);
        let run = opened(scene, &dir);
        let bytes = golden(&format!("{name}.expected"));
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let eye: Vec<f32> =
            file.tensor("eye").unwrap().data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let camera = camera(Vec3::from_slice(&eye).as_dvec3());
        // What the camera cannot see is not decoded, so all is asked for.
        let got = run.loaded.model.all_splats(&Timestamp::normalised(0.0), &camera).unwrap();
        let seen: Vec<usize> = (0..got.len()).filter(|&k| got.opacities[k] > 0.0).collect();
        let Color::Rgb(colors) = &got.color else { panic!("anchors decode to colours") };
        let got = Splats {
            means: seen.iter().map(|&k| got.means[k]).collect(),
            quats: seen.iter().map(|&k| got.quats[k]).collect(),
            scales: seen.iter().map(|&k| got.scales[k]).collect(),
            opacities: seen.iter().map(|&k| got.opacities[k]).collect(),
            color: Color::Rgb(seen.iter().map(|&k| colors[k]).collect()),
            kernel: Kernel::Gaussian,
        };
        assert_same(name, &got, &expected(&file, 0), &camera, 1e-5);
    }
}

/// The golden file with other settings, without some tensors, or with other metadata.
fn altered(name: &str, drop: &str, change: impl Fn(&mut BTreeMap<String, String>)) -> Vec<u8> {
    let bytes = golden(name);
    let (_, metadata) = SafeTensors::read_metadata(&bytes).unwrap();
    let mut about: BTreeMap<String, String> = metadata.metadata().clone().into_iter().flatten().collect();
    change(&mut about);
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let kept: Vec<(&str, TensorView<'_>)> = file.iter().filter(|(name, _)| *name != drop).collect();
    safetensors::serialize(kept, Some(about.into_iter().collect())).unwrap()
}

fn error(bytes: &[u8]) -> CheckpointError {
    Scene::read(bytes).unwrap_err()
}

#[test]
fn what_gs4d_does_not_have_is_refused_by_name() {
    let with = |name: &str, from: &str, to: &str| {
        altered(name, "", |about| {
            let args = about.get_mut("args").unwrap();
            assert!(args.contains(from), "{args}");
            *args = args.replace(from, to);
        })
    };
    for (name, from, to, said) in [
        ("4dgaussians", "\"no_dshs\": true", "\"no_dshs\": false", "colour that changes with time"),
        ("4dgaussians", "\"no_do\": true", "\"no_do\": false", "opacity that changes with time"),
        ("4dgaussians", "\"apply_rotation\": false", "\"apply_rotation\": true", "the product of quaternions"),
        ("deformable", "\"is_6dof\": false", "\"is_6dof\": true", "the screw motion"),
        ("grid4d", "\"scale_xyz\": 1.0", "\"scale_xyz\": [1.0, 1.0, 2.0]", "a cube of unequal sides"),
        ("grid4d", "\"deform_level_dim\": 2", "\"deform_level_dim\": 4", "4 features a level"),
        ("trace", "\"freegave\": false", "\"freegave\": true", "motion by patterns"),
    ] {
        let error = error(&with(name, from, to)).to_string();
        assert!(error.contains(said) && error.contains("no counterpart"), "{error}");
    }
    // Switches that earlier versions do not have.
    for (name, from) in [
        ("4dgaussians", "\"static_mlp\": false, "),
        ("4dgaussians", "\"grid_pe\": 0, "),
        ("deformable", ", \"is_6dof\": false"),
    ] {
        assert!(Scene::read(&with(name, from, "")).is_ok(), "{name}: {from}");
    }
    assert_eq!(error(&with("4dgaussians", "\"no_do\": true, ", "")), CheckpointError::Setting("no_do"));
    // A table that the file does not hold is not made.
    let larger = with("grid4d", "\"canonical_log2_hashmap_size\": 9", "\"canonical_log2_hashmap_size\": 27");
    assert!(matches!(error(&larger), CheckpointError::Shape { .. }));
    let longer = with("grid4d", "\"canonical_num_levels\": 5", "\"canonical_num_levels\": 6");
    assert!(matches!(error(&longer), CheckpointError::Shape { .. }));
    assert_eq!(error(&with("scaffold", "\"use_feat_bank\"", "\"other\"")), CheckpointError::Setting("use_feat_bank"));
}

#[test]
fn files_that_are_no_exported_checkpoints_are_refused() {
    assert!(matches!(error(b"something else"), CheckpointError::Format(_)));
    let same = |_: &mut BTreeMap<String, String>| {};
    let bare = altered("deformable", "", |about| about.clear());
    assert_eq!(error(&bare), CheckpointError::NotExported("args"));
    let other = altered("deformable", "", |about| drop(about.insert("code".into(), "SC-GS".into())));
    assert_eq!(error(&other), CheckpointError::Code("SC-GS".into()));
    for (name, tensor) in [
        ("deformable", "deform.gaussian_warp.bias"),
        ("4dgaussians", "deformation.deformation_net.grid.aabb"),
        ("grid4d", "grid4d.yzt_encoding.offsets"),
        ("scaffold", "cov_mlp.2.weight"),
        ("trace", "vel.vel_net.weight_net.0.bias"),
        ("4dgaussians", "ply.opacity"),
        ("grid4d", "ply.x"),
    ] {
        assert_eq!(error(&altered(name, tensor, same)), CheckpointError::Missing(tensor.into()));
    }
    assert!(matches!(error(&altered("deformable", "ply.f_rest_44", same)), CheckpointError::Shape { .. }));
}

/// Whatever is cut away or changed gives an error or a scene, never a panic.
#[test]
fn damaged_files_do_not_panic() {
    for name in ["4dgaussians", "deformable-blender", "grid4d", "scaffold-bank", "trace"] {
        let bytes = golden(name);
        let head = bytes.len().min(9000);
        for k in (0..head).step_by(7) {
            let mut other = bytes.clone();
            other[k] ^= 0x11;
            drop(Scene::read(&other));
            drop(Scene::read(&bytes[..k]));
        }
        let file = SafeTensors::deserialize(&bytes).unwrap();
        for (tensor, view) in file.iter() {
            drop(Scene::read(&altered(name, tensor, |_| {})));
            // Other values of the same shape.
            let at = view.data().as_ptr() as usize - bytes.as_ptr() as usize;
            for value in [f32::NAN, f32::INFINITY, -1e30, 1e9] {
                let mut other = bytes.clone();
                other[at..at + view.data().len()]
                    .chunks_exact_mut(4)
                    .for_each(|b| b.copy_from_slice(&value.to_le_bytes()));
                drop(Scene::read(&other));
            }
        }
    }
}
