//! A character: a template, the skeleton that moves it, and its animation clips.

use crate::clip::Clip;
use crate::skeleton::{Pose, Skeleton};
use crate::skin::{Skinning, skin};
use crate::template::Template;
use glam::Vec3;

/// A rigged, animated mesh, from a file ([`mod@crate::read`]) or made in code ([`crate::figure`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Character {
    /// The mesh in its bind pose.
    pub template: Template,
    /// Nodes and joints; the template's skin weights refer to its joints.
    pub skeleton: Skeleton,
    /// Animations, in the order of the file.
    pub clips: Vec<Clip>,
    /// Row of the template's welded vertex for each vertex of the file, in its order: meshes of the scene, their primitives,
    /// their rows.
    pub source_vertices: Vec<u32>,
    /// What the reader repaired or left out, counted.
    pub fallbacks: Fallbacks,
}

/// Counts of what a reader repaired or left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Fallbacks {
    /// Vertices without a positive weight: bound to the nearest joint of their skin.
    pub unbound_vertices: usize,
    /// Vertices with negative weights, which are dropped, or a sum farther than 1e-2 from 1, which is normalised.
    pub mended_weights: usize,
    /// Triangles dropped because two of their corners are one vertex.
    pub collapsed_faces: usize,
    /// Triangles of no area in space, kept.
    pub flat_faces: usize,
    /// Triangles of no area in the texture, kept; they own no texel.
    pub flat_face_uvs: usize,
    /// Primitives of points or lines, or without positions: left out.
    pub ignored_primitives: usize,
    /// Animation channels of things that are not read (or of nothing): left out.
    pub ignored_channels: usize,
}

impl Fallbacks {
    /// The counts above 0, each with a description.
    pub fn list(&self) -> Vec<(&'static str, usize)> {
        let all = [
            ("vertices without weights, bound to the nearest joint", self.unbound_vertices),
            ("vertices with mended weights", self.mended_weights),
            ("collapsed triangles dropped", self.collapsed_faces),
            ("triangles of no area", self.flat_faces),
            ("triangles of no area in the texture", self.flat_face_uvs),
            ("primitives ignored", self.ignored_primitives),
            ("animation channels ignored", self.ignored_channels),
        ];
        all.into_iter().filter(|(_, n)| *n > 0).collect()
    }
}

impl Character {
    /// The first clip called `name`.
    pub fn clip(&self, name: &str) -> Option<&Clip> {
        self.clips.iter().find(|c| c.name == name)
    }

    /// World positions of the template's vertices at a pose, morphs included; one row per vertex.
    pub fn posed(&self, pose: &Pose, skinning: Skinning) -> Vec<Vec3> {
        let transforms = skinning.blend(&self.template.weights, &self.skeleton.skinning(pose));
        skin(&self.template.morphed(&pose.morphs), &transforms)
    }
}
