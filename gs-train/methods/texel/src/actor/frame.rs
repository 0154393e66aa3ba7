//! A frame on its way through the networks: the posed template, what is seen on it, and the inputs of both.

use glam::{Affine3A, Vec3};
use gs_texel::gaussians::TexelBase;

/// The template at a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Posed {
    /// The bind pose with the morphs the pose knows of, `N` rows.
    pub canonical: Vec<Vec3>,
    /// Blended skinning matrices, `N` rows.
    pub transforms: Vec<Affine3A>,
    /// Their rotations `(w, x, y, z)`.
    pub(super) turns: Vec<[f32; 4]>,
    /// `κ`.
    pub(super) kappas: Vec<f32>,
    /// Normals of the posed template.
    pub normals: Vec<Vec3>,
    /// The same without the rotation of its root.
    pub(super) root_free: Vec<Vec3>,
}

/// What the cameras say about the texels of a table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Display-encoded colours, 0 where unseen; `K` rows.
    pub colors: Vec<[f32; 3]>,
    /// Number of views, 0 where unseen; a mean where texels were resized.
    pub views: Vec<f32>,
}

impl Seen {
    /// Takes a light off the colours.
    pub(super) fn divide(&mut self, light: [f32; 3]) {
        if light != [1.0; 3] {
            self.colors.iter_mut().for_each(|c| c.iter_mut().zip(light).for_each(|(c, light)| *c /= light));
        }
    }
}

/// A frame before GeoNet: the posed template and what is seen on it.
#[derive(Clone, Debug, PartialEq)]
pub struct First {
    /// The template in the pose of this frame.
    pub posed: Posed,
    /// What is seen on it, at the size of unprojection, in the light of the mean textures.
    pub seen: Seen,
    /// Light of the frame over that of the mean textures, per channel; 1 unless light is followed.
    pub light: [f32; 3],
    /// GeoNet's input, `[S, S, 6]`.
    pub input: Vec<f32>,
}

/// A frame after GeoNet: offsets, and the inputs of GauNet.
#[derive(Clone, Debug, PartialEq)]
pub struct Second {
    /// `D`, metres in the bind pose, `N` rows.
    pub offsets: Vec<Vec3>,
    /// Where texels lie and how they are turned.
    pub base: TexelBase,
    /// What is seen on them, in the light of the mean textures.
    pub seen: Seen,
    /// Colours of the images over those of the Gaussians that `seen` leads to, per channel.
    pub light: [f32; 3],
    /// Light that [`Actor::relit`](super::Actor::relit) put on `seen`, over that of the mean textures.
    pub relit: [f32; 3],
    /// Light to be put on colours that texels have of their own: that of `relit` where `light` takes it off the Gaussians again.
    pub own: [f32; 3],
    /// GauNet's input, `[S, S, 6]`.
    pub input: Vec<f32>,
}
