//! `poses.json` or `poses.bin`: values that replace those of the motion's pose, frame by frame.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;
use gs_core::cast;
use gs_texel::{Character, Pose};
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::cameras::key;
use super::manifest::Manifest;
use super::poses_bin::Stated;
use crate::error::{DataError, Place};
use crate::files::read_text;
use crate::json::{Fields, quote_non_finite};

/// Largest file, and largest frame: 500 nodes have 100 kB.
const MAX_BYTES: u64 = 256 << 20;
const MAX_FRAME_BYTES: usize = 1 << 20;

/// A pose, and the morph weights that the images show, where they are known.
type Posed = (Pose, Option<Vec<f32>>);

/// The pose and the true morph weights of every frame in `manifest.lists`.
pub(super) fn read(dir: &Path, manifest: &Manifest, character: &Character) -> Result<Vec<Posed>, DataError> {
    let (file, numbers) = (&dir.join("poses.json"), &dir.join("poses.bin"));
    let stated = Stated::read(numbers, character)?;
    if !stated.is_empty() && file.is_file() {
        let (place, value) = (Place::new(numbers, ""), "there is a poses.json, too".to_owned());
        let why = "one pose of a frame would silently win over the other";
        return Err(DataError::Field { place, value, why, fix: "keep one of the two files" });
    }
    let text = if file.is_file() { read_text(file, MAX_BYTES)? } else { "{}".into() };
    let text = quote_non_finite(&text);
    let written: BTreeMap<String, &RawValue> = serde_json::from_str(&text).map_err(|e| broken(file, &e))?;
    let nothing = Map::new();
    let top = Fields::new(file, "", &nothing);
    let mut by_number = BTreeMap::new();
    for (frame, raw) in &written {
        by_number.insert(key(&top, frame)?, (frame, *raw));
    }
    let clip = manifest.clip(character);
    let pose = |(&number, _)| {
        let seconds = f64::from(number) / manifest.fps;
        let rest = || character.skeleton.rest_pose();
        let mut pose = clip.map_or_else(rest, |c| c.pose(&character.skeleton, seconds));
        stated.amend(&mut pose, number);
        if let Some((frame, raw)) = by_number.get(&number) {
            amend(&mut pose, file, frame, raw, character)?;
        }
        Ok(manifest.known(character, pose))
    };
    manifest.lists.iter().map(pose).collect()
}

/// The pose in a file of one frame, where it replaces values of `pose`.
///
/// # Errors
/// As for a frame of `poses.json`.
pub(super) fn read_one(file: &Path, mut pose: Pose, character: &Character) -> Result<Pose, DataError> {
    let text = read_text(file, MAX_FRAME_BYTES as u64)?;
    let text = quote_non_finite(&text);
    let raw: &RawValue = serde_json::from_str(&text).map_err(|e| broken(file, &e))?;
    amend(&mut pose, file, "", raw, character)?;
    Ok(pose)
}

fn broken(file: &Path, e: &serde_json::Error) -> DataError {
    DataError::syntax(file, format!("line {}, column {}", e.line(), e.column()), e.to_string())
}

/// Replaces the values of a pose that its frame states.
fn amend(pose: &mut Pose, file: &Path, frame: &str, raw: &RawValue, character: &Character) -> Result<(), DataError> {
    if raw.get().len() > MAX_FRAME_BYTES {
        let place = Place::new(file, frame);
        return Err(DataError::TooLarge { place, bytes: raw.get().len() as u64, limit: MAX_FRAME_BYTES as u64 });
    }
    let map: Map<String, Value> = serde_json::from_str(raw.get())
        .map_err(|e| DataError::syntax(file, frame, format!("a frame is an object with nodes and morphs: {e}")))?;
    let fields = Fields::new(file, frame, &map);
    if let Some(nodes) = map.get("nodes") {
        let why = "it is an object of nodes by name";
        let nodes = nodes.as_object().ok_or_else(|| fields.fault("nodes", &nodes.to_string(), why, "correct it"))?;
        for (name, node) in nodes {
            let at = format!("nodes.{name}");
            let Some(number) = character.skeleton.node(name) else {
                return Err(fields.fault(&at, "no node of the template", "a pose moves its nodes", "correct the name"));
            };
            let why = "a node has translation, rotation and scale";
            let node = node.as_object().ok_or_else(|| fields.fault(&at, &node.to_string(), why, "correct it"))?;
            let node = Fields::new(file, format!("{frame}.{at}"), node);
            let local = &mut pose.locals[number as usize];
            local.translation = node.numbers("translation")?.map_or(local.translation, DVec3::from_array);
            local.scale = node.numbers("scale")?.map_or(local.scale, DVec3::from_array);
            if let Some(q) = node.numbers::<4>("rotation")? {
                if q.iter().all(|v| *v == 0.0) {
                    let why = "a rotation is a quaternion w, x, y, z of any length but 0";
                    return Err(node.fault("rotation", "[0, 0, 0, 0]", why, "correct it"));
                }
                local.rotation = q;
            }
        }
    }
    morphs(pose, &fields, &map)
}

fn morphs(pose: &mut Pose, fields: &Fields, map: &Map<String, Value>) -> Result<(), DataError> {
    let Some(weights) = map.get("morphs").filter(|v| !v.is_null()) else { return Ok(()) };
    let why = "it is a list with a finite weight for each morph of the template";
    let list = weights.as_array().filter(|l| l.len() == pose.morphs.len());
    let list = list.ok_or_else(|| fields.fault("morphs", &weights.to_string(), why, "correct the list"))?;
    for (i, (weight, value)) in pose.morphs.iter_mut().zip(list).enumerate() {
        let number = value.as_f64().map(cast::to_f32).filter(|v| v.is_finite());
        let fault = || fields.fault(&format!("morphs[{i}]"), &value.to_string(), why, "correct the number");
        *weight = number.ok_or_else(fault)?;
    }
    Ok(())
}
