//! Writing a generated film in the layout `avatar`.

use std::io::Write;
use std::path::Path;

use gs_core::Camera;
use gs_core::io::write_file;
use gs_texel::maps_exr::{Kind, Layer, save_layers};
use gs_texel::read::percent_decoded;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::super::save::{create_dir, save, save_json, save_png};
use super::super::write::check_vacant;
use super::{Atlas, AvatarOptions, Scene};
use gs_data::avatar::layout::{FrameUse, Role};
use gs_data::avatar::{BUILTIN, MeasuredPoints, SurfacePoints};
use gs_data::ply::write_points;
use gs_data::{DataError, DataOptions, Dataset, ImageSource, Place, PointCloud, Root};

/// Generates a film and writes it to `dir`: `scene.json`, `cameras.json`, `images/CAMERA/FRAME.png` (straight alpha),
/// `points/FRAME.ply`, a copy of the template and, with `truth`, `gt/CAMERA/FRAME.exr` with the layers `depth` (camera-space
/// z), `N` (normal, world) and `P` (position, world) at pixel centres, 0 where nothing is visible. Returns the film in memory. Unless
/// `overwrite` is set the folder must be empty or absent.
///
/// # Errors
/// `io.exists` if the folder holds files, `io.write` if writing fails, else those of [`super::generate`].
pub fn write(dir: &Path, options: &AvatarOptions, truth: bool, overwrite: bool) -> Result<Dataset, DataError> {
    check_vacant(dir, overwrite)?;
    let scene = Scene::new(options)?;
    create_dir(dir.to_path_buf())?;
    let template = copy_template(dir, &options.template)?;
    let film = scene.film()?;
    for id in 0..scene.cameras.len() {
        create_dir(dir.join(format!("images/{id:03}")))?;
    }
    film.shots.par_iter().try_for_each(|shot| match &shot.view.image {
        ImageSource::Memory(image) => {
            save_png(&dir.join(format!("images/{:03}/{:06}.png", shot.view.camera_id, shot.number)), image)
        }
        ImageSource::File(_) => Ok(()),
    })?;
    for frame in &film.frames {
        if let Some(SurfacePoints::Memory(points)) = &frame.points {
            let folder = create_dir(dir.join("points"))?;
            save_points(&folder.join(format!("{:06}.ply", frame.number)), points)?;
        }
    }
    if truth {
        save_truth(dir, &scene)?;
    }
    let cameras = scene.cameras.iter().enumerate().map(|(id, c)| camera_json(id, &c.camera, c.role));
    save_json(&dir.join("cameras.json"), &cameras.collect())?;
    save_json(&dir.join("scene.json"), &scene_json(&scene, &template))?;
    film.into_dataset(&DataOptions::default())
}

/// Copies a template's file and the files it refers to into the folder; returns the name for `scene.json`.
fn copy_template(dir: &Path, template: &str) -> Result<String, DataError> {
    if template.starts_with(BUILTIN) {
        return Ok(template.to_owned());
    }
    let from = Path::new(template);
    let bytes = std::fs::read(from).map_err(|e| DataError::read(from, e))?;
    let binary = bytes.starts_with(b"glTF");
    let name = if binary { "actor.glb" } else { "actor.gltf" };
    save(&dir.join(name), &bytes)?;
    // A GLB's JSON chunk follows 20 bytes of headers (glTF 2.0, 4.4); its length is at byte 12.
    let length = || bytes.get(12..16).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let text = if binary { length().and_then(|n| bytes.get(20..20 + n)).unwrap_or_default() } else { &bytes[..] };
    let gltf: Value = serde_json::from_slice(text).map_err(|e| DataError::syntax(from, "", e.to_string()))?;
    let folder = from.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let root = Root::new(folder)?;
    for list in ["buffers", "images"] {
        for (i, entry) in gltf[list].as_array().into_iter().flatten().enumerate() {
            let Some(uri) = entry["uri"].as_str().filter(|uri| !uri.starts_with("data:")) else { continue };
            let place = Place::new(from, format!("{list}[{i}].uri"));
            let name = percent_decoded(uri).unwrap_or_else(|| uri.to_owned());
            let beside = root.resolve(&name, &place)?;
            let to = dir.join(beside.strip_prefix(folder).unwrap_or(Path::new(&name)));
            create_dir(to.parent().unwrap_or(dir).to_path_buf())?;
            save(&to, &std::fs::read(&beside).map_err(|e| DataError::read(&beside, e))?)?;
        }
    }
    Ok(name.to_owned())
}

fn save_points(file: &Path, points: &MeasuredPoints) -> Result<(), DataError> {
    let colors = points.colors.clone().unwrap_or_else(|| vec![[0.5; 3]; points.positions.len()]);
    let cloud = PointCloud { positions: points.positions.clone(), colors };
    let content = |out: &mut dyn Write| write_points(&cloud, out);
    write_file(file, true, content).map_err(|e| DataError::unwritten(file, e))
}

/// Writes the ground truth at the pixel centres of every image.
fn save_truth(dir: &Path, scene: &Scene) -> Result<(), DataError> {
    let (cameras, frames) = (scene.cameras.len(), scene.frames.len());
    for id in 0..cameras {
        create_dir(dir.join(format!("gt/{id:03}")))?;
    }
    let layer = |name: &str, kind, map| Layer { name: name.into(), kind, half: false, map };
    (0..frames).into_par_iter().try_for_each(|frame| {
        let stage = scene.stage(frame);
        (0..cameras).try_for_each(|id| {
            let maps = stage.truth(&scene.cameras[id].camera);
            let file = dir.join(format!("gt/{id:03}/{frame:06}.exr"));
            let layers = [
                layer("depth", Kind::Plain, maps.depth),
                layer("N", Kind::Vector, maps.normal),
                layer("P", Kind::Vector, maps.position),
            ];
            save_layers(&file, &layers, true).map_err(|e| DataError::unwritten(&file, e))
        })
    })
}

fn camera_json(id: usize, c: &Camera, role: Role) -> Value {
    let name = Role::NAMES.iter().find(|(_, r)| *r == role).map(|(name, _)| *name);
    let (r, t) = (c.rotation.transpose(), c.translation);
    let row = |axis: glam::DVec3, t: f64| [axis.x, axis.y, axis.z, t];
    let e = [row(r.x_axis, t.x), row(r.y_axis, t.y), row(r.z_axis, t.z), [0.0, 0.0, 0.0, 1.0]];
    json!({
        "id": id, "w": c.width, "h": c.height, "role": name, "dist": null, "pixel_center": "half",
        "K": [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
        "E": e.concat(),
    })
}

fn scene_json(scene: &Scene, template: &str) -> Value {
    let o = AvatarOptions { atlas: scene.atlas, ..scene.options.clone() };
    let list =
        |of: FrameUse| -> Vec<usize> { (0..scene.frames.len()).filter(|&n| scene.frames[n].list == of).collect() };
    json!({
        "version": 1, "units": "m", "up": "y", "fps": scene.fps,
        "frames": { "start": 0, "count": o.frames, "step": 1 },
        "template": template, "auto_uv": scene.atlas == Atlas::Anew, "repack": scene.atlas == Atlas::Repack, "clip": scene.clip.as_ref().map(|c| c.name.as_str()),
        "skinning": o.skinning, "morph": o.morph, "background": [0, 0, 0],
        "splits": { "train": list(FrameUse::Train), "test": list(FrameUse::Test), "ood": list(FrameUse::Ood) },
        "generated": o,
    })
}
