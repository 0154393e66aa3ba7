//! The template: a mesh in its bind pose with texture coordinates, skin weights, materials and morph targets.

use glam::{Vec2, Vec3, Vec4};
use gs_core::Image;
use std::sync::Arc;

/// A skinned mesh in its bind pose.
///
/// Vertices are welded: one row per distinct point of the surface, also along seams of texture or normals. Texture
/// coordinates belong to corners of faces. Each face has two sets: where it lies in the atlas ([`Template::uvs`]), and where it
/// reads the texture of its material ([`Template::corner_uvs`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Template {
    /// `v̄`: positions in the bind pose, in the unit of the world, `N` rows.
    pub vertices: Vec<Vec3>,
    /// Triangles: `F` rows of three vertex rows, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
    /// Atlas coordinates `(u, v)`, in `[0, 1]²` unless the file has others, `v` downwards.
    pub uvs: Vec<Vec2>,
    /// The same triangles as rows of `uvs`; `F` rows, or empty if the mesh has no texture coordinates.
    pub face_uvs: Vec<[u32; 3]>,
    /// Row of each triangle's material in `materials`; `F` rows.
    pub face_materials: Vec<u16>,
    /// Coordinates of each triangle's corners in its material's texture, which wraps by [`Material::wrap`]; `F` rows, or empty
    /// if they equal the atlas coordinates.
    pub material_uvs: Vec<[Vec2; 3]>,
    /// Display-encoded colour and opacity of each triangle's corners, a factor on materials without a texture; `F` rows, or
    /// empty if the mesh has no vertex colours.
    pub face_colors: Vec<[Vec4; 3]>,
    /// Materials, the rows that `face_materials` names.
    pub materials: Vec<Material>,
    /// Joints and weights of each vertex, `N` rows.
    pub weights: SkinWeights,
    /// Morph targets, added to the vertices before skinning.
    pub morphs: Vec<Morph>,
}

/// Sparse skin weights: per vertex any number of joints, whose weights sum to 1.
///
/// ```
/// use gs_texel::SkinWeights;
///
/// let mut weights = SkinWeights::default();
/// assert!(weights.push([(3, 0.5), (1, -0.2), (3, 0.5), (2, 1.0)], 0));
/// assert_eq!(weights.row(0).collect::<Vec<_>>(), [(3, 0.5), (2, 0.5)]);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinWeights {
    /// Vertex `i` has the entries `begins[i]..begins[i + 1]`; `N + 1` values.
    pub begins: Vec<u32>,
    /// Joint of each entry, a row of [`crate::Skeleton::joints`].
    pub joints: Vec<u32>,
    /// Weight of each entry, above 0.
    pub weights: Vec<f32>,
}

impl SkinWeights {
    /// Number of vertices `N`, the rows.
    pub fn len(&self) -> usize {
        self.begins.len().saturating_sub(1)
    }

    /// Whether there is no vertex.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Appends a vertex. Equal joints are merged, weights that are not positive and finite are dropped, the rest is normalised
    /// to sum 1. If none is left, `fallback` gets weight 1 and the result is `false`.
    pub fn push(&mut self, influences: impl IntoIterator<Item = (u32, f32)>, fallback: u32) -> bool {
        if self.begins.is_empty() {
            self.begins.push(0);
        }
        let start = self.joints.len();
        for (joint, weight) in influences {
            if !(weight > 0.0 && weight.is_finite()) {
                continue;
            }
            match self.joints[start..].iter().position(|&j| j == joint) {
                Some(at) => self.weights[start + at] = (self.weights[start + at] + weight).min(f32::MAX),
                None => {
                    self.joints.push(joint);
                    self.weights.push(weight);
                }
            }
        }
        let sum: f64 = self.weights[start..].iter().map(|&w| f64::from(w)).sum();
        self.weights[start..].iter_mut().for_each(|w| *w = (f64::from(*w) / sum) as f32);
        let bound = self.joints.len() > start;
        if !bound {
            self.joints.push(fallback);
            self.weights.push(1.0);
        }
        self.begins.push(self.joints.len() as u32);
        bound
    }

    /// `(joint, weight)` of every entry of vertex `i`.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (u32, f32)> + '_ {
        let range = self.begins[i] as usize..self.begins[i + 1] as usize;
        self.joints[range.clone()].iter().copied().zip(self.weights[range].iter().copied())
    }
}

/// A morph target (blend shape): offsets of all vertices.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Morph {
    /// Name from the file; empty if it has none.
    pub name: String,
    /// `Δ`: offsets of the vertices in the bind pose at weight 1, `N` rows.
    pub offsets: Vec<Vec3>,
}

/// Base colour of the faces that refer to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name from the file; empty if it has none.
    pub name: String,
    /// Display-encoded colour and opacity, a factor on the texture.
    pub factor: Vec4,
    /// Display-encoded RGBA in `[0, 1]`, 4 channels; may be shared by materials. `None`: the factor alone.
    pub texture: Option<Arc<Image>>,
    /// Opacity below which a texel is a hole; `None`: no holes.
    pub cutout: Option<f32>,
    /// Whether back faces are to be drawn too; nothing in this crate depends on it.
    pub double_sided: bool,
    /// Wrap mode of the texture along `u` and `v`.
    pub wrap: [Wrap; 2],
}

/// How a texture continues outside `[0, 1]`.
///
/// ```
/// use gs_texel::Wrap;
///
/// assert_eq!([Wrap::Repeat, Wrap::Clamp, Wrap::Mirror].map(|w| w.at(1.25)), [0.25, 1.0, 0.75]);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Periodic with period 1.
    #[default]
    Repeat,
    /// Beyond the border, the border texel.
    Clamp,
    /// Periodic with period 2, every second copy mirrored.
    Mirror,
}

impl Wrap {
    /// The coordinate in `[0, 1]` that `x` maps to.
    pub fn at(self, x: f32) -> f32 {
        match self {
            Wrap::Repeat => x - x.floor(),
            Wrap::Clamp => x.clamp(0.0, 1.0),
            Wrap::Mirror => 1.0 - (x - 2.0 * (0.5 * x).floor() - 1.0).abs(),
        }
    }

    /// The derivative of that coordinate.
    fn slope(self, x: f32) -> f32 {
        match self {
            Wrap::Repeat => 1.0,
            Wrap::Clamp => f32::from(u8::from((0.0..=1.0).contains(&x))),
            Wrap::Mirror => 1.0 - 2.0 * (x.floor().rem_euclid(2.0)),
        }
    }

    /// The texel of `0..n` that texel `x` of an unbounded row maps to.
    fn texel(self, x: i64, n: usize) -> usize {
        let n = n as i64;
        let inside = match self {
            Wrap::Repeat => x.rem_euclid(n),
            Wrap::Clamp => x.clamp(0, n - 1),
            Wrap::Mirror => x.rem_euclid(2 * n).min(2 * n - 1 - x.rem_euclid(2 * n)),
        };
        inside as usize
    }
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            factor: Vec4::ONE,
            texture: None,
            cutout: None,
            double_sided: false,
            wrap: [Wrap::default(); 2],
        }
    }
}

impl Material {
    /// Display-encoded colour and opacity at a texture coordinate, bilinear, factor included.
    pub fn colour(&self, uv: Vec2) -> Vec4 {
        self.colour_and_slope(uv).0
    }

    /// [`Material::colour`] and its derivatives by `u` and `v`.
    fn colour_and_slope(&self, uv: Vec2) -> (Vec4, [Vec4; 2]) {
        let Some(texture) = self.texture.as_ref().filter(|t| t.width * t.height > 0 && t.channels == 4) else {
            return (self.factor, [Vec4::ZERO; 2]);
        };
        let x = self.wrap[0].at(uv.x) * texture.width as f32 - 0.5;
        let y = self.wrap[1].at(uv.y) * texture.height as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let texel = |dx: i64, dy: i64| {
            let u = self.wrap[0].texel(x0 as i64 + dx, texture.width);
            let v = self.wrap[1].texel(y0 as i64 + dy, texture.height);
            Vec4::from_slice(texture.pixel(u, v))
        };
        let [[a, b], [c, d]] = [0, 1].map(|dy| [0, 1].map(|dx| texel(dx, dy)));
        let (above, below) = (a.lerp(b, x - x0), c.lerp(d, x - x0));
        let along_u = (b - a).lerp(d - c, y - y0) * (texture.width as f32 * self.wrap[0].slope(uv.x));
        let along_v = (below - above) * (texture.height as f32 * self.wrap[1].slope(uv.y));
        (above.lerp(below, y - y0) * self.factor, [along_u * self.factor, along_v * self.factor])
    }
}

impl Template {
    /// Coordinates of a triangle's corners in its material's texture; `None` without texture coordinates.
    pub fn corner_uvs(&self, face: usize) -> Option<[Vec2; 3]> {
        let in_atlas = || self.face_uvs.get(face).map(|f| f.map(|k| self.uvs[k as usize]));
        self.material_uvs.get(face).copied().or_else(in_atlas)
    }

    /// Display-encoded colour and opacity at three barycentric coordinates of a triangle.
    pub fn colour(&self, face: usize, bary: [f32; 3]) -> Vec4 {
        self.colour_and_slopes(face, bary).0
    }

    /// [`Template::colour`] and its derivatives by the barycentric coordinates.
    pub(crate) fn colour_and_slopes(&self, face: usize, bary: [f32; 3]) -> (Vec4, [Vec4; 3]) {
        let material = self.face_materials.get(face).and_then(|&m| self.materials.get(usize::from(m)));
        let corners = self.face_colors.get(face).filter(|_| material.is_none_or(|m| m.texture.is_none()));
        let corners = corners.copied().unwrap_or([Vec4::ONE; 3]);
        let own = corners[0] * bary[0] + corners[1] * bary[1] + corners[2] * bary[2];
        let Some(material) = material else { return (own, corners) };
        let Some(at) = self.corner_uvs(face) else {
            return (own * material.factor, corners.map(|c| c * material.factor));
        };
        let (color, [u, v]) = material.colour_and_slope(at[0] * bary[0] + at[1] * bary[1] + at[2] * bary[2]);
        let slope = |k: usize| corners[k] * color + own * (u * at[k].x + v * at[k].y);
        (own * color, [0, 1, 2].map(slope))
    }

    /// Vertices of the bind pose with morphs: `v̄ + Σ_k w_k Δ_k`, `w` one weight per morph.
    pub fn morphed(&self, morphs: &[f32]) -> Vec<Vec3> {
        let mut vertices = self.vertices.clone();
        for (morph, &w) in self.morphs.iter().zip(morphs).filter(|(_, w)| **w != 0.0) {
            vertices.iter_mut().zip(&morph.offsets).for_each(|(v, &d)| *v += d * w);
        }
        vertices
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_cleaned() {
        let mut w = SkinWeights::default();
        assert!(w.is_empty());
        assert!(w.push([(3, 0.5), (1, -0.2), (3, 0.5), (2, 1.0), (9, f32::NAN)], 0));
        assert!(!w.push([(1, 0.0), (2, -1.0)], 7));
        assert_eq!(w.len(), 2);
        assert_eq!(w.row(0).collect::<Vec<_>>(), [(3, 0.5), (2, 0.5)]);
        assert_eq!(w.row(1).collect::<Vec<_>>(), [(7, 1.0)]);
        assert!(w.push([(1, f32::MAX), (2, f32::MAX)], 0));
        assert_eq!(w.row(2).collect::<Vec<_>>(), [(1, 0.5), (2, 0.5)]);
    }

    #[test]
    fn textures_go_on_as_they_say() {
        for (x, want) in
            [(0.25, [0.25; 3]), (1.25, [0.25, 1.0, 0.75]), (-0.25, [0.75, 0.0, 0.25]), (2.5, [0.5, 1.0, 0.5])]
        {
            assert_eq!([Wrap::Repeat, Wrap::Clamp, Wrap::Mirror].map(|w| w.at(x)), want, "{x}");
        }
        let mirrored: Vec<usize> = [-1, -4, 0, 1, 2, -2, 4, 3, 5].map(|x| Wrap::Mirror.texel(x, 3)).to_vec();
        assert_eq!(mirrored, [0, 2, 0, 1, 2, 1, 1, 2, 0]);
        let texture = Image { width: 2, height: 1, channels: 4, data: vec![0., 0., 0., 1., 1., 1., 1., 1.] };
        let mut material =
            Material { texture: Some(Arc::new(texture)), factor: Vec4::new(1.0, 0.5, 1.0, 1.0), ..Material::default() };
        assert_eq!(material.colour(Vec2::new(0.25, 0.5)), Vec4::new(0.0, 0.0, 0.0, 1.0));
        assert_eq!(material.colour(Vec2::new(0.5, 7.5)), Vec4::new(0.5, 0.25, 0.5, 1.0));
        assert_eq!(material.colour(Vec2::new(0.0, 0.5)), Vec4::new(0.5, 0.25, 0.5, 1.0), "across the border");
        material.wrap = [Wrap::Clamp; 2];
        assert_eq!(material.colour(Vec2::new(-3.0, 0.5)), Vec4::new(0.0, 0.0, 0.0, 1.0));
    }

    #[test]
    fn morphs_are_added() {
        let offsets = vec![Vec3::X, Vec3::Y];
        let morphs = vec![Morph { name: "a".into(), offsets: offsets.clone() }, Morph { name: "b".into(), offsets }];
        let template = Template { vertices: vec![Vec3::ZERO; 2], morphs, ..Template::default() };
        assert_eq!(template.morphed(&[0.5, 0.25]), [0.75 * Vec3::X, 0.75 * Vec3::Y]);
    }
}
