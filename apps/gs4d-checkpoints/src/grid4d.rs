//! Grid4D as method `grid4d`.

use crate::cloud::{cloud, layer, set, set_list, stacked, whole};
use crate::file::Exported;
use crate::hash_table::table;
use crate::{CheckpointError, Scene};
use gs_deform::encode::hash::config::HashGridConfig;
use serde_json::Value;

const CODE: &str = "Grid4D";
const METHOD: &str = "grid4d";
const GRIDS: [&str; 4] = ["xyz", "xyt", "yzt", "xzt"];

pub(crate) fn scene(file: &Exported<'_>) -> Result<Scene, CheckpointError> {
    let mut scene = cloud(file, CODE, METHOD)?;
    let Scene { settings, tensors, .. } = &mut scene;
    let grids = [grid(file, "canonical")?, grid(file, "deform")?];
    for name in GRIDS {
        let config = &grids[usize::from(name.ends_with('t'))];
        tensors.push((format!("field.grids.{name}"), table(file, &format!("grid4d.{name}_encoding"), config)?));
    }
    let [width, _] = file.matrix("deform.spatial_mlp.0.weight")?;
    let depth = (0..).take_while(|k| file.has(&format!("deform.grid_mlp.{}.weight", 2 * k))).count();
    let [space, time] = [2 * grids[0].levels, 6 * grids[1].levels];
    tensors.extend(layer(file, "deform.spatial_mlp.0", "field.net.space", [width, space])?);
    tensors.extend(layer(file, "deform.temporal_mlp.0", "field.net.time", [width, time])?);
    for k in 0..depth {
        let (from, to) = (format!("deform.grid_mlp.{}", 2 * k), format!("field.net.hidden.{k}"));
        tensors.extend(layer(file, &from, &to, [width, width])?);
    }
    let heads = [("warp", 7), ("rotation", 4), ("scaling", 3)].map(|(n, o)| (format!("deform.gaussian_{n}"), o));
    tensors.extend(stacked(file, &heads, "field.net.head", width)?);
    for (name, grid) in ["canonical", "temporal"].iter().zip(&grids) {
        let key = |leaf: &str| format!("field.{name}.{leaf}");
        settings.extend([
            set_list(&key("base"), &grid.base.map(f64::from)),
            set_list(&key("end"), &grid.end.map(f64::from)),
            set(&key("levels"), whole(grid.levels)),
            set(&key("log2_table"), i64::from(grid.log2_table)),
        ]);
    }
    settings.extend([
        set("field.bound", bound(file)?),
        set("field.width", whole(width)),
        set("field.depth", whole(depth)),
        set("field.directional", file.setting("network_args")["directional"].as_bool().unwrap_or(true)),
        set("field.compat_grid4d", true),
    ]);
    Ok(scene)
}

/// Half the side of the cube in world units: the code scales positions before it looks them up.
fn bound(file: &Exported<'_>) -> Result<f64, CheckpointError> {
    let bound = file.setting("grid_args")["bound"].as_f64().ok_or(CheckpointError::Setting("grid_args.bound"))?;
    let scale = axes(file.setting("scale_xyz"), 1.0).ok_or(CheckpointError::Setting("scale_xyz"))?;
    if scale[0] == scale[1] && scale[1] == scale[2] && scale[0] > 0.0 {
        return Ok(bound / f64::from(scale[0]));
    }
    let what = format!("a cube of unequal sides (scale_xyz = {scale:?})");
    Err(CheckpointError::Unsupported { code: CODE, what, method: METHOD })
}

/// A number for all axes, or one for each; `absent` where there is none.
fn axes(value: &Value, absent: f32) -> Option<[f32; 3]> {
    #[expect(clippy::cast_possible_truncation, reason = "a resolution or factor, exact in f32")]
    let single = |v: &Value| v.as_f64().map(|v| v as f32);
    match value {
        Value::Null => Some([absent; 3]),
        Value::Array(of) => {
            let numbers: Option<Vec<f32>> = of.iter().map(single).collect();
            numbers?.try_into().ok()
        }
        one => Some([single(one)?; 3]),
    }
}

/// Sizes of the grid over space (`canonical`) or of those over time (`deform`).
fn grid(file: &Exported<'_>, name: &str) -> Result<HashGridConfig, CheckpointError> {
    let args = file.setting("grid_args");
    let value = |leaf: &str| &args[format!("{name}_{leaf}")];
    let whole = |leaf: &str| value(leaf).as_u64().ok_or(CheckpointError::Setting("grid_args"));
    let sizes = |leaf: &str| axes(value(leaf), f32::NAN).ok_or(CheckpointError::Setting("grid_args"));
    if whole("level_dim")? != 2 {
        let what = format!("{} features a level ({name}_level_dim)", whole("level_dim")?);
        return Err(CheckpointError::Unsupported { code: CODE, what, method: METHOD });
    }
    let (levels, log2_table) = (whole("num_levels")?, whole("log2_hashmap_size")?);
    let small = |n: u64| u32::try_from(n).map_err(|_| CheckpointError::Setting("grid_args"));
    Ok(HashGridConfig {
        base: sizes("base_resolution")?,
        end: sizes("desired_resolution")?,
        levels: small(levels)? as usize,
        log2_table: small(log2_table)?,
    })
}
