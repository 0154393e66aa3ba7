//! Cameras as JSON, in three layouts that are recognised by their fields:
//!
//! * **INRIA `cameras.json`** (Kerbl et al. 2023): a list of `{id, img_name, width, height, position, rotation, fx, fy}`;
//!   `position` is the camera centre, `rotation` the rows of the camera→world rotation, OpenCV axes. The principal point
//!   is the image centre unless `cx`, `cy` say otherwise.
//! * **gs4d**: an object or a list of `{width, height, fx, fy, cx, cy, world_to_camera[, name, time]}` with a 4×4
//!   row-major matrix, OpenCV axes. Where an entry has both, `world_to_camera` is used.
//! * **transforms** (nerfstudio, instant-ngp, Blender): an object with `frames`, each with `transform_matrix`
//!   (camera→world, OpenGL axes: y up, z backward) and perhaps `time`; intrinsics for all frames or per frame: `w`, `h`,
//!   and `fl_x`, `fl_y`, `cx`, `cy` or `camera_angle_x` (full horizontal angle, radians; `fx = w / (2 tan(angle/2))`).
//!   Where `w` and `h` are missing (D-NeRF), [`load_cameras`] takes the size of the frame's image beside the file
//!   (feature `images`); [`parse_cameras`] opens nothing and asks for them.
//!
//! Distortion coefficients other than zero, and fisheye models, are refused: [`Camera`] is a pinhole.
//!
//! ```
//! use gs_core::io::{Limits, parse_cameras};
//!
//! let json = br#"{"w": 8, "h": 4, "camera_angle_x": 1.5707963267948966, "frames": [{"file_path": "r_0", "time": 0.5,
//!     "transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]}]}"#;
//! let frame = &parse_cameras(json, "transforms.json", &Limits::default())?[0];
//! assert_eq!((frame.name.as_str(), frame.time), ("r_0", Some(0.5)));
//! assert!((frame.camera.fx - 4.0).abs() < 1e-12); // w / (2 tan 45°)
//! assert_eq!(frame.camera.forward(), glam::DVec3::NEG_Z); // OpenGL cameras look along −z
//! # Ok::<(), gs_core::io::IoError>(())
//! ```

use super::camera_json::{Context, Record};
use super::error::{At, Source};
use super::{IoError, Limits, read_file, write_file};
use crate::camera::Camera;
use glam::{DMat3, DVec3};
use serde_json::json;
use std::io::Write;
use std::path::Path;

/// A camera with its name and its timestamp from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Name of the entry: image name or relative path, as in the file; the index where it has none.
    pub name: String,
    /// The camera, valid by [`Camera::check`].
    pub camera: Camera,
    /// Timestamp as in the file, if any.
    pub time: Option<f32>,
}

/// A lower bound of the text length of a frame with a matrix.
const MIN_FRAME_TEXT: usize = 48;

/// Reads the cameras of a JSON file of any of the three layouts, in file order.
///
/// # Errors
/// As [`read_file`] and [`parse_cameras`].
pub fn load_cameras(path: &Path, limits: &Limits) -> Result<Vec<NamedCamera>, IoError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    parse(&read_file(path, limits)?, &path.display().to_string(), limits, &|name| size_of_image(folder, name, limits))
}

/// Size of the image `name` (with or without extension) inside `folder`, if it exists and is readable.
#[cfg(feature = "images")]
fn size_of_image(folder: &Path, name: &str, limits: &Limits) -> Option<(u32, u32)> {
    use std::path::Component;
    let inside = Path::new(name).components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    let candidates = ["", ".png", ".jpg", ".jpeg"].map(|ending| folder.join(format!("{name}{ending}")));
    let file = candidates.into_iter().find(|f| inside && f.is_file())?;
    super::images::image_size(&read_file(&file, limits).ok()?, name, limits).ok()
}

/// Without an image reader no size is known.
#[cfg(not(feature = "images"))]
fn size_of_image(_: &Path, _: &str, _: &Limits) -> Option<(u32, u32)> {
    None
}

/// Size of a frame's image by the frame's name, where it is known.
type SizeOf<'a> = &'a dyn Fn(&str) -> Option<(u32, u32)>;

/// Reads cameras from JSON text. `file` is the name used in errors.
///
/// # Errors
/// Not JSON, a missing field, a value out of its domain: each with entry index and field.
pub fn parse_cameras(text: &[u8], file: &str, limits: &Limits) -> Result<Vec<NamedCamera>, IoError> {
    parse(text, file, limits, &|_| None)
}

fn parse(text: &[u8], file: &str, limits: &Limits, size_of: SizeOf) -> Result<Vec<NamedCamera>, IoError> {
    let src = Source { file, format: "camera JSON" };
    let text = text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text);
    let mut out: Vec<NamedCamera> = Vec::new();
    let mut shared = None;
    let context = Context::new(src);
    context.parse(text, false, &mut |index, record| {
        limits.rows(src, index as u64 + 1)?;
        if record.frames.is_some() {
            shared = Some(record);
        } else {
            out.push(camera_of(index, record, src)?);
        }
        Ok(())
    })?;
    if let Some(shared) = shared {
        if !out.is_empty() {
            let at = At::Entry { index: out.len(), field: "frames".into(), text: (0, 0) };
            return Err(src.malformed(at, "a transforms object inside a list of cameras", "give one layout per file"));
        }
        // Bounded by the text, so a list of empty objects reserves little.
        let frames = limits.rows(src, shared.frames.unwrap_or(0) as u64)?;
        out.reserve_exact(frames.min(text.len() / MIN_FRAME_TEXT));
        let context = Context::new(src);
        context.parse(text, true, &mut |index, frame| {
            out.push(frame_of(index, frame, &shared, src, size_of)?);
            Ok(())
        })?;
    }
    if out.is_empty() {
        let at = At::Entry { index: 0, field: Box::default(), text: (0, 0) };
        return Err(src.missing(at, "cameras", "the file holds no camera; add one"));
    }
    Ok(out)
}

/// A missing-field error for an entry.
fn missing(index: usize, field: &'static str, advice: &'static str, src: Source<'_>) -> IoError {
    let at = At::Entry { index, field: Box::default(), text: (0, 0) };
    src.missing(at, field, advice)
}

/// An image side: a whole number of pixels.
fn side(index: usize, field: &'static str, value: Option<f64>, src: Source<'_>) -> Result<u32, IoError> {
    let value = value
        .ok_or_else(|| missing(index, field, "add the size in pixels, or keep the images beside the file", src))?;
    if value.fract() != 0.0 || !(1.0..=f64::from(crate::camera::MAX_SIDE)).contains(&value) {
        return Err(src.value(index, field, value, "a whole number of pixels from 1 to 32768"));
    }
    Ok(value as u32)
}

/// The camera of a checked entry.
fn finish(
    index: usize,
    name: Option<String>,
    camera: Camera,
    time: Option<f64>,
    src: Source<'_>,
) -> Result<NamedCamera, IoError> {
    let name = name.unwrap_or_else(|| index.to_string());
    if let Err(source) = camera.check() {
        return Err(IoError::Camera { file: src.file.into(), index, name, source });
    }
    let time = time.map(|t| t as f32);
    if let Some(t) = time.filter(|t| !t.is_finite()) {
        return Err(src.value(index, "time", f64::from(t), "must be finite"));
    }
    Ok(NamedCamera { name, camera, time })
}

/// An entry of the INRIA or gs4d layout.
fn camera_of(index: usize, record: Record, src: Source<'_>) -> Result<NamedCamera, IoError> {
    refuse_distortion(index, &record, src)?;
    let need = |field| record.number(field).ok_or_else(|| missing(index, field, "add it to that entry", src));
    let width = side(index, "width", record.number("width"), src)?;
    let height = side(index, "height", record.number("height"), src)?;
    let (rotation, translation) = match (record.world_to_camera, record.position, record.rotation) {
        (Some(rows), _, _) => split(rows),
        (None, Some(position), Some(rows)) => {
            // c2w rows are the columns of the world→camera rotation.
            let rotation = DMat3::from_cols_array_2d(&rows);
            (rotation, -(rotation * DVec3::from_array(position)))
        }
        (None, None, _) => return Err(missing(index, "world_to_camera", "or give position and rotation", src)),
        (None, Some(_), None) => return Err(missing(index, "rotation", "add it to that entry", src)),
    };
    let camera = Camera {
        width,
        height,
        fx: need("fx")?,
        fy: need("fy")?,
        cx: record.number("cx").unwrap_or(0.5 * f64::from(width)),
        cy: record.number("cy").unwrap_or(0.5 * f64::from(height)),
        rotation,
        translation,
    };
    let time = record.number("time");
    finish(index, record.name, camera, time, src)
}

/// A frame of a transforms file; `shared` holds the fields for all frames.
fn frame_of(
    index: usize,
    frame: Record,
    shared: &Record,
    src: Source<'_>,
    size_of: SizeOf,
) -> Result<NamedCamera, IoError> {
    refuse_distortion(index, shared, src)?;
    refuse_distortion(index, &frame, src)?;
    let number = |field| frame.number(field).or_else(|| shared.number(field));
    let stated = number("w").zip(number("h"));
    let measured = || frame.name.as_deref().and_then(size_of).map(|(w, h)| (f64::from(w), f64::from(h)));
    let size = stated.or_else(measured);
    let width = side(index, "w", size.map(|s| s.0).or(number("w")), src)?;
    let height = side(index, "h", size.map(|s| s.1).or(number("h")), src)?;
    let Some(matrix) = frame.transform_matrix else {
        return Err(missing(index, "transform_matrix", "add it to that frame", src));
    };
    let focal = |length, angle, side: u32| {
        number(length).or_else(|| number(angle).map(|a: f64| 0.5 * f64::from(side) / (0.5 * a).tan()))
    };
    let Some(fx) = focal("fl_x", "camera_angle_x", width) else {
        return Err(missing(index, "fl_x", "add fl_x (pixels) or camera_angle_x (radians)", src));
    };
    let (c2w, center) = split(matrix);
    // OpenGL to OpenCV: the camera's y and z axes change sign.
    let c2w = DMat3::from_cols(c2w.x_axis, -c2w.y_axis, -c2w.z_axis);
    let rotation = c2w.transpose();
    let camera = Camera {
        width,
        height,
        fx,
        fy: focal("fl_y", "camera_angle_y", height).unwrap_or(fx),
        cx: number("cx").unwrap_or(0.5 * f64::from(width)),
        cy: number("cy").unwrap_or(0.5 * f64::from(height)),
        rotation,
        translation: -(rotation * center),
    };
    finish(index, frame.name.clone(), camera, number("time"), src)
}

/// Rotation and translation of a row-major 4×4 matrix.
fn split(rows: [[f64; 4]; 4]) -> (DMat3, DVec3) {
    let [[a, b, c, x], [d, e, f, y], [g, h, i, z], _] = rows;
    (DMat3::from_cols_array(&[a, d, g, b, e, h, c, f, i]), DVec3::new(x, y, z))
}

fn refuse_distortion(index: usize, record: &Record, src: Source<'_>) -> Result<(), IoError> {
    for field in ["k1", "k2", "k3", "k4", "p1", "p2"] {
        if let Some(value) = record.number(field).filter(|v| *v != 0.0) {
            let rule = "only pinhole cameras are supported: set it to 0 to ignore the distortion";
            return Err(src.value(index, field, value, rule));
        }
    }
    if record.is_fisheye {
        return Err(src.unsupported("a fisheye lens (`is_fisheye`)".to_owned(), "give PINHOLE cameras"));
    }
    match record.camera_model.as_deref() {
        None | Some("PINHOLE" | "SIMPLE_PINHOLE" | "OPENCV" | "SIMPLE_RADIAL" | "RADIAL") => Ok(()),
        Some(model) => {
            let model = super::ply_header::clip(model);
            Err(src.unsupported(format!("camera model `{model}`"), "give PINHOLE cameras"))
        }
    }
}

/// Writes cameras as an INRIA `cameras.json` whose entries also carry `cx`, `cy`, `world_to_camera` and `time`, so that
/// [`parse_cameras`] returns exactly what was written.
///
/// # Errors
/// The writer's own.
pub fn write_cameras(cameras: &[NamedCamera], out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "[")?;
    for (id, NamedCamera { name, camera, time }) in cameras.iter().enumerate() {
        let w2c = camera.rotation.transpose().to_cols_array_2d();
        let [tx, ty, tz] = camera.translation.to_array();
        let [r0, r1, r2] = w2c.map(|[a, b, c]| [a, b, c]);
        let row = |[a, b, c]: [f64; 3], t: f64| [a, b, c, t];
        let mut entry = json!({
            "id": id,
            "img_name": name,
            "width": camera.width,
            "height": camera.height,
            "position": camera.position().to_array(),
            "rotation": camera.rotation.to_cols_array_2d(),
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "world_to_camera": [row(r0, tx), row(r1, ty), row(r2, tz), [0.0, 0.0, 0.0, 1.0]],
        });
        if let (Some(t), Some(map)) = (time, entry.as_object_mut()) {
            map.insert("time".into(), json!(t));
        }
        let comma = if id + 1 < cameras.len() { "," } else { "" };
        writeln!(out, "{entry}{comma}")?;
    }
    writeln!(out, "]")
}

/// Writes cameras to a file as [`write_cameras`] does, completely or not at all.
///
/// # Errors
/// As [`write_file`].
pub fn save_cameras(path: &Path, cameras: &[NamedCamera], overwrite: bool) -> Result<(), IoError> {
    write_file(path, overwrite, |out| write_cameras(cameras, out))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Vec<NamedCamera>, IoError> {
        parse_cameras(text.as_bytes(), "c.json", &Limits::default())
    }

    fn error(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    fn two() -> Vec<NamedCamera> {
        let eye = DVec3::new(1.0, -2.0, 0.5);
        let camera = Camera::look_at(64, 48, 0.7, eye, DVec3::ZERO, DVec3::Z).unwrap();
        let other = Camera { cx: 30.25, fy: 71.5, ..camera.clone() };
        vec![
            NamedCamera { name: "a \"b\"".into(), camera, time: None },
            NamedCamera { name: "c".into(), camera: other, time: Some(0.1) },
        ]
    }

    const ENTRY: &str = r#"{"id":0,"img_name":"v","width":4,"height":2,"position":[1,2,3],
        "rotation":[[0,0,1],[1,0,0],[0,1,0]],"fx":5.5,"fy":6,"extra":{"deep":[1,{"x":null}]}}"#;

    #[test]
    fn round_trip_is_exact() {
        let mut out = Vec::new();
        write_cameras(&two(), &mut out).unwrap();
        assert_eq!(parse_cameras(&out, "c.json", &Limits::default()).unwrap(), two());
        // An INRIA reader sees position and rotation only.
        let text = String::from_utf8(out).unwrap().replace("world_to_camera", "ignored");
        for (a, b) in parse(&text).unwrap().iter().zip(two()) {
            assert!((a.camera.translation - b.camera.translation).length() < 1e-14);
            assert_eq!(a.camera.rotation, b.camera.rotation);
        }
    }

    #[test]
    fn inria_rotation_rows_are_camera_to_world() {
        for text in [ENTRY.to_owned(), format!("\u{feff}[{ENTRY}]")] {
            let c = &parse(&text).unwrap()[0];
            assert_eq!((c.name.as_str(), c.camera.cx, c.camera.cy, c.time), ("v", 2.0, 1.0, None));
            assert!((c.camera.position() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-15);
            // Third column of c2w is the view direction.
            assert_eq!(c.camera.forward(), DVec3::new(1.0, 0.0, 0.0));
        }
    }

    #[test]
    fn world_to_camera_has_priority_and_missing_names_become_indices() {
        let with = ENTRY.replace(r#""img_name":"v""#, r#""world_to_camera":[[1,0,0,7],[0,1,0,8],[0,0,1,9]],"time":2"#);
        let c = &parse(&format!("[{ENTRY},{with}]")).unwrap()[1];
        assert_eq!(c.camera.translation, DVec3::new(7.0, 8.0, 9.0));
        assert_eq!((c.name.as_str(), c.time), ("1", Some(2.0)));
    }

    #[test]
    fn transforms_use_opengl_axes_and_shared_intrinsics_in_any_order() {
        let text = r#"{"frames":[{"file_path":"./r_0","rotation":0.1,"time":0.5,
            "transform_matrix":[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]},
            {"file_path":"r_1","w":10,"h":6,"fl_x":9,"transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,0]]}],
            "camera_angle_x":1.5707963267948966,"w":8.0,"h":4}"#;
        let all = parse(text).unwrap();
        let (a, b) = (&all[0], &all[1].camera);
        assert_eq!((a.name.as_str(), a.time), ("./r_0", Some(0.5)));
        assert!((a.camera.fx - 4.0).abs() < 1e-12 && a.camera.fy == a.camera.fx);
        assert_eq!(a.camera.position(), DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(a.camera.forward(), DVec3::new(0.0, 0.0, -1.0), "OpenGL cameras look along -z");
        assert_eq!(a.camera.to_camera(DVec3::new(1.0, 3.0, 3.0)).y, -1.0, "world up is up");
        assert_eq!((b.width, b.height, b.fx, b.cx), (10, 6, 9.0, 5.0));
        assert!(error(&text.replace(r#","h":4"#, "")).contains("`h` is missing (at entry 0)"));
        assert!(error(&text.replace(r#""camera_angle_x":"#, r#""k1":"#)).contains("`k1` = 1.57"));
        assert!(error(&text.replace("camera_angle_x", "other")).contains("`fl_x` is missing (at entry 0)"));
        assert!(error(&text.replace("[0,0,0,1]]}", "[0,0,1,1]]}")).contains("last row"));
        assert!(error(&text.replace(r#""w":8.0"#, r#""camera_model":"OPENCV_FISHEYE","w":8"#)).contains("FISHEYE"));
    }

    #[test]
    fn errors_name_entry_and_field() {
        let second = |from: &str, to: &str| error(&format!("[{ENTRY},{}]", ENTRY.replace(from, to)));
        assert!(second("5.5", "NaN").contains("entry 1, field `fx`, line 3"));
        assert!(second("5.5", "1e999").contains("number out of range (at entry 1, field `fx`"));
        assert!(second("5.5", "-1").contains("entry 1 (`v`): camera fx = -1"));
        assert!(second("5.5", "\"5\"").contains("entry 1, field `fx`"));
        assert!(second("[1,2,3]", "[1,2]").contains("entry 1, field `position`"));
        assert!(second("[1,2,3]", "[1,Infinity,3]").contains("entry 1, field `position`"));
        assert!(second("[1,2,3]", "[1,2,3,4]").contains("entry 1, field `position`"));
        assert!(second("[0,0,1]", "[0,0,2]").contains("rotation is not orthonormal"));
        assert!(second("\"fy\"", "\"gy\"").contains("`fy` is missing (at entry 1)"));
        assert!(second("\"position\"", "\"p\"").contains("`world_to_camera` is missing (at entry 1)"));
        assert!(second("\"rotation\"", "\"r\"").contains("`rotation` is missing (at entry 1)"));
        assert!(second("\"width\":4", "\"width\":4.5").contains("row 1, `width` = 4.5"));
        assert!(second("\"width\":4", "\"width\":1e9").contains("row 1, `width`"));
        assert!(second("\"fy\":6", "\"fy\":6,\"time\":1e300").contains("row 1, `time` = inf"));
        assert!(error("[]").contains("`cameras` is missing"));
        assert!(error("").contains("EOF") && error("7").contains("invalid type"));
        assert!(error(&format!("{ENTRY} x")).contains("trailing"));
        assert!(error(&format!("[{ENTRY},{}]", r#"{"frames":[]}"#)).contains("one layout"));
        let tight = Limits { max_rows: 1, ..Limits::default() };
        let text = format!("[{ENTRY},{ENTRY}]");
        assert!(matches!(parse_cameras(text.as_bytes(), "c", &tight), Err(IoError::Limit { .. })));
        let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
        assert!(error(&deep).contains("entry 0"));
        assert!(parse(&ENTRY.replace("null", &deep)).is_ok(), "nesting in a skipped field is parsed without recursion");
    }
}
