//! Materials of a glTF file: base colour, its texture and texture transform.

use super::accessors::Data;
use super::buffers::Folder;
use super::error::CharacterError;
use crate::template::{Material, Wrap};
use glam::{Mat2, Vec2, Vec4};
use gltf::json;
use gltf::json::material::AlphaMode;
use gltf::json::texture::WrappingMode;
use gltf::json::validation::Checked;
use gs_core::Image;
use gs_core::io::images::decode_rgba8;
use std::sync::Arc;

/// Default opacity threshold of cut-out textures (glTF's).
const DEFAULT_CUTOUT: f32 = 0.5;

/// The set of texture coordinates of a material, and their transform.
#[derive(Clone, Copy)]
pub(super) struct Layout {
    /// Index of the set (`TEXCOORD_n`).
    pub(super) set: u32,
    /// `uv' = linear · uv + offset`.
    linear: Mat2,
    offset: Vec2,
}

impl Layout {
    const IDENTITY: Self = Self { set: 0, linear: Mat2::IDENTITY, offset: Vec2::ZERO };

    pub(super) fn apply(&self, uv: Vec2) -> Vec2 {
        self.linear * uv + self.offset
    }
}

/// All materials of the file, then the default one.
pub(super) fn read(
    data: &Data<'_>,
    folder: &Folder<'_>,
    textures: bool,
) -> Result<Vec<(Material, Layout)>, CharacterError> {
    let mut images = vec![None; data.root.images.len()];
    let mut decoded = 0;
    let mut out = Vec::with_capacity(data.root.materials.len() + 1);
    for (i, source) in data.root.materials.iter().enumerate() {
        let (mut material, layout, image) = material(data, source, i)?;
        if let Some(image) = image.filter(|_| textures) {
            let slot = images.get_mut(image);
            let slot =
                slot.ok_or_else(|| data.malformed(format!("material {i}"), "has an image that does not exist"))?;
            if slot.is_none() {
                let loaded = load(data, folder, image)?;
                decoded += 4 * loaded.data.len() as u64;
                if decoded > folder.limits.max_image_bytes {
                    return Err(CharacterError::TooMuch {
                        file: data.file.into(),
                        what: "the sum of the images".into(),
                    });
                }
                *slot = Some(Arc::new(loaded));
            }
            material.texture.clone_from(slot);
        }
        out.push((material, layout));
    }
    out.push((Material::default(), Layout::IDENTITY));
    Ok(out)
}

/// A material without its image, and the index of that image.
fn material(
    data: &Data<'_>,
    source: &json::Material,
    i: usize,
) -> Result<(Material, Layout, Option<usize>), CharacterError> {
    let base = &source.pbr_metallic_roughness;
    let factor = Vec4::from_array(base.base_color_factor.0);
    let cutoff = source.alpha_cutoff.as_ref().map_or(DEFAULT_CUTOUT, |c| c.0);
    let mut out = Material {
        name: source.name.clone().unwrap_or_default(),
        factor: factor.truncate().map(srgb_encode).extend(factor.w),
        cutout: matches!(source.alpha_mode, Checked::Valid(AlphaMode::Mask)).then_some(cutoff),
        double_sided: source.double_sided,
        ..Material::default()
    };
    let wrong = |what: &str| data.malformed(format!("material {i}"), what);
    if !factor.is_finite() || !cutoff.is_finite() {
        return Err(wrong("has a colour or cutoff that is not finite"));
    }
    let Some(info) = &base.base_color_texture else { return Ok((out, Layout::IDENTITY, None)) };
    let texture = data.root.get(info.index).ok_or_else(|| wrong("has a texture that does not exist"))?;
    if let Some(sampler) = texture.sampler {
        let sampler = data.root.get(sampler).ok_or_else(|| wrong("has a sampler that does not exist"))?;
        out.wrap = [&sampler.wrap_s, &sampler.wrap_t].map(|w| match w {
            Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
            Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
            _ => Wrap::Repeat,
        });
    }
    let layout = layout(info);
    if !layout.linear.is_finite() || !layout.offset.is_finite() {
        return Err(wrong("has a texture transform that is not finite"));
    }
    Ok((out, layout, Some(texture.source.value())))
}

/// `uv' = offset + R(rotation) · scale · uv`, counter-clockwise where `v` points down.
fn layout(info: &json::texture::Info) -> Layout {
    let transform = info.extensions.as_ref().and_then(|e| e.texture_transform.as_ref());
    let Some(t) = transform else { return Layout { set: info.tex_coord, ..Layout::IDENTITY } };
    let (sin, cos) = t.rotation.0.sin_cos();
    let [sx, sy] = t.scale.0;
    Layout {
        set: t.tex_coord.unwrap_or(info.tex_coord),
        linear: Mat2::from_cols(Vec2::new(cos * sx, -sin * sx), Vec2::new(sin * sy, cos * sy)),
        offset: Vec2::from_array(t.offset.0),
    }
}

/// A linear colour value, display-encoded (sRGB).
pub(super) fn srgb_encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear.max(0.0) } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

fn load(data: &Data<'_>, folder: &Folder<'_>, index: usize) -> Result<Image, CharacterError> {
    let wrong = |what: &str| data.malformed(format!("image {index}"), what);
    let image = data.root.images.get(index).ok_or_else(|| wrong("does not exist"))?;
    let name = format!("{} (image {index})", data.file);
    let read = |bytes: &[u8]| Ok(decode_rgba8(bytes, &name, folder.limits)?.to_image());
    match (image.buffer_view, &image.uri) {
        (Some(view), _) => read(data.view(view)?.0),
        (None, Some(uri)) => read(&folder.read(uri)?),
        (None, None) => Err(wrong("has neither a buffer view nor a URI")),
    }
}
