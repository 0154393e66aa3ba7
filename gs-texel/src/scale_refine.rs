//! `κ`: scale factor of Gaussians where the posed template is stretched, so that no holes open between them.
//!
//! ```text
//! κ_i = min(κ_max, max(1, β max_e ℓ_e(posed)/ℓ_e(bind)))          over the edges e at vertex i
//! ```
//! (DUT, supplement: the refining scale map.) The posed template is the undeformed one. κ is interpolated to texels and
//! multiplies all three axes, in training and in use; backward treats it as a constant.
//!
//! ```
//! use glam::Vec3;
//! use gs_texel::scale_refine::{ScaleRefine, ScaleRefineOptions};
//!
//! let rest = [Vec3::ZERO, Vec3::X, Vec3::Y];
//! let refine = ScaleRefine::new(&rest, &[[0, 1, 2]], ScaleRefineOptions::default());
//! // Stretched to twice its length along x; no edge of the third vertex stretches by more than √2.5.
//! let kappas = refine.kappas(&rest.map(|p| Vec3::new(2.0 * p.x, p.y, p.z)));
//! assert_eq!(kappas, [2.0, 2.0, 2.5f32.sqrt()]);
//! ```

use glam::Vec3;

/// Shorter edges of the bind pose are left out, metres.
const MIN_EDGE: f64 = 1e-6;

/// Which edges enter the maximum at a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StretchRule {
    /// All edges that end at it.
    #[default]
    AllEdges,
    /// The first edge of every face at it, as in DUT's published code.
    FirstEdge,
}

/// Bounds and rules of [`ScaleRefine`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScaleRefineOptions {
    /// Edges at a vertex. Default: all.
    pub rule: StretchRule,
    /// `β`: factor on the ratio of lengths, above 0. Default: 1.
    pub gain: f64,
    /// `κ_max`: upper bound of κ, at least 1. Default: 4.
    pub most: f64,
}

impl Default for ScaleRefineOptions {
    fn default() -> Self {
        Self { rule: StretchRule::AllEdges, gain: 1.0, most: 4.0 }
    }
}

/// Edges of a template with their lengths in the bind pose.
#[derive(Clone, Debug)]
pub struct ScaleRefine {
    edges: Vec<RestEdge>,
    options: ScaleRefineOptions,
}

/// An edge, one over its length at rest, and the vertices whose κ it enters.
#[derive(Clone, Copy, Debug)]
struct RestEdge {
    ends: [u32; 2],
    inverse: f64,
    vertices: [u32; 3],
}

impl ScaleRefine {
    /// Takes lengths from the bind pose `rest`. Edges shorter than a micrometre are left out.
    pub fn new(rest: &[Vec3], faces: &[[u32; 3]], options: ScaleRefineOptions) -> Self {
        let edge = |ends: [u32; 2], vertices| {
            let length = distance(rest, ends);
            (length >= MIN_EDGE).then(|| RestEdge { ends, inverse: 1.0 / length, vertices })
        };
        let edges = match options.rule {
            StretchRule::FirstEdge => faces.iter().filter_map(|f| edge([f[0], f[1]], *f)).collect(),
            StretchRule::AllEdges => {
                let sides = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
                let mut sides: Vec<[u32; 2]> = sides.map(|[a, b]| [a.min(b), a.max(b)]).collect();
                sides.sort_unstable();
                sides.dedup();
                sides.into_iter().filter_map(|[a, b]| edge([a, b], [a, b, b])).collect()
            }
        };
        Self { edges, options }
    }

    /// `κ` of every vertex of the posed, undeformed template; in `[1, κ_max]` even where positions are not finite.
    pub fn kappas(&self, posed: &[Vec3]) -> Vec<f32> {
        let mut most = vec![1.0f64; posed.len()];
        for s in &self.edges {
            let ratio = self.options.gain * distance(posed, s.ends) * s.inverse;
            for v in s.vertices {
                // `max` drops a NaN, so does the bound below an infinity.
                most[v as usize] = most[v as usize].max(ratio);
            }
        }
        most.into_iter().map(|k| k.min(self.options.most.max(1.0)) as f32).collect()
    }
}

fn distance(points: &[Vec3], [a, b]: [u32; 2]) -> f64 {
    points[a as usize].as_dvec3().distance(points[b as usize].as_dvec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit square in two triangles, and a vertex of no face.
    const FACES: [[u32; 3]; 2] = [[0, 1, 2], [1, 3, 2]];
    fn square() -> Vec<Vec3> {
        vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::new(1.0, 1.0, 0.0), Vec3::splat(9.0)]
    }

    fn all(options: ScaleRefineOptions, posed: &[Vec3]) -> Vec<f32> {
        ScaleRefine::new(&square(), &FACES, options).kappas(posed)
    }

    fn mapped(f: impl Fn(Vec3) -> Vec3) -> Vec<Vec3> {
        square().into_iter().map(f).collect()
    }

    #[test]
    fn a_stretch_along_x_is_felt_by_its_edges_and_never_exceeded() {
        for a in [1.0f32, 1.3, 2.5] {
            let kappas = all(ScaleRefineOptions::default(), &mapped(|p| Vec3::new(a * p.x, p.y, p.z)));
            assert!(kappas.iter().all(|k| (1.0..=a + 1e-6).contains(k)), "{kappas:?}");
            // Every vertex of the square ends an edge along x.
            assert!(kappas[..4].iter().all(|k| (k - a).abs() < 1e-6), "{kappas:?}");
            assert_eq!(kappas[4], 1.0, "a vertex of no face");
        }
    }

    #[test]
    fn rigid_motion_and_compression_change_nothing() {
        let turn = glam::Quat::from_axis_angle(Vec3::new(2.0, 3.0, 6.0) / 7.0, 1.1);
        let moved = all(ScaleRefineOptions::default(), &mapped(|p| turn * p + Vec3::new(0.1, 0.2, 0.3)));
        assert!(moved.iter().all(|k| (1.0..1.0 + 1e-6).contains(k)), "{moved:?}");
        assert_eq!(all(ScaleRefineOptions::default(), &mapped(|p| 0.5 * p)), [1.0; 5]);
    }

    #[test]
    fn the_first_edge_of_a_face_speaks_for_its_corners() {
        let first = ScaleRefineOptions { rule: StretchRule::FirstEdge, ..ScaleRefineOptions::default() };
        // Along x: face 0's first edge lies along x, face 1's (1 to 3) along y.
        assert_eq!(all(first, &mapped(|p| Vec3::new(2.0 * p.x, p.y, p.z))), [2.0, 2.0, 2.0, 1.0, 1.0]);
        assert_eq!(all(first, &mapped(|p| Vec3::new(p.x, 3.0 * p.y, p.z))), [1.0, 3.0, 3.0, 3.0, 1.0]);
    }

    #[test]
    fn gain_and_bounds() {
        let gain = ScaleRefineOptions { gain: 1.5, ..ScaleRefineOptions::default() };
        assert_eq!(all(gain, &square())[0], 1.5);
        assert_eq!(all(ScaleRefineOptions::default(), &mapped(|p| 50.0 * p))[0], 4.0);
        let bad = mapped(|p| if p == Vec3::X { Vec3::NAN } else { p });
        assert!(all(ScaleRefineOptions::default(), &bad).iter().all(|k| (1.0..=4.0).contains(k)));
        let far = mapped(|p| if p == Vec3::X { Vec3::INFINITY } else { p });
        assert!(all(ScaleRefineOptions::default(), &far).iter().all(|k| (1.0..=4.0).contains(k)));
    }

    #[test]
    fn edges_of_no_length_are_skipped() {
        let rest = [Vec3::ZERO, 1e-7 * Vec3::X, Vec3::Y];
        let refine = ScaleRefine::new(&rest, &[[0, 1, 2], [0, 0, 1]], ScaleRefineOptions::default());
        let kappas = refine.kappas(&[Vec3::ZERO, Vec3::X, Vec3::Y]);
        assert!(kappas[0] == 1.0 && (kappas[1] - 2f32.sqrt()).abs() < 1e-5, "{kappas:?}");
    }
}
