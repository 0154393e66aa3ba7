//! The template: a mesh in its bind pose, with texture coordinates, skin weights, materials and morph targets.

use glam::{Vec2, Vec3, Vec4};
use gs_core::Image;
use std::sync::Arc;

/// A skinned mesh in its bind pose.
///
/// Vertices are welded: one row per distinct point of the surface, whatever seams of texture or normals run through it.
/// Texture coordinates belong to corners of faces.
#[derive(Clone, Debug, Default, PartialEq)]
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
    /// Where the corners of each triangle lie in their material's texture, which repeats or not as that says; `F` rows,
    /// or none where that is where they lie in the atlas (`uvs`).
    pub paint: Vec<[Vec2; 3]>,
    /// Display-encoded colour and opacity of each triangle's corners, which materials without a texture are multiplied by;
    /// `F` rows, or none where the mesh has no colours.
    pub face_colors: Vec<[Vec4; 3]>,
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
    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.begins.len().saturating_sub(1)
    }

    /// Whether there is no vertex.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Appends a row: equal joints are merged, weights that are not positive and finite left out, the rest made to sum to
    /// 1. Returns `false`, with weight 1 on `fallback`, if none is left.
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

    /// Joints and weights of vertex `i`.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (u32, f32)> + '_ {
        let range = self.begins[i] as usize..self.begins[i + 1] as usize;
        self.joints[range.clone()].iter().copied().zip(self.weights[range].iter().copied())
    }
}

/// A morph target.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Morph {
    /// Its name, empty if the file gives none.
    pub name: String,
    /// `Δ`: offsets in the bind pose at weight 1, `N` rows.
    pub offsets: Vec<Vec3>,
}

/// The appearance of some faces.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Its name, empty if the file gives none.
    pub name: String,
    /// Display-encoded colour and opacity that the texture is multiplied by.
    pub factor: Vec4,
    /// Colour `[0, 1]`, display-encoded, 4 channels; materials may share one. None: the factor alone.
    pub texture: Option<Arc<Image>>,
    /// Texels of less opacity are holes; none: no holes.
    pub cutout: Option<f32>,
    /// Seen from behind too.
    pub double_sided: bool,
    /// How the texture goes on outside `[0, 1]`, along `u` and `v`.
    pub wrap: [Wrap; 2],
}

/// How a texture goes on outside `[0, 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Again and again.
    #[default]
    Repeat,
    /// Its border.
    Clamp,
    /// Again and again, every second one turned round.
    Mirror,
}

impl Wrap {
    /// The coordinate in `[0, 1]` that is read for `x`.
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

    /// The texel that is read for texel number `x` of a row of `n`.
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
    /// Colour and opacity at a place of the texture: bilinear, display-encoded.
    pub fn colour(&self, uv: Vec2) -> Vec4 {
        self.colour_and_slope(uv).0
    }

    /// The same, and its derivatives along `u` and `v`.
    pub fn colour_and_slope(&self, uv: Vec2) -> (Vec4, [Vec4; 2]) {
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
    /// Where the corners of a triangle lie in its material's texture, if it has texture coordinates.
    pub fn painted(&self, face: usize) -> Option<[Vec2; 3]> {
        let in_atlas = || self.face_uvs.get(face).map(|f| f.map(|k| self.uvs[k as usize]));
        self.paint.get(face).copied().or_else(in_atlas)
    }

    /// Display-encoded colour and opacity of a point of a triangle, by its three barycentric coordinates.
    pub fn colour(&self, face: usize, bary: [f32; 3]) -> Vec4 {
        self.colour_and_slopes(face, bary).0
    }

    /// The same, and its derivatives with respect to the barycentric coordinates.
    pub fn colour_and_slopes(&self, face: usize, bary: [f32; 3]) -> (Vec4, [Vec4; 3]) {
        let material = self.face_materials.get(face).and_then(|&m| self.materials.get(usize::from(m)));
        let corners = self.face_colors.get(face).filter(|_| material.is_none_or(|m| m.texture.is_none()));
        let corners = corners.copied().unwrap_or([Vec4::ONE; 3]);
        let own = corners[0] * bary[0] + corners[1] * bary[1] + corners[2] * bary[2];
        let Some(material) = material else { return (own, corners) };
        let Some(at) = self.painted(face) else { return (own * material.factor, corners.map(|c| c * material.factor)) };
        let (color, [u, v]) = material.colour_and_slope(at[0] * bary[0] + at[1] * bary[1] + at[2] * bary[2]);
        let slope = |k: usize| corners[k] * color + own * (u * at[k].x + v * at[k].y);
        (own * color, [0, 1, 2].map(slope))
    }

    /// `v̄ + Σ_k w_k Δ_k`: the vertices with morphs of these weights, in the bind pose.
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
