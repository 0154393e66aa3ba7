//! 4DGaussians as method `fourdgs`.
//!
//! The code's box is stored upper corner first, so its planes run against the axes: they are mirrored here. Its planes are `[channels, b, a]`, gs4d's
//! `[channels / 16, b, a, 16]`. Times 0 … 1 fall on the upper half of its time axis, and gs4d stores that half only.

use crate::cloud::{cloud, layer, set, set_list, stacked, whole};
use crate::file::{Exported, misshapen};
use crate::{CheckpointError, Scene};
use glam::Vec3;

const CODE: &str = "4DGaussians";
const METHOD: &str = "fourdgs";
const NET: &str = "deformation.deformation_net";
/// Axes of the planes (x y z t = 0 1 2 3), the fast one first, in the order both codes number them.
const PLANES: [(&str, usize, usize); 6] =
    [("xy", 0, 1), ("xz", 0, 2), ("xt", 0, 3), ("yz", 1, 2), ("yt", 1, 3), ("zt", 2, 3)];
/// Heads: the switch that leaves one out, its name there, and here; its outputs.
const HEADS: [(&str, &str, &str, usize); 3] = [
    ("no_dx", "pos_deform", "means", 3),
    ("no_ds", "scales_deform", "scales", 3),
    ("no_dr", "rotations_deform", "quats", 4),
];
/// Channels of a texel of gs4d.
const LANES: usize = 16;

pub(crate) fn scene(file: &Exported<'_>) -> Result<Scene, CheckpointError> {
    refuse(file)?;
    let mut scene = cloud(file, CODE, METHOD)?;
    let Scene { settings, tensors, .. } = &mut scene;
    let Planes { nodes, channels } = Planes::of(file)?;
    let base = nodes[0];
    let factors: Vec<usize> = nodes.iter().map(|n| n[0] / base[0]).collect();
    let features = channels * nodes.len();
    let [width, inputs] = file.matrix(&format!("{NET}.feature_out.0.weight"))?;
    if inputs != features {
        return Err(misshapen(
            &format!("{NET}.feature_out.0.weight"),
            &[width, inputs],
            format!("F32 [_, {features}]"),
        ));
    }
    let depth = (0..).take_while(|k| file.has(&format!("{NET}.feature_out.{}.weight", 2 * k))).count();
    for (l, nodes) in nodes.iter().enumerate() {
        for (p, (pair, a, b)) in PLANES.into_iter().enumerate() {
            let plane = file.values(&format!("{NET}.grid.grids.{l}.{p}"), &[1, channels, nodes[b], nodes[a]])?;
            tensors.push((format!("field.planes.{pair}.{l}"), mirrored(&plane, channels, *nodes, (a, b))));
        }
    }
    for k in 0..depth {
        let inputs = if k == 0 { features } else { width };
        let (from, to) = (format!("{NET}.feature_out.{}", 2 * k), format!("field.trunk.{k}"));
        tensors.extend(layer(file, &from, &to, [width, inputs])?);
    }
    let mut hidden = Vec::new();
    for (switch, from, to, outputs) in HEADS {
        let moves = !file.flag(switch)?;
        settings.push(set(&format!("field.move_{to}"), moves));
        if moves {
            hidden.push((format!("{NET}.{from}.1"), width));
            tensors.extend(layer(file, &format!("{NET}.{from}.3"), &format!("field.{to}"), [outputs, width])?);
        }
    }
    tensors.extend(stacked(file, &hidden, "field.hidden", width)?);
    settings.extend([
        set("margin", 0.0),
        set("field.width", whole(width)),
        set("field.depth", whole(depth)),
        set("field.hexplane.channels", whole(channels)),
        set_list("field.hexplane.levels", &factors.iter().map(|f| whole(*f)).collect::<Vec<_>>()),
        set_list("field.hexplane.resolution", &base.map(whole)),
    ]);
    Ok(Scene { bounds: bounds(file)?, ..scene })
}

/// Fails for what the field of gs4d does not have.
fn refuse(file: &Exported<'_>) -> Result<(), CheckpointError> {
    let unsupported =
        |what: &str| Err(CheckpointError::Unsupported { code: CODE, what: what.to_owned(), method: METHOD });
    for (switch, what) in [
        ("no_grid", "a field without planes (no_grid)"),
        ("empty_voxel", "the grid of empty space (empty_voxel)"),
        ("static_mlp", "the network of static points (static_mlp)"),
        ("apply_rotation", "the product of quaternions (apply_rotation)"),
    ] {
        if file.flag_or(switch, false)? {
            return unsupported(what);
        }
    }
    for (switch, head, what) in [
        ("no_do", "opacity_deform", "opacity that changes with time (no_do=False)"),
        ("no_dshs", "shs_deform", "colour that changes with time (no_dshs=False)"),
    ] {
        // A head without a switch is of a version that always has it.
        let has = file.has(&format!("{NET}.{head}.1.weight"));
        if has && !file.flag(switch)? {
            return unsupported(what);
        }
    }
    let encodes = !file.setting("grid_pe").is_null() && file.number("grid_pe")? != 0.0;
    if encodes { unsupported("the encoding of features (grid_pe)") } else { Ok(()) }
}

/// Sizes of the planes.
struct Planes {
    /// Nodes along x, y, z, t of each level.
    nodes: Vec<[usize; 4]>,
    channels: usize,
}

impl Planes {
    fn of(file: &Exported<'_>) -> Result<Self, CheckpointError> {
        let name = |l: usize, p: usize| format!("{NET}.grid.grids.{l}.{p}");
        let (mut nodes, mut channels): (Vec<[usize; 4]>, _) = (Vec::new(), 0);
        while nodes.is_empty() || file.has(&name(nodes.len(), 0)) {
            let l = nodes.len();
            let sizes = |p: usize| -> Result<[usize; 3], CheckpointError> {
                let shape = file.tensor(&name(l, p))?.shape;
                match shape[..] {
                    [1, channels, b, a] if a > 1 && b > 1 => Ok([channels, b, a]),
                    _ => Err(misshapen(&name(l, p), &shape, "F32 [1, channels, nodes, nodes]".to_owned())),
                }
            };
            let ([c, y, x], [_, t, z]) = (sizes(0)?, sizes(5)?);
            channels = c;
            let level = [x, y, z, t];
            let base = nodes.first().copied().unwrap_or(level);
            let factor = x / base[0];
            let fits = (0..3).all(|d| level[d] == factor * base[d]) && t == base[3];
            if !fits || !channels.is_multiple_of(LANES) {
                let want = format!("a multiple of {:?} nodes with channels a multiple of {LANES}", &base[..3]);
                return Err(misshapen(&name(l, 0), &[1, c, y, x], want));
            }
            nodes.push(level);
        }
        Ok(Self { nodes, channels })
    }
}

/// A plane over axes `a` (fast) and `b`, in gs4d's order of channels, space reversed, the time rows that are never read left out.
fn mirrored(plane: &[f32], channels: usize, nodes: [usize; 4], (a, b): (usize, usize)) -> Vec<f32> {
    let (wide, high) = (nodes[a], nodes[b]);
    let first = if b == 3 { (high - 1) / 2 } else { 0 };
    let rows: Vec<usize> = if b == 3 { (first..high).collect() } else { (0..high).rev().collect() };
    let mut out = Vec::with_capacity(channels * wide * rows.len());
    for group in (0..channels).step_by(LANES) {
        for row in &rows {
            for column in (0..wide).rev() {
                out.extend((group..group + LANES).map(|c| plane[(c * high + row) * wide + column]));
            }
        }
    }
    out
}

/// The box of the planes.
fn bounds(file: &Exported<'_>) -> Result<[Vec3; 2], CheckpointError> {
    let aabb = file.values(&format!("{NET}.grid.aabb"), &[2, 3])?;
    let [upper, lower] = [0, 3].map(|k| Vec3::from_slice(&aabb[k..]));
    if lower.cmplt(upper).all() {
        return Ok([lower, upper]);
    }
    let want = "the upper corner of a box above its lower one".to_owned();
    Err(CheckpointError::Shape { name: format!("{NET}.grid.aabb"), got: format!("{aabb:?}"), want })
}
