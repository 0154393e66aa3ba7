//! Squared change of edge lengths from the template:
//!
//! ```text
//! L = Σ_e w_e (|v'_a − v'_b| − |v̄_a − v̄_b|)²
//! g_a = 2 w_e (ℓ − ℓ0)(v'_a − v'_b)/ℓ = −g_b
//! ```
//! The three forms in print differ in the weights alone, so they are one table of weighted edges, made once.

use super::{MIN_DOUBLE_AREA, Point, SurfaceLoss, area_normal, ring_shares};
use crate::surface::{NONE, Topology};
use glam::DVec3;

/// Lower bound of a length that is divided by, metres.
const MIN_LENGTH: f64 = 1e-8;

/// Edges of the isometry loss and their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IsometryRule {
    /// The mean over edges: `w = 1/|E|`.
    #[default]
    AllEdges,
    /// The mean over vertices of the mean over a vertex' edges: `w = (1/|N_a| + 1/|N_b|)/N`. Edges of vertices with few
    /// neighbours get more weight.
    RingMean,
    /// The first edge of every face, as in DUT's published code: `w = 1/F`.
    FirstEdge,
}

/// Edge lengths and weights of a template.
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
    /// Takes lengths from the bind pose `rest`. Edges of degenerate faces only are left out.
    pub fn new<P: Point>(rest: &[P], faces: &[[u32; 3]], topology: &Topology, rule: IsometryRule) -> Self {
        let sound = |f: u32| f != NONE && area_normal(rest, faces[f as usize]).length() >= MIN_DOUBLE_AREA;
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

    /// Number of edges in the loss.
    pub fn len(&self) -> usize {
        self.edges.len()
    }

    /// Whether there are no edges in the loss.
    pub fn is_empty(&self) -> bool {
        self.edges.is_empty()
    }

    /// The loss of the deformed bind pose `v' = v̄ + D`, one row per vertex, and its gradient.
    pub fn evaluate<P: Point>(&self, points: &[P]) -> SurfaceLoss {
        let mut loss = SurfaceLoss::none(points.len());
        for Edge { ends: [a, b], rest, weight } in &self.edges {
            let along: DVec3 = points[*a as usize].wide() - points[*b as usize].wide();
            let length = along.length();
            let stretch = length - rest;
            loss.value += weight * stretch * stretch;
            let d_end = along * (2.0 * weight * stretch / length.max(MIN_LENGTH));
            loss.grad[*a as usize] += d_end;
            loss.grad[*b as usize] -= d_end;
        }
        loss
    }
}
