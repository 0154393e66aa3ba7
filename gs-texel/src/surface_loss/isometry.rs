//! Edges keep the lengths they have in the template:
//!
//! ```text
//! L = Σ_e w_e (|v'_a − v'_b| − |v̄_a − v̄_b|)²
//! g_a = 2 w_e (ℓ − ℓ0)(v'_a − v'_b)/ℓ = −g_b
//! ```
//! The three forms in print differ in the weights alone, so they are one table of weighted edges, made once.

use super::{DEGENERATE, Point, SurfaceLoss, area_normal, ring_shares};
use crate::surface::{NONE, Topology};
use glam::DVec3;

/// Shorter lengths have no direction, metres.
const SHORT: f64 = 1e-8;

/// Which edges count, and how much.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IsometryRule {
    /// Every edge alike: `w = 1/|E|`.
    #[default]
    AllEdges,
    /// The mean over vertices of the mean over a vertex' edges: `w = (1/|N_a| + 1/|N_b|)/N`, so edges of vertices with few
    /// neighbours count more.
    RingMean,
    /// The first edge of every face, as the published code does: `w = 1/F`.
    FirstEdge,
}

/// The lengths of the template and the weights of its edges.
#[derive(Clone, Debug)]
pub struct Isometry {
    edges: Vec<Edge>,
}

#[derive(Clone, Copy, Debug)]
struct Edge {
    ends: [u32; 2],
    rest: f64,
    weight: f64,
}

impl Isometry {
    /// From the bind pose. Edges of degenerate faces alone are left out and not counted.
    pub fn new<P: Point>(rest: &[P], faces: &[[u32; 3]], topology: &Topology, rule: IsometryRule) -> Self {
        let sound = |f: u32| f != NONE && area_normal(rest, faces[f as usize]).length() >= DEGENERATE;
        let ends: Vec<[u32; 2]> = match rule {
            IsometryRule::FirstEdge => {
                (0..).zip(faces).filter(|(f, _)| sound(*f)).map(|(_, face)| [face[0], face[1]]).collect()
            }
            IsometryRule::AllEdges | IsometryRule::RingMean => {
                let sides = topology.edges.iter().zip(&topology.edge_faces);
                sides.filter(|(_, faces)| faces.iter().any(|f| sound(*f))).map(|(ends, _)| *ends).collect()
            }
        };
        let weights = match rule {
            IsometryRule::RingMean => ring_shares(&ends),
            IsometryRule::AllEdges | IsometryRule::FirstEdge => vec![1.0 / ends.len() as f64; ends.len()],
        };
        let length = |[a, b]: [u32; 2]| (rest[a as usize].wide() - rest[b as usize].wide()).length();
        let edge = |(ends, weight)| Edge { ends, rest: length(ends), weight };
        Self { edges: ends.into_iter().zip(weights).map(edge).collect() }
    }

    /// Edges that count.
    pub fn len(&self) -> usize {
        self.edges.len()
    }

    /// Whether none counts.
    pub fn is_empty(&self) -> bool {
        self.edges.is_empty()
    }

    /// The loss of the deformed bind pose `v' = v̄ + D`.
    pub fn evaluate<P: Point>(&self, points: &[P]) -> SurfaceLoss {
        let mut loss = SurfaceLoss::none(points.len());
        for Edge { ends: [a, b], rest, weight } in &self.edges {
            let along: DVec3 = points[*a as usize].wide() - points[*b as usize].wide();
            let length = along.length();
            let stretch = length - rest;
            loss.value += weight * stretch * stretch;
            let pull = along * (2.0 * weight * stretch / length.max(SHORT));
            loss.grad[*a as usize] += pull;
            loss.grad[*b as usize] -= pull;
        }
        loss
    }
}
