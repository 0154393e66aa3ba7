//! Cameras of a rig from OpenCV's YAML and from a COLMAP model, against those of a film whose files they replace.

use glam::{DMat3, DQuat};
use gs_data::avatar::layout::Role;
use gs_data::avatar::rig::{RigOptions, write_rig};
use gs_data::{DataOptions, Dataset, View};
use gs_synth::avatar::{AvatarOptions, write};
use std::fmt::Write;
use std::path::Path;
use tempfile::TempDir;

const UNIT: f64 = 1e-3;

fn options() -> RigOptions {
    RigOptions { unit: UNIT, conditioning: vec![0, 2, 4, 6], held_out: vec![1, 3, 5, 7], overwrite: true }
}

/// A film on disk, and as it is read.
fn film() -> (TempDir, Dataset) {
    let dir = tempfile::tempdir().unwrap();
    let film = AvatarOptions { per_ring: 8, rings: 2, frames: 2, size: 40, points: 400, ..AvatarOptions::default() };
    write(dir.path(), &film, false, false).unwrap();
    let data = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
    (dir, data)
}

/// One view of each camera, by its number.
fn cameras(data: &Dataset) -> Vec<&View> {
    let mut views: Vec<&View> = data.train.iter().chain(&data.test).filter(|v| v.time.normalised == 0.0).collect();
    views.sort_by_key(|v| v.camera_id);
    views
}

fn matrix(name: &str, rows: usize, values: &[f64]) -> String {
    let list = values.iter().map(|v| format!("{v:e}")).collect::<Vec<_>>().join(",\n       ");
    format!(
        "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {}\n   dt: d\n   data: [ {list} ]\n",
        values.len() / rows
    )
}

/// The cameras as EasyMocap writes them, in millimetres.
fn easymocap(dir: &Path, views: &[&View], rodrigues: bool) {
    let names = views
        .iter()
        .fold("%YAML:1.0\n---\nnames:\n".to_owned(), |s, v| s + &format!("   - \"cam{:02}\"\n", v.camera_id));
    let (mut intri, mut extri) = (names.clone(), names);
    for v in views {
        let (c, name) = (&v.camera, format!("cam{:02}", v.camera_id));
        intri += &matrix(&format!("K_{name}"), 3, &[c.fx, 0.0, c.cx - 0.5, 0.0, c.fy, c.cy - 0.5, 0.0, 0.0, 1.0]);
        intri += &matrix(&format!("dist_{name}"), 1, &[0.0; 5]);
        let turn = DQuat::from_mat3(&c.rotation).to_scaled_axis();
        extri += &match rodrigues {
            true => matrix(&format!("R_{name}"), 3, &turn.to_array()),
            false => matrix(&format!("Rot_{name}"), 3, &c.rotation.transpose().to_cols_array()),
        };
        extri += &matrix(&format!("T_{name}"), 3, &(c.translation / UNIT).to_array());
    }
    std::fs::write(dir.join("intri.yml"), intri).unwrap();
    std::fs::write(dir.join("extri.yml"), extri).unwrap();
}

fn same(dir: &Path, want: &Dataset, slack: f64) {
    let got = Dataset::open(dir, &DataOptions::default()).unwrap();
    let (want, got) = (cameras(want), cameras(&got));
    assert_eq!(want.len(), got.len());
    for (want, got) in want.into_iter().zip(got) {
        let (a, b) = (&want.camera, &got.camera);
        assert_eq!((want.camera_id, &want.name), (got.camera_id, &got.name));
        assert!(
            a.position().distance(b.position()) < slack && (a.fx - b.fx).abs() < slack && (a.cx - b.cx).abs() < slack
        );
        let turned = DQuat::from_mat3(&(a.rotation.transpose() * b.rotation)).to_scaled_axis().length();
        assert!(turned < slack, "{turned}");
    }
}

#[test]
fn calibrations_of_opencv_replace_the_cameras_of_a_film() {
    let (dir, data) = film();
    let rig = tempfile::tempdir().unwrap();
    for rodrigues in [false, true] {
        easymocap(rig.path(), &cameras(&data), rodrigues);
        let e = write_rig(dir.path(), rig.path(), &RigOptions { overwrite: false, ..options() }).unwrap_err();
        assert_eq!(e.code(), "io.exists");
        let written = write_rig(dir.path(), &rig.path().join("intri.yml"), &options()).unwrap();
        assert_eq!((written.len(), written[3].id, &*written[3].name, written[3].size), (16, 3, "cam03", [40, 40]));
        let held_out: Vec<u32> = written.iter().filter(|c| c.role == Role::Test).map(|c| c.id).collect();
        assert_eq!(held_out, [1, 3, 5, 7]);
        same(dir.path(), &data, 1e-9);
    }
    // Four cameras around the person, where none are named.
    let free = RigOptions { unit: UNIT, overwrite: true, ..RigOptions::default() };
    let written = write_rig(dir.path(), rig.path(), &free).unwrap();
    let chosen: Vec<_> = written.iter().filter(|c| c.role == Role::Cond).collect();
    assert_eq!((chosen.len(), chosen[0].id), (4, 0));
    for (i, a) in chosen.iter().enumerate() {
        assert!(chosen[..i].iter().all(|b| a.position.distance(b.position) > 3.0), "{chosen:?}");
    }
}

#[test]
fn a_colmap_model_of_the_rig_does_the_same() {
    let (dir, data) = film();
    let rig = tempfile::tempdir().unwrap();
    let (mut cameras_txt, mut images_txt) = (String::new(), String::new());
    for (k, v) in cameras(&data).iter().enumerate() {
        let (c, t) = (&v.camera, v.camera.translation / UNIT);
        let q = DQuat::from_mat3(&DMat3::from_cols_array(&c.rotation.to_cols_array()));
        writeln!(cameras_txt, "{} PINHOLE {} {} {} {} {} {}", k + 1, c.width, c.height, c.fx, c.fy, c.cx, c.cy)
            .unwrap();
        let name = format!("take/cam_{:03}.png", v.camera_id);
        writeln!(images_txt, "{} {} {} {} {} {} {} {} {} {name}\n", k + 1, q.w, q.x, q.y, q.z, t.x, t.y, t.z, k + 1)
            .unwrap();
    }
    std::fs::create_dir_all(rig.path().join("sparse/0")).unwrap();
    std::fs::write(rig.path().join("sparse/0/cameras.txt"), cameras_txt).unwrap();
    std::fs::write(rig.path().join("sparse/0/images.txt"), images_txt).unwrap();
    write_rig(dir.path(), rig.path(), &options()).unwrap();
    same(dir.path(), &data, 1e-6);
}

#[test]
fn what_is_missing_is_named() {
    let (dir, data) = film();
    let rig = tempfile::tempdir().unwrap();
    easymocap(rig.path(), &cameras(&data), false);
    let fault = |options: &RigOptions| write_rig(dir.path(), rig.path(), options).unwrap_err();
    let unknown = RigOptions { held_out: vec![99], ..options() };
    assert!(fault(&unknown).to_string().contains("99"));
    let text = std::fs::read_to_string(rig.path().join("extri.yml")).unwrap();
    std::fs::write(rig.path().join("extri.yml"), text.replace("T_cam05", "U_cam05")).unwrap();
    let e = fault(&options());
    assert!(e.code() == "data.field" && e.to_string().contains("T_cam05"), "{e}");
    std::fs::remove_file(rig.path().join("extri.yml")).unwrap();
    assert!(fault(&options()).to_string().contains("extri.yml"));
    std::fs::remove_file(rig.path().join("intri.yml")).unwrap();
    assert_eq!(fault(&options()).code(), "data.layout");
    easymocap(rig.path(), &cameras(&data), false);
    std::fs::remove_dir_all(dir.path().join("images/004")).unwrap();
    assert!(fault(&options()).to_string().contains("images/004"));
}
