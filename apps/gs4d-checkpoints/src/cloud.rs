//! The canonical cloud of a checkpoint: the columns of `point_cloud.ply`, whose logarithms and logits are those of gs4d.

use crate::file::{Exported, misshapen};
use crate::{CheckpointError, Scene};
use glam::Vec3;
use toml::Value;

/// One setting.
pub(crate) fn set(key: &str, value: impl Into<Value>) -> (String, Value) {
    (key.to_owned(), value.into())
}

/// A setting that is a list.
pub(crate) fn set_list<T: Copy + Into<Value>>(key: &str, values: &[T]) -> (String, Value) {
    set(key, Value::Array(values.iter().map(|v| (*v).into()).collect()))
}

/// A whole number as a setting.
pub(crate) fn whole(n: usize) -> i64 {
    i64::try_from(n).unwrap_or(i64::MAX)
}

/// `PREFIX0`, `PREFIX1`, …
pub(crate) fn numbered(prefix: &str, count: usize) -> Vec<String> {
    (0..count).map(|k| format!("{prefix}{k}")).collect()
}

/// The colour behind the scene.
pub(crate) fn background(file: &Exported<'_>) -> Result<(String, Value), CheckpointError> {
    Ok(set("schedule.background", if file.flag("white_background")? { "white" } else { "black" }))
}

/// The box around positions, `[rows, 3]`.
pub(crate) fn box_around(positions: &[f32]) -> [Vec3; 2] {
    let points = positions.as_chunks().0.iter().map(|p| Vec3::from_array(*p)).filter(|p| p.is_finite());
    points.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[lo, hi], p| [lo.min(p), hi.max(p)])
}

/// The canonical cloud of a file as a scene of `method`, whose field is still to come.
pub(crate) fn cloud(file: &Exported<'_>, code: &'static str, method: &'static str) -> Result<Scene, CheckpointError> {
    let rows = file.points()?;
    let rest = file.names("ply.f_rest_");
    let degree = match rest {
        0 => 0u8,
        9 => 1,
        24 => 2,
        45 => 3,
        _ => return Err(misshapen("ply.f_rest_*", &[rest], "0, 9, 24 or 45 columns".to_owned())),
    };
    let per_channel = rest / 3;
    let interleaved: Vec<String> =
        (0..per_channel).flat_map(|k| (0..3).map(move |c| format!("f_rest_{}", c * per_channel + k))).collect();
    let means = file.rows(&["x", "y", "z"].map(str::to_owned))?;
    let bounds = box_around(&means);
    let mut tensors = vec![
        ("cloud.means".to_owned(), means),
        ("cloud.quats".to_owned(), file.rows(&numbered("rot_", 4))?),
        ("cloud.log_scales".to_owned(), file.rows(&numbered("scale_", 3))?),
        ("cloud.logit_opacities".to_owned(), file.rows(&["opacity".to_owned()])?),
        ("cloud.sh_dc".to_owned(), file.rows(&numbered("f_dc_", 3))?),
    ];
    if rest > 0 {
        tensors.push(("cloud.sh_rest".to_owned(), file.rows(&interleaved)?));
    }
    let settings = vec![
        set("cloud.sh_degree", i64::from(degree)),
        set("schedule.density.max_splats", whole(rows)),
        background(file)?,
    ];
    let (iteration, notes) = (file.iteration()?, Vec::new());
    Ok(Scene { code, iteration, method, rows, settings, tensors, bounds, notes })
}

/// Weight and bias of a linear layer under another name.
pub(crate) fn layer(
    file: &Exported<'_>,
    from: &str,
    to: &str,
    [outputs, inputs]: [usize; 2],
) -> Result<[(String, Vec<f32>); 2], CheckpointError> {
    let weight = file.values(&format!("{from}.weight"), &[outputs, inputs])?;
    let bias = file.values(&format!("{from}.bias"), &[outputs])?;
    Ok([(format!("{to}.weight"), weight), (format!("{to}.bias"), bias)])
}

/// Layers with the same inputs as one, outputs below each other.
pub(crate) fn stacked(
    file: &Exported<'_>,
    from: &[(String, usize)],
    to: &str,
    inputs: usize,
) -> Result<[(String, Vec<f32>); 2], CheckpointError> {
    let [mut weight, mut bias]: [Vec<f32>; 2] = Default::default();
    for (name, outputs) in from {
        weight.extend(file.values(&format!("{name}.weight"), &[*outputs, inputs])?);
        bias.extend(file.values(&format!("{name}.bias"), &[*outputs])?);
    }
    Ok([(format!("{to}.weight"), weight), (format!("{to}.bias"), bias)])
}
