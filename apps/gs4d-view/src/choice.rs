//! Splats in a box of the image: histograms of their properties, and export of those inside or of the others.

use crate::legend::histogram;
use crate::question::Choice;
use crate::shot::{MIN_OPACITY, SelectionCache, Shot};
use crate::stage::Stage;
use gs_core::cast;
use gs_core::io::RawSplats;
use gs_core::io::ply;
use gs_train::renderer::file_stem;
use serde_json::{Value, json};

/// Number of splats in a box, and histograms of their properties.
///
/// # Errors
/// A message, if the camera of the box is invalid or the splats cannot be computed.
pub(crate) fn describe(
    stage: &Stage,
    shot: &Shot,
    choice: &Choice,
    selections: &mut SelectionCache,
) -> Result<Value, String> {
    let members = selections.members(stage, &shot.scene, choice)?;
    let splats = shot.all_splats()?;
    let inside: Vec<usize> = (0..splats.len()).filter(|&i| is_chosen(&members, i)).collect();
    let of = |value: &dyn Fn(usize) -> f32| inside.iter().map(|&i| value(i)).collect::<Vec<f32>>();
    let depth = |i: usize| cast::to_f32(shot.camera.to_camera(splats.means[i].as_dvec3()).z);
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

/// Name and bytes of a `.ply` file of the visible splats inside a box, or of those outside, for this camera and time.
///
/// # Errors
/// A message, if there are none or a splat is invalid.
pub(crate) fn file(
    stage: &Stage,
    shot: &Shot,
    choice: Option<&Choice>,
    inside_box: bool,
    selections: &mut SelectionCache,
) -> Result<(String, Vec<u8>), String> {
    let members = choice.map(|c| selections.members(stage, &shot.scene, c)).transpose()?;
    let inside = |i: usize| members.as_ref().is_some_and(|m| is_chosen(m, i));
    let splats = shot.all_splats()?.into_owned().with_plain_kernel();
    let wanted = |&i: &usize| splats.opacities[i] >= MIN_OPACITY && inside(i) == inside_box;
    let kept: Vec<usize> = (0..splats.len()).filter(wanted).collect();
    if kept.is_empty() {
        return Err("there is no splat to save".into());
    }
    let raw = RawSplats::from_splats(&splats.rows(&kept)).map_err(|e| e.to_string())?;
    let mut bytes = Vec::new();
    ply::write(&raw, &mut bytes).map_err(|e| e.to_string())?;
    let part = if inside_box { "chosen" } else { "rest" };
    Ok((format!("{}_t{:.3}_{part}.ply", file_stem(&shot.show.name), shot.time), bytes))
}
