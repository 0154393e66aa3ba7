//! Differences of neighbouring normals:
//!
//! ```text
//! faces:    L = (1/|E₂|) Σ_{edges between faces f, g} (1 − n_f·n_g)          n = m/|m|,  m = (b − a) × (c − a)
//! vertices: L = (1/N) Σ_i (1/|N_i|) Σ_{j∈N_i} (1 − n_i·n_j)                  n_i = Σ_f θ_if n_f / |·|
//! from rest: ½ |(n_i − n_j) − (n̄_i − n̄_j)|² in place of 1 − n_i·n_j          n̄ on a surface at rest
//! backward: g_m = (I − n nᵀ) g_n / |m|        ∂θ/∂u = (û cos θ − ŵ)/(|u| sin θ) for the sides u, w of a corner
//! ```
//! Vertex normals are weighted by the angles `θ` of the corners. Pairs with a face without area contribute nothing but keep
//! their share, so that other pairs do not gain weight when a face collapses.

use super::{MIN_DOUBLE_AREA, Point, SurfaceLoss, area_normal, area_normal_backward, ring_shares};
use crate::surface::{NONE, Topology};
use glam::DVec3;

/// Which pairs of normals are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormalRule {
    /// Normals of faces that share an edge.
    #[default]
    FacePairs,
    /// Normals of vertices that share an edge.
    VertexRing,
}

/// Pairs of faces or vertices whose normals are compared, with their weights.
#[derive(Clone, Debug)]
pub struct NormalConsistency {
    faces: Vec<[u32; 3]>,
    rule: NormalRule,
    pairs: Vec<Pair>,
}

/// Two normals that are compared.
#[derive(Clone, Copy, Debug)]
struct Pair {
    of: [u32; 2],
    share: f64,
    /// What `n_i − n_j` should be.
    chord: DVec3,
}

/// The normals of a surface, and what they are made of.
struct Normals {
    /// `m` of every face.
    areas: Vec<DVec3>,
    /// `n` of every face.
    flat: Vec<DVec3>,
    /// What is normalised to `of`.
    sums: Vec<DVec3>,
    /// Of faces or vertices.
    of: Vec<DVec3>,
}

impl NormalConsistency {
    /// Takes pairs from the topology of `faces`. An edge of one face gives no pair of faces, an edge of more than two gives one.
    pub fn new(faces: &[[u32; 3]], topology: &Topology, rule: NormalRule) -> Self {
        let pairs = match rule {
            NormalRule::FacePairs => {
                let sides = topology.edge_faces.iter();
                let pairs: Vec<[u32; 2]> = sides.filter(|[f, g]| *g != NONE && f != g).copied().collect();
                let each = 1.0 / pairs.len() as f64;
                pairs.into_iter().map(|p| (p, each)).collect::<Vec<_>>()
            }
            NormalRule::VertexRing => topology.edges.iter().copied().zip(ring_shares(&topology.edges)).collect(),
        };
        let pairs = pairs.into_iter().map(|(of, share)| Pair { of, share, chord: DVec3::ZERO }).collect();
        Self { faces: faces.to_vec(), rule, pairs }
    }

    /// Asks that neighbouring normals differ as they do on `rest`, one row per vertex, and not that they are equal: the loss and its
    /// gradient are 0 there. Pairs without a normal at rest are left out.
    pub fn from_rest<P: Point>(mut self, rest: &[P]) -> Self {
        let normals = self.normals(rest).of;
        self.pairs.retain_mut(|pair| {
            let [a, b] = pair.of.map(|i| normals[i as usize]);
            pair.chord = a - b;
            a != DVec3::ZERO && b != DVec3::ZERO
        });
        self
    }

    /// The loss of the deformed bind pose, one row per vertex, and its gradient.
    pub fn evaluate<P: Point>(&self, points: &[P]) -> SurfaceLoss {
        let mut loss = SurfaceLoss::none(points.len());
        let Normals { areas, flat, sums, of: normals } = self.normals(points);
        let mut d_normals = vec![DVec3::ZERO; normals.len()];
        for Pair { of: [i, j], share, chord } in &self.pairs {
            let (a, b) = (normals[*i as usize], normals[*j as usize]);
            if a == DVec3::ZERO || b == DVec3::ZERO {
                continue;
            }
            // Half the squared chord: 1 − cos without cancellation. Of the gradients, what lies along a normal is dropped below.
            loss.value += 0.5 * share * (a - b - *chord).length_squared();
            d_normals[*i as usize] -= *share * (b + *chord);
            d_normals[*j as usize] -= *share * (a - *chord);
        }
        for ((d, n), sum) in d_normals.iter_mut().zip(&normals).zip(&sums) {
            *d = (*d - *n * n.dot(*d)) / sum.length().max(MIN_DOUBLE_AREA);
        }
        match self.rule {
            NormalRule::FacePairs => {
                for (face, d) in self.faces.iter().zip(d_normals) {
                    area_normal_backward(points, *face, d, &mut loss.grad);
                }
            }
            NormalRule::VertexRing => self.vertex_sums_backward(points, &areas, &flat, &d_normals, &mut loss.grad),
        }
        loss
    }

    fn normals<P: Point>(&self, points: &[P]) -> Normals {
        let areas: Vec<DVec3> = self.faces.iter().map(|f| area_normal(points, *f)).collect();
        let flat: Vec<DVec3> = areas.iter().map(|m| unit(*m)).collect();
        let (sums, of) = match self.rule {
            NormalRule::FacePairs => (areas.clone(), flat.clone()),
            NormalRule::VertexRing => {
                let sums = self.vertex_sums(points, &flat);
                let normals = sums.iter().map(|s| unit(*s)).collect();
                (sums, normals)
            }
        };
        Normals { areas, flat, sums, of }
    }

    /// `Σ_f θ_if n_f` of each vertex.
    fn vertex_sums<P: Point>(&self, points: &[P], flat: &[DVec3]) -> Vec<DVec3> {
        let mut sums = vec![DVec3::ZERO; points.len()];
        for (face, n) in self.faces.iter().zip(flat).filter(|(_, n)| **n != DVec3::ZERO) {
            for corner in corners(*face) {
                let [u, w] = arms(points, corner);
                sums[corner[0] as usize] += *n * u.cross(w).length().atan2(u.dot(w));
            }
        }
        sums
    }

    fn vertex_sums_backward<P: Point>(
        &self,
        points: &[P],
        areas: &[DVec3],
        flat: &[DVec3],
        d_sums: &[DVec3],
        grad: &mut [DVec3],
    ) {
        for ((face, m), n) in self.faces.iter().zip(areas).zip(flat).filter(|(_, n)| **n != DVec3::ZERO) {
            let mut d_n = DVec3::ZERO;
            for corner in corners(*face) {
                let [u, w] = arms(points, corner);
                let d = d_sums[corner[0] as usize];
                d_n += d * u.cross(w).length().atan2(u.dot(w));
                // An arm turned away from the other, in the plane of the face, opens the angle by 1/|arm|.
                let d_angle = n.dot(d);
                let d_u = u.cross(*n) * (d_angle / u.length_squared());
                let d_w = n.cross(w) * (d_angle / w.length_squared());
                grad[corner[1] as usize] += d_u;
                grad[corner[2] as usize] += d_w;
                grad[corner[0] as usize] -= d_u + d_w;
            }
            let d_m = (d_n - *n * n.dot(d_n)) / m.length();
            area_normal_backward(points, *face, d_m, grad);
        }
    }
}

/// A face starting at each of its corners, orientation kept.
fn corners([a, b, c]: [u32; 3]) -> [[u32; 3]; 3] {
    [[a, b, c], [b, c, a], [c, a, b]]
}

fn arms<P: Point>(points: &[P], [at, next, last]: [u32; 3]) -> [DVec3; 2] {
    let tip = points[at as usize].wide();
    [points[next as usize].wide() - tip, points[last as usize].wide() - tip]
}

/// The direction of `m`; zero where it has none.
fn unit(m: DVec3) -> DVec3 {
    let length = m.length();
    if length < MIN_DOUBLE_AREA { DVec3::ZERO } else { m / length }
}
