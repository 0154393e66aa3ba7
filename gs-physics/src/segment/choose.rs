//! The number of rigid bodies: clusters that share a twist are merged.
//!
//! From an over-segmentation, the two clusters that are closest to sharing one twist are merged, and again, while their
//! distance is allowed. The twist of a cluster is the least-squares one over velocities `u_i = v_i + w_i × (x_i − o)` of its
//! particles,
//! ```text
//! R(C) = min over (v, w) of Σ_i weight |v + w × (x_i − o) − u_i|²      6 unknowns, sums are additive over clusters
//! d²(A, B) = (R(A ∪ B) − R(A) − R(B)) (W_A + W_B) / (W_A W_B)         mean squared velocity that separates A and B
//! ```
//! and two clusters are one body if `d ≤ max(tolerance · u_rms, spread · r)`. `u_rms` is the root mean square speed of
//! moving particles, `r² = (R(A) + R(B)) / (W_A + W_B)` the residual of the clusters' own twists, so that noise within a body
//! does not count as a second body: the halves of a normal distribution have `d = 2.65 r`. Clusters lighter than
//! [`MergeOptions::min_share`] are outliers: they take the label of the one they fit best, without changing its twist.

use super::by_weight;
use crate::refit::cholesky;
use crate::twist::{Motion, Twist};
use glam::{DVec3, Vec3};
use gs_core::cast;
use rayon::prelude::*;

/// Ridge of the normal equations, relative to their largest diagonal element where the particles' distance is the unit of length.
const RIDGE: f64 = 1e-9;
/// Particles per rayon task.
const BLOCK: usize = 1024;

/// Distance up to which clusters are one body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MergeOptions {
    /// Largest distance as a fraction of the root mean square speed of moving particles.
    pub tolerance: f64,
    /// Largest distance as a multiple of the residual of the clusters' own twists.
    pub spread: f64,
    /// Clusters with a smaller fraction of the total weight are outliers, not bodies.
    pub min_share: f64,
}

impl Default for MergeOptions {
    fn default() -> Self {
        Self { tolerance: 0.05, spread: 3.0, min_share: 0.005 }
    }
}

/// Normal equations of the twist of a set of particles; sums of two sets are the sums of their union.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct TwistSums {
    /// Sum of the weights of the particles.
    pub weight: f64,
    normal: [[f64; 6]; 6],
    right: [f64; 6],
    square: f64,
}

impl TwistSums {
    /// Adds a particle at `x` (relative to the origin) with velocity `u`.
    pub(crate) fn add(&mut self, weight: f64, x: DVec3, u: DVec3) {
        // Rows of [I, −[x]×].
        let rows = [[1.0, 0.0, 0.0, 0.0, x.z, -x.y], [0.0, 1.0, 0.0, -x.z, 0.0, x.x], [0.0, 0.0, 1.0, x.y, -x.x, 0.0]];
        for (row, u) in rows.iter().zip(u.to_array()) {
            for (i, a) in row.iter().enumerate() {
                self.right[i] += weight * a * u;
                row.iter().zip(&mut self.normal[i]).for_each(|(b, n)| *n += weight * a * b);
            }
        }
        self.weight += weight;
        self.square += weight * u.length_squared();
    }

    /// The sums of the union of two sets.
    fn union(&self, other: &Self) -> Self {
        let mut sum = *self;
        sum.weight += other.weight;
        sum.square += other.square;
        for i in 0..6 {
            sum.right[i] += other.right[i];
            (0..6).for_each(|j| sum.normal[i][j] += other.normal[i][j]);
        }
        sum
    }

    /// Weighted mean of the squared speeds.
    fn mean_square(&self) -> f64 {
        if self.weight > 0.0 { self.square / self.weight } else { 0.0 }
    }

    /// The least-squares twist; where particles on a line or point leave it undetermined the shortest, by a ridge.
    pub fn twist(&self) -> Twist<f64> {
        let x = self.solution();
        Twist { v: [x[0], x[1], x[2]], w: [x[3], x[4], x[5]] }
    }

    /// `v` and `w`. Lengths are measured in distances of the particles from the origin, so that the ridge does not depend on the unit.
    fn solution(&self) -> [f64; 6] {
        let distance = (self.normal[3][3].max(self.normal[4][4]).max(self.normal[5][5]) / self.weight).sqrt();
        let unit = if distance > 0.0 { 1.0 / distance } else { 1.0 };
        let unit = |i: usize| if i < 3 { 1.0 } else { unit };
        let normal: [[f64; 6]; 6] =
            std::array::from_fn(|i| std::array::from_fn(|j| unit(i) * unit(j) * self.normal[i][j]));
        let right: [f64; 6] = std::array::from_fn(|i| unit(i) * self.right[i]);
        let x = cholesky(normal, right, RIDGE);
        std::array::from_fn(|i| unit(i) * x[i])
    }

    /// `R` of the module header: the weighted squared residual of [`TwistSums::twist`].
    pub fn residual(&self) -> f64 {
        let x = self.solution();
        let quadratic: f64 = (0..6).map(|i| x[i] * (0..6).map(|j| self.normal[i][j] * x[j]).sum::<f64>()).sum();
        let linear: f64 = (0..6).map(|i| x[i] * self.right[i]).sum();
        (self.square - 2.0 * linear + quadratic).max(0.0)
    }
}

/// Sums of each of `k` labels. Particles whose position or twist is not finite do not count.
fn twist_sums(
    positions: &[Vec3],
    motions: &[Motion<f32>],
    origin: Vec3,
    weights: Option<&[f32]>,
    labels: &[u32],
    k: usize,
) -> Vec<TwistSums> {
    let block = |b: usize| {
        let mut sums = vec![TwistSums::default(); k];
        for i in b * BLOCK..((b + 1) * BLOCK).min(labels.len()) {
            let x = (positions[i] - origin).as_dvec3();
            let [v, w] = [motions[i].twist.v, motions[i].twist.w].map(|a| Vec3::from_array(a).as_dvec3());
            let u = v + w.cross(x);
            if x.is_finite() && u.is_finite() {
                sums[labels[i] as usize].add(weights.map_or(1.0, |w| w[i].into()), x, u);
            }
        }
        sums
    };
    let blocks: Vec<_> = (0..labels.len().div_ceil(BLOCK)).into_par_iter().map(block).collect();
    let mut total = vec![TwistSums::default(); k];
    for sums in blocks {
        total.iter_mut().zip(&sums).for_each(|(t, s)| *t = t.union(s));
    }
    total
}

/// Rigid bodies found by [`merged`], heaviest first.
#[derive(Clone, Debug, PartialEq)]
pub struct Merged {
    /// The body of each particle, an index into `bodies`.
    pub labels: Vec<u32>,
    /// Sums of each body, without outliers.
    pub bodies: Vec<TwistSums>,
    /// Distance `d` of each merged pair, in order, world units per unit of time.
    pub distances: Vec<f64>,
    /// Distance of the pair that would be merged next; none if one body is left.
    pub next: Option<f64>,
}

/// Merges the clusters `labels < k` of particles into bodies; `weights` are 1 each if `None`.
pub fn merged(
    positions: &[Vec3],
    motions: &[Motion<f32>],
    origin: Vec3,
    weights: Option<&[f32]>,
    (labels, k): (&[u32], usize),
    options: &MergeOptions,
) -> Merged {
    let mut sums = twist_sums(positions, motions, origin, weights, labels, k);
    let all = sums.iter().fold(TwistSums::default(), |a, b| a.union(b));
    let least = options.min_share * all.weight;
    let floor = options.tolerance * moving_speed(&sums, least);
    let heavy = sums.iter().position(|s| s.weight > 0.0).unwrap_or(0);
    let mut body_of: Vec<usize> = (0..k).map(|c| if sums[c].weight > 0.0 { c } else { heavy }).collect();
    let mut residual: Vec<f64> = sums.iter().map(TwistSums::residual).collect();
    let (mut distances, mut next) = (Vec::new(), None);
    loop {
        let left: Vec<usize> = (0..k).filter(|&c| body_of[c] == c && sums[c].weight > 0.0).collect();
        let small = left.iter().copied().filter(|&c| sums[c].weight < least);
        let small = small.min_by(|&a, &b| sums[a].weight.total_cmp(&sums[b].weight));
        let pairs = left.iter().flat_map(|&a| left.iter().map(move |&b| (a, b))).filter(|(a, b)| a < b);
        let pairs = pairs.filter(|&(a, b)| small.is_none_or(|s| a == s || b == s));
        let distance = |(a, b): (usize, usize)| {
            let (sa, sb) = (&sums[a], &sums[b]);
            let own = residual[a] + residual[b];
            let d2 = (sa.union(sb).residual() - own).max(0.0) * (sa.weight + sb.weight) / (sa.weight * sb.weight);
            let noise = options.spread * (own / (sa.weight + sb.weight)).sqrt();
            (d2.sqrt(), floor.max(noise), a, b)
        };
        // By distance relative to the allowed one: a clean pair does not keep noisy pairs from merging.
        let best = pairs.map(distance).min_by(|x, y| (x.0 / x.1).total_cmp(&(y.0 / y.1)));
        let Some((distance, allowed, a, b)) = best else { break };
        if small.is_none() && distance > allowed {
            next = Some(distance);
            break;
        }
        let (from, to) = if small == Some(a) { (a, b) } else { (b, a) };
        if small.is_none() {
            distances.push(distance);
            sums[to] = sums[to].union(&sums[from]);
            residual[to] = sums[to].residual();
        }
        body_of.iter_mut().filter(|b| **b == from).for_each(|b| *b = to);
    }
    let mut new: Vec<u32> = labels.iter().map(|l| cast::to_u32(body_of[*l as usize])).collect();
    let order = by_weight(&mut new, |i| weights.map_or(1.0, |w| w[i].into()), k);
    Merged { labels: new, bodies: order.iter().map(|&c| sums[c]).collect(), distances, next }
}

/// Root mean square speed over clusters of at least weight `least` that move at least a tenth as fast as the fastest.
fn moving_speed(sums: &[TwistSums], least: f64) -> f64 {
    let heavy = || sums.iter().filter(|s| s.weight >= least);
    let fastest = heavy().map(TwistSums::mean_square).fold(0.0, f64::max);
    let moving = heavy().filter(|s| s.mean_square() >= 0.01 * fastest);
    moving.fold(TwistSums::default(), |a, b| a.union(b)).mean_square().sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::super::{FeatureOptions, KMeansOptions, features, kmeans};
    use super::*;
    use gs_core::Rng;

    const ORIGIN: Vec3 = Vec3::new(0.2, -0.1, 0.3);

    /// Bodies as (centre, v, w, particles) with relative noise on their twists: positions, motions, labels.
    fn scene(bodies: &[(Vec3, Vec3, Vec3, usize)], noise: f32) -> (Vec<Vec3>, Vec<Motion<f32>>, Vec<u32>) {
        let (mut x, mut m, mut truth) = (Vec::new(), Vec::new(), Vec::new());
        for (label, &(centre, v, w, n)) in bodies.iter().enumerate() {
            for i in 0..n {
                let mut rng = Rng::new(8, "bodies", label as u32, i as u64);
                let mut draw = || Vec3::new(rng.normal(), rng.normal(), rng.normal());
                x.push(centre + 0.15 * draw());
                let (v, w) = (v + noise * v.length() * draw(), w + noise * w.length() * draw());
                m.push(Motion { twist: Twist { v: v.to_array(), w: w.to_array() }, ..Motion::default() });
                truth.push(label as u32);
            }
        }
        (x, m, truth)
    }

    fn bodies(x: &[Vec3], m: &[Motion<f32>]) -> Merged {
        let (rows, width) = features(m, &FeatureOptions::default());
        let found = kmeans(&rows, width, None, &KMeansOptions { k: 12, ..KMeansOptions::default() });
        merged(x, m, ORIGIN, None, (&found.labels, found.k), &MergeOptions::default())
    }

    fn four() -> [(Vec3, Vec3, Vec3, usize); 4] {
        [
            (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, 900),
            (Vec3::X, Vec3::new(0.0, 1.0, 0.2), Vec3::ZERO, 500),
            (Vec3::Y, Vec3::new(-0.5, 0.0, 0.0), Vec3::new(0.0, 0.0, 6.0), 400),
            (-Vec3::X, Vec3::new(0.0, 0.0, -0.3), Vec3::new(2.0, 0.0, 0.0), 300),
        ]
    }

    #[test]
    fn bodies_are_counted_with_and_without_noise() {
        for noise in [0.0, 0.02, 0.05] {
            let (x, m, truth) = scene(&four(), noise);
            let found = bodies(&x, &m);
            assert_eq!(found.bodies.len(), 4, "noise {noise}: {:?} next {:?}", found.distances, found.next);
            let wrong = found.labels.iter().zip(&truth).filter(|(a, b)| a != b).count();
            assert!(wrong * 100 < truth.len(), "noise {noise}: {wrong} of {}", truth.len());
            let twist = found.bodies[2].twist();
            assert!((twist.w[2] - 6.0).abs() < 0.02 + noise as f64 && twist.w[0].abs() < 0.1, "{twist:?}");
        }
    }

    #[test]
    fn one_body_is_one_and_rest_is_one() {
        let (x, m, _) = scene(&four()[2..3], 0.03);
        assert_eq!(bodies(&x, &m).bodies.len(), 1);
        let (x, m, _) = scene(&four()[..1], 0.0);
        let rest = bodies(&x, &m);
        assert_eq!((rest.bodies.len(), rest.next), (1, None));
    }

    /// A bending sheet is no rigid body, nor a few.
    #[test]
    fn a_bending_sheet_stays_in_many_pieces() {
        let x: Vec<Vec3> =
            (0..2000).map(|i| Vec3::new((i % 50) as f32 / 25.0 - 1.0, (i / 50) as f32 / 20.0, 0.0)).collect();
        let wave = |x: &Vec3| Twist { v: [0.0, 0.0, (6.0 * x.x).sin()], w: [0.0; 3] };
        let m: Vec<_> = x.iter().map(|x| Motion { twist: wave(x), ..Motion::default() }).collect();
        assert!(bodies(&x, &m).bodies.len() >= 4);
    }

    #[test]
    fn a_few_outliers_are_no_body() {
        let (mut x, mut m, _) = scene(&four(), 0.02);
        for k in 0..5 {
            x.push(Vec3::splat(k as f32 * 0.1));
            m.push(Motion { twist: Twist { v: [0.0, 0.0, 40.0], w: [0.0; 3] }, ..Motion::default() });
        }
        assert_eq!(bodies(&x, &m).bodies.len(), 4);
    }

    /// Sums of a screw motion give back its twist without residual; sums are additive.
    #[test]
    fn least_squares_twists() {
        let (v, w) = (DVec3::new(0.3, -1.0, 0.5), DVec3::new(2.0, 0.1, -4.0));
        let mut parts = [TwistSums::default(); 2];
        for i in 0..40u64 {
            let mut rng = Rng::new(1, "screw", 0, i);
            let x = DVec3::new(rng.normal().into(), rng.normal().into(), rng.normal().into());
            parts[i as usize % 2].add(0.5 + i as f64, x, v + w.cross(x));
        }
        let both = parts[0].union(&parts[1]);
        let twist = both.twist();
        assert!((DVec3::from_array(twist.v) - v).length() < 1e-7 && (DVec3::from_array(twist.w) - w).length() < 1e-7);
        assert!(both.residual() < 1e-10 * both.weight);
        let mut point = TwistSums::default();
        point.add(2.0, DVec3::X, DVec3::Y);
        assert!(point.residual() < 1e-12 && point.twist().v.iter().all(|v| v.is_finite()));
        assert_eq!(TwistSums::default().residual(), 0.0);
    }

    /// Particles on a line, in metres and in micrometres: the turn about the line is undetermined, all else is the same.
    #[test]
    fn the_unit_of_length_does_not_matter() {
        let (v, w) = (DVec3::new(0.3, -1.0, 0.5), DVec3::new(0.0, 2.0, -4.0));
        let in_units = |unit: f64| {
            let mut sums = TwistSums::default();
            for i in 0..20 {
                let x = DVec3::X * (0.2 + 0.1 * f64::from(i));
                sums.add(1.0, unit * x, unit * (v + w.cross(x)));
            }
            let twist = sums.twist();
            (DVec3::from_array(twist.v) / unit, DVec3::from_array(twist.w), sums.residual() / (unit * unit))
        };
        for unit in [1e-6, 1.0, 1e6] {
            let (found, turn, residual) = in_units(unit);
            assert!((found - v).length() < 1e-6 && (turn - w).length() < 1e-6, "unit {unit}: {found} {turn}");
            assert!(residual < 1e-6, "unit {unit}: {residual}");
        }
    }
}
