//! Deformable-3D-GS as method `defgs`.

use crate::cloud::{cloud, layer, set, whole};
use crate::file::{Exported, misshapen};
use crate::{CheckpointError, Scene};

const CODE: &str = "Deformable-3D-GS";
const METHOD: &str = "defgs";
/// Frequency bands of an encoded position.
const BANDS_POSITION: usize = 10;

pub(crate) fn scene(file: &Exported<'_>) -> Result<Scene, CheckpointError> {
    if file.has("deform.branch_w.weight") || file.flag_or("is_6dof", false)? {
        let what = "the screw motion (is_6dof)".to_owned();
        return Err(CheckpointError::Unsupported { code: CODE, what, method: METHOD });
    }
    let mut scene = cloud(file, CODE, METHOD)?;
    network(file, BANDS_POSITION, &mut scene)?;
    Ok(scene)
}

/// The network of place and time, whose encoded positions have so many frequency bands.
pub(crate) fn network(file: &Exported<'_>, bands: usize, scene: &mut Scene) -> Result<(), CheckpointError> {
    let Scene { settings, tensors, .. } = scene;
    let position = 3 * (1 + 2 * bands);
    let first = "deform.linear.0.weight";
    let [width, inputs] = file.matrix(first)?;
    let depth = (0..).take_while(|k| file.has(&format!("deform.linear.{k}.weight"))).count();
    let wrong = || misshapen(first, &[width, inputs], format!("F32 [_, {position} and the encoded time]"));
    let time = inputs.checked_sub(position).ok_or_else(wrong)?;
    let encoded = match file.has("deform.timenet.0.weight") {
        true => {
            let [hidden, encoded] = file.matrix("deform.timenet.0.weight")?;
            tensors.extend(layer(file, "deform.timenet.0", "field.time.0", [hidden, encoded])?);
            tensors.extend(layer(file, "deform.timenet.2", "field.time.1", [time, hidden])?);
            settings.extend([set("field.time_hidden", whole(hidden)), set("field.time_features", whole(time))]);
            encoded
        }
        false => {
            settings.push(set("field.time_hidden", 0));
            time
        }
    };
    if encoded % 2 == 0 {
        return Err(wrong());
    }
    let skip = depth / 2;
    for k in 0..depth {
        let takes = match k {
            0 => inputs,
            k if k == skip + 1 => inputs + width,
            _ => width,
        };
        tensors.extend(layer(file, &format!("deform.linear.{k}"), &format!("field.layer.{k}"), [width, takes])?);
    }
    for (from, to, outputs) in [("warp", "means", 3), ("rotation", "quats", 4), ("scaling", "scales", 3)] {
        tensors.extend(layer(file, &format!("deform.gaussian_{from}"), &format!("field.{to}"), [outputs, width])?);
    }
    settings.extend([
        set("field.width", whole(width)),
        set("field.depth", whole(depth)),
        set("field.skip", whole(skip)),
        set("field.bands_position", whole(bands)),
        set("field.bands_time", whole((encoded - 1) / 2)),
    ]);
    Ok(())
}
