//! The data set as files: `transforms.json` and `points.ply`, in nerfstudio's layout.
//!
//! `transforms.json` comes last: a folder with it is whole.

use crate::error::ImportError;
use crate::poses::Posed;
use glam::DVec3;
use gs_core::io::write_file;
use gs_data::{PointCloud, ply};
use serde_json::{Map, Value, json};
use std::path::Path;

/// A frame of the data set.
pub(crate) struct Frame {
    /// Path of the image from the data set.
    pub(crate) file: String,
    pub(crate) mask: Option<String>,
    /// Seconds; none of unordered images.
    pub(crate) time: Option<f64>,
    /// Number of its camera, where there are several.
    pub(crate) camera: Option<usize>,
    pub(crate) posed: Posed,
}

impl Frame {
    fn json(&self) -> Value {
        let Posed { camera: c, lens } = &self.posed;
        // Camera to world, OpenGL axes: y up, looking along −z.
        let axes = c.rotation.transpose();
        let centre = c.position();
        let row = |k: usize| json!([axes.x_axis[k], -axes.y_axis[k], -axes.z_axis[k], centre[k]]);
        let mut frame = Map::new();
        let mut put = |key: &str, value: Value| {
            frame.insert(key.to_owned(), value);
        };
        put("file_path", json!(self.file));
        put("transform_matrix", json!([row(0), row(1), row(2), json!([0.0, 0.0, 0.0, 1.0])]));
        self.time.into_iter().for_each(|t| put("time", json!(t)));
        self.camera.into_iter().for_each(|k| put("camera_index", json!(k)));
        self.mask.iter().for_each(|m| put("mask_path", json!(m)));
        let intrinsics = [("fl_x", c.fx), ("fl_y", c.fy), ("cx", c.cx), ("cy", c.cy)];
        let sides = [("w", c.width), ("h", c.height)].map(|(key, side)| (key, f64::from(side)));
        let rest = if lens.fisheye { [("k3", lens.k3), ("k4", lens.k4)] } else { [("p1", lens.p1), ("p2", lens.p2)] };
        let distortion = [("k1", lens.k1), ("k2", lens.k2)].into_iter().chain(rest);
        intrinsics.into_iter().chain(sides).chain(distortion).for_each(|(key, value)| put(key, json!(value)));
        Value::Object(frame)
    }
}

/// Writes the two files. `held_out` is the camera whose frames are for tests.
pub(crate) fn write(
    data: &Path,
    frames: &[Frame],
    points: &PointCloud,
    held_out: Option<usize>,
) -> Result<(), ImportError> {
    write_file(&data.join("points.ply"), true, |out| ply::write_points(points, out))?;
    let mut top = json!({
        "camera_model": if frames.iter().any(|f| f.posed.lens.fisheye) { "OPENCV_FISHEYE" } else { "OPENCV" },
        "ply_file_path": "points.ply",
        "frames": frames.iter().map(Frame::json).collect::<Vec<_>>(),
    });
    if held_out.is_some() {
        let (test, train): (Vec<&Frame>, Vec<&Frame>) = frames.iter().partition(|f| f.camera == held_out);
        let names = |list: Vec<&Frame>| list.iter().map(|f| f.file.clone()).collect::<Vec<_>>();
        top["train_filenames"] = json!(names(train));
        top["test_filenames"] = json!(names(test));
    }
    let content = |out: &mut dyn std::io::Write| {
        serde_json::to_writer_pretty(&mut *out, &top)?;
        out.write_all(b"\n")
    };
    Ok(write_file(&data.join("transforms.json"), true, content)?)
}

/// The points of a model in another world.
pub(crate) fn moved(points: &PointCloud, change: &crate::poses::Similarity) -> PointCloud {
    let positions = points.positions.iter().map(|p| change.point(DVec3::from(*p)).as_vec3()).collect();
    PointCloud { positions, colors: points.colors.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Camera;
    use gs_data::{DataOptions, Dataset, Lens};

    #[test]
    fn what_is_written_is_what_a_reader_gets() {
        let dir = tempfile::tempdir().unwrap();
        let frame = |k: usize| {
            let eye = DVec3::new(3.0 + k as f64, -1.0, 2.0);
            let camera = Camera::look_at(16, 12, 0.9, eye, DVec3::ZERO, DVec3::Z).unwrap();
            let file = format!("images/cam{:02}/0000{}.png", k / 3, k % 3);
            std::fs::create_dir_all(dir.path().join(&file).parent().unwrap()).unwrap();
            image::GrayImage::new(16, 12).save(dir.path().join(&file)).unwrap();
            let lens = Lens { k1: -0.05, p2: 0.001, ..Lens::default() };
            Frame {
                file,
                mask: None,
                time: Some(0.2 * (k % 3) as f64),
                camera: Some(k / 3),
                posed: Posed { camera, lens },
            }
        };
        let mut frames: Vec<Frame> = (0..6).map(frame).collect();
        let points = PointCloud { positions: vec![glam::Vec3::ONE], colors: vec![[1.0, 0.0, 0.0]] };
        write(dir.path(), &frames, &points, Some(1)).unwrap();
        let data = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
        assert_eq!((data.layout, data.train.len(), data.test.len()), ("nerfstudio", 3, 3));
        let view = &data.train[2];
        assert!((view.time.seconds - 0.4).abs() < 1e-9 && view.camera_id == 0 && data.test[0].camera_id == 1);
        let truth = frames[2].posed.clone();
        assert!(view.camera.position().distance(truth.camera.position()) < 1e-9);
        let ahead = DVec3::new(0.1, 0.2, 0.3);
        let [a, b] = [&view.camera, &truth.camera].map(|c| c.to_pixel(c.to_camera(ahead)));
        assert!(a.distance(b) < 1e-9 && view.lens == Some(truth.lens));
        let fisheye = Lens { fisheye: true, k1: -0.05, k3: 0.01, k4: 0.002, ..Lens::default() };
        frames.iter_mut().for_each(|f| f.posed.lens = fisheye);
        write(dir.path(), &frames, &points, None).unwrap();
        let read = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
        assert!(read.train.iter().all(|v| v.lens == Some(fisheye)));
        assert_eq!(data.points.unwrap(), points);
    }
}
