//! glTF 2.0, as text or GLB, into a character.

use super::accessors::Data;
use super::buffers::Folder;
use super::error::CharacterError;
use super::meshes::Meshes;
use super::weld::RawMesh;
use super::{ReadOptions, clips, container, materials, nodes};
use crate::character::Character;
use crate::skeleton::Skeleton;
use glam::{DAffine3, DVec3, Vec3};

/// A unit of the bind space that differs from the world's by at most this share is taken for it.
const UNIT_TOLERANCE: f64 = 1e-3;

pub(super) fn read(
    bytes: &[u8],
    folder: &Folder<'_>,
    options: &ReadOptions,
) -> Result<(RawMesh, Character), CharacterError> {
    let file = folder.file;
    let (json, binary) = container::split(bytes, file)?;
    let root = container::parse(json, file)?;
    container::extensions(&root, file)?;
    let buffers = container::buffers(&root, binary, folder)?;
    let data = Data::new(file, &root, buffers, json.len());
    let nodes = nodes::read(&data)?;
    let materials = materials::read(&data, folder, options.textures)?;
    let mut skeleton = Skeleton { nodes: nodes.nodes.clone(), ..Skeleton::default() };
    let rest = skeleton.globals(&skeleton.rest_pose());
    if rest.iter().any(|g| !g.is_finite()) {
        return Err(data.malformed("nodes", "have frames that are not finite"));
    }
    let mut meshes = Meshes::new(&data, &nodes, rest, &materials, options.uv_set);
    meshes.read()?;
    let Meshes { mut mesh, joints, blocks, rest_morphs, mut fallbacks, .. } = meshes;
    skeleton.joints = joints;
    skeleton.rest_morphs = rest_morphs;
    to_world_units(&mut mesh, &mut skeleton);
    if mesh.points.iter().chain(mesh.deltas.iter().map(|d| &d.2)).any(|p| !p.is_finite()) {
        return Err(data.malformed("nodes", "scale a mesh beyond the range of numbers"));
    }
    let clips = clips::read(&data, &nodes, &blocks, &mut fallbacks)?;
    skeleton.root = match &options.root_joint {
        None => skeleton.common_root(),
        Some(name) => {
            let missing = || data.malformed(format!("node `{name}`"), "does not exist, asked for as the root");
            skeleton.node(name).ok_or_else(missing)?
        }
    };
    let mut character = Character { skeleton, clips, fallbacks, ..Character::default() };
    character.template.materials = materials.into_iter().map(|(material, _)| material).collect();
    Ok((mesh, character))
}

/// Brings the bind space to the unit of the world; posed positions stay what they are.
fn to_world_units(mesh: &mut RawMesh, skeleton: &mut Skeleton) {
    let unit = bind_unit(mesh, skeleton);
    if (unit - 1.0).abs() <= UNIT_TOLERANCE {
        return;
    }
    let scale = |v: &mut Vec3| *v = (v.as_dvec3() * unit).as_vec3();
    mesh.points.iter_mut().for_each(scale);
    mesh.deltas.iter_mut().for_each(|(_, _, delta)| scale(delta));
    let back = DAffine3::from_scale(DVec3::splat(1.0 / unit));
    skeleton.joints.iter_mut().for_each(|j| j.inverse_bind *= back);
}

/// Length in the world of a unit of the bind space, at rest: the median over joints with weights, 1 without any.
fn bind_unit(mesh: &RawMesh, skeleton: &Skeleton) -> f64 {
    let at_rest = skeleton.skinning(&skeleton.rest_pose());
    let mut used = vec![false; at_rest.len()];
    for &joint in &mesh.weights.joints {
        used.get_mut(joint as usize).into_iter().for_each(|u| *u = true);
    }
    let of_used = at_rest.iter().zip(used).filter(|(_, used)| *used);
    let units = of_used.map(|(a, _)| a.matrix3.determinant().abs().cbrt());
    let mut units: Vec<f64> = units.filter(|u| u.is_normal()).collect();
    units.sort_by(f64::total_cmp);
    units.get(units.len() / 2).copied().unwrap_or(1.0)
}
