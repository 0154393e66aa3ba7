//! glTF 2.0, as text or GLB, into a character.

use super::accessors::Data;
use super::buffers::Folder;
use super::error::CharacterError;
use super::meshes::Meshes;
use super::weld::RawMesh;
use super::{ReadOptions, clips, container, materials, nodes};
use crate::character::Character;
use crate::skeleton::Skeleton;

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
    let Meshes { mesh, joints, blocks, rest_morphs, mut fallbacks, .. } = meshes;
    skeleton.joints = joints;
    skeleton.rest_morphs = rest_morphs;
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
