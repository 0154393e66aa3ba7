//! Nodes of a glTF file: order, rest transforms, and which are in the scene.

use super::accessors::Data;
use super::error::CharacterError;
use crate::skeleton::{Node, Trs};
use crate::skin::{quat_of, rotation_of};
use glam::{DMat3, DVec3};
use gltf::json;

/// A matrix may differ from translation · rotation · scale by this share of its size.
const SHEAR_TOLERANCE: f64 = 1e-4;

/// Nodes in depth-first order, parents before children.
pub(super) struct Nodes {
    pub(super) nodes: Vec<Node>,
    /// Row in the file of each of `nodes`.
    pub(super) source: Vec<usize>,
    /// Row in `nodes` of each node of the file.
    pub(super) place: Vec<u32>,
    /// Whether each of `nodes` is in the scene.
    pub(super) shown: Vec<bool>,
}

pub(super) fn read(data: &Data<'_>) -> Result<Nodes, CharacterError> {
    let count = data.root.nodes.len();
    let parents = parents(data)?;
    let mut out = Nodes { nodes: Vec::new(), source: Vec::new(), place: vec![u32::MAX; count], shown: Vec::new() };
    let roots = scene_roots(data);
    let mut ranks = vec![usize::MAX; count];
    for (rank, &i) in roots.iter().flatten().enumerate() {
        ranks.get_mut(i).into_iter().for_each(|r| *r = rank.min(*r));
    }
    let rank = |i: usize| ranks.get(i).copied().unwrap_or(usize::MAX);
    let mut stack: Vec<usize> = (0..count).filter(|&i| parents.get(i) == Some(&None)).collect();
    stack.sort_by_cached_key(|&i| std::cmp::Reverse((rank(i), i)));
    while let Some(i) = stack.pop() {
        let Some(node) = data.root.nodes.get(i) else { continue };
        let parent = parents.get(i).copied().flatten().and_then(|p| out.place.get(p)).copied();
        let shown = roots.is_none() || rank(i) < usize::MAX;
        let shown = shown || parent.and_then(|p| out.shown.get(p as usize)).copied().unwrap_or(false);
        if let Some(slot) = out.place.get_mut(i) {
            *slot = out.nodes.len() as u32;
        }
        let name = node.name.clone().unwrap_or_default();
        out.nodes.push(Node { name, parent, rest: rest(data, i, node)? });
        out.source.push(i);
        out.shown.push(shown);
        stack.extend(node.children.iter().flatten().rev().map(json::Index::value));
    }
    if out.nodes.len() < count {
        return Err(data.malformed("nodes", "some are their own ancestors"));
    }
    Ok(out)
}

/// The parent of every node.
fn parents(data: &Data<'_>) -> Result<Vec<Option<usize>>, CharacterError> {
    let mut parents = vec![None; data.root.nodes.len()];
    for (i, node) in data.root.nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            let slot: Option<&mut Option<usize>> = parents.get_mut(child.value());
            let slot =
                slot.ok_or_else(|| data.malformed(format!("node {i}"), format!("has no child {}", child.value())))?;
            if slot.replace(i).is_some() {
                return Err(data.malformed(format!("node {}", child.value()), "has two parents"));
            }
        }
    }
    Ok(parents)
}

/// Roots of the default (else the first) scene, as listed; `None`: every root.
fn scene_roots(data: &Data<'_>) -> Option<Vec<usize>> {
    let index = data.root.scene.map_or(0, |s| s.value());
    let scene = data.root.scenes.get(index).or(data.root.scenes.first())?;
    Some(scene.nodes.iter().map(json::Index::value).collect())
}

fn rest(data: &Data<'_>, i: usize, node: &json::Node) -> Result<Trs, CharacterError> {
    let wrong = |what: &str| data.malformed(format!("node {i}"), what);
    let vector = |v: Option<[f32; 3]>, default| v.map_or(default, |v| DVec3::from_array(v.map(f64::from)));
    let trs = match &node.matrix {
        Some(m) => decompose(&m.map(f64::from)).ok_or_else(|| wrong("has a matrix with shear or perspective"))?,
        None => {
            let [x, y, z, w] = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |q| q.0).map(f64::from);
            Trs {
                translation: vector(node.translation, DVec3::ZERO),
                rotation: [w, x, y, z],
                scale: vector(node.scale, DVec3::ONE),
            }
        }
    };
    let finite = trs.translation.is_finite() && trs.scale.is_finite() && trs.rotation.iter().all(|v| v.is_finite());
    if !finite || trs.rotation == [0.0; 4] {
        return Err(wrong("has a frame that is not finite, or a rotation of length 0"));
    }
    Ok(trs)
}

/// Translation, rotation and scale of a column-major matrix; `None` if it has shear or perspective.
fn decompose(m: &[f64; 16]) -> Option<Trs> {
    let [a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, x, y, z, w] = *m;
    let linear = DMat3::from_cols(DVec3::new(a0, a1, a2), DVec3::new(b0, b1, b2), DVec3::new(c0, c1, c2));
    if !linear.is_finite() || [a3, b3, c3] != [0.0; 3] || w != 1.0 {
        return None;
    }
    let turn = rotation_of(linear).unwrap_or(DMat3::IDENTITY);
    let stretch = turn.transpose() * linear;
    let scale = DVec3::new(stretch.x_axis.x, stretch.y_axis.y, stretch.z_axis.z);
    let size = linear.to_cols_array().iter().fold(0.0f64, |a, v| a.max(v.abs()));
    let sheared = !stretch.abs_diff_eq(DMat3::from_diagonal(scale), SHEAR_TOLERANCE * size);
    (!sheared).then(|| Trs { translation: DVec3::new(x, y, z), rotation: quat_of(&turn), scale })
}
