//! Nodes, joints and poses: forward kinematics in `f64`.
//!
//! ```text
//! G_j = G_parent(j) L_j        A_j = G_j B_j⁻¹        L = translation · rotation · scale
//! ```
//! `G` is a node's frame in the world, `B_j⁻¹` the inverse of the joint's frame in the bind pose, `A_j` the matrix that
//! skinning applies to the bind pose.

use crate::skin::rotation_of;
use glam::{DAffine3, DMat3, DVec3};
use gs_core::rot;

/// Below this sine two bones count as parallel.
const PARALLEL_SINE: f64 = 1e-9;

/// Translation, rotation and scale of a node relative to its parent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trs {
    /// Translation in the asset's units (glTF: metres).
    pub translation: DVec3,
    /// Quaternion `(w, x, y, z)` of any length but 0.
    pub rotation: [f64; 4],
    /// Scale along the node's own axes; may be negative or 0.
    pub scale: DVec3,
}

impl Trs {
    /// No translation, no rotation, scale 1.
    pub const IDENTITY: Self = Self { translation: DVec3::ZERO, rotation: [1.0, 0.0, 0.0, 0.0], scale: DVec3::ONE };

    /// A pure translation by `translation`.
    pub fn at(translation: DVec3) -> Self {
        Self { translation, ..Self::IDENTITY }
    }

    /// The matrix `L = translation · rotation · scale`.
    pub fn affine(&self) -> DAffine3 {
        let turn = rotation_matrix(self.rotation);
        DAffine3::from_mat3_translation(turn * DMat3::from_diagonal(self.scale), self.translation)
    }
}

/// The rotation matrix of a quaternion `(w, x, y, z)` of any length; the identity for length 0.
pub fn rotation_matrix(wxyz: [f64; 4]) -> DMat3 {
    let rows = rot::matrix(rot::normalise(wxyz).wxyz);
    DMat3::from_cols_array_2d(&rows).transpose()
}

/// The quaternion `(w, x, y, z)` of the rotation by `angle` radians about `axis` (any length; 0 gives the identity).
pub fn axis_angle(axis: DVec3, angle: f64) -> [f64; 4] {
    let axis = axis.normalize_or_zero() * (0.5 * angle).sin();
    let w = if axis == DVec3::ZERO { 1.0 } else { (0.5 * angle).cos() };
    [w, axis.x, axis.y, axis.z]
}

/// A node of the scene graph.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Name from the file; empty if it has none.
    pub name: String,
    /// Row of its parent in [`Skeleton::nodes`], smaller than its own; `None` for a root.
    pub parent: Option<u32>,
    /// Transform relative to the parent in the rest pose.
    pub rest: Trs,
}

/// A node that skin weights refer to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Row of the node in [`Skeleton::nodes`].
    pub node: u32,
    /// `B_j⁻¹`: maps the template's space to the joint's in the bind pose.
    pub inverse_bind: DAffine3,
}

/// A hierarchy of nodes, parents before children, and the joints among them.
///
/// ```
/// use glam::DVec3;
/// use gs_texel::{Node, Skeleton, Trs};
/// use std::f64::consts::FRAC_PI_2;
///
/// let node = |parent| Node { name: String::new(), parent, rest: Trs::at(DVec3::X) };
/// let arm = Skeleton { nodes: vec![node(None), node(Some(0))], ..Skeleton::default() };
/// let mut pose = arm.rest_pose();
/// assert_eq!(arm.globals(&pose)[1].translation, DVec3::new(2.0, 0.0, 0.0));
/// pose.turn(0, DVec3::Z, FRAC_PI_2);
/// assert!(arm.globals(&pose)[1].translation.abs_diff_eq(DVec3::new(1.0, 1.0, 0.0), 1e-15));
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skeleton {
    /// Nodes; every parent stands before its children.
    pub nodes: Vec<Node>,
    /// Joints; [`crate::SkinWeights::joints`] holds rows of this list.
    pub joints: Vec<Joint>,
    /// Row of the node whose rotation is the character's heading ([`Skeleton::root_rotation`]).
    pub root: u32,
    /// Weights of the template's morphs in the rest pose, one per morph.
    pub rest_morphs: Vec<f32>,
}

/// The transforms of all nodes and the weights of all morphs at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// Transform of each node relative to its parent; rows of [`Skeleton::nodes`].
    pub locals: Vec<Trs>,
    /// Weight of each of the template's morphs.
    pub morphs: Vec<f32>,
}

impl Pose {
    /// Rotates a node by `angle` radians about an axis of its own frame: `R' = R · R(axis, angle)`.
    pub fn turn(&mut self, node: u32, axis: DVec3, angle: f64) {
        let local = &mut self.locals[node as usize];
        local.rotation = rot::hamilton(rot::normalise(local.rotation).wxyz, axis_angle(axis, angle));
    }
}

impl Skeleton {
    /// The pose without animation: every node and morph at rest.
    pub fn rest_pose(&self) -> Pose {
        Pose { locals: self.nodes.iter().map(|n| n.rest).collect(), morphs: self.rest_morphs.clone() }
    }

    /// `G`: node-to-world matrices, one per node.
    pub fn globals(&self, pose: &Pose) -> Vec<DAffine3> {
        let mut globals: Vec<DAffine3> = Vec::with_capacity(self.nodes.len());
        for (node, local) in self.nodes.iter().zip(&pose.locals) {
            let local = local.affine();
            globals.push(node.parent.map_or(local, |p| globals[p as usize] * local));
        }
        globals
    }

    /// The skinning matrices `A_j = G_j B_j⁻¹`, one per joint.
    pub fn skinning(&self, pose: &Pose) -> Vec<DAffine3> {
        let globals = self.globals(pose);
        self.joints.iter().map(|j| globals[j.node as usize] * j.inverse_bind).collect()
    }

    /// `R_root`: rotation of the root relative to the bind pose, or to the rest pose if it is no joint.
    pub fn root_rotation(&self, pose: &Pose) -> DMat3 {
        let moved = self.globals(pose)[self.root as usize];
        let bind = match self.joints.iter().find(|j| j.node == self.root) {
            Some(joint) => joint.inverse_bind,
            None => self.globals(&self.rest_pose())[self.root as usize].inverse(),
        };
        rotation_of((moved * bind).matrix3).unwrap_or(DMat3::IDENTITY)
    }

    /// Row of the first node called `name`.
    pub fn node(&self, name: &str) -> Option<u32> {
        self.nodes.iter().position(|n| n.name == name).map(|i| i as u32)
    }

    /// The lowest common ancestor of all joints; without one, the uppermost joint above the first joint.
    pub fn common_root(&self) -> u32 {
        let Some(first) = self.joints.first() else { return 0 };
        let mut shared = Some(first.node);
        for joint in &self.joints {
            // A parent's number is smaller than its child's, so the larger of the two climbs until they meet.
            let mut other = Some(joint.node);
            while let (Some(a), Some(b)) = (shared, other)
                && a != b
            {
                if a > b {
                    shared = self.nodes[a as usize].parent;
                } else {
                    other = self.nodes[b as usize].parent;
                }
            }
            if other.is_none() {
                shared = None;
            }
        }
        shared.unwrap_or_else(|| self.uppermost_joint(first.node))
    }

    fn uppermost_joint(&self, node: u32) -> u32 {
        let is_joint = |n: u32| self.joints.iter().any(|j| j.node == n);
        let above = std::iter::successors(Some(node), |&n| self.nodes[n as usize].parent);
        above.filter(|&n| is_joint(n)).last().unwrap_or(node)
    }

    /// Unit axis that a joint bends about, in its own frame: orthogonal to the bones to its parent and to its first child in
    /// `pose`. If these are parallel, any axis orthogonal to the bone to the child.
    pub fn hinge_axis(&self, pose: &Pose, node: u32) -> DVec3 {
        let globals = self.globals(pose);
        let here = globals[node as usize];
        let parent = self.nodes[node as usize].parent;
        let child = self.nodes.iter().position(|n| n.parent == Some(node));
        let upper = parent.map_or(DVec3::ZERO, |p| here.translation - globals[p as usize].translation);
        let fore = child.map_or(DVec3::Y, |c| globals[c].translation - here.translation);
        let across = upper.cross(fore);
        let world = if across.length() > PARALLEL_SINE * upper.length() * fore.length() && across != DVec3::ZERO {
            across
        } else {
            fore.try_normalize().unwrap_or(DVec3::Y).any_orthogonal_vector()
        };
        let turn = rotation_of(here.matrix3).unwrap_or(DMat3::IDENTITY);
        (turn.transpose() * world).normalize_or(DVec3::X)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn arm() -> Skeleton {
        let node = |name: &str, parent, at| Node { name: name.to_owned(), parent, rest: Trs::at(at) };
        let nodes = vec![
            node("world", None, DVec3::ZERO),
            node("shoulder", Some(0), DVec3::X),
            node("elbow", Some(1), DVec3::X),
            node("hand", Some(2), DVec3::Y),
            node("hip", Some(0), DVec3::NEG_Y),
        ];
        let mut arm = Skeleton { nodes, ..Skeleton::default() };
        let globals = arm.globals(&arm.rest_pose());
        arm.joints = (1..5).map(|n| Joint { node: n, inverse_bind: globals[n as usize].inverse() }).collect();
        arm
    }

    #[test]
    fn frames_follow_their_parents() {
        let arm = arm();
        let mut pose = arm.rest_pose();
        for a in arm.skinning(&pose) {
            assert!(a.abs_diff_eq(DAffine3::IDENTITY, 1e-12));
        }
        pose.turn(1, DVec3::Z, FRAC_PI_2);
        let globals = arm.globals(&pose);
        assert!(globals[2].translation.abs_diff_eq(DVec3::new(1.0, 1.0, 0.0), 1e-12));
        assert!(globals[3].translation.abs_diff_eq(DVec3::new(0.0, 1.0, 0.0), 1e-12));
        // Only what hangs on the shoulder moves.
        assert!(arm.skinning(&pose)[3].abs_diff_eq(DAffine3::IDENTITY, 1e-12));
    }

    #[test]
    fn the_root_is_the_lowest_common_ancestor() {
        let mut arm = arm();
        assert_eq!(arm.common_root(), 0);
        arm.joints.truncate(3);
        assert_eq!(arm.common_root(), 1);
        arm.joints.drain(..1);
        assert_eq!(arm.common_root(), 2);
        // Two trees: the first joint's uppermost joint.
        arm.nodes[4].parent = None;
        arm.joints.push(Joint { node: 4, inverse_bind: DAffine3::IDENTITY });
        assert_eq!(arm.common_root(), 2);
    }

    #[test]
    fn a_hinge_lies_across_its_bones() {
        let mut arm = arm();
        let axis = arm.hinge_axis(&arm.rest_pose(), 2);
        assert!(axis.abs_diff_eq(DVec3::Z, 1e-12), "{axis}");
        arm.nodes[3].rest.translation = DVec3::X;
        let straight = arm.hinge_axis(&arm.rest_pose(), 2);
        assert!(straight.dot(DVec3::X).abs() < 1e-12 && (straight.length() - 1.0).abs() < 1e-12);
        assert!(arm.hinge_axis(&arm.rest_pose(), 0).is_finite());
    }

    #[test]
    fn the_root_turns_with_its_node() {
        let mut arm = arm();
        arm.root = 1;
        let mut pose = arm.rest_pose();
        pose.turn(1, DVec3::new(1.0, 2.0, -0.5), 0.7);
        let want = rotation_matrix(axis_angle(DVec3::new(1.0, 2.0, -0.5), 0.7));
        assert!(arm.root_rotation(&pose).abs_diff_eq(want, 1e-12));
        arm.root = 0;
        assert!(arm.root_rotation(&pose).abs_diff_eq(DMat3::IDENTITY, 1e-12));
        assert_eq!(axis_angle(DVec3::ZERO, 1.0), [1.0, 0.0, 0.0, 0.0]);
    }
}
