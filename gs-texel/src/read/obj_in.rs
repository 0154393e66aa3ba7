//! OBJ meshes (the `tobj` crate) as static characters on one joint.

use super::ReadOptions;
use super::buffers::Folder;
use super::error::CharacterError;
use super::weld::RawMesh;
use crate::character::Character;
use crate::skeleton::{Joint, Node, Skeleton, Trs};
use crate::template::Material;
use glam::{DAffine3, Vec2, Vec3, Vec4};
use gs_core::io::images::decode_rgba8;
use std::cell::RefCell;
use std::sync::Arc;

pub(super) fn read(
    bytes: &[u8],
    folder: &Folder<'_>,
    options: &ReadOptions,
) -> Result<(RawMesh, Character), CharacterError> {
    let file = folder.file;
    let settings = tobj::LoadOptions { triangulate: true, single_index: false, ..tobj::LoadOptions::default() };
    // Keeps the error of a material file, which is more specific than that of tobj.
    let refused = RefCell::new(None);
    let library = |path: &std::path::Path| {
        let empty = Ok(Default::default());
        if !options.textures {
            return empty;
        }
        match material_file(&path.to_string_lossy(), folder) {
            Ok(text) => tobj::load_mtl_buf(&mut text.as_slice()),
            Err(e) => {
                *refused.borrow_mut() = Some(e);
                empty
            }
        }
    };
    let syntax = |e: tobj::LoadError| CharacterError::Syntax { file: file.into(), what: format!("no OBJ: {e}") };
    let (models, materials) = tobj::load_obj_buf(&mut &*bytes, &settings, library).map_err(syntax)?;
    if let Some(error) = refused.into_inner() {
        return Err(error);
    }
    let mut out = RawMesh::default();
    for model in &models {
        add(&mut out, model, materials.as_ref().map_or(0, Vec::len), file)?;
    }
    let mut character = Character { skeleton: static_skeleton(), ..Character::default() };
    for material in materials.iter().flatten() {
        character.template.materials.push(material_of(material, folder)?);
    }
    character.template.materials.push(Material::default());
    Ok((out, character))
}

/// The text of a material file. Refuses colours with less than three numbers, on which `tobj` panics.
fn material_file(name: &str, folder: &Folder<'_>) -> Result<Vec<u8>, CharacterError> {
    let text = folder.read(name)?;
    for (k, line) in String::from_utf8_lossy(&text).lines().enumerate() {
        let mut words = line.split_whitespace();
        let Some(colour) = words.next().filter(|w| ["Ka", "Kd", "Ks", "Ke"].contains(w)) else { continue };
        let numbers = words.count();
        if numbers < 3 {
            let what = format!("{numbers} numbers; a colour has three");
            let place = format!("line {}, `{colour}`", k + 1);
            return Err(CharacterError::Malformed { file: name.into(), place, what });
        }
    }
    Ok(text)
}

fn static_skeleton() -> Skeleton {
    let nodes = vec![Node { name: "body".into(), parent: None, rest: Trs::IDENTITY }];
    Skeleton { nodes, joints: vec![Joint { node: 0, inverse_bind: DAffine3::IDENTITY }], ..Skeleton::default() }
}

/// Adds the triangles of a model. `v` points up in OBJ, down here.
fn add(out: &mut RawMesh, model: &tobj::Model, materials: usize, file: &str) -> Result<(), CharacterError> {
    let (mesh, base) = (&model.mesh, out.points.len() as u32);
    let place = |what: &str| format!("{what} of `{}`", model.name.chars().take(60).collect::<String>());
    let check = |what: &str, values: &[f32], width: usize| match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(at) => Err(CharacterError::NotFinite {
            file: file.into(),
            place: place(what),
            row: at / width,
            component: at % width,
            value: values.get(at).copied().map_or(f64::NAN, f64::from),
        }),
    };
    check("positions", &mesh.positions, 3)?;
    check("texture coordinates", &mesh.texcoords, 2)?;
    out.points.extend(mesh.positions.as_chunks().0.iter().map(|p| Vec3::from_array(*p)));
    for _ in mesh.positions.as_chunks::<3>().0 {
        out.weights.push([(0, 1.0)], 0);
    }
    let uvs = mesh.texcoords.as_chunks::<2>().0;
    let uv = |k: &u32| uvs.get(*k as usize).map(|&[u, v]| Vec2::new(u, 1.0 - v));
    let material = mesh.material_id.unwrap_or(materials).min(materials);
    let material = u16::try_from(material).unwrap_or(u16::MAX);
    let count = out.points.len() as u32;
    for (k, &face) in mesh.indices.as_chunks::<3>().0.iter().enumerate() {
        let face: [u32; 3] = face.map(|v| v.saturating_add(base));
        if face.iter().any(|&v| v >= count) {
            let what = format!("triangle {k} has a vertex that does not exist");
            return Err(CharacterError::Malformed { file: file.into(), place: place("faces"), what });
        }
        let corners = mesh.texcoord_indices.get(3 * k..3 * k + 3).unwrap_or(&[]);
        out.faces.push(face);
        out.face_materials.push(material);
        out.material_uvs.push(match corners {
            [a, b, c] => uv(a).zip(uv(b)).zip(uv(c)).map(|((a, b), c)| [a, b, c]),
            _ => None,
        });
    }
    Ok(())
}

fn material_of(source: &tobj::Material, folder: &Folder<'_>) -> Result<Material, CharacterError> {
    let colour = source.diffuse.unwrap_or([1.0; 3]).map(|v| if v.is_finite() { v } else { 1.0 });
    let texture = source.diffuse_texture.as_deref().map(|name| {
        let bytes = folder.read(name)?;
        let image = decode_rgba8(&bytes, name, folder.limits)?.to_image();
        Ok::<_, CharacterError>(Arc::new(image))
    });
    Ok(Material {
        name: source.name.clone(),
        factor: Vec4::new(colour[0], colour[1], colour[2], source.dissolve.filter(|d| d.is_finite()).unwrap_or(1.0)),
        texture: texture.transpose()?,
        ..Material::default()
    })
}
