//! TRACE as method `trace`: its field in `deform.pth`, its law of motion in `vel.pth`.
//!
//! The field's heads give a whole quaternion, gs4d's what is added to that of no turn. The law's network has place and time encoded together,
//! gs4d's one after the other.

use crate::cloud::{cloud, layer, set, whole};
use crate::deformable::network;
use crate::file::{Exported, misshapen};
use crate::{CheckpointError, Scene};

const CODE: &str = "TRACE";
const METHOD: &str = "trace";
const LAW: &str = "vel.vel_net.weight_net";
/// Frequency bands of an encoded position.
const BANDS_POSITION: usize = 8;
/// A twist and its rate.
const OUTPUTS: usize = 12;

pub(crate) fn scene(file: &Exported<'_>) -> Result<Scene, CheckpointError> {
    for (switch, what) in
        [("freegave", "motion by patterns (freegave)"), ("is_6dof", "the screw motion of the field (is_6dof)")]
    {
        if file.flag_or(switch, false)? {
            return Err(CheckpointError::Unsupported { code: CODE, what: what.to_owned(), method: METHOD });
        }
    }
    let mut scene = cloud(file, CODE, METHOD)?;
    network(file, BANDS_POSITION, &mut scene)?;
    let turn = scene.tensors.iter_mut().find(|(name, _)| name == "field.quats.bias");
    turn.into_iter().for_each(|(_, bias)| bias[0] -= 1.0);
    law(file, &mut scene)?;
    let (last, rate) = (file.number("max_time")?, file.number("fps")?);
    scene.notes.push(format!(
        "its field ends at time {last} and its steps are 1/{rate}, in the unit of the data's times; the run counts both in intervals between \
         frames: --set physics.back_frames=N --set physics.step_frames=N"
    ));
    Ok(scene)
}

/// The network of the law of motion.
fn law(file: &Exported<'_>, scene: &mut Scene) -> Result<(), CheckpointError> {
    let name = |k: usize| if k == 0 { format!("{LAW}.0") } else { format!("{LAW}.{}.0", k + 1) };
    let first = format!("{}.weight", name(0));
    let [hidden, inputs] = file.matrix(&first)?;
    let layers = (0..).take_while(|k| file.has(&format!("{}.weight", name(*k)))).count();
    if inputs % 8 != 4 || layers < 2 {
        let want = "F32 [_, 4 (1 + 2 bands)] before other layers".to_owned();
        return Err(misshapen(&first, &[hidden, inputs], want));
    }
    let bands = inputs / 8;
    let columns = columns(bands);
    let [(to, weight), bias] = layer(file, &name(0), "physics.layer.0", [hidden, inputs])?;
    let weight = weight.chunks_exact(inputs).flat_map(|row| columns.iter().map(move |c| row[*c])).collect();
    scene.tensors.extend([(to, weight), bias]);
    for k in 1..layers {
        let outputs = if k + 1 == layers { OUTPUTS } else { hidden };
        scene.tensors.extend(layer(file, &name(k), &format!("physics.layer.{k}"), [outputs, hidden])?);
    }
    scene.settings.extend([
        set("law.hidden", whole(hidden)),
        set("law.depth", whole(layers - 1)),
        set("law.bands", whole(bands)),
        set("law.integrator", "rk2"),
        set("law.local_origin", false),
    ]);
    Ok(())
}

/// For each column here the one there. There the four values are encoded together, as `x, sin x, cos x, sin 2x, …`; here place, then time.
fn columns(bands: usize) -> Vec<usize> {
    let groups = 2 * bands + 1;
    let place = (0..groups).flat_map(|g| (0..3).map(move |d| 4 * g + d));
    place.chain((0..groups).map(|g| 4 * g + 3)).collect()
}

#[cfg(test)]
mod tests {
    use super::columns;
    use gs_core::nn::encoding::{encode, width};

    #[test]
    fn columns_are_those_of_the_same_values() {
        let (place, time, bands) = ([0.3, -1.2, 0.7], [0.45], 3);
        let mut there = vec![0.0; width(4, bands)];
        encode(&[place[0], place[1], place[2], time[0]], 4, bands, &mut there);
        let (mut here, mut after) = (vec![0.0; width(3, bands)], vec![0.0; width(1, bands)]);
        encode(&place, 3, bands, &mut here);
        encode(&time, 1, bands, &mut after);
        here.extend(after);
        let moved: Vec<f32> = columns(bands).into_iter().map(|c| there[c]).collect();
        assert_eq!(moved, here);
    }
}
