//! Cameras that a run and a compact scene keep, so that they can be orbited and exported where the data are not.

use crate::RunError;
use gs_core::Time;
use gs_core::io::cameras::{NamedCamera, parse_cameras, write_cameras};
use gs_core::io::{IoError, Limits};
use gs_data::{ImageSource, ImageU8, View};
use serde_json::Value;
use std::sync::Arc;

/// Number of cameras kept, at most.
const KEPT: usize = 16;
/// What follows from the others.
const DERIVED: [&str; 3] = ["id", "position", "rotation"];

/// Up to [`KEPT`] cameras of the views, evenly spaced, as camera JSON.
pub(crate) fn keep(views: &[View]) -> Result<Value, RunError> {
    let n = views.len().min(KEPT);
    let cameras: Vec<NamedCamera> = (0..n)
        .filter_map(|k| views.get(k * views.len() / n))
        .map(|v| NamedCamera { name: v.name.clone(), camera: v.camera.clone(), time: Some(v.time.normalised) })
        .collect();
    let mut text = Vec::new();
    let written = write_cameras(&cameras, &mut text).and_then(|()| Ok(serde_json::from_slice(&text)?));
    let mut json: Value = written.map_err(|source| RunError::io("write", "the cameras".as_ref(), source))?;
    for entry in json.as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut) {
        entry.retain(|key, _| !DERIVED.contains(&key.as_str()));
    }
    Ok(json)
}

/// The cameras of such JSON, as views without images; `file` is the name used in errors.
///
/// # Errors
/// Those of the camera reader; a time that is not finite.
pub(crate) fn views(json: &str, file: &str) -> Result<Vec<View>, IoError> {
    let cameras = parse_cameras(json.as_bytes(), file, &Limits::default())?;
    let no_image = || ImageSource::Memory(Arc::new(ImageU8 { width: 0, height: 0, data: Vec::new() }));
    let view = |(k, c): (u32, NamedCamera)| {
        let time = Time::new(c.time.unwrap_or(0.0)).unwrap_or_default();
        View::new(&c.name, c.camera, time, no_image(), k)
    };
    Ok((0..).zip(cameras).map(view).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_come_back_as_they_were() {
        let data = gs_synth::testkit::scene("balls", 16, 40);
        let kept = keep(&data.train).unwrap();
        let back = views(&kept.to_string(), "kept").unwrap();
        assert_eq!(back.len(), KEPT);
        assert_eq!((&back[0].camera, &back[0].name), (&data.train[0].camera, &data.train[0].name));
        assert_eq!(back[8].camera, data.train[20].camera);
        assert_eq!(back[8].time.normalised, data.train[20].time.normalised);
        assert!(keep(&[]).unwrap().as_array().unwrap().is_empty());
    }
}
