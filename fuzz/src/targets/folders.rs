//! Small data folders for layouts that gs4d has no writer of, and the way all folders are opened.

use super::{Error, images};
use crate::case::Case;
use glam::{DMat3, DQuat, DVec3};
use gs_core::Camera;
use gs_data::{DataOptions, Dataset};
use serde_json::{Value, json};
use std::path::Path;

pub const WIDTH: u32 = 10;
pub const HEIGHT: u32 = 8;

/// Opens a folder with the files of an input in it.
pub fn open(case: &Case, dir: &Path, layout: &str) -> Result<Dataset, String> {
    case.write(dir).map_err(|e| format!("the work folder: {e}"))?;
    let options = DataOptions { layout: Some(layout.into()), ..DataOptions::default() };
    let data = Dataset::open(dir, &options).map_err(|e| e.to_string())?;
    for v in data.train.iter().chain(&data.val).chain(&data.test).chain(&data.extrapolate) {
        v.camera.check().expect("a valid camera");
        assert!(v.time.normalised.is_finite(), "{}: time {:?}", v.name, v.time);
    }
    let points = data.points.iter().flat_map(|p| &p.positions);
    assert!(points.clone().all(|p| p.is_finite()), "a point that is not finite");
    Ok(data)
}

/// Cameras around the origin.
pub fn cameras(n: usize) -> Result<Vec<Camera>, Error> {
    let eye = |k: usize| DVec3::new(3.0 * (k as f64).cos(), 3.0 * (k as f64).sin(), 1.0);
    Ok((0..n).map(|k| Camera::look_at(WIDTH, HEIGHT, 0.8, eye(k), DVec3::ZERO, DVec3::Z)).collect::<Result<_, _>>()?)
}

/// Camera to world with OpenGL axes.
pub fn opengl(c: &Camera) -> Value {
    let r = c.rotation.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let p = c.position();
    let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], p[i]];
    json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
}

/// World to camera with OpenCV axes.
fn opencv(c: &Camera) -> Value {
    let (r, t) = (c.rotation, c.translation);
    let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]];
    json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
}

/// Rotation `w x y z` and translation, world to camera.
fn pose(c: &Camera) -> [f64; 7] {
    let (q, t) = (DQuat::from_mat3(&c.rotation), c.translation);
    [q.w, q.x, q.y, q.z, t.x, t.y, t.z]
}

/// Writes a PNG.
pub fn put_png(dir: &Path, name: &str, channels: usize) -> Result<(), Error> {
    let bytes = images::png(WIDTH as usize, HEIGHT as usize, channels)?;
    Ok(Case::one(name, bytes).write(dir)?)
}

/// Nested and flat files of NVFi.
pub fn nvfi(dir: &Path) -> Result<Vec<Case>, Error> {
    let cameras = cameras(3)?;
    let frame = |k: usize, t: usize| json!({"file_path": format!("./c{k}_{t}"), "time": t as f64 / 4.0});
    for (k, t) in (0..3).flat_map(|k| (0..4).map(move |t| (k, t))) {
        put_png(dir, &format!("c{k}_{t}.png"), 4)?;
    }
    let nested = |ks: &[usize], ts: &[usize]| {
        let of = |k: usize| ts.iter().map(|&t| frame(k, t)).collect::<Value>();
        let camera =
            |&k: &usize| (format!("cam_{k}"), json!({"transform_matrix": opengl(&cameras[k]), "frames": of(k)}));
        json!({"camera_angle_x": 0.8, "data": ks.iter().map(camera).collect::<serde_json::Map<_, _>>()}).to_string()
    };
    let flat = |ks: &[usize], ts: &[usize]| {
        let both = ks.iter().flat_map(|&k| ts.iter().map(move |&t| (k, t)));
        let posed = both.map(|(k, t)| {
            let mut f = frame(k, t);
            f["transform_matrix"] = opengl(&cameras[k]);
            f
        });
        json!({"camera_angle_x": 0.8, "frames": posed.collect::<Value>()}).to_string()
    };
    let splits = |form: &dyn Fn(&[usize], &[usize]) -> String| {
        Case::one("transforms_train.json", form(&[0, 1], &[0, 1, 2]))
            .with("transforms_val.json", form(&[2], &[0, 1, 2]))
            .with("transforms_test.json", form(&[0, 1, 2], &[3]))
    };
    Ok(vec![splits(&nested), splits(&flat)])
}

/// `transforms.json` of nerfstudio with lens, masks, times and points.
pub fn nerfstudio(dir: &Path) -> Result<Vec<Case>, Error> {
    let cameras = cameras(4)?;
    let mut frames = Vec::new();
    for (k, c) in cameras.iter().enumerate() {
        put_png(dir, &format!("images/f{k}.png"), 3)?;
        put_png(dir, &format!("masks/f{k}.png"), 1)?;
        let (image, mask) = (format!("images/f{k}.png"), format!("masks/f{k}.png"));
        let time = k as f64 / 3.0;
        frames.push(json!({"file_path": image, "mask_path": mask, "time": time, "transform_matrix": opengl(c)}));
    }
    let c = &cameras[0];
    let text = json!({
        "camera_model": "OPENCV", "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "w": WIDTH, "h": HEIGHT,
        "k1": 0.01, "k2": 0.0, "p1": 0.0, "p2": 0.001, "ply_file_path": "points.ply", "frames": frames,
    });
    let points = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n0 1 2 3 4 5\n";
    Ok(vec![Case::one("transforms.json", text.to_string()).with("points.ply", points)])
}

/// A PNG with its mask, and a JPEG, of a nerfstudio folder.
pub fn images_and_masks(dir: &Path) -> Result<Vec<Case>, Error> {
    let text = nerfstudio(dir)?.swap_remove(0);
    let text = String::from_utf8_lossy(text.first()).replace("images/f1.png", "images/f1.jpg");
    Case::one("transforms.json", text).with("points.ply", "").write(dir)?;
    Case::one("images/f1.jpg", images::jpeg(WIDTH, HEIGHT)?).write(dir)?;
    let text = std::fs::read_to_string(dir.join("transforms.json"))?.replace("\"ply_file_path\":\"points.ply\",", "");
    std::fs::write(dir.join("transforms.json"), text)?;
    Ok(vec![Case::of_folder(dir, &["images/f0.png", "masks/f0.png", "images/f1.jpg"])?])
}

fn colmap_images(dir: &Path) -> Result<Vec<Camera>, Error> {
    (0..4).try_for_each(|k| put_png(dir, &format!("images/f{k}.png"), 3))?;
    cameras(4)
}

/// A COLMAP model as text.
pub fn colmap_text(dir: &Path) -> Result<Vec<Case>, Error> {
    let cameras = colmap_images(dir)?;
    let c = &cameras[0];
    let lens = format!("# c\n1 OPENCV {WIDTH} {HEIGHT} {} {} {} {} 0.1 0.2 0.01 0.02\n", c.fx, c.fy, c.cx, c.cy);
    let mut views = String::from("# c\n");
    for (k, c) in cameras.iter().enumerate() {
        let pose = pose(c).map(|v| v.to_string()).join(" ");
        let observed = if k % 2 == 0 { "1.5 2.5 7 3.0 4.0 -1" } else { "" };
        views += &format!("{} {pose} 1 f{k}.png\n{observed}\n", k + 1);
    }
    let points = "# c\n1 0.1 0.2 0.3 255 0 51 0.5 1 2 3 4\n2 -1 -2 -3 0 0 0 0.1\n";
    let of = |lens: &str| {
        Case::one("sparse/0/cameras.txt", lens)
            .with("sparse/0/images.txt", views.as_str())
            .with("sparse/0/points3D.txt", points)
    };
    Ok(vec![of(&lens), of(&format!("1 SIMPLE_PINHOLE {WIDTH} {HEIGHT} 9 5 4\n"))])
}

/// The same in binary.
pub fn colmap_binary(dir: &Path) -> Result<Vec<Case>, Error> {
    let cameras = colmap_images(dir)?;
    let c = &cameras[0];
    let floats = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let longs = |values: &[u64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let ints = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let pinhole = floats(&[c.fx, c.fy, c.cx, c.cy]);
    let lens = [longs(&[1]), ints(&[1, 1]), longs(&[WIDTH.into(), HEIGHT.into()]), pinhole].concat();
    let mut views = longs(&[cameras.len() as u64]);
    for (k, c) in cameras.iter().enumerate() {
        let name = format!("f{k}.png\0").into_bytes();
        views.extend([ints(&[k as u32 + 1]), floats(&pose(c)), ints(&[1]), name, longs(&[1, 0, 0, 0])].concat());
    }
    let mut points = longs(&[2]);
    for p in [[0.1, 0.2, 0.3], [-1.0, -2.0, -3.0]] {
        points.extend([longs(&[9]), floats(&p), vec![255, 0, 51], floats(&[0.5]), longs(&[1, 0])].concat());
    }
    let case = Case::one("sparse/0/cameras.bin", lens).with("sparse/0/images.bin", views);
    Ok(vec![case.with("sparse/0/points3D.bin", points)])
}

/// `poses_bounds.npy` of LLFF, a rig of two cameras with two frames each.
pub fn llff(dir: &Path) -> Result<Vec<Case>, Error> {
    let mut values = Vec::new();
    for (k, c) in cameras(2)?.iter().enumerate() {
        (0..2).try_for_each(|t| put_png(dir, &format!("cam{k:02}/images/{t:04}.png"), 3))?;
        let axes = c.rotation.transpose();
        let size = DVec3::new(HEIGHT.into(), WIDTH.into(), c.fx);
        let columns = [axes.y_axis, axes.x_axis, -axes.z_axis, c.position(), size];
        values.extend((0..15).map(|i| columns[i % 5][i / 5]).chain([1.0, 8.0]));
    }
    let head = format!("{:<117}\n", "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 17), }");
    let mut npy = [&b"\x93NUMPY\x01\x00"[..], &118u16.to_le_bytes(), head.as_bytes()].concat();
    npy.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    Ok(vec![Case::one("poses_bounds.npy", npy)])
}

/// The lists of cameras of a PanopticSports clip.
pub fn panoptic(dir: &Path) -> Result<Vec<Case>, Error> {
    let cameras = cameras(3)?;
    for (k, t) in (0..3).flat_map(|k| (0..2).map(move |t| (k, t))) {
        Case::one(&format!("ims/{k}/{t:06}.jpg"), images::jpeg(WIDTH, HEIGHT)?).write(dir)?;
        put_png(dir, &format!("seg/{k}/{t:06}.png"), 1)?;
    }
    let meta = |ks: &[usize]| {
        let table = |cell: &dyn Fn(usize, usize) -> Value| -> Value {
            (0..2).map(|t| ks.iter().map(|&k| cell(t, k)).collect::<Value>()).collect()
        };
        let c = &cameras[0];
        let k = json!([[c.fx, 0.1, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]]);
        json!({
            "w": WIDTH, "h": HEIGHT, "k": table(&|_, _| k.clone()), "w2c": table(&|_, k| opencv(&cameras[k])),
            "fn": table(&|t, k| json!(format!("{k}/{t:06}.jpg"))), "cam_id": table(&|_, k| json!(k)),
        })
        .to_string()
    };
    Ok(vec![Case::one("train_meta.json", meta(&[0, 1])).with("test_meta.json", meta(&[2]))])
}
