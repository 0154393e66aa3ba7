//! `κ`: how much larger Gaussians must be where the posed template is stretched, lest holes open between them.
//!
//! ```text
//! κ_i = min(κ_max, max(1, β max_e ℓ_e(posed)/ℓ_e(bind)))          over the edges e at vertex i
//! ```
//! (DUT, supplement: the refining scale map.) The posed template is the undeformed one. κ is interpolated to texels and
//! multiplies all three axes, in training and in use; it is a constant on the way back.

use glam::Vec3;

/// Shorter edges of the bind pose have no ratio, metres.
const SHORT: f64 = 1e-6;

/// Which edges a vertex looks at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StretchRule {
    /// All that end at it.
    #[default]
    AllEdges,
    /// The first of every face at it, as the published code does.
    FirstEdge,
}

/// How κ is bounded.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScaleRefineOptions {
    /// Which edges count.
    pub rule: StretchRule,
    /// `β`: factor on the ratio of lengths, above 0.
    pub gain: f64,
    /// `κ_max`, at least 1.
    pub most: f64,
}

impl Default for ScaleRefineOptions {
    fn default() -> Self {
        Self { rule: StretchRule::AllEdges, gain: 1.0, most: 4.0 }
    }
}

/// The edges of a template that are compared, made once.
#[derive(Clone, Debug)]
pub struct ScaleRefine {
    stretches: Vec<Stretch>,
    options: ScaleRefineOptions,
}

/// An edge, one over its length at rest, and the vertices that look at it.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    ends: [u32; 2],
    inverse: f64,
    seen_by: [u32; 3],
}

impl ScaleRefine {
    /// From the bind pose. Edges shorter than a micrometre are left out.
    pub fn new(rest: &[Vec3], faces: &[[u32; 3]], options: ScaleRefineOptions) -> Self {
        let stretch = |ends: [u32; 2], seen_by| {
            let length = between(rest, ends);
            (length >= SHORT).then(|| Stretch { ends, inverse: 1.0 / length, seen_by })
        };
        let stretches = match options.rule {
            StretchRule::FirstEdge => faces.iter().filter_map(|f| stretch([f[0], f[1]], *f)).collect(),
            StretchRule::AllEdges => {
                let sides = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
                let mut sides: Vec<[u32; 2]> = sides.map(|[a, b]| [a.min(b), a.max(b)]).collect();
                sides.sort_unstable();
                sides.dedup();
                sides.into_iter().filter_map(|[a, b]| stretch([a, b], [a, b, b])).collect()
            }
        };
        Self { stretches, options }
    }

    /// `κ` of every vertex of the posed, undeformed template, in `[1, κ_max]` whatever the positions.
    pub fn kappas(&self, posed: &[Vec3]) -> Vec<f32> {
        let mut most = vec![1.0f64; posed.len()];
        for s in &self.stretches {
            let ratio = self.options.gain * between(posed, s.ends) * s.inverse;
            for v in s.seen_by {
                // `max` drops a NaN, so does the bound below an infinity.
                most[v as usize] = most[v as usize].max(ratio);
            }
        }
        most.into_iter().map(|k| k.min(self.options.most.max(1.0)) as f32).collect()
    }
}

fn between(points: &[Vec3], [a, b]: [u32; 2]) -> f64 {
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
