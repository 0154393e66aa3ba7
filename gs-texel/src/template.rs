//! The template: a mesh in its bind pose, with texture coordinates, skin weights, materials and morph targets.

use glam::{Vec2, Vec3, Vec4};
use gs_core::Image;

/// A skinned mesh in its bind pose.
///
/// Vertices are welded: one row per distinct point of the surface, whatever seams of texture or normals run through it.
/// Texture coordinates belong to corners of faces.
#[derive(Clone, Debug, Default)]
pub struct Template {
    /// `v̄`: positions in the bind pose, `N` rows.
    pub vertices: Vec<Vec3>,
    /// Triangles, `F` rows of vertex numbers, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
    /// Texture coordinates, `v` downwards.
    pub uvs: Vec<Vec2>,
    /// The triangles again, as numbers of texture coordinates; `F` rows, or none where the mesh has no coordinates.
    pub face_uvs: Vec<[u32; 3]>,
    /// Number of each triangle's material; `F` rows.
    pub face_materials: Vec<u16>,
    /// What the surface looks like.
    pub materials: Vec<Material>,
    /// Which joints move a vertex, and how much.
    pub weights: SkinWeights,
    /// Shapes that are added before skinning.
    pub morphs: Vec<Morph>,
}

/// Rows of joints and weights, `Σ_j w = 1` in each, as many a row as it needs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinWeights {
    /// Row `i` is `begins[i]..begins[i + 1]`; `N + 1` values.
    pub begins: Vec<u32>,
    /// Joint numbers.
    pub joints: Vec<u32>,
    /// Weights, all above 0.
    pub weights: Vec<f32>,
}

impl SkinWeights {
    /// Joints and weights of vertex `i`.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (u32, f32)> + '_ {
        let range = self.begins[i] as usize..self.begins[i + 1] as usize;
        self.joints[range.clone()].iter().copied().zip(self.weights[range].iter().copied())
    }
}

/// A morph target.
#[derive(Clone, Debug, Default)]
pub struct Morph {
    /// Its name, empty if the file gives none.
    pub name: String,
    /// `Δ`: offsets in the bind pose at weight 1, `N` rows.
    pub offsets: Vec<Vec3>,
}

/// The appearance of some faces.
#[derive(Clone, Debug)]
pub struct Material {
    /// Its name, empty if the file gives none.
    pub name: String,
    /// Display-encoded colour and opacity that the texture is multiplied by.
    pub factor: Vec4,
    /// Colour `[0, 1]`, display-encoded, 4 channels; none: the factor alone.
    pub texture: Option<Image>,
    /// Texels of less opacity are holes; none: no holes.
    pub cutout: Option<f32>,
    /// Seen from behind too.
    pub double_sided: bool,
}
