//! K-means of weighted rows (Lloyd 1982) from k-means++ seeds (Arthur and Vassilvitskii 2007).
//!
//! Restarts run on a stratified sample of at most [`KMeansOptions::sample`] rows; the best centres are then refined on all
//! rows.

use super::by_weight;
use gs_core::{Rng, cast};
use rayon::prelude::*;

/// Rows per rayon task; sums are added block by block.
const BLOCK: usize = 1024;

/// Number of clusters, restarts and seed of [`kmeans`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KMeansOptions {
    /// Number of clusters, at least 1; fewer are found if there are fewer distinct rows.
    pub k: usize,
    /// Number of k-means++ starts; the one with the smallest inertia is kept.
    pub restarts: u32,
    /// Largest number of Lloyd's steps per start.
    pub steps: u32,
    /// Stops when the summed squared motion of the centres is below this, over the mean square of the rows about their mean.
    pub tolerance: f64,
    /// Largest number of rows for the restarts.
    pub sample: usize,
    /// Seed of the sample and of the starts.
    pub seed: u64,
}

impl Default for KMeansOptions {
    fn default() -> Self {
        Self { k: 8, restarts: 10, steps: 300, tolerance: 1e-6, sample: 16_384, seed: 0 }
    }
}

/// Clusters of rows, heaviest first.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Clusters {
    /// The cluster of each row, `0..k`.
    pub labels: Vec<u32>,
    /// Mean row of each cluster, `[k, width]`.
    pub centres: Vec<f64>,
    /// Number of clusters found, at most [`KMeansOptions::k`].
    pub k: usize,
    /// `Σ w |row − centre|²`.
    pub inertia: f64,
}

/// Rows `[n, width]` with optional weights.
#[derive(Clone, Copy)]
struct Rows<'a> {
    data: &'a [f32],
    width: usize,
    weights: Option<&'a [f32]>,
}

impl Rows<'_> {
    fn len(&self) -> usize {
        self.data.len() / self.width
    }

    fn row(&self, i: usize) -> &[f32] {
        &self.data[i * self.width..][..self.width]
    }

    fn weight(&self, i: usize) -> f64 {
        self.weights.map_or(1.0, |w| f64::from(w[i]))
    }
}

/// Clusters `rows`, `[n, width]`, with non-negative `weights` (1 each if `None`). Without rows there are no clusters.
///
/// # Panics
/// In debug builds, if lengths do not match.
///
/// ```
/// use gs_physics::segment::{KMeansOptions, kmeans};
/// let rows = [0.0, 0.5, 1.0, 7.0, 8.0];
/// let found = kmeans(&rows, 1, None, &KMeansOptions { k: 2, ..KMeansOptions::default() });
/// assert_eq!(found.labels, [0, 0, 0, 1, 1]);
/// assert_eq!((found.centres, found.inertia), (vec![0.5, 7.5], 1.0));
/// ```
pub fn kmeans(rows: &[f32], width: usize, weights: Option<&[f32]>, options: &KMeansOptions) -> Clusters {
    debug_assert!(width > 0 && rows.len().is_multiple_of(width) && options.k > 0);
    let all = Rows { data: rows, width, weights };
    debug_assert!(weights.is_none_or(|w| w.len() == all.len()));
    if all.len() == 0 {
        return Clusters::default();
    }
    let picked: Vec<usize> = sample(all.len(), options.sample.max(options.k), options.seed);
    let data: Vec<f32> = picked.iter().flat_map(|&i| all.row(i)).copied().collect();
    let share: Option<Vec<f32>> = weights.map(|w| picked.iter().map(|&i| w[i]).collect());
    let few = Rows { data: &data, width, weights: share.as_deref() };
    let tolerance = options.tolerance * spread(&few);
    let start = |r: u32| lloyd(&few, seeds(&few, options, r), options.steps, tolerance);
    let best = (0..options.restarts.max(1)).map(start).reduce(|a, b| if b.1 < a.1 { b } else { a });
    let (mut centres, _) = best.unwrap_or_default();
    if picked.len() < all.len() {
        centres = lloyd(&all, centres, options.steps, tolerance).0;
    }
    let (mut labels, inertia) = labelled(&all, &centres);
    let order = by_weight(&mut labels, |i| all.weight(i), centres.len() / width);
    let centres: Vec<f64> = order.iter().flat_map(|&c| &centres[c * width..][..width]).copied().collect();
    Clusters { labels, k: order.len(), centres, inertia }
}

/// Stratified sample of at most `max` of `0..n`: one index from each of `max` equal intervals.
pub(super) fn sample(n: usize, max: usize, seed: u64) -> Vec<usize> {
    let begin = |k: usize| k * n / max;
    let pick = |k: usize| {
        begin(k) + Rng::new(seed, "sample", 0, k as u64).below(cast::to_u32(begin(k + 1) - begin(k))) as usize
    };
    if n <= max { (0..n).collect() } else { (0..max).map(pick).collect() }
}

/// `Σ w |row − mean|² / Σ w`.
fn spread(rows: &Rows<'_>) -> f64 {
    let one = rows.row(0).iter().map(|x| f64::from(*x)).collect();
    let (centre, _) = lloyd(rows, one, 1, 0.0);
    let weight: f64 = (0..rows.len()).map(|i| rows.weight(i)).sum();
    labelled(rows, &centre).1 / weight.max(f64::MIN_POSITIVE)
}

fn squared(row: &[f32], centre: &[f64]) -> f64 {
    row.iter().zip(centre).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum()
}

/// The nearest centre (of equally near ones the first) and its squared distance.
fn nearest(row: &[f32], centres: &[f64], width: usize) -> (usize, f64) {
    let mut best = (0, f64::INFINITY);
    for (c, centre) in centres.chunks_exact(width).enumerate() {
        let d = squared(row, centre);
        if d < best.1 {
            best = (c, d);
        }
    }
    best
}

/// k-means++: each seed is a row picked with probability proportional to its squared distance to those before it.
fn seeds(rows: &Rows<'_>, options: &KMeansOptions, restart: u32) -> Vec<f64> {
    let mut rng = Rng::new(options.seed, "kmeans.seeds", restart, 0);
    let n = rows.len();
    let mut likelihood: Vec<f64> = (0..n).map(|i| rows.weight(i)).collect();
    let mut distance = vec![f64::INFINITY; n];
    let mut centres = Vec::with_capacity(options.k * rows.width);
    for _ in 0..options.k {
        let total: f64 = likelihood.iter().sum();
        if total.is_nan() || total <= 0.0 {
            break;
        }
        let mut left = total * (f64::from(rng.bits()) + 0.5) / 4_294_967_296.0;
        let over = |&i: &usize| {
            left -= likelihood[i];
            left < 0.0
        };
        let last = || (0..n).rfind(|&i| likelihood[i] > 0.0);
        let Some(i) = (0..n).find(over).filter(|&i| likelihood[i] > 0.0).or_else(last) else { break };
        let centre: Vec<f64> = rows.row(i).iter().map(|x| f64::from(*x)).collect();
        distance.par_iter_mut().zip(&mut likelihood).enumerate().for_each(|(i, (d, likelihood))| {
            *d = d.min(squared(rows.row(i), &centre));
            *likelihood = rows.weight(i) * *d;
        });
        centres.extend(centre);
    }
    if centres.is_empty() {
        centres.extend(rows.row(0).iter().map(|x| f64::from(*x)));
    }
    centres
}

/// Sums over the rows of one block.
struct Sums {
    /// `Σ w row` and `Σ w` of each cluster, `[k, width + 1]`.
    clusters: Vec<f64>,
    inertia: f64,
    /// Largest weighted squared distance from a row to its centre, and that row.
    farthest: (f64, usize),
}

fn block(rows: &Rows<'_>, centres: &[f64], range: std::ops::Range<usize>) -> Sums {
    let (width, k) = (rows.width, centres.len() / rows.width);
    let mut sums = Sums { clusters: vec![0.0; k * (width + 1)], inertia: 0.0, farthest: (0.0, 0) };
    for i in range {
        let (row, w) = (rows.row(i), rows.weight(i));
        let (c, d) = nearest(row, centres, width);
        let of = &mut sums.clusters[c * (width + 1)..][..width + 1];
        of.iter_mut().zip(row).for_each(|(s, x)| *s += w * f64::from(*x));
        of[width] += w;
        sums.inertia += w * d;
        if w * d > sums.farthest.0 {
            sums.farthest = (w * d, i);
        }
    }
    sums
}

fn total(rows: &Rows<'_>, centres: &[f64]) -> Sums {
    let blocks = rows.len().div_ceil(BLOCK);
    let range = |b: usize| b * BLOCK..((b + 1) * BLOCK).min(rows.len());
    let all: Vec<Sums> = (0..blocks).into_par_iter().map(|b| block(rows, centres, range(b))).collect();
    all.into_iter()
        .reduce(|mut a, b| {
            a.clusters.iter_mut().zip(&b.clusters).for_each(|(a, b)| *a += b);
            a.inertia += b.inertia;
            a.farthest = if b.farthest.0 > a.farthest.0 { b.farthest } else { a.farthest };
            a
        })
        .expect("at least one row")
}

/// Lloyd's algorithm: moves centres to the means of their rows until they converge; an empty cluster goes to the row farthest
/// from its centre. Gives centres and the inertia of the last assignment.
fn lloyd(rows: &Rows<'_>, mut centres: Vec<f64>, steps: u32, tolerance: f64) -> (Vec<f64>, f64) {
    let width = rows.width;
    let mut inertia = f64::INFINITY;
    for _ in 0..steps {
        let sums = total(rows, &centres);
        inertia = sums.inertia;
        let (mut moved, mut refilled) = (0.0, false);
        for (centre, sums_of) in centres.chunks_exact_mut(width).zip(sums.clusters.chunks_exact(width + 1)) {
            let weight = sums_of[width];
            if weight > 0.0 {
                for (c, s) in centre.iter_mut().zip(sums_of) {
                    let to = s / weight;
                    moved += (to - *c).powi(2);
                    *c = to;
                }
            } else if !refilled && sums.farthest.0 > 0.0 {
                let row = rows.row(sums.farthest.1);
                centre.iter_mut().zip(row).for_each(|(c, x)| *c = f64::from(*x));
                (refilled, moved) = (true, f64::INFINITY);
            }
        }
        if moved <= tolerance {
            break;
        }
    }
    (centres, inertia)
}

fn labelled(rows: &Rows<'_>, centres: &[f64]) -> (Vec<u32>, f64) {
    let mut labels = vec![0u32; rows.len()];
    labels.par_chunks_mut(BLOCK).enumerate().for_each(|(b, labels)| {
        for (k, label) in labels.iter_mut().enumerate() {
            *label = cast::to_u32(nearest(rows.row(b * BLOCK + k), centres, rows.width).0);
        }
    });
    (labels, total(rows, centres).inertia)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `sizes[c]` points around `(10 c, 0)`.
    fn blobs(sizes: &[usize], noise: f32) -> (Vec<f32>, Vec<u32>) {
        let mut rng = Rng::new(3, "blobs", 0, 0);
        let (mut rows, mut truth) = (Vec::new(), Vec::new());
        for (c, &n) in sizes.iter().enumerate() {
            for _ in 0..n {
                rows.extend([10.0 * c as f32 + noise * rng.normal(), noise * rng.normal()]);
                truth.push(c as u32);
            }
        }
        (rows, truth)
    }

    #[test]
    fn blobs_are_found_heaviest_first() {
        let (rows, truth) = blobs(&[30, 500, 200, 90], 1.0);
        let found = kmeans(&rows, 2, None, &KMeansOptions { k: 4, ..Default::default() });
        let rank = [3, 0, 1, 2];
        assert!(found.labels.iter().zip(&truth).all(|(l, t)| *l == rank[*t as usize]));
        assert!((found.centres[0] - 10.0).abs() < 0.2 && (found.centres[2] - 20.0).abs() < 0.3);
        assert!((found.inertia / (2.0 * 820.0) - 1.0).abs() < 0.1, "two unit variances a row: {}", found.inertia);
    }

    /// The optimum of a line of 7 numbers, by trying every cut.
    #[test]
    fn the_best_of_all_partitions_is_found() {
        let rows = [0.0f32, 0.4, 1.0, 3.0, 3.2, 6.0, 6.1];
        let cost = |part: &[f32]| {
            let mean = part.iter().map(|x| f64::from(*x)).sum::<f64>() / part.len() as f64;
            part.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>()
        };
        let cuts = (1..6).flat_map(|a| (a + 1..7).map(move |b| (a, b)));
        let best = cuts.map(|(a, b)| cost(&rows[..a]) + cost(&rows[a..b]) + cost(&rows[b..]));
        let best = best.fold(f64::INFINITY, f64::min);
        let found = kmeans(&rows, 1, None, &KMeansOptions { k: 3, ..Default::default() });
        assert!((found.inertia - best).abs() < 1e-12 && found.labels == [0, 0, 0, 1, 1, 2, 2]);
    }

    #[test]
    fn weights_are_repetitions() {
        let rows = [0.0f32, 1.0, 5.0, 6.0];
        let heavy = kmeans(&rows, 1, Some(&[3.0, 1.0, 1.0, 0.0]), &KMeansOptions { k: 2, ..Default::default() });
        let repeated = kmeans(&[0.0, 0.0, 0.0, 1.0, 5.0], 1, None, &KMeansOptions { k: 2, ..Default::default() });
        assert_eq!(heavy.centres, [0.25, 5.0]);
        assert_eq!((heavy.centres, heavy.inertia), (repeated.centres, repeated.inertia));
        assert_eq!(heavy.labels, [0, 0, 1, 1]);
    }

    #[test]
    fn any_number_of_threads_and_more_rows_than_the_sample() {
        let (rows, truth) = blobs(&[2500, 1500, 3100], 0.7);
        let options = KMeansOptions { k: 3, sample: 500, ..Default::default() };
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| kmeans(&rows, 2, None, &options))
        };
        let one = run(1);
        assert_eq!(one, run(3));
        assert!(one.labels.iter().zip(&truth).all(|(l, t)| *l == [1, 2, 0][*t as usize]));
    }

    #[test]
    fn few_rows() {
        let five = KMeansOptions { k: 5, ..Default::default() };
        assert_eq!(kmeans(&[], 3, None, &five), Clusters::default());
        let same = kmeans(&[1.0, 2.0, 1.0, 2.0, 1.0, 2.0], 2, None, &five);
        assert_eq!((same.k, same.labels, same.inertia), (1, vec![0, 0, 0], 0.0));
        let two = kmeans(&[1.0, 4.0, 1.0], 1, None, &five);
        assert_eq!((two.k, two.labels), (2, vec![0, 1, 0]));
        let massless = kmeans(&[1.0, 4.0], 1, Some(&[0.0, 0.0]), &five);
        assert_eq!(massless.labels, [0, 0]);
    }
}
