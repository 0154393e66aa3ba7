//! Scaffold-GS as method `scaffold`.

use crate::cloud::{background, box_around, layer, numbered, set, whole};
use crate::file::{Exported, misshapen};
use crate::{CheckpointError, Scene};

const CODE: &str = "Scaffold-GS";
/// Heads: name there and here, the switch for the distance, outputs per Gaussian.
const HEADS: [(&str, &str, &str, usize); 3] = [
    ("opacity_mlp", "opacity", "add_opacity_dist", 1),
    ("color_mlp", "color", "add_color_dist", 3),
    ("cov_mlp", "covariance", "add_cov_dist", 7),
];
/// Names that the vectors of appearance may have.
const APPEARANCE: [&str; 2] = ["appearance.embedding.weight", "embedding_appearance.embedding.weight"];

pub(crate) fn scene(file: &Exported<'_>) -> Result<Scene, CheckpointError> {
    let (rows, features) = (file.points()?, file.names("ply.f_anchor_feat_"));
    let offsets = file.names("ply.f_offset_") / 3;
    // Stored axis by axis.
    let of_gaussians: Vec<String> =
        (0..offsets).flat_map(|k| (0..3).map(move |d| format!("f_offset_{}", d * offsets + k))).collect();
    let positions = file.rows(&["x", "y", "z"].map(str::to_owned))?;
    let bounds = box_around(&positions);
    let voxel = match file.number("voxel_size")? {
        size if size > 0.0 => size,
        _ => f64::from(lattice_step(&positions)),
    };
    let mut tensors = vec![
        ("anchors.positions".to_owned(), positions),
        ("anchors.offsets".to_owned(), file.rows(&of_gaussians)?),
        ("anchors.features".to_owned(), file.rows(&numbered("f_anchor_feat_", features))?),
        ("anchors.log_scales".to_owned(), file.rows(&numbered("scale_", 6))?),
    ];
    let appearance = appearance(file)?;
    let mut settings = vec![
        background(file)?,
        set("anchors.voxel", voxel),
        set("anchors.offsets", whole(offsets)),
        set("anchors.features", whole(features)),
        set("adapt.max_anchors", whole(rows)),
        set("decoder.appearance", whole(appearance.width)),
    ];
    for (from, to, switch, outputs) in HEADS {
        let distance = file.flag(switch)?;
        let own = if to == "color" { appearance.width } else { 0 };
        let inputs = features + 3 + usize::from(distance) + own;
        settings.push(set(&format!("decoder.distance.{to}"), distance));
        let [first, last] = [0, 2].map(|k| format!("{from}.{k}"));
        tensors.extend(layer(file, &first, &format!("heads.{to}.0"), [features, inputs])?);
        tensors.extend(layer(file, &last, &format!("heads.{to}.1"), [outputs * offsets, features])?);
    }
    let bank = file.flag("use_feat_bank")?;
    settings.push(set("decoder.feature_bank", bank));
    if bank {
        tensors.extend(layer(file, "feature_bank_mlp.0", "heads.bank.0", [features, 4])?);
        tensors.extend(layer(file, "feature_bank_mlp.2", "heads.bank.1", [3, features])?);
    }
    let mut notes = Vec::new();
    if appearance.cameras > 1 {
        notes.push(format!("the mean of {} vectors of appearance stands for all cameras", appearance.cameras));
    }
    if appearance.width > 0 {
        tensors.push(("heads.appearance".to_owned(), appearance.mean));
    }
    Ok(Scene { code: CODE, iteration: file.iteration()?, method: "scaffold", rows, settings, tensors, bounds, notes })
}

/// The vectors of appearance, one per camera.
#[derive(Default)]
struct Appearance {
    width: usize,
    cameras: usize,
    mean: Vec<f32>,
}

fn appearance(file: &Exported<'_>) -> Result<Appearance, CheckpointError> {
    let Some(name) = APPEARANCE.into_iter().find(|name| file.has(name)) else { return Ok(Appearance::default()) };
    let [cameras, width] = file.matrix(name)?;
    if cameras == 0 || width == 0 {
        return Err(misshapen(name, &[cameras, width], "a vector per camera".to_owned()));
    }
    let values = file.values(name, &[cameras, width])?;
    let sum = |k: usize| values.iter().skip(k).step_by(width).map(|v| f64::from(*v)).sum::<f64>();
    #[expect(clippy::cast_possible_truncation, reason = "a mean of f32")]
    let mean = (0..width).map(|k| (sum(k) / cameras as f64) as f32).collect();
    Ok(Appearance { width, cameras, mean })
}

/// The side of the cells that anchors stand on, where the settings leave it to the data: the least distance along an axis that is more than rounding.
fn lattice_step(positions: &[f32]) -> f32 {
    let mut step = f32::INFINITY;
    for axis in 0..3 {
        let mut along: Vec<f32> = positions.iter().skip(axis).step_by(3).copied().collect();
        along.sort_by(f32::total_cmp);
        let rounding = 1e-5 * along.iter().fold(0.0f32, |most, v| most.max(v.abs()));
        let steps = along.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > rounding);
        step = steps.fold(step, f32::min);
    }
    if step.is_finite() { step } else { 0.01 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_side_of_cells_is_the_least_step() {
        let at = |cells: [i32; 3]| cells.map(|c| c as f32 * 0.013);
        let positions: Vec<f32> = [[0, 4, 900], [3, 5, -7], [17, 40, 2]].into_iter().flat_map(at).collect();
        assert!((lattice_step(&positions) - 0.013).abs() < 1e-6);
        assert_eq!(lattice_step(&[1.0, 2.0, 3.0]), 0.01);
    }
}
