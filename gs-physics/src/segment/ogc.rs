//! Rigid parts from the paths of points, without physics: object geometry consistency (OGC, Song and Yang, NeurIPS 2022), as
//! TRACE scores methods that only deform.
//!
//! Every point `p` has logits `z_p`, `o_p = softmax(z_p)`. A step picks a random time, fits one rigid motion `(R_k, t_k)` to
//! each object by [Kabsch](crate::kabsch) with weights `o_pk` (constants in backward), and minimises
//! ```text
//! L_dyn    = (1/N) Σ_p |Σ_k o_pk (R_k p + t_k) − q_p|         p at the first time, q_p at the random one
//! L_smooth = (1/N) Σ_p (1/H) Σ_h |o_p − o_h|₁                 H nearest neighbours within a radius, the point itself beyond
//! L        = L_dyn + λ L_smooth                               λ from step smooth_from on
//! ```
//! by Adam on the logits; objects without a point at the end are dropped. Beyond [`OgcOptions::points`] points, the others
//! take the label of the nearest one that was optimised.

use super::by_weight;
use super::kmeans::sample;
use super::near::nearest;
use crate::kabsch::{PairSums, Rigid};
use glam::{DVec3, Vec3};
use gs_core::{Rng, cast};
use rayon::prelude::*;

/// Points per rayon task.
const BLOCK: usize = 512;
/// Residuals shorter than this have a zero gradient, world units.
const MIN_RESIDUAL: f64 = 1e-12;
/// Adam's `β₁` and `β₂`, its authors' defaults.
const BETA: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;

/// Objects, steps and weights of [`Ogc::learn`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OgcOptions {
    /// Largest number of objects, at least 1.
    pub k: usize,
    /// Number of Adam steps, each at one random time.
    pub steps: u32,
    /// Learning rate of Adam on the logits.
    pub learning_rate: f64,
    /// Weight `λ` of the smoothness term.
    pub smooth: f64,
    /// Step from which the smoothness term counts.
    pub smooth_from: u32,
    /// Number of neighbours `H` of each point.
    pub neighbours: usize,
    /// Largest distance of neighbours, over the root mean square distance of points from their centroid.
    pub radius: f32,
    /// Standard deviation of the initial logits.
    pub init_std: f64,
    /// Largest number of points that are optimised.
    pub points: usize,
    /// Seed of the sample, the initial logits and the times.
    pub seed: u64,
}

impl Default for OgcOptions {
    fn default() -> Self {
        Self {
            k: 8,
            steps: 1000,
            learning_rate: 0.01,
            smooth: 0.1,
            smooth_from: 500,
            neighbours: 4,
            radius: 0.1,
            init_std: 1.0,
            points: 16_384,
            seed: 0,
        }
    }
}

/// Object labels of points, learnt from their paths.
///
/// ```
/// use glam::Vec3;
/// use gs_physics::segment::{Ogc, OgcOptions};
/// // Two rows of points that move apart.
/// let row = |y: f32, shift: f32| (0..8).map(move |i| Vec3::new(0.1 * i as f32 + shift, y, 0.0));
/// let frame = |t: f32| row(0.0, t).chain(row(2.0, -t)).collect::<Vec<_>>();
/// let found = Ogc::learn(&[frame(0.0), frame(1.0)], &OgcOptions { k: 2, ..OgcOptions::default() });
/// let labels = found.map(|f| f.labels).unwrap_or_default();
/// assert!(labels[..8].iter().all(|l| *l == labels[0]) && labels[8..].iter().all(|l| *l == 1 - labels[0]));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Ogc {
    /// The object of each point, ordered by decreasing number of points.
    pub labels: Vec<u32>,
    /// Number of objects with at least one point.
    pub k: usize,
    /// `L_dyn` of the last step, world units.
    pub loss: f64,
}

/// Points, their positions at one other time, and their soft labels `[n, k]`.
struct Step<'a> {
    p: &'a [DVec3],
    q: &'a [DVec3],
    soft: &'a [f64],
    k: usize,
}

impl Ogc {
    /// Learns labels of the points of `frames`, `[times][n]`: the same points at every time; neighbours are those at the
    /// first. None if `k` is 0, there are fewer than two times, no points, frames of different lengths or positions that are
    /// not finite.
    pub fn learn(frames: &[Vec<Vec3>], options: &OgcOptions) -> Option<Self> {
        let first = frames.first().filter(|f| frames.len() > 1 && !f.is_empty())?;
        let valid = |f: &Vec<Vec3>| f.len() == first.len() && f.iter().all(|p| p.is_finite());
        if !frames.iter().all(valid) || options.k == 0 {
            return None;
        }
        let picked = sample(first.len(), options.points.max(1), options.seed);
        let positions: Vec<Vec<DVec3>> =
            frames.iter().map(|f| picked.iter().map(|&i| f[i].as_dvec3()).collect()).collect();
        let points: Vec<Vec3> = picked.iter().map(|&i| first[i]).collect();
        let edges = Edges::of(&points, options)?;
        let (soft, loss) = optimise(&positions, &edges, options);
        let argmax = |o: &[f64]| cast::to_u32((0..o.len()).rev().max_by(|&a, &b| o[a].total_cmp(&o[b])).unwrap_or(0));
        let mut labels: Vec<u32> = soft.chunks_exact(options.k).map(argmax).collect();
        if picked.len() < first.len() {
            let nearest = nearest(&points, first, 1, f32::INFINITY)?;
            labels = nearest.into_iter().map(|i| labels[i as usize]).collect();
        }
        let k = by_weight(&mut labels, |_| 1.0, options.k).len();
        Some(Self { labels, k, loss })
    }
}

/// Pairs of neighbours in compressed rows: `ends[begins[p]..begins[p + 1]]` are the points that `p` is compared with, twice
/// where both are neighbours of each other.
struct Edges {
    begins: Vec<usize>,
    ends: Vec<u32>,
    /// Neighbours `H` of each point, at least 1.
    count: usize,
}

impl Edges {
    fn of(points: &[Vec3], options: &OgcOptions) -> Option<Self> {
        let n = points.len();
        let centre = points.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / n as f64;
        let spread = (points.iter().map(|p| (p.as_dvec3() - centre).length_squared()).sum::<f64>() / n as f64).sqrt();
        // The nearest of all is the point itself.
        let count = options.neighbours + 1;
        let neighbours = nearest(points, points, count, options.radius * cast::to_f32(spread))?;
        let pairs = || {
            let rows = neighbours.chunks_exact(count).enumerate();
            rows.flat_map(|(p, row)| row[1..].iter().map(move |h| (p, *h as usize))).filter(|(p, h)| p != h)
        };
        let mut begins = vec![0; n + 1];
        pairs().for_each(|(p, h)| {
            begins[p + 1] += 1;
            begins[h + 1] += 1;
        });
        (0..n).for_each(|i| begins[i + 1] += begins[i]);
        let (mut next, mut ends) = (begins.clone(), vec![0; begins[n]]);
        for (p, h) in pairs() {
            (ends[next[p]], ends[next[h]]) = (cast::to_u32(h), cast::to_u32(p));
            (next[p], next[h]) = (next[p] + 1, next[h] + 1);
        }
        Some(Self { begins, ends, count: options.neighbours.max(1) })
    }
}

/// Runs all steps; gives the soft labels at the end, `[n, k]`, and the last `L_dyn`.
fn optimise(positions: &[Vec<DVec3>], edges: &Edges, options: &OgcOptions) -> (Vec<f64>, f64) {
    let (n, k) = (positions[0].len(), options.k);
    let init = |i: usize| {
        let mut rng = Rng::new(options.seed, "ogc.start", 0, i as u64);
        (0..k).map(move |_| options.init_std * f64::from(rng.normal()))
    };
    let mut logits: Vec<f64> = (0..n).flat_map(init).collect();
    let (mut soft, mut grad) = (softmax(&logits, k), vec![0.0; n * k]);
    let (mut first, mut second) = (vec![0.0; n * k], vec![0.0; n * k]);
    let mut loss = 0.0;
    for step in 0..options.steps {
        let at = 1 + Rng::new(options.seed, "ogc.time", step, 0).below(cast::to_u32(positions.len() - 1)) as usize;
        let pairs = Step { p: &positions[0], q: &positions[at], soft: &soft, k };
        let smooth = if step >= options.smooth_from { options.smooth } else { 0.0 };
        loss = pairs.gradient(&pairs.motions(), edges, smooth, &mut grad).0;
        let count = f64::from(step + 1);
        let scale = options.learning_rate * (1.0 - BETA[1].powf(count)).sqrt() / (1.0 - BETA[0].powf(count));
        let moments = first.par_chunks_mut(BLOCK * k).zip(second.par_chunks_mut(BLOCK * k));
        logits.par_chunks_mut(BLOCK * k).zip(moments).zip(grad.par_chunks(BLOCK * k)).for_each(|((z, (m, v)), g)| {
            for (((z, m), v), g) in z.iter_mut().zip(m).zip(v).zip(g) {
                *m += (1.0 - BETA[0]) * (g - *m);
                *v += (1.0 - BETA[1]) * (g * g - *v);
                *z -= scale * *m / (v.sqrt() + EPSILON);
            }
        });
        soft = softmax(&logits, k);
    }
    (soft, loss)
}

fn softmax(logits: &[f64], k: usize) -> Vec<f64> {
    let mut soft = logits.to_vec();
    soft.par_chunks_mut(BLOCK * k).for_each(|block| {
        for row in block.chunks_exact_mut(k) {
            let top = row.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            row.iter_mut().for_each(|z| *z = (*z - top).exp());
            let sum: f64 = row.iter().sum();
            row.iter_mut().for_each(|z| *z /= sum);
        }
    });
    soft
}

impl Step<'_> {
    /// The best rigid motion of each object, with soft labels as weights.
    fn motions(&self) -> Vec<Rigid> {
        let centre = |x: &[DVec3]| x.iter().sum::<DVec3>() / x.len() as f64;
        let empty = vec![PairSums::about([centre(self.p), centre(self.q)]); self.k];
        let block = |b: usize| {
            let mut sums = empty.clone();
            for i in b * BLOCK..((b + 1) * BLOCK).min(self.p.len()) {
                for (sums, o) in sums.iter_mut().zip(&self.soft[i * self.k..][..self.k]) {
                    sums.add(*o, self.p[i], self.q[i]);
                }
            }
            sums
        };
        let blocks: Vec<_> = (0..self.p.len().div_ceil(BLOCK)).into_par_iter().map(block).collect();
        let mut all = empty.clone();
        blocks.iter().for_each(|b| all.iter_mut().zip(b).for_each(|(a, b)| a.merge(b)));
        all.iter().map(|sums| sums.fit(1e-9)).collect()
    }

    /// `(L_dyn, L_smooth)` and the gradient of `L_dyn + smooth L_smooth` with respect to the logits; motions are constants.
    fn gradient(&self, motions: &[Rigid], edges: &Edges, smooth: f64, grad: &mut [f64]) -> (f64, f64) {
        let k = self.k;
        let block = |(b, grad): (usize, &mut [f64])| {
            let mut loss = (0.0, 0.0);
            for (slot, g) in grad.chunks_exact_mut(k).enumerate() {
                let one = self.point(b * BLOCK + slot, motions, edges, smooth, g);
                loss = (loss.0 + one.0, loss.1 + one.1);
            }
            loss
        };
        let parts: Vec<(f64, f64)> = grad.par_chunks_mut(BLOCK * k).enumerate().map(block).collect();
        let sum = parts.iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        let n = self.p.len() as f64;
        (sum.0 / n, sum.1 / n)
    }

    /// One point's share of both losses (times n) and its gradient. Each pair of neighbours is visited from both ends, with
    /// half the loss.
    fn point(&self, i: usize, motions: &[Rigid], edges: &Edges, smooth: f64, g: &mut [f64]) -> (f64, f64) {
        let (k, n) = (self.k, self.p.len() as f64);
        let o = &self.soft[i * k..][..k];
        // Σ o = 1, so the weighted residuals sum to the residual of the weighted positions.
        let residual = |m: &Rigid| m.apply(self.p[i]) - self.q[i];
        let e: DVec3 = motions.iter().zip(o).map(|(m, o)| residual(m) * *o).sum();
        let length = e.length();
        let direction = if length < MIN_RESIDUAL { DVec3::ZERO } else { e / (length * n) };
        g.iter_mut().zip(motions).for_each(|(g, m)| *g = direction.dot(residual(m)));
        let each = 1.0 / edges.count as f64;
        let mut rough = 0.0;
        for &h in &edges.ends[edges.begins[i]..edges.begins[i + 1]] {
            for ((g, a), b) in g.iter_mut().zip(o).zip(&self.soft[h as usize * k..][..k]) {
                rough += 0.5 * each * (a - b).abs();
                *g += if a == b { 0.0 } else { smooth * each / n * (a - b).signum() };
            }
        }
        let mean: f64 = g.iter().zip(o).map(|(g, o)| g * o).sum();
        g.iter_mut().zip(o).for_each(|(g, o)| *g = o * (*g - mean));
        (length, rough)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};

    /// Points of balls at five times; each ball rotates and translates differently.
    fn balls(count: usize, n: usize) -> (Vec<Vec<Vec3>>, Vec<u32>) {
        let truth: Vec<u32> = (0..n).map(|i| (i % count) as u32).collect();
        let frame = |t: f32| {
            let place = |i: usize| {
                let mut rng = Rng::new(2, "balls", 0, i as u64);
                let b = (i % count) as f32;
                let local = 0.2 * Vec3::new(rng.normal(), rng.normal(), rng.normal());
                let turn = Quat::from_axis_angle(Vec3::new(1.0, b, -0.5).normalize(), t * (1.0 - b));
                let way = Vec3::new((2.0 * b).sin(), (2.0 * b).cos(), 0.3 * b);
                turn * local + Vec3::new(b, 0.4 * b, 0.0) + way * t
            };
            (0..n).map(place).collect()
        };
        ([0.0, 0.25, 0.5, 0.75, 1.0].map(frame).to_vec(), truth)
    }

    #[test]
    fn the_gradient_is_the_derivative() {
        let (frames, _) = balls(2, 60);
        let positions: Vec<Vec<DVec3>> = frames.iter().map(|f| f.iter().map(|p| p.as_dvec3()).collect()).collect();
        let options = OgcOptions { k: 3, radius: 1.0, ..OgcOptions::default() };
        let edges = Edges::of(&frames[0], &options).unwrap();
        assert!(edges.ends.len() > 300, "both ends of at most 240 pairs: {}", edges.ends.len());
        let mut logits: Vec<f64> = (0..180).map(|i| Rng::new(5, "z", 0, i).normal().into()).collect();
        let soft = softmax(&logits, 3);
        let at = |soft: &[f64], motions: Option<&[Rigid]>, grad: &mut [f64]| {
            let step = Step { p: &positions[0], q: &positions[3], soft, k: 3 };
            let own = step.motions();
            let (dynamic, smooth) = step.gradient(motions.unwrap_or(&own), &edges, 0.3, grad);
            (dynamic + 0.3 * smooth, own)
        };
        let mut grad = vec![0.0; 180];
        let (_, motions) = at(&soft, None, &mut grad);
        let mut unused = vec![0.0; 180];
        for i in (0..180).step_by(7) {
            let kept = logits[i];
            let [up, down] = [1e-6, -1e-6].map(|h| {
                logits[i] = kept + h;
                at(&softmax(&logits, 3), Some(&motions), &mut unused).0
            });
            logits[i] = kept;
            let want = (up - down) / 2e-6;
            assert!((grad[i] - want).abs() < 1e-8 + 1e-6 * want.abs(), "{i}: {} {want}", grad[i]);
        }
    }

    /// At least 97 % of the points share their object with points of their own ball alone.
    #[test]
    fn balls_are_separated() {
        let (frames, truth) = balls(3, 900);
        for options in
            [OgcOptions { k: 3, ..OgcOptions::default() }, OgcOptions { points: 300, ..OgcOptions::default() }]
        {
            let found = Ogc::learn(&frames, &options).unwrap();
            let mut counts = vec![[0usize; 3]; found.k];
            found.labels.iter().zip(&truth).for_each(|(l, t)| counts[*l as usize][*t as usize] += 1);
            let pure: usize = counts.iter().map(|c| *c.iter().max().unwrap()).sum();
            assert!(pure * 100 >= 97 * 900, "{counts:?} loss {}", found.loss);
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same() {
        let (frames, _) = balls(2, 1500);
        let options = OgcOptions { k: 3, steps: 20, ..OgcOptions::default() };
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Ogc::learn(&frames, &options))
        };
        assert_eq!(run(1), run(3));
        assert!(Ogc::learn(&frames[..1], &options).is_none() && Ogc::learn(&[vec![], vec![]], &options).is_none());
    }
}
