//! A box of splats: what they are like, and a file of them or of the others.

use crate::legend::histogram;
use crate::question::{Choice, Part};
use crate::shot::{Chosen, FAINTEST, Shot};
use crate::stage::Stage;
use gs_core::io::RawSplats;
use gs_core::io::ply;
use gs_train::renderer::file_stem;
use gs4d_eval::export::rows;
use serde_json::{Value, json};

/// How many splats a box holds and how their properties are spread.
///
/// # Errors
/// In words, if its camera is none or a pose cannot be taken.
pub fn describe(stage: &Stage, shot: &Shot, choice: &Choice, chosen: &mut Chosen) -> Result<Value, String> {
    let members = chosen.members(stage, &shot.scene, choice)?;
    let splats = shot.all_splats()?;
    let inside: Vec<usize> = (0..splats.len()).filter(|&i| is_chosen(&members, i)).collect();
    let of = |value: &dyn Fn(usize) -> f32| inside.iter().map(|&i| value(i)).collect::<Vec<f32>>();
    let depth = |i: usize| shot.camera.to_camera(splats.means[i].as_dvec3()).z as f32;
    let mut spread = vec![
        histogram("opacity", "", Some([0.0, 1.0]), &of(&|i| splats.opacities[i])),
        histogram("largest scale", "world units", None, &of(&|i| splats.scales[i].max_element())),
        histogram("depth", "world units", None, &of(&depth)),
    ];
    for q in shot.scene.quantities(shot.time)? {
        spread.push(histogram(q.name, q.unit, q.range, &of(&|i| q.values.get(i).copied().unwrap_or(f32::NAN))));
    }
    Ok(json!({"count": inside.len(), "of": splats.len(), "spread": spread}))
}

fn is_chosen(members: &[bool], i: usize) -> bool {
    members.get(i).copied().unwrap_or(false)
}

/// The name and the bytes of a `.ply` file of the visible splats of a part, as this camera sees them at this moment.
///
/// # Errors
/// In words, if there is none, or a splat is not sound.
pub fn file(
    stage: &Stage,
    shot: &Shot,
    choice: Option<&Choice>,
    part: Part,
    chosen: &mut Chosen,
) -> Result<(String, Vec<u8>), String> {
    let members = choice.map(|c| chosen.members(stage, &shot.scene, c)).transpose()?;
    let inside = |i: usize| members.as_ref().is_some_and(|m| is_chosen(m, i));
    let splats = shot.all_splats()?.into_owned().with_plain_kernel();
    let wanted = |&i: &usize| splats.opacities[i] >= FAINTEST && inside(i) == (part == Part::Chosen);
    let kept: Vec<usize> = (0..splats.len()).filter(wanted).collect();
    if kept.is_empty() {
        return Err("there is no splat to save".into());
    }
    let raw = RawSplats::from_splats(&rows(&splats, &kept)).map_err(|e| e.to_string())?;
    let mut bytes = Vec::new();
    ply::write(&raw, &mut bytes).map_err(|e| e.to_string())?;
    let part = match part {
        Part::Chosen => "chosen",
        Part::Rest => "rest",
    };
    Ok((format!("{}_t{:.3}_{part}.ply", file_stem(&shot.show.name), shot.time), bytes))
}
